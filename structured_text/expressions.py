"""Types of every expression, and what stands behind every name: strict, nothing is converted by itself."""

from typing import Any, NoReturn

from structured_text import library
from structured_text import syntax as tree
from structured_text.declarations import Declarations, fitting
from structured_text.errors import Place
from structured_text.lexer import why_left_out
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

NOTHING = Structure("nothing")
"""Expected of a call whose result nobody takes."""

_NUMBERS = (SIGNED, UNSIGNED, FLOAT)
_WIDENED = {SIGNED: (SIGNED, FLOAT), UNSIGNED: (SIGNED, UNSIGNED, FLOAT), FLOAT: (FLOAT,), BITS: (BITS,)}
_PASSED = ("VAR_INPUT", "VAR_IN_OUT", "VAR_OUTPUT")
_OPERANDS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("=", "<>"), (*_NUMBERS, BITS, BOOL_KIND)),
    **dict.fromkeys(("<", ">", "<=", ">="), (*_NUMBERS, BITS)),
    **dict.fromkeys(("AND", "OR", "XOR"), (BOOL_KIND, BITS)), **dict.fromkeys(("+", "-", "*", "/"), _NUMBERS),
    "MOD": (SIGNED, UNSIGNED), **dict.fromkeys(("AND_THEN", "OR_ELSE"), (BOOL_KIND,)),
}  # fmt: skip


class Expressions:
    """Checks the expressions of the unit at hand; ``names`` is what the texts declare."""

    names: Declarations

    def __init__(self) -> None:
        self._unit: tree.Unit | None = None
        self._file = ""

    def _refuse(self, line: int, cause: str, reason: str) -> NoReturn:
        Place(self._file, line).refuse(cause, reason)

    def _unknown(self, line: int, name: str, why: str) -> NoReturn:
        self.names.refusals.unknown(Place(self._file, line), name, why)

    def _demand(self, holds: bool, line: int, cause: str, reason: str) -> None:
        Place(self._file, line).demand(holds, cause, reason)

    # places

    def _target(self, expression: tree.Expression) -> tree.Expression:
        """A place that may be written to."""
        found = root = self._expression(expression)
        while isinstance(root, tree.Member | tree.Index):
            if isinstance(root, tree.Member) and root.section == "VAR_OUTPUT":
                self._refuse(
                    root.line, "type", f"{root.name} is an output of its block: it cannot be written"
                )
            root = root.of
        if not isinstance(root, tree.Name):
            self._refuse(found.line, "type", "expected a variable")
        variable = root.variable
        why = (
            "is a constant" if variable.constant is not None
            else "is an input: it cannot be written" if variable.section == "VAR_INPUT"
            else "counts a FOR: it cannot be written within" if variable.running
            else ""
        )  # fmt: skip
        self._demand(not why, found.line, "type", f"{variable.name} {why}")
        return found

    def _name(self, expression: tree.Name, _: Type | None) -> tree.Expression:
        word = expression.name.upper()
        own = self._unit.variables.get(word) if self._unit else None
        variable = own or self.names.global_variable(word)
        if variable is None:
            return self._value_alone(expression)
        if variable.constant is not None and is_scalar(variable.type):
            return _literal(expression.line, variable.constant, variable.type)
        expression.variable, expression.type = variable, variable.type
        return expression

    def _value_alone(self, expression: tree.Name) -> tree.Expression:
        """The value of an enumeration without the enumeration's name."""
        name, owners = expression.name, self.names.owners.get(expression.name.upper(), [])
        self._demand(
            len(owners) < 2, expression.line, "name", f"{name} is a value of {' and of '.join(owners)}"
        )
        found = self._enumerated(owners[0], expression) if owners else None
        return found or self._unknown(expression.line, name, "is not declared")

    def _member(self, expression: tree.Member, _: Type | None) -> tree.Expression:
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
            self._unknown(expression.line, of.name, f"has no {expression.name}")
        private = of.is_block and part.section == "VAR"
        self._demand(not private, expression.line, "name", f"{expression.name} is private to {of.name}")
        expression.offset, expression.section, expression.type = part.offset, part.section, part.type
        return expression

    def _enumerated(self, name: str, expression: tree.Member | tree.Name) -> tree.Literal | None:
        word, names = name.upper(), self.names
        if (self._unit and word in self._unit.variables) or not names.is_taken(word) or word in names.units:
            return None
        of = (
            None
            if names.global_variable(word)
            else names.named_type(name, Place(self._file, expression.line))
        )
        if not isinstance(of, Enumeration):
            return None
        if expression.name.upper() not in of.values:
            self._unknown(expression.line, of.name, f"has no {expression.name}")
        return _literal(expression.line, of.values[expression.name.upper()], of)

    def _index(self, expression: tree.Index, _: Type | None) -> tree.Expression:
        expression.of = self._expression(expression.of)
        of, line, given = expression.of.type, expression.line, len(expression.indices)
        if not isinstance(of, Array):
            self._refuse(line, "type", f"{name_of(of)} has no elements")
        expected = f"{len(of.bounds)} indices are expected, {given} are given"
        self._demand(given == len(of.bounds), line, "type", expected)
        expression.indices = [self._expression(index) for index in expression.indices]
        for index, (low, high) in zip(expression.indices, of.bounds, strict=True):
            why = f"an index of {name_of(index.type)}: expected a whole number"
            self._demand(is_of(index.type, SIGNED, UNSIGNED), line, "type", why)
            if isinstance(index, tree.Literal):
                outside = f"index {index.value} is outside {low}..{high}"
                self._demand(low <= index.value <= high, line, "value", outside)
        expression.type = of.of
        return expression

    # expressions

    def _expected(self, expression: tree.Expression, expect: Type) -> tree.Expression:
        """``expression`` of the type ``expect``, or of one that it is widened from."""
        found = _widened(self._expression(expression, expect), expect)
        wrong = f"expected {expect.name}, found {name_of(found.type)}"
        self._demand(found.type == expect, found.line, "type", wrong)
        return found

    def _expression(self, expression: tree.Expression, expect: Type | None = None) -> tree.Expression:
        """``expression`` with its type; ``expect`` decides for numbers without one."""
        if expression.type is not None:
            return expression
        return _CHECKS[type(expression)](self, expression, expect)

    def _literal(self, expression: tree.Literal, expect: Type | None) -> tree.Expression:
        taken = (FLOAT,) if isinstance(expression.value, float) else (SIGNED, UNSIGNED, BITS, FLOAT)
        usual = LREAL if isinstance(expression.value, float) else DINT
        kind = expression.named or (expect if expect is not None and is_of(expect, *taken) else usual)
        if is_of(kind, FLOAT):
            expression.value = float(expression.value)
        fits = is_of(kind, FLOAT) or not isinstance(expression.value, float)
        self._demand(fits, expression.line, "type", f"{expression.value} is no {kind.name}")
        expression.type = kind
        fitting(expression.value, kind, Place(self._file, expression.line))
        return expression

    def _unary(self, expression: tree.Unary, expect: Type | None) -> tree.Expression:
        expression.operand = self._expression(expression.operand, expect)
        kind, sign = expression.operand.type, expression.sign
        allowed = (SIGNED, FLOAT) if sign == "-" else (BOOL_KIND, BITS)
        self._demand(is_of(kind, *allowed), expression.line, "type", f"{sign} of {name_of(kind)}")
        expression.type = kind
        return expression

    def _binary(self, expression: tree.Binary, expect: Type | None) -> tree.Expression:
        sign = expression.sign
        compares = sign in ("=", "<>", "<", ">", "<=", ">=")
        # A whole division stays one where a real number is expected: 1 / 2 is 0 there too.
        if compares or (sign == "/" and is_of(expect, FLOAT) and _is_open(expression, int)):
            expect = None
        if _is_open(expression.left) and not _is_open(expression.right):
            expression.right = self._expression(expression.right, expect)
            expression.left = self._expression(expression.left, expression.right.type)
        else:
            expression.left = self._expression(expression.left, expect)
            expression.right = self._expression(expression.right, expression.left.type)
        expression.left = _widened(expression.left, expression.right.type)
        expression.right = _widened(expression.right, expression.left.type)
        left, right = expression.left.type, expression.right.type
        differ = f"{name_of(left)} {sign} {name_of(right)}: expected two of one type"
        self._demand(left is not None and left == right, expression.line, "type", differ)
        allowed = is_of(left, *_OPERANDS[sign]) or (sign in ("=", "<>") and isinstance(left, Enumeration))
        self._demand(allowed, expression.line, "type", f"{sign} of {left.name}")
        expression.type = BOOL if compares else left
        return expression

    # calls

    def _called(self, call: tree.Call, expect: Type | None) -> tree.Expression:
        """A call whose result is taken."""
        word = call.of.name.upper() if isinstance(call.of, tree.Name) else ""
        own = self._unit.variables.get(word) if self._unit else None
        if own is None and library.is_known(word):
            return self._library(call, word, expect)
        if word in self.names.units and (own is None or own.section == "RESULT"):
            call.unit = self.names.units[word]
            through = f"{call.unit.name} is called through an instance"
            self._demand(call.unit.kind == "FUNCTION", call.line, "type", through)
            self.names.unit(call.unit)
        else:
            self._block(call, word)
        if self._unit is not None:
            self._unit.calls.append(call.unit.name.upper())
        self._hand_over(call, call.unit)
        call.type = call.unit.result
        no_value = f"the call of {call.unit.name} has no value: read its outputs"
        self._demand(call.type is not None or expect is NOTHING, call.line, "type", no_value)
        return call

    def _block(self, call: tree.Call, word: str) -> None:
        known = (self._unit and word in self._unit.variables) or self.names.global_variable(word)
        if isinstance(call.of, tree.Name) and not known:
            self._unknown(call.line, call.of.name, f"is not declared{why_left_out(word)}")
        call.of = self._target(call.of)
        of = call.of.type
        if not isinstance(of, Structure) or not of.is_block:
            self._refuse(call.line, "type", f"{name_of(of)} cannot be called")
        call.unit = self.names.units[of.name.upper()]

    def _hand_over(self, call: tree.Call, unit: tree.Unit) -> None:
        """Check the arguments and leave them by parameter, in capitals."""
        passed = {n: v for n, v in unit.variables.items() if v.section in _PASSED}
        for place, (given, value, is_output) in enumerate(call.arguments):
            if given is None and place >= len(passed):
                self._unknown(call.line, unit.name, f"takes {len(passed)} arguments")
            name = given or list(passed.values())[place].name
            if name.upper() not in passed:
                self._unknown(call.line, unit.name, f"has no parameter {name}")
            parameter = passed[name.upper()]
            self._demand(name.upper() not in call.given, call.line, "name", f"{name} is given twice")
            sign = "=>" if parameter.section == "VAR_OUTPUT" else ":="
            fits = given is None or is_output == (sign == "=>")
            self._demand(fits, call.line, "syntax", f"{name} of {unit.name} is given with {sign}")
            call.given[name.upper()] = self._argument(value, parameter)
        for name, parameter in passed.items():
            stored = unit.instance is not None or (
                parameter.initial is not None and is_scalar(parameter.type)
            )
            optional = parameter.section == "VAR_OUTPUT" or (parameter.section == "VAR_INPUT" and stored)
            without = f"{unit.name} is called without {parameter.name}"
            self._demand(optional or name in call.given, call.line, "name", without)

    def _argument(self, value: tree.Expression, parameter: tree.Variable) -> tree.Expression:
        if parameter.section == "VAR_INPUT":
            return self._expected(value, parameter.type)
        found = self._target(value)
        wrong = f"expected {parameter.type.name}, found {name_of(found.type)}"
        self._demand(found.type == parameter.type, found.line, "type", wrong)
        return found

    def _library(self, call: tree.Call, word: str, expect: Type | None) -> tree.Expression:
        values = [value for _, value, _ in call.arguments]
        by_place = all(name is None for name, _, _ in call.arguments)
        self._demand(by_place, call.line, "syntax", f"{word} takes its arguments by place")
        own = library.assumed(word, expect)
        first = next((self._expression(v, own) for v in values if not _is_open(v)), None)
        kind = own if first is None or word == "SEL" else first.type
        checked = [self._expression(v, library.argument_type(word, k, kind)) for k, v in enumerate(values)]
        sized = {v.type.size: v.type for v in checked if isinstance(v.type, Elementary)}
        checked = [_widened(v, sized[max(sized)]) if sized else v for v in checked]
        try:
            call.type = library.result_type(word, [v.type for v in checked])
        except library.NotSo as error:
            self._refuse(call.line, "type", str(error))
        call.library, call.given = word, {str(place): v for place, v in enumerate(checked)}
        return call


_CHECKS: dict[type[tree.Expression], Any] = {
    tree.Name: Expressions._name, tree.Member: Expressions._member, tree.Index: Expressions._index,
    tree.Literal: Expressions._literal, tree.Unary: Expressions._unary, tree.Binary: Expressions._binary,
    tree.Call: Expressions._called,
}  # fmt: skip


def _literal(line: int, value: Any, of: Type) -> tree.Literal:
    made = tree.Literal(line, value)
    made.type = of
    return made


def _is_open(expression: tree.Expression, of: type = object) -> bool:
    """Whether it is made of numbers (``of``) without a type, so that the other side's decides."""
    if isinstance(expression, tree.Binary):
        return _is_open(expression.left, of) and _is_open(expression.right, of)
    if isinstance(expression, tree.Unary):
        return _is_open(expression.operand, of)
    untyped = isinstance(expression, tree.Literal) and expression.named is expression.type is None
    return untyped and isinstance(getattr(expression, "value", None), of)


def _widened(found: tree.Expression, goal: Type) -> tree.Expression:
    """``found`` as a ``goal`` that has room for each of its values; else as it is.

    Arithmetic without a sign wraps, and where depends on the width: it is not widened behind one's back.
    """
    of = found.type
    if not isinstance(of, Elementary) or not isinstance(goal, Elementary) or goal.size <= of.size:
        return found
    wraps = of.kind in (UNSIGNED, BITS) and isinstance(found, tree.Binary | tree.Unary)
    if wraps or goal.kind not in _WIDENED.get(of.kind, ()):
        return found
    made = tree.Call(found.line, found, [])
    made.library, made.given, made.type = f"TO_{goal.name}", {"0": found}, goal
    return made


def is_of(kind: Type | None, *kinds: str) -> bool:
    """Whether it is an elementary type of one of these kinds."""
    return isinstance(kind, Elementary) and kind.kind in kinds


def name_of(of: Type | None) -> str:
    return "nothing" if of is None else of.name
