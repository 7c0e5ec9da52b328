"""Tokens to a tree: recursive descent."""

from typing import NoReturn

from structured_text import syntax as tree
from structured_text.errors import Place
from structured_text.lexer import LIBRARY, NAME, NUMBER, RESERVED, Token, tokens
from structured_text.types import BOOL, ELEMENTARY, FLOAT

_BINARY = (("OR",), ("XOR",), ("AND",), ("=", "<>"), ("<", ">", "<=", ">="), ("+", "-"), ("*", "/", "MOD"))
_SECTIONS = {"VAR", "VAR_INPUT", "VAR_OUTPUT", "VAR_IN_OUT"}
_UNITS = {"FUNCTION", "FUNCTION_BLOCK", "PROGRAM"}
Declaration = tree.TypeDeclaration | tree.Unit | tree.Globals


class Parser:
    """The declarations of one text."""

    def __init__(self, file: str, text: str) -> None:
        """Raises StructuredTextError for what are no tokens."""
        self._file = file
        self._tokens = list(tokens(file, text))
        self._at = 0

    def declarations(self) -> list[Declaration]:
        """All of the text. Raises StructuredTextError."""
        found: list[Declaration] = []
        while self._peek.kind != "end":
            if self._accept("TYPE"):
                while not self._accept("END_TYPE"):
                    found.append(self._type_declaration())
            elif self._peek.word == "VAR_GLOBAL":
                found.append(tree.Globals(self._file, self._section()))
            elif self._peek.word in _UNITS:
                found.append(self._unit())
            else:
                self._wrong("TYPE, VAR_GLOBAL, FUNCTION, FUNCTION_BLOCK or PROGRAM")
        return found

    # tokens

    @property
    def _peek(self) -> Token:
        return self._tokens[self._at]

    def _next(self) -> Token:
        self._at += 1
        return self._tokens[self._at - 1]

    def _accept(self, *words: str) -> Token | None:
        return self._next() if self._peek.word in words and self._peek.kind != NUMBER else None

    def _expect(self, word: str) -> Token:
        return self._accept(word) or self._wrong(word)

    def _wrong(self, expected: str) -> NoReturn:
        Place(self._file, self._peek.line).refuse("syntax", f"expected {expected}, found {self._peek.text}")

    def _new_name(self) -> Token:
        """A name that is declared."""
        token = self._peek
        if token.kind != NAME:
            self._wrong("a name")
        if token.word in RESERVED or token.word in ELEMENTARY:
            Place(self._file, token.line).refuse("reserved", f"{token.text} is a reserved word")
        if token.word in LIBRARY or ("_TO_" in token.word and token.word.split("_TO_")[-1] in ELEMENTARY):
            Place(self._file, token.line).refuse("reserved", f"{token.text} is a standard function")
        if token.text.startswith("__"):
            Place(self._file, token.line).refuse("reserved", f"{token.text} begins with two underscores")
        return self._next()

    # declarations

    def _type_declaration(self) -> tree.TypeDeclaration:
        name = self._new_name()
        made = tree.TypeDeclaration(self._file, name.line, name.text)
        self._expect(":")
        if self._accept("STRUCT"):
            made.members = []
            while not self._accept("END_STRUCT"):
                made.members += self._declared("VAR", False)
            self._accept(";")
            return made
        if self._accept("("):
            made.values = []
            while True:
                value = self._new_name()
                made.values.append(
                    (value.text, self._expression() if self._accept(":=") else None, value.line)
                )
                if not self._accept(","):
                    break
            self._expect(")")
            if self._peek.kind == NAME:
                made.base = self._next().word
        else:
            made.alias = self._type_text()
        self._expect(";")
        return made

    def _type_text(self) -> tree.TypeText:
        line = self._peek.line
        if not self._accept("ARRAY"):
            if self._peek.kind != NAME:
                self._wrong("a type")
            return tree.TypeText(line, self._next().text)
        self._expect("[")
        bounds = []
        while True:
            low = self._expression()
            self._expect("..")
            bounds.append((low, self._expression()))
            if not self._accept(","):
                break
        self._expect("]")
        self._expect("OF")
        return tree.TypeText(line, "ARRAY", bounds, self._type_text())

    def _section(self) -> list[tree.VariableDeclaration]:
        section, constant = self._next().word, self._accept("CONSTANT") is not None
        declared: list[tree.VariableDeclaration] = []
        while not self._accept("END_VAR"):
            declared += self._declared(section, constant)
        return declared

    def _declared(self, section: str, constant: bool) -> list[tree.VariableDeclaration]:
        names = [self._new_name()]
        while self._accept(","):
            names.append(self._new_name())
        self._expect(":")
        of = self._type_text()
        initial = self._initializer() if self._accept(":=") else None
        self._expect(";")
        return [tree.VariableDeclaration(n.line, n.text, section, of, initial, constant) for n in names]

    def _initializer(self) -> tree.Initializer:
        line = self._peek.line
        if self._accept("["):
            values = [self._initializer()]
            while self._accept(","):
                values.append(self._initializer())
            self._expect("]")
            return tree.Initializer(line, values)
        named = self._tokens[self._at + 1 : self._at + 3]
        if self._peek.word == "(" and named[0].kind == NAME and named[1].word == ":=":
            self._next()
            parts: dict[str, tree.Initializer] = {}
            while True:
                name = self._next()
                self._expect(":=")
                parts[name.text] = self._initializer()
                if not self._accept(","):
                    break
            self._expect(")")
            return tree.Initializer(line, parts)
        return tree.Initializer(line, self._expression())

    def _unit(self) -> tree.Unit:
        kind, name = self._next(), self._new_name()
        result = None
        if kind.word == "FUNCTION":
            self._expect(":")
            result = self._type_text()
        declared: list[tree.VariableDeclaration] = []
        while self._peek.word in _SECTIONS:
            declared += self._section()
        body = self._body(f"END_{kind.word}")
        self._next()
        return tree.Unit(self._file, name.line, kind.word, name.text, result, declared, body)

    # statements

    def _body(self, *ends: str) -> tree.Body:
        """Statements up to one of the words ``ends``, which is left."""
        body: tree.Body = []
        while self._peek.word not in ends or self._peek.kind != NAME:
            if self._peek.kind == "end" or self._peek.word.startswith("END_"):
                self._wrong(" or ".join(ends))
            if not self._accept(";"):
                body.append(self._statement())
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
        if self._accept(":="):
            value = self._expression()
            self._expect(";")
            return tree.Assignment(token.line, target, value)
        if not isinstance(target, tree.Call):
            self._wrong(":=")
        self._expect(";")
        return tree.CallStatement(token.line, target)

    def _ended(self, word: str) -> None:
        self._expect(word)
        self._accept(";")

    def _if(self, line: int) -> tree.If:
        branches = []
        while True:
            condition = self._expression()
            self._expect("THEN")
            branches.append((condition, self._body("ELSIF", "ELSE", "END_IF")))
            if not self._accept("ELSIF"):
                break
        otherwise = self._body("END_IF") if self._accept("ELSE") else []
        self._ended("END_IF")
        return tree.If(line, branches, otherwise)

    def _case(self, line: int) -> tree.Case:
        selector = self._expression()
        self._expect("OF")
        branches = []
        while self._peek.word not in ("ELSE", "END_CASE"):
            labels = []
            while True:
                low = self._expression()
                labels.append((low, self._expression() if self._accept("..") else low))
                if not self._accept(","):
                    break
            self._expect(":")
            branches.append((labels, self._case_body()))
        otherwise = self._body("END_CASE") if self._accept("ELSE") else []
        self._ended("END_CASE")
        return tree.Case(line, selector, branches, otherwise)

    def _case_body(self) -> tree.Body:
        body: tree.Body = []
        while self._peek.word not in ("ELSE", "END_CASE") and not self._at_label():
            if self._peek.kind == "end":
                self._wrong("END_CASE")
            if not self._accept(";"):
                body.append(self._statement())
        return body

    def _at_label(self) -> bool:
        """Whether a CASE label stands here: a : comes before any := ; or (."""
        for token in self._tokens[self._at : self._at + 64]:
            if token.word == ":":
                return True
            if (token.kind == NAME and token.word in RESERVED) or token.word in (":=", ";", "(", "["):
                return False
        return False

    def _for(self, line: int) -> tree.For:
        name = self._next()
        if name.kind != NAME:
            self._wrong("a name")
        self._expect(":=")
        first = self._expression()
        self._expect("TO")
        last = self._expression()
        step = self._expression() if self._accept("BY") else None
        self._expect("DO")
        body = self._body("END_FOR")
        self._ended("END_FOR")
        return tree.For(line, tree.Name(line, name.text), first, last, step, body)

    def _while(self, line: int) -> tree.While:
        condition = self._expression()
        self._expect("DO")
        body = self._body("END_WHILE")
        self._ended("END_WHILE")
        return tree.While(line, condition, body, False)

    def _repeat(self, line: int) -> tree.While:
        body = self._body("UNTIL")
        self._expect("UNTIL")
        condition = self._expression()
        self._ended("END_REPEAT")
        return tree.While(line, condition, body, True)

    # expressions

    def _expression(self, level: int = 0) -> tree.Expression:
        if level == len(_BINARY):
            return self._unary()
        left = self._expression(level + 1)
        while sign := self._accept(*_BINARY[level]):
            left = tree.Binary(sign.line, sign.word, left, self._expression(level + 1))
        return left

    def _unary(self) -> tree.Expression:
        sign = self._accept("-", "NOT", "+")
        if sign is None:
            return self._primary()
        operand = self._unary()
        if sign.word == "+":
            return operand
        if sign.word == "-" and isinstance(operand, tree.Literal) and not isinstance(operand.value, bool):
            return tree.Literal(sign.line, -operand.value, operand.named)
        return tree.Unary(sign.line, sign.word, operand)

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
        named = None
        digits = token.text.replace("_", "")
        if digits[0].isalpha():
            prefix, digits = digits.split("#", 1)
            named = ELEMENTARY.get(prefix.upper())
            if named is None:
                Place(self._file, token.line).refuse("type", f"{prefix} is no type of a literal")
        negative, digits = digits.startswith("-"), digits.lstrip("+-")
        if "#" in digits:
            base, digits = digits.split("#")
            try:
                value: float = int(digits, int(base))
            except ValueError:
                Place(self._file, token.line).refuse(
                    "syntax", f"{token.text} has digits beyond its base {base}"
                )
        else:
            value = float(digits) if "." in digits else int(digits)
        if named is BOOL:
            value = bool(value)
        elif named is not None and named.kind == FLOAT:
            value = float(value)
        return tree.Literal(token.line, -value if negative else value, named)

    def _place(self) -> tree.Expression:
        """A variable with its members and indices, or a call."""
        token = self._peek
        if token.kind != NAME or (token.word in RESERVED and token.word not in ELEMENTARY):
            self._wrong("an expression")
        self._next()
        found: tree.Expression = tree.Name(token.line, token.text)
        while True:
            if self._accept("."):
                member = self._next()
                if member.kind != NAME:
                    self._at -= 1
                    self._wrong("the name of a member")
                found = tree.Member(token.line, found, member.text)
            elif self._accept("["):
                indices = [self._expression()]
                while self._accept(","):
                    indices.append(self._expression())
                self._expect("]")
                found = tree.Index(token.line, found, indices)
            elif self._accept("("):
                found = tree.Call(token.line, found, self._arguments())
            else:
                return found

    def _arguments(self) -> list[tree.Argument]:
        given: list[tree.Argument] = []
        while not self._accept(")"):
            if given:
                self._expect(",")
            name = None
            sign = self._tokens[self._at + 1].word
            if self._peek.kind == NAME and sign in (":=", "=>"):
                name = self._next().text
                self._next()
            given.append(tree.Argument(name, self._expression(), name is not None and sign == "=>"))
        return given
