"""Values, places, calls and checks of one unit as LLVM."""

from typing import Any

from llvmlite import ir

from structured_text import lowering
from structured_text import syntax as tree
from structured_text.declarations import BUDGET
from structured_text.lowering import BYTE, POINTER, WORD, number, register
from structured_text.types import BOOL, FLOAT, SIGNED, Array, Type, base_of, is_scalar, packed

INDEX, DIVISION, DOMAIN, CONVERSION, OVERFLOW, LOOP, NOT_FINITE = range(1, 8)
REASONS = {
    INDEX: "an index is outside of its array",
    DIVISION: "division by zero",
    DOMAIN: "a function is not defined for its argument",
    CONVERSION: "a number does not fit the type that it is converted to",
    OVERFLOW: "a signed number overflows",
    LOOP: "a loop does not end",
    NOT_FINITE: "a number is not finite",
}
_INTRINSIC = {"SQRT": "sqrt", "EXP": "exp", "LN": "log", "LOG": "log10", "SIN": "sin", "COS": "cos"}


class Values:
    """What the statements of a unit are made of; ``b`` builds at the present place."""

    def __init__(self, backend: Any, unit: tree.Unit, function: ir.Function) -> None:
        self._backend, self._unit, self._function = backend, unit, function
        self._places: dict[str, Any] = {}
        self._loops: list[tuple[ir.Block, ir.Block]] = []
        self._file = backend.files.index(unit.file)
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
        value = self.b.load(place, typ=lowering.stored(kind), align=kind.align)
        return self.b.icmp_unsigned("!=", value, BYTE(0)) if base_of(kind) is BOOL else value

    def _store(self, value: Any, place: Any, kind: Type) -> None:
        if base_of(kind) is BOOL:
            value = self.b.zext(value, BYTE)
        self.b.store(value, place, align=kind.align)

    # checks

    def _require(self, holds: Any, why: int, line: int) -> None:
        """Go on where ``holds``; else leave the unit, and say why."""
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

    def _spend(self, line: int) -> None:
        """One round of a loop that has no bound of its own."""
        place = self._global(self._backend._names.memory.fields[BUDGET.upper()].offset)
        left = self.b.sub(self.b.load(place, typ=WORD, align=8), WORD(1))
        self.b.store(left, place, align=8)
        self._require(self.b.icmp_signed(">", left, WORD(0)), LOOP, line)

    # places

    def _place(self, expression: tree.Expression) -> Any:
        """Where it lies."""
        if isinstance(expression, tree.Name):
            variable = expression.variable
            assert variable is not None
            if variable.constant is not None:
                return self._backend.constant(packed(variable.type, variable.constant))
            if variable.section == "VAR_GLOBAL":
                assert variable.offset is not None
                return self._global(variable.offset)
            return self._places[variable.name.upper()]
        if isinstance(expression, tree.Member):
            return self._at(self._place(expression.of), number(expression.offset))
        assert isinstance(expression, tree.Index)
        return self._element(expression)

    def _element(self, expression: tree.Index) -> Any:
        of = expression.of.type
        assert isinstance(of, Array)
        base = self._place(expression.of)
        offset: Any = number(0)
        for index, (low, high) in zip(expression.indices, of.bounds, strict=True):
            kind = index.type
            assert kind is not None
            value = lowering.widened(self.b, self._value(index), base_of(kind))
            place = self.b.sub(value, number(low))
            if not isinstance(index, tree.Literal):
                inside = self.b.icmp_unsigned("<=", place, number(high - low))
                self._require(inside, INDEX, expression.line)
            offset = self.b.add(self.b.mul(offset, number(high - low + 1)), place)
        return self._at(base, self.b.mul(offset, number(of.of.size)))

    # values

    def _value(self, expression: tree.Expression) -> Any:
        """A scalar in a register."""
        kind = expression.type
        assert kind is not None
        match expression:
            case tree.Literal(value=value):
                return ir.Constant(register(kind), value)
            case tree.Unary():
                return self._unary(expression)
            case tree.Binary():
                return self._binary(expression)
            case tree.Call():
                return self._library(expression) if expression.library else self._call(expression)
        return self._loaded(self._place(expression), kind)

    def _unary(self, expression: tree.Unary) -> Any:
        value = self._value(expression.operand)
        base = base_of(expression.type)  # type: ignore[arg-type]
        if expression.sign == "NOT":
            return self.b.not_(value)
        if base.kind == FLOAT:
            return self.b.fneg(value)
        return self._counted("-", ir.Constant(value.type, 0), value, expression.line)

    def _binary(self, expression: tree.Binary) -> Any:
        left, right = self._value(expression.left), self._value(expression.right)
        kind = expression.left.type
        assert kind is not None
        base, sign = base_of(kind), expression.sign
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
        assert unit is not None
        passed: list[Any] = []
        instance = None
        if unit.instance is not None:
            instance = self._place(call.of)
            passed.append(instance)
            for name, value in call.given.items():
                if unit.variables[name].section == "VAR_INPUT":
                    self._hand_in(value, self._at(instance, number(unit.variables[name].offset or 0)))
        passed += [self._passed(each, call.given.get(each.name.upper())) for each in unit.parameters()]
        result = self.b.call(self._backend.functions[unit.name.upper()], passed)
        self._leave_if_failed()
        for name, target in call.given.items():
            if instance is not None and unit.variables[name].section == "VAR_OUTPUT":
                source = self._at(instance, number(unit.variables[name].offset or 0))
                lowering.copied(self.b, self._place(target), source, unit.variables[name].type.size)
        return result

    def _hand_in(self, value: tree.Expression, place: Any) -> None:
        kind = value.type
        assert kind is not None
        if is_scalar(kind):
            self._store(self._value(value), place, kind)
        else:
            lowering.copied(self.b, place, self._place(value), kind.size)

    def _passed(self, parameter: tree.Variable, given: tree.Expression | None) -> Any:
        if given is None:  # an output that nobody takes
            with self.b.goto_entry_block():
                return self._room(ir.ArrayType(BYTE, parameter.type.size), parameter.type.align)
        if parameter.section == "VAR_INPUT" and is_scalar(parameter.type):
            return self._value(given)
        return self._place(given)

    def _library(self, call: tree.Call) -> Any:
        values = [self._value(each) for each in call.given.values()]
        kinds = [base_of(each.type) for each in call.given.values() if each.type is not None]
        word = call.library
        found = lowering.converted(self.b, word, values, kinds)
        if found is not None:
            value, holds = found
            if holds is not None:
                self._require(holds, CONVERSION, call.line)
            return value
        holds = lowering.is_defined(self.b, word, values[0])
        if holds is not None:
            self._require(holds, DOMAIN, call.line)
        if word in _INTRINSIC:
            return self.b.call(
                lowering.intrinsic(self._backend.module, _INTRINSIC[word], values[0].type), values[:1]
            )
        if word in ("TAN", "ASIN", "ACOS", "ATAN", "EXPT"):
            function = self._backend.external("pow" if word == "EXPT" else word.lower(), len(values))
            double = [
                v if isinstance(v.type, ir.DoubleType) else self.b.fpext(v, ir.DoubleType()) for v in values
            ]
            result = self.b.call(function, double)
            return (
                result
                if isinstance(values[0].type, ir.DoubleType)
                else self.b.fptrunc(result, values[0].type)
            )
        if word == "ABS" and kinds[0].kind == SIGNED:
            negative = self._counted("-", ir.Constant(values[0].type, 0), values[0], call.line)
            return self.b.select(
                self.b.icmp_signed("<", values[0], ir.Constant(values[0].type, 0)), negative, values[0]
            )
        return lowering.chosen(self.b, self._backend.module, word, values, kinds)
