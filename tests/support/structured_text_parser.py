"""IEC 61131-3 structured text as Python: the part of the language that docs/protocol/*.st keeps to.

Types are never converted by themselves, and arithmetic on bit strings is refused: stricter than a compiler.
"""

import re
from typing import Any, NamedTuple

from tests.support.structured_text_values import (
    BITS,
    ELEMENTARY,
    SIGNED,
    UNSIGNED,
    Runtime,
    StructuredTextError,
)

_TOKEN = re.compile(
    r"\s+|\(\*.*?\*\)|//[^\n]*"
    r"|(?P<number>(?:[A-Z]+#)?(?:16#[0-9A-F]+|\d+\.\d+(?:E[+-]?\d+)?|\d+(?!\.\d)))"
    r"|(?P<name>[A-Za-z_]\w*)|(?P<sign>:=|=>|<=|>=|<>|\.\.|[-+*/=<>()\[\]:;,.])",
    re.DOTALL,
)
_BINARY = (("OR",), ("XOR",), ("AND",), ("=", "<>"), ("<", ">", "<=", ">="), ("+", "-"), ("*", "/", "MOD"))
_SIGNS = {"AND": "&", "OR": "|", "XOR": "^", "=": "==", "<>": "!="}
Literal = "literal"


class ArrayType(NamedTuple):
    """``ARRAY[low..high] OF of``; ``low`` is 0."""

    length: int
    of: str


class FunctionText(NamedTuple):
    """A function: its result's type, its variables by section, and its statements as Python."""

    result: str
    variables: dict[str, dict[str, Any]]
    body: str


class Parser:
    """Recursive descent; every expression becomes Python and a type.

    What the text declares goes into ``types`` and ``functions``, which may hold other texts' already.
    """

    def __init__(self, text: str, types: dict[str, Any], functions: dict[str, FunctionText]) -> None:
        self._tokens: list[str] = []
        at = 0
        while at < len(text):
            match = _TOKEN.match(text, at)
            if match is None:
                raise StructuredTextError(f"at {text[at : at + 30]!r}")
            if match.lastgroup:
                self._tokens.append(match[0])
            at = match.end()
        self._types = types
        self._functions = functions
        self._variables: dict[str, Any] = {}
        self._references: set[str] = set()

    def _peek(self) -> str:
        return self._tokens[0] if self._tokens else ""

    def _take(self, *wanted: str) -> str:
        token = self._tokens.pop(0)
        if wanted and token not in wanted:
            raise StructuredTextError(f"{token!r}, wanted {wanted}, before {' '.join(self._tokens[:8])!r}")
        return token

    # declarations

    def declarations(self) -> None:
        while self._tokens:
            if self._take("TYPE", "FUNCTION") == "TYPE":
                self._type()
            else:
                self._function()

    def _type(self) -> None:
        name = self._take()
        self._take(":")
        if self._peek() == "STRUCT":
            self._take()
            self._types[name] = self._declared("END_STRUCT")
        else:
            self._types[name] = self._kind()
            self._take(";")
        self._take("END_TYPE")

    def _declared(self, end: str) -> dict[str, Any]:
        found: dict[str, Any] = {}
        while self._peek() != end:
            name = self._take()
            self._take(":")
            found[name] = self._kind()
            self._take(";")
        self._take(end)
        return found

    def _kind(self) -> Any:
        name = self._take()
        if name != "ARRAY":
            if name not in ELEMENTARY and name not in self._types:
                raise StructuredTextError(f"type {name} is not declared")
            return name
        self._take("[")
        self._take("0")
        self._take("..")
        high = int(self._take())
        self._take("]")
        self._take("OF")
        return ArrayType(high + 1, self._take())

    def _function(self) -> None:
        name = self._take()
        self._take(":")
        result = self._kind()
        sections: dict[str, dict[str, Any]] = {}
        while self._peek().startswith("VAR"):
            section = self._take("VAR_INPUT", "VAR_IN_OUT", "VAR_OUTPUT", "VAR")
            sections[section] = self._declared("END_VAR")
        self._variables = {name: result}
        for variables in sections.values():
            self._variables |= variables
        by_reference = {**sections.get("VAR_IN_OUT", {}), **sections.get("VAR_OUTPUT", {})}
        self._references = {n for n, kind in by_reference.items() if kind in ELEMENTARY}
        # Entered before its body is read, for what calls it; the text is in order, so nothing calls ahead.
        body = self._statements("    ", "END_FUNCTION")
        self._take("END_FUNCTION")
        self._functions[name] = FunctionText(result, sections, body)

    # statements

    def _statements(self, indent: str, *ends: str) -> str:
        lines = ""
        while self._peek() not in ends:
            lines += self._statement(indent)
        return lines or f"{indent}pass\n"

    def _statement(self, indent: str) -> str:
        word = self._peek()
        if word == "IF":
            return self._if(indent)
        if word in ("WHILE", "FOR"):
            return self._while(indent) if word == "WHILE" else self._for(indent)
        place, key, kind = self._place()
        self._take(":=")
        value = self._as(self._expression(), kind)
        self._take(";")
        return f"{indent}{self._stored(place, key, value)}\n"

    def _stored(self, place: str, key: str, value: str) -> str:
        if place == "v" and key in self._references:
            return f"v.{key}.set({value})"
        return f"{place}[{key}] = {value}" if key.startswith("_.at(") else f"{place}.{key} = {value}"

    def _if(self, indent: str) -> str:
        lines, word = "", "if"
        while self._peek() in ("IF", "ELSIF"):
            self._take()
            condition = self._as(self._expression(), "BOOL")
            self._take("THEN")
            body = self._statements(indent + "    ", "ELSIF", "ELSE", "END_IF")
            lines += f"{indent}{word} {condition}:\n{body}"
            word = "elif"
        if self._peek() == "ELSE":
            self._take()
            lines += f"{indent}else:\n{self._statements(indent + '    ', 'END_IF')}"
        self._take("END_IF")
        return lines

    def _while(self, indent: str) -> str:
        self._take("WHILE")
        condition = self._as(self._expression(), "BOOL")
        self._take("DO")
        body = self._statements(indent + "    ", "END_WHILE")
        self._take("END_WHILE")
        return f"{indent}while {condition}:\n{body}"

    def _for(self, indent: str) -> str:
        self._take("FOR")
        name = self._take()
        kind = self._variables[name]
        self._take(":=")
        first = self._as(self._expression(), kind)
        self._take("TO")
        last = self._as(self._expression(), kind)
        step = 1
        if self._peek() == "BY":
            self._take()
            self._take("-")
            step = -int(self._take())
        self._take("DO")
        body = self._statements(indent + "    ", "END_FOR")
        self._take("END_FOR")
        return f"{indent}for v.{name} in range({first}, {last} + {step}, {step}):\n{body}"

    # expressions

    def _as(self, expression: tuple[str, Any], kind: Any) -> str:
        code, found = expression
        if found == Literal and (kind in UNSIGNED or kind in SIGNED or kind in BITS):
            Runtime.fit(eval(code), kind)
        elif found != kind:
            raise StructuredTextError(f"{code} is {found}, wanted {kind}")
        return code

    def _expression(self, level: int = 0) -> tuple[str, Any]:
        if level == len(_BINARY):
            return self._unary()
        left = self._expression(level + 1)
        while self._peek() in _BINARY[level]:
            left = self._joined(left, self._take(), self._expression(level + 1))
        return left

    def _joined(self, left: tuple[str, Any], sign: str, right: tuple[str, Any]) -> tuple[str, Any]:
        kind = right[1] if left[1] == Literal else left[1]
        if kind == Literal:
            return str(eval(f"{left[0]} {sign} {right[0]}")), Literal
        a, b = self._as(left, kind), self._as(right, kind)
        if sign in ("AND", "OR", "XOR"):
            if kind != "BOOL" and kind not in BITS:
                raise StructuredTextError(f"{sign} of {kind}")
            return f"({a} {_SIGNS[sign]} {b})", kind
        if sign in ("=", "<>", "<", ">", "<=", ">="):
            if kind in BITS and sign not in ("=", "<>"):
                raise StructuredTextError(f"{sign} of {kind}")
            return f"({a} {_SIGNS.get(sign, sign)} {b})", "BOOL"
        if kind in BITS or kind == "BOOL":
            raise StructuredTextError(f"{sign} of {kind}")
        if sign == "/":
            return f"_.divided({a}, {b})", kind
        if sign == "MOD":
            return f"({a} - {b} * _.divided({a}, {b}))", kind
        return f"_.wrap({a} {sign} {b}, {kind!r})", kind

    def _unary(self) -> tuple[str, Any]:
        if self._peek() == "NOT":
            self._take()
            code, kind = self._unary()
            return (f"(not {code})" if kind == "BOOL" else f"({code} ^ {2 ** BITS[kind] - 1})"), kind
        if self._peek() == "-":
            self._take()
            code, kind = self._unary()
            if kind in UNSIGNED or kind in BITS:
                raise StructuredTextError(f"- of {kind}")
            return f"(-{code})", kind
        return self._primary()

    def _primary(self) -> tuple[str, Any]:
        token = self._peek()
        if token == "(":
            self._take()
            code, kind = self._expression()
            self._take(")")
            return f"({code})", kind
        if token in ("TRUE", "FALSE"):
            return self._take().capitalize(), "BOOL"
        if token[0].isdigit() or "#" in token:
            return self._number(self._take())
        if len(self._tokens) > 1 and self._tokens[1] == "(":
            return self._call(self._take())
        place, key, kind = self._place()
        if place == "v" and key in self._references:
            return f"v.{key}.get()", kind
        return (f"{place}[{key}]" if key.startswith("_.at(") else f"{place}.{key}"), kind

    def _number(self, token: str) -> tuple[str, Any]:
        kind, _, digits = token.rpartition("#") if not re.match(r"(.*#)?16#", token) else ("", "", token)
        if "16#" in token:
            kind, _, digits = token.rpartition("16#")
            code = str(int(digits, 16))
        else:
            code = digits
        kind = kind.rstrip("#")
        if kind:
            return self._as((code, Literal), kind), kind
        return code, ("LREAL" if "." in code else Literal)

    def _place(self) -> tuple[str, str, Any]:
        name = self._take()
        place, key, kind = "v", name, self._variables[name]
        while self._peek() in (".", "["):
            whole = f"{place}[{key}]" if key.startswith("_.at(") else f"{place}.{key}"
            declared = self._types.get(kind, kind) if isinstance(kind, str) else kind
            if self._take() == ".":
                place, key = whole, self._take()
                kind = declared[key]
            else:
                index, of = self._expression()
                if of != Literal and of not in UNSIGNED and of not in SIGNED:
                    raise StructuredTextError(f"an index of {of}")
                self._take("]")
                place, key, kind = whole, f"_.at({index})", declared.of
        return place, key, kind

    def _call(self, name: str) -> tuple[str, Any]:
        self._take("(")
        converts = re.fullmatch(r"([A-Z]+)_TO_([A-Z]+)", name)
        if converts or name == "SHR":
            code, kind = self._expression()
            if converts:
                self._take(")")
                return (
                    f"_.converted({self._as((code, kind), converts[1])}, {converts[1]!r}, {converts[2]!r})",
                    converts[2],
                )
            self._take(",")
            by, _ = self._expression()
            self._take(")")
            return f"({code} >> {by})", kind
        function = self._functions[name]
        kinds = {
            n: (section, kind) for section, all_ in function.variables.items() for n, kind in all_.items()
        }
        given = {}
        while self._peek() != ")":
            parameter = self._take()
            section, kind = kinds[parameter]
            self._take("=>" if section == "VAR_OUTPUT" else ":=")
            given[parameter] = self._argument(section, kind)
            if self._peek() == ",":
                self._take()
        self._take(")")
        expected = {n for n, (section, _) in kinds.items() if section != "VAR"}
        if set(given) != expected:
            raise StructuredTextError(f"{name}: given {sorted(given)}, wanted {sorted(expected)}")
        arguments = ", ".join(f"{n}={code}" for n, code in given.items())
        return f"F[{name!r}]({arguments})", function.result

    def _argument(self, section: str, kind: Any) -> str:
        if section == "VAR_INPUT":
            return self._as(self._expression(), kind)
        place, key, found = self._place()
        if found != kind:
            raise StructuredTextError(f"{key} is {found}, wanted {kind}")
        if kind not in ELEMENTARY:
            return f"{place}[{key}]" if key.startswith("_.at(") else f"{place}.{key}"
        if place == "v" and key in self._references:
            return f"v.{key}"
        return f"Reference({place}, {key if key.startswith('_.at(') else repr(key)})"
