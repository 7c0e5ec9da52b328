"""What the texts declare: types, constants, variables and units, with where they lie in memory."""

from collections.abc import Iterable
from typing import Any

from structured_text import syntax as tree
from structured_text.errors import Place
from structured_text.parser import Declaration
from structured_text.types import (
    ELEMENTARY,
    FLOAT,
    Array,
    Elementary,
    Enumeration,
    Structure,
    Type,
    base_of,
    is_scalar,
)

FAULT, BUDGET = "st_fault", "st_budget"
_MOST_BYTES = 1 << 26


def value_of(expression: tree.Expression, place: Place) -> Any:
    """The value of a checked expression of constants. Raises StructuredTextError for any other."""
    if isinstance(expression, tree.Literal):
        return expression.value
    if isinstance(expression, tree.Unary) and expression.sign == "-":
        return -value_of(expression.operand, place)
    if isinstance(expression, tree.Binary) and expression.sign in ("+", "-", "*", "/"):
        left, right = value_of(expression.left, place), value_of(expression.right, place)
        if expression.sign == "/" and right == 0:
            place.refuse("value", "division by zero")
        if expression.sign == "/":
            whole = isinstance(left, int)
            return (
                abs(left) // abs(right) * (1 if (left < 0) == (right < 0) else -1) if whole else left / right
            )
        return {"+": left + right, "-": left - right, "*": left * right}[expression.sign]
    return place.refuse("value", "expected a constant")


class Declarations:
    """All names of the texts, resolved when they are first asked for.

    ``memory``: where every global variable and program lies; its first two parts are the fault and the loop
    budget of the run-time checks.
    """

    def __init__(self, declared: Iterable[Declaration], check: Any) -> None:
        """``check``: checks an expression, with its expected type, its file. Raises StructuredTextError."""
        self._check = check
        self._types: dict[str, tree.TypeDeclaration] = {}
        self._resolved: dict[str, Type | None] = dict(ELEMENTARY)
        self._waiting: dict[str, tuple[str, tree.VariableDeclaration]] = {}
        self.units: dict[str, tree.Unit] = {}
        self.globals: dict[str, tree.Variable] = {}
        self.memory = Structure("memory")
        self.memory.add(FAULT, ELEMENTARY["ULINT"])
        self.memory.add(BUDGET, ELEMENTARY["LINT"])
        for each in declared:
            self._enter(each)

    def _enter(self, each: Declaration) -> None:
        if isinstance(each, tree.Globals):
            for variable in each.declared:
                self._new(variable.name, Place(each.file, variable.line))
                self._waiting[variable.name.upper()] = each.file, variable
            return
        self._new(each.name, Place(each.file, each.line))
        if isinstance(each, tree.Unit):
            self.units[each.name.upper()] = each
        else:
            self._types[each.name.upper()] = each

    def _new(self, name: str, place: Place) -> None:
        if self.is_taken(name):
            place.refuse("name", f"{name} is declared twice (the language ignores case)")

    def is_taken(self, name: str) -> bool:
        """Whether a type, unit or global has this name."""
        word = name.upper()
        return word in self._types or word in self.units or word in self._waiting

    def declared_types(self) -> dict[str, Type]:
        """All resolved types but the elementary ones, by name in capitals."""
        return {n: of for n, of in self._resolved.items() if of is not None and n not in ELEMENTARY}

    def resolve(self) -> None:
        """Lay out all that is declared. Raises StructuredTextError."""
        for name in self._types:
            self.named_type(name, Place("", 0))
        for name in self._waiting:
            self.global_variable(name)
        for unit in self.units.values():
            self.unit(unit)

    # types

    def named_type(self, name: str, place: Place) -> Type:
        """The type ``name``. Raises StructuredTextError where there is none."""
        word = name.upper()
        if word in self._resolved:
            found = self._resolved[word]
            if found is None:
                place.refuse("type", f"{name} contains itself")
            return found
        self._resolved[word] = None
        made: Type
        if word in self._types:
            made = self._declared_type(self._types[word])
        elif word in self.units and self.units[word].kind == "FUNCTION_BLOCK":
            made = Structure(self.units[word].name, is_block=True)
            self._lay_out(self.units[word], made)
        else:
            del self._resolved[word]
            place.refuse("type", f"{name} is no type")
        self._resolved[word] = made
        return made

    def _declared_type(self, of: tree.TypeDeclaration) -> Type:
        if of.alias is not None:
            return self.type_of(of.alias, of.file)
        if of.values is not None:
            return self._enumeration(of)
        made = Structure(of.name)
        for member in of.members or ():
            place = Place(of.file, member.line)
            if member.name.upper() in made.fields:
                place.refuse("name", f"{member.name} is declared twice (the language ignores case)")
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
            if name.upper() in values:
                place.refuse("name", f"{name} is declared twice (the language ignores case)")
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
            if low > high:
                place.refuse("type", f"bounds {low}..{high} hold nothing")
            bounds.append((low, high))
        made = Array(tuple(bounds), self.type_of(text.of, file))
        if made.size > _MOST_BYTES:
            place.refuse("type", f"{made.size} bytes: an array has at most {_MOST_BYTES}")
        return made

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
                    place.refuse("name", f"{kind.name} has no {name}")
            return {n.upper(): self.initial(v, kind.fields[n.upper()].type, file) for n, v in value.items()}
        if not is_scalar(kind):
            place.refuse("type", f"expected the parts of {kind.name} in brackets")
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
        if len(value) != high - low + 1:
            place.refuse("value", f"{high - low + 1} elements are expected, {len(value)} are given")
        made = [self.initial(each, row, place.file) for each in value]
        return [part for rows in made for part in rows] if inner and isinstance(made[0], list) else made

    # variables

    def global_variable(self, name: str) -> tree.Variable | None:
        """The global variable or constant ``name``, None where there is none."""
        word = name.upper()
        if word in self.globals or word not in self._waiting:
            return self.globals.get(word)
        file, declared = self._waiting[word]
        kind = self.type_of(declared.type, file)
        made = self.variable(declared, kind, file)
        if made.constant is None:
            made.offset = self.memory.add(declared.name, kind, made.initial).offset
        self.globals[word] = made
        return made

    def variable(self, declared: tree.VariableDeclaration, kind: Type, file: str) -> tree.Variable:
        """A declared variable with its initial value."""
        place = Place(file, declared.line)
        initial = self.initial(declared.initial, kind, file)
        constant = None
        if declared.constant:
            if initial is None:
                place.refuse("value", f"the constant {declared.name} has no value")
            constant = initial
        elif initial is not None and declared.section == "VAR_IN_OUT":
            place.refuse("value", f"{declared.name} is the caller's: it has no initial value")
        return tree.Variable(declared.name, kind, declared.section, declared.line, initial, constant)

    def unit(self, unit: tree.Unit) -> None:
        """Resolve the variables of ``unit``. Raises StructuredTextError."""
        if unit.variables:
            return
        if unit.kind == "FUNCTION":
            assert unit.result_text is not None
            unit.result = self.type_of(unit.result_text, unit.file)
            if not is_scalar(unit.result):
                Place(unit.file, unit.line).refuse(
                    "type", f"{unit.name} returns {unit.result.name}: use VAR_OUTPUT"
                )
            self._variables(unit, None)
            unit.variables[unit.name.upper()] = tree.Variable(unit.name, unit.result, "RESULT", unit.line)
        elif unit.kind == "PROGRAM":
            made = Structure(unit.name, is_block=True)
            self._lay_out(unit, made)
            self.memory.add(unit.name, made)
        else:
            self.named_type(unit.name, Place(unit.file, unit.line))

    def _lay_out(self, unit: tree.Unit, instance: Structure) -> None:
        unit.instance = instance
        self._variables(unit, instance)

    def _variables(self, unit: tree.Unit, instance: Structure | None) -> None:
        for declared in unit.declared:
            place, word = Place(unit.file, declared.line), declared.name.upper()
            if word in unit.variables:
                place.refuse("name", f"{declared.name} is declared twice (the language ignores case)")
            if self.is_taken(word):
                place.refuse("shadowed", f"{declared.name} hides a global name (the language ignores case)")
            kind = self.type_of(declared.type, unit.file)
            made = self.variable(declared, kind, unit.file)
            if isinstance(kind, Structure) and kind.is_block and instance is None and made.section == "VAR":
                place.refuse("type", f"{declared.name}: a function keeps no function block")
            if instance is not None and made.section != "VAR_IN_OUT" and made.constant is None:
                made.offset = instance.add(declared.name, kind, made.initial, made.section).offset
            unit.variables[word] = made


def fitting(value: Any, kind: Type, place: Place) -> Any:
    """``value`` if it fits ``kind``. Raises StructuredTextError."""
    base: Elementary = base_of(kind)
    if base.kind != FLOAT and not isinstance(value, bool):
        low, high = base.range
        if not low <= value <= high:
            place.refuse("value", f"{value} does not fit {kind.name}")
    return value
