"""Values, places, calls and checks of one unit as LLVM."""

from collections.abc import Callable
from typing import Any

from llvmlite import ir

from structured_text import library, lowering
from structured_text import syntax as tree
from structured_text.declarations import BUDGET
from structured_text.lowering import BYTE, POINTER, WORD, number, register
from structured_text.types import BOOL, FLOAT, SIGNED, Array, Type, align_of, base_of, is_scalar, packed

INDEX, DIVISION, DOMAIN, CONVERSION, OVERFLOW, LOOP = range(1, 7)
REASONS = {
    INDEX: "an index is outside of its array",
    DIVISION: "division by zero",
    DOMAIN: "a function is not defined for its argument",
    CONVERSION: "a number does not fit the type that it is converted to",
    OVERFLOW: "a signed number overflows",
    LOOP: "a loop does not end",
}
FREE = 1000
"""Rounds that are known before, and few enough to take no part in the count."""

_INTRINSIC = {"SQRT": "sqrt", "EXP": "exp", "LN": "log", "LOG": "log10", "SIN": "sin", "COS": "cos"}


class Values:
    """What the statements of a unit are made of; ``b`` builds at the present place."""

    def __init__(self, backend: Any, unit: tree.Unit, function: ir.Function) -> None:
        self._backend, self._unit, self._function = backend, unit, function
        self._places: dict[str, Any] = {}
        self._loops: list[tuple[ir.Block, ir.Block]] = []
        self._file = backend.files.index(unit.file)
        self._cost = 1
        self._apart: dict[str, Any] = {}
        self._entry = function.append_basic_block("entry")
        self._exit = ir.Block(function, "exit")
        self._failed = ir.Block(function, "failed")
        self.b = ir.IRBuilder(self._entry)
        with self.b.goto_block(self._failed):
            self._why = self.b.phi(WORD)

    # memory

    def _room(self, kind: Any, align: int) -> Any:
        made = self.b.alloca(kind)
        made.align, made.type = align, POINTER  # llvmlite still gives it the type of what it points to
        return made

    def _at(self, base: Any, offset: Any) -> Any:
        return self.b.gep(base, [offset], source_etype=BYTE)

    def _global(self, offset: int) -> Any:
        return self._at(self._backend.memory, number(offset))

    def _loaded(self, place: Any, kind: Type) -> Any:
        value = self.b.load(place, typ=lowering.stored(kind), align=align_of(kind))
        return self.b.icmp_unsigned("!=", value, BYTE(0)) if base_of(kind) is BOOL else value

    def _store(self, value: Any, place: Any, kind: Type) -> None:
        if base_of(kind) is BOOL:
            value = self.b.zext(value, BYTE)
        self.b.store(value, place, align=align_of(kind))

    # checks

    def _require(self, holds: Any, why: int, line: int) -> None:
        """Go on where ``holds``, which None always does; else leave the unit, and say why."""
        if holds is None:
            return
        packed_why = ir.Constant(WORD, why << 48 | self._file << 32 | line)
        following = self._function.append_basic_block()
        self._why.add_incoming(packed_why, self.b.block)
        branch = self.b.cbranch(holds, following, self._failed)
        branch.set_weights([1 << 20, 1])
        self.b.position_at_end(following)

    def _leave_if_failed(self) -> None:
        fault = self.b.load(self._global(0), typ=WORD, align=8)
        following = self._function.append_basic_block()
        branch = self.b.cbranch(self.b.icmp_unsigned("==", fault, WORD(0)), following, self._exit)
        branch.set_weights([1 << 20, 1])
        self.b.position_at_end(following)

    def _spend(self, line: int, rounds: int) -> None:
        """Take so many rounds, in loops or in what is called, from those that the whole call may take."""
        place = self._global(self._backend._names.memory.fields[BUDGET.upper()].offset)
        left = self.b.sub(self.b.load(place, typ=WORD, align=8), WORD(rounds))
        self.b.store(left, place, align=8)
        self._require(self.b.icmp_signed(">", left, WORD(0)), LOOP, line)

    # places

    def _place(self, expression: tree.Expression) -> Any:
        """Where it lies."""
        if isinstance(expression, tree.Member):
            return self._at(self._place(expression.of), number(expression.offset))
        if isinstance(expression, tree.Index):
            return self._element(expression)
        assert isinstance(expression, tree.Name)
        variable = expression.variable
        if variable.constant is not None:
            return self._backend.constant(packed(variable.type, variable.constant))
        if variable.section == "VAR_GLOBAL":
            return self._global(variable.offset or 0)
        return self._places[variable.name.upper()]

    def _element(self, expression: tree.Index) -> Any:
        of, offset, base = expression.of.type, number(0), self._place(expression.of)
        assert isinstance(of, Array)
        for index, (low, high) in zip(expression.indices, of.bounds, strict=True):
            value = lowering.widened(self.b, self._value(index), base_of(index.type))
            place = self.b.sub(value, number(low))
            if not isinstance(index, tree.Literal):
                inside = self.b.icmp_unsigned("<=", place, number(high - low))
                self._require(inside, INDEX, expression.line)
            offset = self.b.add(self.b.mul(offset, number(high - low + 1)), place)
        return self._at(base, self.b.mul(offset, number(of.of.size)))

    # values

    def _value(self, expression: tree.Expression) -> Any:
        """A scalar in a register."""
        make = _VALUES.get(type(expression))
        return make(self, expression) if make else self._loaded(self._place(expression), expression.type)

    def _unary(self, expression: tree.Unary) -> Any:
        value = self._value(expression.operand)
        if expression.sign == "NOT":
            return self.b.not_(value)
        if base_of(expression.type).kind == FLOAT:
            return self.b.fneg(value)
        return self._counted("-", ir.Constant(value.type, 0), value, expression.line)

    def _binary(self, expression: tree.Binary) -> Any:
        kind, sign, left = expression.left.type, expression.sign, self._value(expression.left)
        if sign in ("AND_THEN", "OR_ELSE"):
            return self._decided(expression, left)
        base, right = base_of(kind), self._value(expression.right)
        if sign in ("=", "<>", "<", ">", "<=", ">="):
            return lowering.comparison(self.b, base)(sign, left, right)
        if sign in ("AND", "OR", "XOR"):
            return {"AND": self.b.and_, "OR": self.b.or_, "XOR": self.b.xor}[sign](left, right)
        if base.kind == FLOAT:
            if sign == "/":
                holds = self.b.fcmp_unordered("!=", right, ir.Constant(right.type, 0.0))
                self._require(holds, DIVISION, expression.line)
            return {"+": self.b.fadd, "-": self.b.fsub, "*": self.b.fmul, "/": self.b.fdiv}[sign](left, right)
        if sign in ("/", "MOD"):
            return self._divided(expression, left, right, base.kind == SIGNED)
        if base.kind == SIGNED:
            return self._counted(sign, left, right, expression.line)
        return {"+": self.b.add, "-": self.b.sub, "*": self.b.mul}[sign](left, right)

    def _decided(self, expression: tree.Binary, left: Any) -> Any:
        """The right side only where the left one leaves it open."""
        with self.b.goto_entry_block():
            place = self._room(BYTE, 1)
        self._store(left, place, BOOL)
        with self.b.if_then(left if expression.sign == "AND_THEN" else self.b.not_(left)):
            self._store(self._value(expression.right), place, BOOL)
        return self._loaded(place, BOOL)

    def _divided(self, expression: tree.Binary, left: Any, right: Any, signed: bool) -> Any:
        if not isinstance(expression.right, tree.Literal) or expression.right.value == 0:
            self._require(
                self.b.icmp_unsigned("!=", right, ir.Constant(right.type, 0)), DIVISION, expression.line
            )
        if not signed:
            return (self.b.udiv if expression.sign == "/" else self.b.urem)(left, right)
        least = ir.Constant(left.type, -(1 << left.type.width - 1))
        overflows = self.b.and_(
            self.b.icmp_signed("==", left, least),
            self.b.icmp_signed("==", right, ir.Constant(right.type, -1)),
        )
        self._require(self.b.not_(overflows), OVERFLOW, expression.line)
        return (self.b.sdiv if expression.sign == "/" else self.b.srem)(left, right)

    def _counted(self, sign: str, left: Any, right: Any, line: int) -> Any:
        """Signed arithmetic that does not wrap."""
        method = {"+": "sadd_with_overflow", "-": "ssub_with_overflow", "*": "smul_with_overflow"}[sign]
        both = getattr(self.b, method)(left, right)
        self._require(self.b.not_(self.b.extract_value(both, 1)), OVERFLOW, line)
        return self.b.extract_value(both, 0)

    # calls

    def _call(self, call: tree.Call) -> Any:
        unit = call.unit
        passed: list[Any] = []
        instance = None
        if unit.instance is not None:
            instance = self._place(call.of)
            passed.append(instance)
            for name, value in call.given.items():
                if unit.variables[name].section == "VAR_INPUT":
                    place = self._at(instance, number(unit.variables[name].offset or 0))
                    self._give(value, lambda place=place: place)  # type: ignore[misc]
        taken: list[tuple[Any, Any, int]] = []
        passed += [self._passed(each, call, taken) for each in unit.parameters()]
        cost = self._backend.costs[unit.name.upper()]
        if cost > FREE:
            self._spend(call.line, cost)
        self._cost += min(cost, FREE)
        result = self.b.call(self._backend.functions[unit.name.upper()], passed)
        self._leave_if_failed()
        for name, target in call.given.items():
            if instance is not None and unit.variables[name].section == "VAR_OUTPUT":
                source = self._at(instance, number(unit.variables[name].offset or 0))
                taken.append((self._place(target), source, unit.variables[name].type.size))
        for place, source, size in taken:
            lowering.copied(self.b, place, source, size)
        return result

    def _give(self, value: tree.Expression, place: Callable[[], Any]) -> None:
        """Leave ``value``, which is evaluated first, at ``place``."""
        if is_scalar(value.type):
            self._store(self._value(value), place(), value.type)
        else:
            source = self._place(value)
            lowering.copied(self.b, place(), source, value.type.size)

    def _passed(self, parameter: tree.Variable, call: tree.Call, taken: list[tuple[Any, Any, int]]) -> Any:
        """What is handed over. An output that others could see is made apart, ``taken`` after the call."""
        given, kind = call.given.get(parameter.name.upper()), parameter.type
        if parameter.section == "VAR_INPUT" and is_scalar(kind):
            return ir.Constant(register(kind), parameter.initial) if given is None else self._value(given)
        place = None if given is None else self._place(given)
        if parameter.section != "VAR_OUTPUT" or (given is not None and _is_alone(given, call)):
            return place
        key = f"{call.unit.name}.{parameter.name}"  # no call needs it while another one does
        if key not in self._apart:
            with self.b.goto_entry_block():
                self._apart[key] = self._room(ir.ArrayType(BYTE, kind.size), align_of(kind))
        if place is not None:
            taken.append((place, self._apart[key], kind.size))
        return self._apart[key]

    def _library(self, call: tree.Call) -> Any:
        values = [self._value(each) for each in call.given.values()]
        kinds = [base_of(each.type) for each in call.given.values()]
        word = call.library
        if library.conversion(word):
            value, holds = lowering.converted(self.b, word, values[0], kinds[0])
            self._require(holds, CONVERSION, call.line)
            return value
        self._require(lowering.is_defined(self.b, word, values[0]), DOMAIN, call.line)
        if word in _INTRINSIC:
            return self.b.call(
                lowering.intrinsic(self._backend.module, _INTRINSIC[word], values[0].type), values[:1]
            )
        if word in ("TAN", "ASIN", "ACOS", "ATAN", "EXPT"):
            function = self._backend.external("pow" if word == "EXPT" else word.lower(), len(values))
            kind = values[0].type
            double = [lowering.resized(self.b, each, ir.DoubleType()) for each in values]
            result = lowering.resized(self.b, self.b.call(function, double), kind)
            self._require(lowering.is_finite(self.b, result) if word == "EXPT" else None, DOMAIN, call.line)
            return result
        if word == "ABS" and kinds[0].kind == SIGNED:
            negative = self._counted("-", ir.Constant(values[0].type, 0), values[0], call.line)
            return self.b.select(
                self.b.icmp_signed("<", values[0], ir.Constant(values[0].type, 0)), negative, values[0]
            )
        return lowering.chosen(self.b, self._backend.module, word, values, kinds)


_VALUES: dict[type[tree.Expression], Any] = {
    tree.Literal: lambda _, literal: ir.Constant(register(literal.type), literal.value),
    tree.Unary: Values._unary, tree.Binary: Values._binary,
    tree.Call: lambda values, call: (values._library if call.library else values._call)(call),
}  # fmt: skip


def _root(place: tree.Expression) -> tree.Expression:
    while isinstance(place, tree.Member | tree.Index):
        place = place.of
    return place


def _is_alone(place: tree.Expression, call: tree.Call) -> bool:
    """Whether nothing but this argument of ``call`` leads to ``place``: it lies on the caller's stack."""
    variable = getattr(_root(place), "variable", None)
    roots = [getattr(_root(each), "variable", None) for each in call.given.values()]
    own = variable is not None and variable.offset is None and variable.section != "VAR_IN_OUT"
    return own and sum(root is variable for root in roots) == 1
