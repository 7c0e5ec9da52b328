"""Statements, unit by unit, once everything that is declared has its type."""

from collections.abc import Iterable

from structured_text import syntax as tree
from structured_text.declarations import Declarations, value_of
from structured_text.errors import Place
from structured_text.expressions import Expressions, name_of
from structured_text.parser import Declaration
from structured_text.types import (
    BOOL,
    DINT,
    SIGNED,
    UNSIGNED,
    Elementary,
    Enumeration,
    Type,
)


def check(declared: Iterable[Declaration]) -> Declarations:
    """The declarations with every body checked. Raises StructuredTextError."""
    checker = Checker(declared)
    return checker.names


class Checker(Expressions):
    """Checks all units at once; ``names`` is what they declare."""

    def __init__(self, declared: Iterable[Declaration]) -> None:
        super().__init__()
        self._loops = 0
        self.names = Declarations(declared, self._constant)
        self.names.resolve()
        for unit in self.names.units.values():
            self._unit, self._file = unit, unit.file
            self._body(unit.body)
        for unit in self.names.units.values():
            self._refuse_recursion(unit, ())

    def _constant(self, expression: tree.Expression, expect: Type, file: str) -> tree.Expression:
        """An expression outside of every body."""
        before = self._unit, self._file
        self._unit, self._file = None, file
        try:
            return self._expected(expression, expect)
        finally:
            self._unit, self._file = before

    def _refuse_recursion(self, unit: tree.Unit, callers: tuple[str, ...]) -> None:
        if unit.name in callers:
            Place(unit.file, unit.line).refuse("name", f"{unit.name} calls itself")
        for name, _ in unit.calls:
            self._refuse_recursion(self.names.units[name], (*callers, unit.name))

    # statements

    def _body(self, body: tree.Body) -> None:
        for statement in body:
            self._statement(statement)

    def _statement(self, statement: tree.Statement) -> None:
        match statement:
            case tree.Assignment():
                statement.target = self._target(statement.target)
                assert statement.target.type is not None
                statement.value = self._expected(statement.value, statement.target.type)
            case tree.CallStatement():
                self._call(statement.call, as_statement=True)
            case tree.If():
                statement.branches = [(self._expected(c, BOOL), body) for c, body in statement.branches]
                for _, body in statement.branches:
                    self._body(body)
                self._body(statement.otherwise)
            case tree.Case():
                self._case(statement)
            case tree.For():
                self._for(statement)
            case tree.While():
                statement.condition = self._expected(statement.condition, BOOL)
                self._loop(statement.body)
            case tree.Jump(word=word) if word != "RETURN" and not self._loops:
                self._refuse(statement.line, "syntax", f"{word} stands in no loop")

    def _loop(self, body: tree.Body) -> None:
        self._loops += 1
        self._body(body)
        self._loops -= 1

    def _case(self, statement: tree.Case) -> None:
        statement.selector = self._expression(statement.selector)
        kind = statement.selector.type
        whole = isinstance(kind, Elementary) and kind.kind in (SIGNED, UNSIGNED)
        if kind is None or not (whole or isinstance(kind, Enumeration)):
            self._refuse(
                statement.line, "type", f"CASE of {name_of(kind)}: expected a whole number or an enumeration"
            )
        taken: list[tuple[int, int]] = []
        for labels, body in statement.branches:
            ranges = []
            for low, high in labels:
                place = Place(self._file, low.line)
                pair = tuple(value_of(self._expected(e, kind), place) for e in (low, high))
                if any(pair[0] <= b and a <= pair[1] for a, b in taken):
                    place.refuse("value", f"the label {pair[0]} stands twice in one CASE")
                ranges.append((pair[0], pair[1]))
                taken.append(ranges[-1])
            statement.ranges.append(ranges)
            self._body(body)
        self._body(statement.otherwise)

    def _for(self, statement: tree.For) -> None:
        name = self._target(statement.variable)
        variable = statement.variable.variable
        assert variable is not None
        kind = name.type
        if not (
            isinstance(kind, Elementary) and kind.kind in (SIGNED, UNSIGNED) and variable.section == "VAR"
        ):
            self._refuse(
                statement.line, "type", f"FOR counts with {variable.name}: expected a whole number of VAR"
            )
        statement.first = self._expected(statement.first, kind)
        statement.last = self._expected(statement.last, kind)
        if statement.step is not None:
            step = self._expected(statement.step, DINT)
            statement.by = value_of(step, Place(self._file, statement.line))
            if statement.by == 0:
                self._refuse(statement.line, "value", "FOR goes on BY 0")
        variable.running = True
        self._loop(statement.body)
        variable.running = False
