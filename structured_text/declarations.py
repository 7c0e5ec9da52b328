"""What the texts declare: types, constants, variables and units, with where they lie in memory."""

import operator
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from typing import Any

from structured_text import syntax as tree
from structured_text.errors import Place, StructuredTextError, TextErrors
from structured_text.lexer import why_left_out
from structured_text.parser import Declaration
from structured_text.types import (
    ELEMENTARY,
    FLOAT,
    Array,
    Enumeration,
    Structure,
    Type,
    base_of,
    is_scalar,
)

FAULT, BUDGET = "st_fault", "st_budget"
_MOST_BYTES, _MOST_STACK = 1 << 26, 1 << 20
_DEEPEST = 40
_TWICE = "declared twice (the language ignores case)"


_FOLDED: dict[str, Callable[[Any, Any], Any]] = {
    "+": operator.add, "-": operator.sub, "*": operator.mul,
    "/": lambda a, b: int(Fraction(a, b)) if isinstance(a, int) and isinstance(b, int) else a / b,
}  # fmt: skip


def value_of(expression: tree.Expression, place: Place) -> Any:
    """The value of a checked expression of constants. Raises StructuredTextError for any other."""
    if isinstance(expression, tree.Literal):
        return expression.value
    if isinstance(expression, tree.Unary) and expression.sign == "-":
        return -value_of(expression.operand, place)
    if isinstance(expression, tree.Binary) and expression.sign in _FOLDED:
        left, right = value_of(expression.left, place), value_of(expression.right, place)
        place.demand(expression.sign != "/" or right != 0, "value", "division by zero")
        return _FOLDED[expression.sign](left, right)
    if isinstance(expression, tree.Call) and expression.library.startswith("TO_"):  # it is widened
        value = value_of(expression.given["0"], place)
        return float(value) if base_of(expression.type).kind == FLOAT else value
    return place.refuse("value", "expected a constant")


class Declarations:
    """All names of the texts, resolved when they are first asked for.

    ``memory``: where every global variable and program lies; its first two parts are the fault and the loop
    budget of the run-time checks. ``types``: those that are resolved, by name in capitals; ``owners``: the
    enumerations of each value.
    """

    def __init__(self, declared: Iterable[Declaration], check: Any, refusals: TextErrors) -> None:
        """``check``: checks an expression, with its expected type and file; ``refusals`` takes errors."""
        self._check, self.refusals = check, refusals
        self._open_types: list[str] = []
        self._failed: set[str] = set()
        self._stack = 0
        self.owners: dict[str, list[str]] = {}
        self._declared: dict[str, tree.TypeDeclaration] = {}
        self.types: dict[str, Type] = dict(ELEMENTARY)
        self._waiting: dict[str, tuple[str, tree.VariableDeclaration]] = {}
        self.units: dict[str, tree.Unit] = {}
        self.globals: dict[str, tree.Variable] = {}
        self.memory = Structure("memory")
        self.memory.add(FAULT, ELEMENTARY["ULINT"])
        self.memory.add(BUDGET, ELEMENTARY["LINT"])
        for each in declared:
            with refusals.kept():
                self._enter(each)

    def _enter(self, each: Declaration) -> None:
        if isinstance(each, tree.Globals):
            for variable in each.declared:
                with self.refusals.kept():
                    self._new(variable.name, Place(each.file, variable.line))
                    self._waiting[variable.name.upper()] = each.file, variable
            return
        self._new(each.name, Place(each.file, each.line))
        if isinstance(each, tree.Unit):
            self.units[each.name.upper()] = each
            return
        self._declared[each.name.upper()] = each
        for name, _, _ in each.values or ():
            self.owners.setdefault(name.upper(), []).append(each.name)

    def _new(self, name: str, place: Place) -> None:
        place.demand(not self.is_taken(name), "name", f"{name} is {_TWICE}")

    def is_taken(self, name: str) -> bool:
        """Whether a type, unit or global has this name."""
        word = name.upper()
        return word in self._declared or word in self.units or word in self._waiting

    def resolve(self) -> None:
        """Lay out all that is declared."""
        for name, declared in self._declared.items():
            with self.refusals.kept(name):
                self.named_type(name, Place(declared.file, declared.line))
        for name in self._waiting:
            with self.refusals.kept(name):
                self.global_variable(name)
        for name, unit in self.units.items():
            with self.refusals.kept(name):
                self.unit(unit)

    @contextmanager
    def _asks(self, name: str, place: Place) -> Iterator[None]:
        """What the block resolves is ``name``, which refers to others in it, and never to itself."""
        place.demand(name.upper() not in self._open_types, "type", f"{name} contains itself")
        place.demand(name.upper() not in self._failed, "follows", name)
        chain = f"more than {_DEEPEST} declarations, each of which needs a later one"
        place.demand(len(self._open_types) < _DEEPEST, "type", chain)
        self._open_types.append(name.upper())
        try:
            yield
        except StructuredTextError:
            self._failed.add(name.upper())
            raise
        finally:
            self._open_types.pop()

    # types

    def named_type(self, name: str, place: Place) -> Type:
        """The type ``name``. Raises StructuredTextError where there is none."""
        word = name.upper()
        if word in self.types:
            return self.types[word]
        made: Type
        unit = self.units.get(word)
        with self._asks(name, place):
            if word in self._declared:
                made = self._declared_type(self._declared[word])
            elif unit is not None and unit.kind == "FUNCTION_BLOCK":
                made = self._lay_out(unit)
            else:
                self.refusals.unknown(place, name, f"is no type{why_left_out(word)}", "type")
        self.types[word] = made
        return _bounded(made, place)

    def _declared_type(self, of: tree.TypeDeclaration) -> Type:
        if of.alias is not None:
            return self.type_of(of.alias, of.file)
        if of.values is not None:
            return self._enumeration(of)
        made = Structure(of.name)
        for member in of.members or ():
            place = Place(of.file, member.line)
            with self.refusals.kept(of.name, member.name):
                place.demand(member.name.upper() not in made.fields, "name", f"{member.name} is {_TWICE}")
                kind = self.type_of(member.type, of.file)
                made.add(member.name, kind, self.initial(member.initial, kind, of.file))
        return made

    def _enumeration(self, of: tree.TypeDeclaration) -> Enumeration:
        base = ELEMENTARY.get(of.base)
        if base is None or base.kind not in ("signed", "unsigned"):
            Place(of.file, of.line).refuse("type", f"{of.base} is no base of an enumeration")
        values: dict[str, int] = {}
        following = 0
        for name, expression, line in of.values or ():
            place = Place(of.file, line)
            place.demand(name.upper() not in values, "name", f"{name} is {_TWICE}")
            if expression is not None:
                following = value_of(self._check(expression, base, of.file), place)
            values[name.upper()] = following
            following += 1
        return Enumeration(of.name, base, values)

    def type_of(self, text: tree.TypeText, file: str) -> Type:
        """The type that ``text`` writes. Raises StructuredTextError."""
        place = Place(file, text.line)
        if text.of is None:
            return self.named_type(text.name, place)
        bounds = []
        for pair in text.bounds:
            low, high = (value_of(self._check(e, ELEMENTARY["DINT"], file), place) for e in pair)
            place.demand(low <= high, "type", f"bounds {low}..{high} hold nothing")
            bounds.append((low, high))
        return _bounded(Array(tuple(bounds), self.type_of(text.of, file)), place)

    # values

    def initial(self, given: tree.Initializer | None, kind: Type, file: str) -> Any:
        """The initial value of a variable of ``kind``; None for zeros. Raises StructuredTextError."""
        if given is None:
            return None
        place, value = Place(file, given.line), given.value
        if isinstance(value, list):
            return self._initial_array(value, kind, place)
        if isinstance(value, dict):
            if not isinstance(kind, Structure):
                place.refuse("type", f"expected {kind.name}, found the parts of a structure")
            for name in value:
                if name.upper() not in kind.fields:
                    self.refusals.unknown(place, kind.name, f"has no {name}")
            return {n.upper(): self.initial(v, kind.fields[n.upper()].type, file) for n, v in value.items()}
        place.demand(is_scalar(kind), "type", f"expected the parts of {kind.name} in brackets")
        found = value_of(self._check(value, kind, file), place)
        return fitting(found, kind, place)

    def _initial_array(self, value: list[tree.Initializer], kind: Type, place: Place) -> list[Any]:
        """Elements in the order of memory; rows of a further dimension may be in brackets of their own."""
        if not isinstance(kind, Array):
            place.refuse("type", f"expected {kind.name}, found a list")
        (low, high), *inner = kind.bounds
        row: Type = Array(tuple(inner), kind.of) if inner else kind.of
        if inner and not isinstance(value[0].value, list):
            row, (low, high) = kind.of, (0, kind.length - 1)
        given = f"{high - low + 1} elements are expected, {len(value)} are given"
        place.demand(len(value) == high - low + 1, "value", given)
        made = [self.initial(each, row, place.file) for each in value]
        return [part for rows in made for part in rows] if inner and isinstance(made[0], list) else made

    # variables

    def global_variable(self, name: str) -> tree.Variable | None:
        """The global variable or constant ``name``, None where there is none."""
        word = name.upper()
        if word in self.globals or word not in self._waiting:
            return self.globals.get(word)
        file, declared = self._waiting[word]
        place = Place(file, declared.line)
        with self._asks(declared.name, place):
            kind = self.type_of(declared.type, file)
            made = self.variable(declared, kind, file)
        if made.constant is None:
            made.offset = self.memory.add(declared.name, kind, made.initial).offset
            _bounded(self.memory, place)
        self.globals[word] = made
        return made

    def variable(self, declared: tree.VariableDeclaration, kind: Type, file: str) -> tree.Variable:
        """A declared variable with its initial value."""
        place = Place(file, declared.line)
        initial = self.initial(declared.initial, kind, file)
        name, known = declared.name, initial is not None
        place.demand(known or not declared.constant, "value", f"the constant {name} has no value")
        callers = declared.section == "VAR_IN_OUT"
        place.demand(not (known and callers), "value", f"{name} is the caller's: it has no initial value")
        constant = initial if declared.constant else None
        return tree.Variable(name, kind, declared.section, declared.line, initial, constant)

    def unit(self, unit: tree.Unit) -> None:
        """Resolve the variables of ``unit``. Raises StructuredTextError."""
        if unit.variables:
            return
        place = Place(unit.file, unit.line)
        if unit.kind == "FUNCTION":
            self._variables(unit, None)
            if unit.result_text is None:
                return
            unit.result = self.type_of(unit.result_text, unit.file)
            name = unit.result.name
            place.demand(is_scalar(unit.result), "type", f"{unit.name} returns {name}: use VAR_OUTPUT")
            unit.variables[unit.name.upper()] = tree.Variable(unit.name, unit.result, "RESULT", unit.line)
        elif unit.kind == "PROGRAM":
            self.memory.add(unit.name, self._lay_out(unit))
            _bounded(self.memory, place)
        else:
            self.named_type(unit.name, place)

    def _lay_out(self, unit: tree.Unit) -> Structure:
        unit.instance = Structure(unit.name, is_block=True)
        self._variables(unit, unit.instance)
        return unit.instance

    def _variables(self, unit: tree.Unit, instance: Structure | None) -> None:
        for declared in unit.declared:
            with self.refusals.kept(unit.name, declared.name):
                self._variable(declared, unit, instance)

    def _variable(
        self, declared: tree.VariableDeclaration, unit: tree.Unit, instance: Structure | None
    ) -> None:
        place, word = Place(unit.file, declared.line), declared.name.upper()
        hides = f"{declared.name} hides a global name (the language ignores case)"
        place.demand(word not in unit.variables, "name", f"{declared.name} is {_TWICE}")
        place.demand(not self.is_taken(word), "shadowed", hides)
        kind = self.type_of(declared.type, unit.file)
        made = self.variable(declared, kind, unit.file)
        kept = instance if made.section != "VAR_TEMP" else None
        block = isinstance(kind, Structure) and kind.is_block
        lost = block and kept is None and made.section in ("VAR", "VAR_TEMP")
        place.demand(not lost, "type", f"{declared.name}: a function keeps no function block")
        if kept is not None and made.section != "VAR_IN_OUT" and made.constant is None:
            made.offset = kept.add(declared.name, kind, made.initial, made.section).offset
        elif made.constant is None and made.section != "VAR_IN_OUT":
            over = f"with {declared.name}, functions' variables take over {_MOST_STACK} bytes"
            place.demand(self._stack + kind.size <= _MOST_STACK, "type", over)
            self._stack += kind.size
        unit.variables[word] = made


def _bounded(of: Type, place: Place) -> Type:
    """``of`` if it is neither too large nor too deep. Raises StructuredTextError."""
    place.demand(of.size <= _MOST_BYTES, "type", f"{of.name} has {of.size} bytes: at most {_MOST_BYTES}")
    place.demand(
        getattr(of, "depth", 0) <= _DEEPEST, "type", f"{of.name} has parts in parts more than {_DEEPEST} deep"
    )
    return of


def fitting(value: Any, kind: Type, place: Place) -> Any:
    """``value`` if it fits ``kind``. Raises StructuredTextError."""
    low, high = base_of(kind).range
    place.demand(low <= value <= high, "value", f"{value} does not fit {kind.name}")
    return value
