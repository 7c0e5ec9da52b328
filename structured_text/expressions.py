"""Types of every expression, and what stands behind every name: strict, nothing is converted by itself."""

from typing import NoReturn

from structured_text import library
from structured_text import syntax as tree
from structured_text.declarations import Declarations, fitting
from structured_text.errors import Place
from structured_text.types import (
    BITS,
    BOOL,
    BOOL_KIND,
    DINT,
    FLOAT,
    LREAL,
    SIGNED,
    UNSIGNED,
    Array,
    Elementary,
    Enumeration,
    Structure,
    Type,
    is_scalar,
)

_NUMBERS = (SIGNED, UNSIGNED, FLOAT)
_PASSED = ("VAR_INPUT", "VAR_IN_OUT", "VAR_OUTPUT")
_WRITABLE = {"VAR", "VAR_OUTPUT", "VAR_IN_OUT", "VAR_GLOBAL", "RESULT"}


class Expressions:
    """Checks the expressions of the unit at hand; ``names`` is what the texts declare."""

    names: Declarations

    def __init__(self) -> None:
        self._unit: tree.Unit | None = None
        self._file = ""

    def _refuse(self, line: int, cause: str, reason: str) -> NoReturn:
        Place(self._file, line).refuse(cause, reason)

    # places

    def _target(self, expression: tree.Expression) -> tree.Expression:
        """A place that may be written to."""
        found = self._expression(expression)
        root = found
        while isinstance(root, tree.Member | tree.Index):
            if isinstance(root, tree.Member) and root.section == "VAR_OUTPUT":
                self._refuse(
                    root.line, "type", f"{root.name} is an output of its block: it cannot be written"
                )
            root = root.of
        if not isinstance(root, tree.Name) or root.variable is None:
            self._refuse(found.line, "type", "expected a variable")
        variable = root.variable
        if variable.constant is not None:
            self._refuse(found.line, "type", f"{variable.name} is a constant")
        if variable.section not in _WRITABLE:
            self._refuse(found.line, "type", f"{variable.name} is an input: it cannot be written")
        if variable.running:
            self._refuse(found.line, "type", f"{variable.name} counts a FOR: it cannot be written within")
        return found

    def _name(self, expression: tree.Name) -> tree.Expression:
        word = expression.name.upper()
        variable = self._unit.variables.get(word) if self._unit else None
        variable = variable or self.names.global_variable(word)
        if variable is None:
            self._refuse(expression.line, "name", f"{expression.name} is not declared")
        if variable.constant is not None and is_scalar(variable.type):
            made = tree.Literal(expression.line, variable.constant)
            made.type = variable.type
            return made
        expression.variable, expression.type = variable, variable.type
        return expression

    def _member(self, expression: tree.Member) -> tree.Expression:
        if isinstance(expression.of, tree.Name):
            found = self._enumerated(expression.of.name, expression)
            if found is not None:
                return found
        expression.of = self._expression(expression.of)
        of = expression.of.type
        if not isinstance(of, Structure):
            self._refuse(expression.line, "type", f"{name_of(of)} has no members")
        part = of.fields.get(expression.name.upper())
        if part is None:
            self._refuse(expression.line, "name", f"{of.name} has no {expression.name}")
        if of.is_block and part.section == "VAR":
            self._refuse(expression.line, "name", f"{expression.name} is private to {of.name}")
        expression.offset, expression.section, expression.type = part.offset, part.section, part.type
        return expression

    def _enumerated(self, name: str, expression: tree.Member) -> tree.Literal | None:
        if (self._unit and name.upper() in self._unit.variables) or not self.names.is_taken(name):
            return None
        if name.upper() in self.names.units or self.names.global_variable(name):
            return None
        of = self.names.named_type(name, Place(self._file, expression.line))
        if not isinstance(of, Enumeration):
            return None
        if expression.name.upper() not in of.values:
            self._refuse(expression.line, "name", f"{of.name} has no {expression.name}")
        made = tree.Literal(expression.line, of.values[expression.name.upper()], of)
        made.type = of
        return made

    def _index(self, expression: tree.Index) -> tree.Expression:
        expression.of = self._expression(expression.of)
        of = expression.of.type
        if not isinstance(of, Array):
            self._refuse(expression.line, "type", f"{name_of(of)} has no elements")
        if len(expression.indices) != len(of.bounds):
            count = len(expression.indices)
            self._refuse(expression.line, "type", f"{len(of.bounds)} indices are expected, {count} are given")
        expression.indices = [self._expression(index) for index in expression.indices]
        for index, (low, high) in zip(expression.indices, of.bounds, strict=True):
            kind = index.type
            if not (isinstance(kind, Elementary) and kind.kind in (SIGNED, UNSIGNED)):
                self._refuse(expression.line, "type", f"an index of {name_of(kind)}: expected a whole number")
            if isinstance(index, tree.Literal) and not low <= index.value <= high:
                self._refuse(expression.line, "value", f"index {index.value} is outside {low}..{high}")
        expression.type = of.of
        return expression

    # expressions

    def _expected(self, expression: tree.Expression, expect: Type) -> tree.Expression:
        """``expression`` of the type ``expect`` and no other."""
        found = self._expression(expression, expect)
        if found.type != expect:
            self._refuse(found.line, "type", f"expected {expect.name}, found {name_of(found.type)}")
        return found

    def _expression(self, expression: tree.Expression, expect: Type | None = None) -> tree.Expression:
        """``expression`` with its type; ``expect`` decides for numbers without one."""
        if expression.type is not None:
            return expression
        match expression:
            case tree.Literal():
                return self._literal(expression, expect)
            case tree.Name():
                return self._name(expression)
            case tree.Member():
                return self._member(expression)
            case tree.Index():
                return self._index(expression)
            case tree.Unary():
                return self._unary(expression, expect)
            case tree.Binary():
                return self._binary(expression, expect)
        assert isinstance(expression, tree.Call)
        return self._call(expression, expect=expect)

    def _literal(self, expression: tree.Literal, expect: Type | None) -> tree.Expression:
        kind: Type
        if expression.named is not None:
            kind = expression.named
        elif isinstance(expression.value, float):
            kind = expect if isinstance(expect, Elementary) and expect.kind == FLOAT else LREAL
        else:
            whole = isinstance(expect, Elementary) and expect.kind in (SIGNED, UNSIGNED, BITS)
            kind = expect if whole and expect is not None else DINT
        expression.type = kind
        fits_float = isinstance(expression.value, float) == (
            isinstance(kind, Elementary) and kind.kind == FLOAT
        )
        if not fits_float:
            self._refuse(expression.line, "type", f"{expression.value} is no {kind.name}")
        fitting(expression.value, kind, Place(self._file, expression.line))
        return expression

    def _unary(self, expression: tree.Unary, expect: Type | None) -> tree.Expression:
        expression.operand = self._expression(expression.operand, expect)
        kind = expression.operand.type
        of = kind.kind if isinstance(kind, Elementary) else ""
        if of not in ((SIGNED, FLOAT) if expression.sign == "-" else (BOOL_KIND, BITS)):
            self._refuse(expression.line, "type", f"{expression.sign} of {name_of(kind)}")
        expression.type = kind
        return expression

    def _binary(self, expression: tree.Binary, expect: Type | None) -> tree.Expression:
        sign = expression.sign
        compares = sign in ("=", "<>", "<", ">", "<=", ">=")
        expect = None if compares else expect
        if _is_open(expression.left) and not _is_open(expression.right):
            expression.right = self._expression(expression.right, expect)
            expression.left = self._expression(expression.left, expression.right.type)
        else:
            expression.left = self._expression(expression.left, expect)
            expression.right = self._expression(expression.right, expression.left.type)
        left, right = expression.left.type, expression.right.type
        if left != right or left is None:
            self._refuse(
                expression.line, "type", f"{name_of(left)} {sign} {name_of(right)}: expected two of one type"
            )
        kind = left.kind if isinstance(left, Elementary) else "enumeration" if is_scalar(left) else ""
        if compares:
            allowed = kind in (*_NUMBERS, BITS) or (sign in ("=", "<>") and kind != "")
        elif sign in ("AND", "OR", "XOR"):
            allowed = kind in (BOOL_KIND, BITS)
        else:
            allowed = kind in _NUMBERS and not (sign == "MOD" and kind == FLOAT)
        if not allowed:
            self._refuse(expression.line, "type", f"{sign} of {left.name}")
        expression.type = BOOL if compares else left
        return expression

    # calls

    def _call(
        self, call: tree.Call, *, as_statement: bool = False, expect: Type | None = None
    ) -> tree.Expression:
        word = call.of.name.upper() if isinstance(call.of, tree.Name) else ""
        own = self._unit.variables.get(word) if self._unit else None
        local = own is not None and own.section != "RESULT"
        if word in self.names.units and not local:
            call.unit = self.names.units[word]
            if call.unit.kind != "FUNCTION":
                self._refuse(call.line, "type", f"{call.unit.name} is called through an instance")
            self.names.unit(call.unit)
        elif word and not local and library.is_known(word):
            return self._library(call, word, expect)
        else:
            self._block(call, as_statement)
        assert call.unit is not None
        if self._unit is not None:
            self._unit.calls.append((call.unit.name.upper(), call.line))
        self._hand_over(call, call.unit)
        call.type = call.unit.result
        return call

    def _block(self, call: tree.Call, as_statement: bool) -> None:
        if isinstance(call.of, tree.Name) and not self._is_variable(call.of.name):
            self._refuse(call.line, "name", f"{call.of.name} is not declared")
        call.of = self._target(call.of)
        of = call.of.type
        if not isinstance(of, Structure) or not of.is_block:
            self._refuse(call.line, "type", f"{name_of(of)} cannot be called")
        if not as_statement:
            self._refuse(call.line, "type", f"the call of a {of.name} has no value: read its outputs")
        call.unit = self.names.units[of.name.upper()]

    def _is_variable(self, name: str) -> bool:
        known = self._unit is not None and name.upper() in self._unit.variables
        return known or self.names.global_variable(name) is not None

    def _hand_over(self, call: tree.Call, unit: tree.Unit) -> None:
        """Check the arguments and leave them by parameter, in capitals."""
        passed = [
            v for v in unit.variables.values() if v.section in ("VAR_INPUT", "VAR_IN_OUT", "VAR_OUTPUT")
        ]
        by_name = {each.name.upper(): each for each in passed}
        for place, argument in enumerate(call.arguments):
            name = argument.name
            if name is None:
                if place >= len(passed):
                    self._refuse(call.line, "type", f"{unit.name} takes {len(passed)} arguments")
                name = passed[place].name
            parameter = by_name.get(name.upper())
            if parameter is None:
                self._refuse(call.line, "name", f"{unit.name} has no parameter {name}")
            if parameter.name.upper() in call.given:
                self._refuse(call.line, "name", f"{name} is given twice")
            if argument.name is not None and argument.is_output != (parameter.section == "VAR_OUTPUT"):
                sign = "=>" if parameter.section == "VAR_OUTPUT" else ":="
                self._refuse(call.line, "syntax", f"{name} of {unit.name} is given with {sign}")
            call.given[parameter.name.upper()] = self._argument(argument.value, parameter)
        for parameter in passed:
            optional = parameter.section == "VAR_OUTPUT" or (
                unit.instance is not None and parameter.section == "VAR_INPUT"
            )
            if parameter.name.upper() not in call.given and not optional:
                self._refuse(call.line, "name", f"{unit.name} is called without {parameter.name}")

    def _argument(self, value: tree.Expression, parameter: tree.Variable) -> tree.Expression:
        if parameter.section == "VAR_INPUT":
            return self._expected(value, parameter.type)
        found = self._target(value)
        if found.type != parameter.type:
            self._refuse(found.line, "type", f"expected {parameter.type.name}, found {name_of(found.type)}")
        return found

    def _library(self, call: tree.Call, word: str, expect: Type | None) -> tree.Expression:
        if any(argument.name is not None for argument in call.arguments):
            self._refuse(call.line, "syntax", f"{word} takes its arguments by place")
        values = [argument.value for argument in call.arguments]
        try:
            own = library.assumed(word, expect)
            first = next((self._expression(v, own) for v in values if not _is_open(v)), None)
            kind = own if first is None or word == "SEL" else first.type
            checked = [
                self._expression(v, library.argument_type(word, place, kind))
                for place, v in enumerate(values)
            ]
            call.type = library.result_type(word, [v.type for v in checked])
        except library.NotSo as error:
            self._refuse(call.line, "type", str(error))
        call.library, call.given = word, {str(place): v for place, v in enumerate(checked)}
        return call


def _is_open(expression: tree.Expression) -> bool:
    """Whether it is made of numbers without a type, so that the other side's decides."""
    if isinstance(expression, tree.Binary):
        return _is_open(expression.left) and _is_open(expression.right)
    if isinstance(expression, tree.Unary):
        return _is_open(expression.operand)
    return isinstance(expression, tree.Literal) and expression.named is None and expression.type is None


def name_of(of: Type | None) -> str:
    return "nothing" if of is None else of.name
