"""Statements, unit by unit, once everything that is declared has its type."""

from collections.abc import Iterable
from graphlib import CycleError, TopologicalSorter
from itertools import pairwise
from typing import Any

from structured_text import syntax as tree
from structured_text.declarations import Declarations, value_of
from structured_text.errors import Place, TextErrors
from structured_text.expressions import NOTHING, Expressions, is_of, name_of
from structured_text.parser import Declaration
from structured_text.types import (
    BITS,
    BOOL,
    DINT,
    SIGNED,
    UNSIGNED,
    Enumeration,
    Type,
    base_of,
)


def check(declared: Iterable[Declaration], refusals: TextErrors | None = None) -> Declarations:
    """The declarations, every body checked. ``refusals``: has errors already. Raises StructuredTextError."""
    return Checker(declared, refusals or TextErrors()).names


class Checker(Expressions):
    """Checks all units at once; ``names`` is what they declare, called units before their callers."""

    def __init__(self, declared: Iterable[Declaration], refusals: TextErrors) -> None:
        super().__init__()
        self._loops = 0
        self._kept = refusals.kept
        self.names = Declarations(declared, self._constant, refusals)
        self.names.resolve()
        for unit in self.names.units.values():
            self._unit, self._file = unit, unit.file
            self._body(unit.body)
        with refusals.kept():
            self._order()
        refusals.tell()

    def _constant(self, expression: tree.Expression, expect: Type, file: str) -> tree.Expression:
        """An expression outside of every body."""
        before = self._unit, self._file
        self._unit, self._file = None, file
        try:
            return self._expected(expression, expect)
        finally:
            self._unit, self._file = before

    def _order(self) -> None:
        units = self.names.units
        try:
            order = TopologicalSorter({name: unit.calls for name, unit in units.items()}).static_order()
            self.names.units = {name: units[name] for name in order}
        except CycleError as error:
            unit = units[min(error.args[1], key=list(units).index)]
            Place(unit.file, unit.line).refuse("name", f"{unit.name} calls itself")

    # statements

    def _body(self, body: tree.Body) -> None:
        for statement in body:
            with self._kept():
                _CHECKS[type(statement)](self, statement)

    def _assignment(self, statement: tree.Assignment) -> None:
        if statement.target is None:
            self._expression(statement.value, NOTHING)
            return
        statement.target = self._target(statement.target)
        statement.value = self._expected(statement.value, statement.target.type)

    def _jump(self, statement: tree.Jump) -> None:
        if statement.word != "RETURN" and not self._loops:
            self._refuse(statement.line, "syntax", f"{statement.word} stands in no loop")

    def _while(self, statement: tree.While) -> None:
        with self._kept():
            statement.condition = self._expected(statement.condition, BOOL)
        self._loop(statement.body)

    def _if(self, statement: tree.If) -> None:
        for place, (condition, body) in enumerate(statement.branches):
            with self._kept():
                statement.branches[place] = self._expected(condition, BOOL), body
            self._body(body)
        self._body(statement.otherwise)

    def _loop(self, body: tree.Body) -> None:
        self._loops += 1
        self._body(body)
        self._loops -= 1

    def _case(self, statement: tree.Case) -> None:
        with self._kept():
            self._labels(statement)
        for _, body in statement.branches:
            self._body(body)
        self._body(statement.otherwise)

    def _labels(self, statement: tree.Case) -> None:
        statement.selector = self._expression(statement.selector)
        kind = statement.selector.type
        chooses = isinstance(kind, Enumeration) or is_of(kind, SIGNED, UNSIGNED, BITS)
        why = f"CASE of {name_of(kind)}: expected a whole number or an enumeration"
        self._demand(chooses, statement.line, "type", why)
        taken: list[tuple[int, int, int]] = []
        for labels, _ in statement.branches:
            ranges = [(self._number(low, kind), self._number(high, kind)) for low, high in labels]
            statement.ranges.append(ranges)
            taken += [(*pair, low.line) for pair, (low, _) in zip(ranges, labels, strict=True)]
        for before, after in pairwise(sorted(taken)):
            twice = f"the label {after[0]} stands twice in one CASE"
            self._demand(before[1] < after[0], after[2], "value", twice)

    def _number(self, expression: tree.Expression, kind: Type) -> int:
        """The value of a constant."""
        return value_of(self._expected(expression, kind), Place(self._file, expression.line))  # type: ignore[no-any-return]

    def _for(self, statement: tree.For) -> None:
        with self._kept():
            self._counter(statement)
        self._loop(statement.body)
        if statement.variable.variable is not None:
            statement.variable.variable.running = False

    def _counter(self, statement: tree.For) -> None:
        kind, variable = self._target(statement.variable).type, statement.variable.variable
        counts = is_of(kind, SIGNED, UNSIGNED) and variable.section in ("VAR", "VAR_TEMP")
        why = f"FOR counts with {variable.name}: expected a whole number of VAR"
        self._demand(counts, statement.line, "type", why)
        statement.first = self._expected(statement.first, kind)
        statement.last = self._expected(statement.last, kind)
        if statement.step is not None:
            statement.by = self._number(statement.step, DINT)
            steps = 0 < abs(statement.by) <= base_of(kind).range[1]
            self._demand(steps, statement.line, "value", f"FOR goes on BY {statement.by}")
        variable.running = True


_CHECKS: dict[type[tree.Statement], Any] = {
    tree.Assignment: Checker._assignment, tree.If: Checker._if,
    tree.Case: Checker._case, tree.For: Checker._for, tree.While: Checker._while, tree.Jump: Checker._jump,
}  # fmt: skip
