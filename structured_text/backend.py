"""The checked tree as LLVM: addresses are bytes from the beginning of a memory that ``types`` has laid out.

Every check that fails leaves its number and line in the first word of the memory, and the call ends at once,
and so do all calls around it.
"""

from typing import Any

from llvmlite import ir

from structured_text import lowering
from structured_text import syntax as tree
from structured_text.declarations import Declarations
from structured_text.lowering import BYTE, FALSE, POINTER, number, register
from structured_text.types import FLOAT, base_of, is_scalar, packed
from structured_text.values import NOT_FINITE, Values

MEMORY = "st_memory"


class Backend:
    """Builds one module. ``files`` numbers the texts; ``finite``: assigned numbers must be."""

    def __init__(self, names: Declarations, triple: str, layout: str, *, finite: bool) -> None:
        self.finite = finite
        self.module = ir.Module(name="structured_text")
        self.module.triple, self.module.data_layout = triple, layout
        self.files = sorted({unit.file for unit in names.units.values()})
        self._names = names
        self.memory = ir.GlobalVariable(self.module, ir.ArrayType(BYTE, names.memory.size), MEMORY)
        self.memory.initializer = ir.Constant(self.memory.value_type, None)
        self.memory.align, self.memory.type = 16, POINTER
        self.functions: dict[str, ir.Function] = {}
        self._constants: dict[bytes, ir.GlobalVariable] = {}
        for name, unit in names.units.items():
            self.functions[name] = ir.Function(self.module, self._signature(unit), f"st_{name}")
        for name, unit in names.units.items():
            UnitBuilder(self, unit, self.functions[name]).build()

    def _signature(self, unit: tree.Unit) -> ir.FunctionType:
        result = ir.VoidType() if unit.result is None else register(unit.result)
        passed: list[Any] = [] if unit.instance is None else [POINTER]
        for each in unit.parameters():
            by_value = each.section == "VAR_INPUT" and is_scalar(each.type)
            passed.append(register(each.type) if by_value else POINTER)
        return ir.FunctionType(result, passed)

    def constant(self, data: bytes) -> ir.GlobalVariable:
        """Bytes that are never written to."""
        if data not in self._constants:
            made = ir.GlobalVariable(
                self.module, ir.ArrayType(BYTE, len(data)), f"st_constant_{len(self._constants)}"
            )
            made.initializer = ir.Constant(made.value_type, bytearray(data))
            made.global_constant, made.linkage, made.align, made.type = True, "internal", 16, POINTER
            self._constants[data] = made
        return self._constants[data]

    def external(self, name: str, count: int) -> ir.Function:
        """A function of C's mathematical library."""
        double = ir.DoubleType()
        found = self.module.globals.get(name)
        return found or ir.Function(self.module, ir.FunctionType(double, [double] * count), name)


class UnitBuilder(Values):
    """Builds one function. ``build`` is called once."""

    def build(self) -> None:
        """The whole body."""
        self._enter()
        self._body(self._unit.body)
        self.b.branch(self._exit)
        if self._why.incomings:
            self._function.blocks.append(self._failed)
            self.b.position_at_end(self._failed)
            self.b.store(self._why, self._global(0), align=8)
            self.b.branch(self._exit)
        self._function.blocks.append(self._exit)
        self.b.position_at_end(self._exit)
        if self._unit.result is None:
            self.b.ret_void()
        else:
            result = self._places[self._unit.name.upper()]
            self.b.ret(self._loaded(result, self._unit.result))

    def _enter(self) -> None:
        given = list(self._function.args)
        self._instance = given.pop(0) if self._unit.instance is not None else None
        passed = dict(zip((p.name.upper() for p in self._unit.parameters()), given, strict=True))
        for name, variable in self._unit.variables.items():
            if variable.constant is not None:
                continue
            if variable.offset is not None:
                self._places[name] = self._at(self._instance, number(variable.offset))
            elif name in passed and variable.section != "VAR_INPUT":
                self._places[name] = passed[name]
            else:
                self._places[name] = self._local(variable, passed.get(name))

    def _local(self, variable: tree.Variable, given: Any) -> Any:
        kind = variable.type
        if is_scalar(kind):
            place = self._room(lowering.stored(kind), kind.align)
            value = ir.Constant(register(kind), variable.initial or 0) if given is None else given
            self._store(value, place, kind)
            return place
        place = self._room(ir.ArrayType(BYTE, kind.size), kind.align)
        if given is None:
            data = packed(kind, variable.initial)
            if any(data):
                given = self._backend.constant(data)
        if given is None:
            lowering.cleared(self.b, place, kind.size)
        else:
            lowering.copied(self.b, place, given, kind.size)
        return place

    # statements

    def _body(self, body: tree.Body) -> None:
        for statement in body:
            self._statement(statement)

    def _statement(self, statement: tree.Statement) -> None:
        match statement:
            case tree.Assignment():
                self._assignment(statement)
            case tree.CallStatement():
                self._call(statement.call)
            case tree.If():
                self._if(statement)
            case tree.Case():
                self._case(statement)
            case tree.For():
                self._for(statement)
            case tree.While():
                self._while(statement)
            case tree.Jump(word=word):
                goal = self._exit if word == "RETURN" else self._loops[-1][word == "CONTINUE"]
                self.b.branch(goal)
                self._begin(self._new())

    def _new(self) -> ir.Block:
        return ir.Block(self._function, self._function.scope.deduplicate("b"))

    def _begin(self, block: ir.Block) -> None:
        self._function.blocks.append(block)
        self.b.position_at_end(block)

    def _assignment(self, statement: tree.Assignment) -> None:
        kind = statement.target.type
        assert kind is not None
        if is_scalar(kind):
            value = self._value(statement.value)
            if self._backend.finite and base_of(kind).kind == FLOAT:
                size = self.b.call(lowering.intrinsic(self._backend.module, "fabs", value.type), [value])
                finite = self.b.fcmp_ordered("<", size, ir.Constant(value.type, float("inf")))
                self._require(finite, NOT_FINITE, statement.line)
            self._store(value, self._place(statement.target), kind)
        else:
            source = self._place(statement.value)
            lowering.copied(self.b, self._place(statement.target), source, kind.size)

    def _if(self, statement: tree.If) -> None:
        after = self._new()
        for condition, body in statement.branches:
            then, otherwise = self._new(), self._new()
            self.b.cbranch(self._value(condition), then, otherwise)
            self._begin(then)
            self._body(body)
            self.b.branch(after)
            self._begin(otherwise)
        self._body(statement.otherwise)
        self.b.branch(after)
        self._begin(after)

    def _case(self, statement: tree.Case) -> None:
        after = self._new()
        selector, kind = self._value(statement.selector), statement.selector.type
        assert kind is not None
        compare = lowering.comparison(self.b, base_of(kind))
        for (_, body), ranges in zip(statement.branches, statement.ranges, strict=True):
            found: Any = FALSE
            for low, high in ranges:
                inside = compare(">=", selector, ir.Constant(selector.type, low))
                inside = self.b.and_(inside, compare("<=", selector, ir.Constant(selector.type, high)))
                found = self.b.or_(found, inside)
            then, otherwise = self._new(), self._new()
            self.b.cbranch(found, then, otherwise)
            self._begin(then)
            self._body(body)
            self.b.branch(after)
            self._begin(otherwise)
        self._body(statement.otherwise)
        self.b.branch(after)
        self._begin(after)

    def _for(self, statement: tree.For) -> None:
        kind = statement.variable.type
        assert kind is not None
        place, last = self._place(statement.variable), self._value(statement.last)
        first = self._value(statement.first)
        self._store(first, place, kind)
        compare = lowering.comparison(self.b, base_of(kind))
        body, step, after = self._new(), self._new(), self._new()
        up = statement.by > 0
        self.b.cbranch(compare("<=" if up else ">=", first, last), body, after)
        self._begin(body)
        self._loops.append((after, step))
        self._body(statement.body)
        self._loops.pop()
        self.b.branch(step)
        self._begin(step)
        if not (isinstance(statement.first, tree.Literal) and isinstance(statement.last, tree.Literal)):
            self._spend(statement.line)
        now, by = self._loaded(place, kind), ir.Constant(last.type, abs(statement.by))
        left = self.b.sub(last, now) if up else self.b.sub(now, last)
        again = self._new()
        self.b.cbranch(self.b.icmp_unsigned(">=", left, by), again, after)
        self._begin(again)
        self._store(self.b.add(now, by) if up else self.b.sub(now, by), place, kind)
        self.b.branch(body)
        self._begin(after)

    def _while(self, statement: tree.While) -> None:
        test, body, after = self._new(), self._new(), self._new()
        self.b.branch(body if statement.test_after else test)
        self._begin(test)
        condition = self._value(statement.condition)
        going_on = (after, body) if statement.test_after else (body, after)
        self.b.cbranch(condition, *going_on)
        self._begin(body)
        self._loops.append((after, test))
        self._spend(statement.line)
        self._body(statement.body)
        self._loops.pop()
        self.b.branch(test)
        self._begin(after)
