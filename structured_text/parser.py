"""Tokens to a tree: recursive descent, which goes on behind a wrong statement or declaration."""

import math
from itertools import chain
from typing import Any

from structured_text import syntax as tree
from structured_text.lexer import LEFT_OUT, NAME, NUMBER, RESERVED, Token, why_left_out
from structured_text.reader import SECTIONS, TOP, UNITS, Reader
from structured_text.types import BOOL, ELEMENTARY

_BINARY = (
    ("OR", "OR_ELSE"), ("XOR",), ("AND", "AND_THEN"), ("=", "<>"), ("<", ">", "<=", ">="), ("+", "-"),
    ("*", "/", "MOD"),
)  # fmt: skip
_LEVELS = {sign: level for level, signs in enumerate(_BINARY) for sign in signs}
_BEGINS = {"", ";", "IF", "CASE", "FOR", "WHILE", "REPEAT", "EXIT", "CONTINUE", "RETURN"}
_MOST_ELEMENTS = 1 << 16
Declaration = tree.TypeDeclaration | tree.Unit | tree.Globals


class Parser(Reader):
    """The declarations of one text."""

    def declarations(self) -> list[Declaration]:
        """All of the text that is of the language. Raises StructuredTextError without ``refusals``."""
        found: list[Declaration] = []
        while self._peek.word:
            self._ends = frozenset(TOP)
            with self._kept(TOP, declares=True):
                self._declaration(found)
        if self._tells:
            self._refusals.tell()
        return found

    def _declaration(self, found: list[Declaration]) -> None:
        if self._accept("TYPE"):
            self._until("END_TYPE", lambda: found.append(self._type_declaration()))
        elif self._peek.word == "VAR_GLOBAL":
            found.append(tree.Globals(self._file, self._section()))
        elif self._peek.word in UNITS:
            found.append(self._unit())
        else:
            self._wrong("TYPE, VAR_GLOBAL, FUNCTION, FUNCTION_BLOCK or PROGRAM")

    # declarations

    def _type_declaration(self) -> tree.TypeDeclaration:
        name = self._new_name()
        made = tree.TypeDeclaration(self._file, name.line, name.text)
        self._expect(":")
        if self._accept("STRUCT"):
            members = made.members = list[tree.VariableDeclaration]()
            self._until("END_STRUCT", lambda: members.extend(self._declared("VAR", False)))
            self._accept(";")
            return made
        if self._accept("("):
            made.values = self._listed(self._enumerator, ")")
            made.base = self._next().word if self._peek.kind == NAME else made.base
        else:
            made.alias = self._type_text()
        self._expect(";")
        return made

    def _enumerator(self) -> tuple[str, tree.Expression | None, int]:
        value = self._new_name()
        return value.text, self._expression() if self._accept(":=") else None, value.line

    def _type_text(self) -> tree.TypeText:
        line = self._peek.line
        if not self._accept("ARRAY"):
            if self._peek.word in LEFT_OUT and self._peek.word in RESERVED:
                self._wrong("a type")
            return tree.TypeText(line, self._name("a type").text)
        with self._deeper():
            self._expect("[")
            bounds = self._listed(lambda: (self._expression(), self._after("..")), "]")
            self._expect("OF")
            return tree.TypeText(line, "ARRAY", bounds, self._type_text())

    def _section(self) -> list[tree.VariableDeclaration]:
        section, constant = self._next(), self._accept("CONSTANT") is not None
        kind = self._accept("RETAIN", "NON_RETAIN", "PERSISTENT") or section
        with self._refusals.kept():  # what is declared so is read all the same
            left_out = f"{kind.text} is left out{why_left_out(kind.word)}"
            self._demand(kind.word not in LEFT_OUT, "syntax", left_out, kind.line)
        declared: list[tree.VariableDeclaration] = []
        self._until("END_VAR", lambda: declared.extend(self._declared(section.word, constant)))
        return declared

    def _declared(self, section: str, constant: bool) -> list[tree.VariableDeclaration]:
        names = self._listed(self._new_name)
        self._expect(":")
        of = self._type_text()
        initial = self._initializer() if self._accept(":=") else None
        self._expect(";")
        return [tree.VariableDeclaration(n.line, n.text, section, of, initial, constant) for n in names]

    def _initializer(self) -> tree.Initializer:
        line = self._peek.line
        with self._deeper():
            if self._accept("["):
                return tree.Initializer(line, list(chain(*self._listed(self._elements, "]"))))
            if self._peek.word == "(" and self._named(1):
                self._next()
                return tree.Initializer(line, dict(self._listed(self._part, ")")))
            return tree.Initializer(line, self._expression())

    def _named(self, further: int = 0) -> bool:
        """Whether a name with := or => stands here, or so much ``further``."""
        name, *sign = self._tokens[self._at + further : self._at + further + 2]
        return name.kind == NAME and sign[0].word in (":=", "=>")

    def _elements(self) -> list[tree.Initializer]:
        """An element, or ``count(element)``."""
        first = self._initializer()
        if not (isinstance(first.value, tree.Literal) and self._accept("(")):
            return [first]
        count, element = first.value.value, self._initializer()
        self._expect(")")
        few = type(count) is int and 0 < count <= _MOST_ELEMENTS
        self._demand(few, "value", f"{count} elements: 1 to {_MOST_ELEMENTS} are listed so", first.line)
        return [element] * count

    def _part(self) -> tuple[str, tree.Initializer]:
        name = self._name("a name")
        self._expect(":=")
        return name.text, self._initializer()

    def _unit(self) -> tree.Unit:
        kind, name = self._next(), self._new_name()
        result = self._type_text() if kind.word == "FUNCTION" and self._accept(":") else None
        declared: list[tree.VariableDeclaration] = []
        while self._peek.word in SECTIONS:
            declared += self._section()
        body = self._body(f"END_{kind.word}")
        self._next()
        return tree.Unit(self._file, name.line, kind.word, name.text, result, declared, body)

    # statements

    def _body(self, *ends: str, labelled: bool = False) -> tree.Body:
        """Statements up to one of the words ``ends``, or a label of CASE, which is left."""
        body: tree.Body = []
        outside, within = self._ends, self._ends | set(ends)
        stops = _BEGINS | within
        with self._deeper():
            while self._peek.word not in ends and not (labelled and self._at_label()):
                self._ends = within
                if self._peek.word in outside:
                    self._wrong(" or ".join(ends))
                with self._kept(stops):
                    if not self._accept(";"):
                        body.append(self._statement())
        self._ends = outside
        return body

    def _statement(self) -> tree.Statement:
        token = self._peek
        made = {
            "IF": self._if, "CASE": self._case, "FOR": self._for, "WHILE": self._while,
            "REPEAT": self._repeat,
        }.get(token.word)  # fmt: skip
        if made is not None:
            self._next()
            return made(token.line)
        if self._accept("EXIT", "CONTINUE", "RETURN"):
            self._expect(";")
            return tree.Jump(token.line, token.word)
        target = self._place()
        calls = isinstance(target, tree.Call) and self._peek.word != ":="
        found = (None, target) if calls else (target, self._after(":="))
        self._expect(";")
        return tree.Assignment(token.line, *found)

    def _ended(self, word: str) -> tree.Body:
        """Statements up to ``word``, which is taken."""
        body = self._body(word)
        self._next()
        self._accept(";")
        return body

    def _if(self, line: int) -> tree.If:
        branches = []
        while True:
            condition = self._expression()
            self._expect("THEN")
            branches.append((condition, self._body("ELSIF", "ELSE", "END_IF")))
            if not self._accept("ELSIF"):
                break
        self._accept("ELSE")
        return tree.If(line, branches, self._ended("END_IF"))

    def _case(self, line: int) -> tree.Case:
        selector = self._expression()
        self._expect("OF")
        branches = []
        while self._peek.word not in ("ELSE", "END_CASE"):
            labels = self._listed(self._label)
            self._expect(":")
            branches.append((labels, self._body("ELSE", "END_CASE", labelled=True)))
        self._accept("ELSE")
        return tree.Case(line, selector, branches, self._ended("END_CASE"))

    def _label(self) -> tuple[tree.Expression, tree.Expression]:
        low = self._expression()
        return low, self._after("..") if self._peek.word == ".." else low

    def _at_label(self) -> bool:
        """Whether a CASE label stands here: a : comes before any := ; or (."""
        at = self._at
        while self._tokens[at].word not in (":=", ";", "(", "[", "") and (
            self._tokens[at].kind != NAME or self._tokens[at].word not in RESERVED
        ):
            if self._tokens[at].word == ":":
                return True
            at += 1
        return False

    def _for(self, line: int) -> tree.For:
        name = tree.Name(line, self._name("a name").text)
        first, last = self._after(":="), self._after("TO")
        step = self._after("BY") if self._peek.word == "BY" else None
        self._expect("DO")
        return tree.For(line, name, first, last, step, self._ended("END_FOR"))

    def _while(self, line: int) -> tree.While:
        condition = self._expression()
        self._expect("DO")
        return tree.While(line, condition, self._ended("END_WHILE"), False)

    def _repeat(self, line: int) -> tree.While:
        body = self._body("UNTIL")
        condition = self._after("UNTIL")
        self._expect("END_REPEAT")
        self._accept(";")
        return tree.While(line, condition, body, True)

    # expressions

    def _after(self, word: str) -> tree.Expression:
        self._expect(word)
        return self._expression()

    def _expression(self, level: int = 0) -> tree.Expression:
        with self._deeper():
            left = self._unary()
            while _LEVELS.get(self._peek.word, -1) >= level:
                sign = self._next()
                right = self._expression(_LEVELS[sign.word] + 1)
                left = self._made(tree.Binary(sign.line, sign.word, left, right), left, right)
            return left

    def _unary(self) -> tree.Expression:
        sign = self._accept("-", "NOT", "+")
        if sign is None:
            return self._primary()
        operand = self._expression(len(_BINARY))
        if sign.word == "+":
            return operand
        if sign.word == "-" and isinstance(operand, tree.Literal) and not isinstance(operand.value, bool):
            return tree.Literal(sign.line, -operand.value, operand.named)
        return self._made(tree.Unary(sign.line, sign.word, operand), operand)

    def _primary(self) -> tree.Expression:
        if self._accept("("):
            inner = self._expression()
            self._expect(")")
            return inner
        if self._peek.kind == NUMBER:
            return self._number(self._next())
        if word := self._accept("TRUE", "FALSE"):
            return tree.Literal(word.line, word.word == "TRUE", BOOL)
        return self._place()

    def _number(self, token: Token) -> tree.Literal:
        text = token.text.replace("_", "")
        *base, digits = text.replace("#-", "#").replace("#+", "#").split("#")
        prefix = base.pop(0) if text[0].isalpha() else ""
        named = ELEMENTARY.get(prefix.upper())
        self._demand(named or not prefix, "type", f"{prefix} is no type of a literal", token.line)
        radix = int(base[0]) if base else 10
        beyond = f"{token.text} has digits beyond its base {radix}"
        self._demand(all(int(d, 16) < radix for d in digits if base), "syntax", beyond, token.line)
        value: Any = float(digits) if "." in digits else int(digits, radix)
        self._demand(value != math.inf, "value", f"{token.text} does not fit LREAL", token.line)
        value = bool(value) if named is BOOL and value in (0, 1) else value
        return tree.Literal(token.line, -value if "#-" in text else value, named)

    def _place(self) -> tree.Expression:
        """A variable with its members and indices, or a call."""
        token = self._peek
        if token.kind != NAME or (token.word in RESERVED and token.word not in ELEMENTARY):
            self._wrong("an expression")
        self._next()
        found: tree.Expression = tree.Name(token.line, token.text)
        while sign := self._accept(".", "#", "[", "("):
            parts = [found]
            if sign.word == "[":
                parts += (indices := self._listed(self._expression, "]"))
                found = tree.Index(token.line, found, indices)
            elif sign.word == "(":
                given = [] if self._accept(")") else self._listed(self._argument, ")")
                found = tree.Call(token.line, found, given)
                parts += [value for _, value, _ in given]
            else:
                found = tree.Member(token.line, found, self._name("the name of a member").text)
            self._made(found, *parts)
        return found

    def _argument(self) -> tree.Argument:
        if not self._named():
            return None, self._expression(), False
        name, sign = self._next().text, self._next().word
        return name, self._expression(), sign == "=>"
