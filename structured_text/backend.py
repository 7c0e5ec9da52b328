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
from structured_text.types import align_of, base_of, is_scalar, packed
from structured_text.values import FREE, Values

MEMORY = "st_memory"


class Backend:
    """Builds one module. ``files`` numbers the texts."""

    def __init__(self, names: Declarations, triple: str, layout: str) -> None:
        self.module = ir.Module(name="structured_text")
        self.module.triple, self.module.data_layout = triple, layout
        self.files = sorted({unit.file for unit in names.units.values()})
        self._names = names
        self.memory = ir.GlobalVariable(self.module, ir.ArrayType(BYTE, names.memory.size), MEMORY)
        self.memory.initializer = ir.Constant(self.memory.value_type, None)
        self.memory.align, self.memory.type = 16, POINTER
        self.functions: dict[str, ir.Function] = {}
        self.costs: dict[str, int] = {}
        self._constants: dict[bytes, ir.GlobalVariable] = {}
        for name, unit in names.units.items():
            self.functions[name] = ir.Function(self.module, self._signature(unit), f"st_{name}")
        for name, unit in names.units.items():
            self.costs[name] = UnitBuilder(self, unit, self.functions[name]).build()

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

    def build(self) -> int:
        """The whole body; how many rounds and calls it takes at most, without those counted as it runs."""
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
        return self._cost

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
                kind = variable.type
                room = lowering.stored(kind) if is_scalar(kind) else ir.ArrayType(BYTE, kind.size)
                self._places[name] = self._room(room, align_of(kind))
                self._begins(variable, passed.get(name))
        # Behind all inputs: a variable may be both.
        for variable in self._unit.parameters():
            if variable.section == "VAR_OUTPUT":
                self._begins(variable, None)

    def _begins(self, variable: tree.Variable, given: Any) -> None:
        """The variable's value when the unit is called: what is ``given``, or its initial one."""
        kind, place = variable.type, self._places[variable.name.upper()]
        if is_scalar(kind):
            value = ir.Constant(register(kind), variable.initial or 0) if given is None else given
            self._store(value, place, kind)
            return
        data = packed(kind, variable.initial) if given is None else b""
        if any(data):
            given = self._backend.constant(data)
        if given is None:
            lowering.cleared(self.b, place, kind.size)
        else:
            lowering.copied(self.b, place, given, kind.size)

    # statements

    def _body(self, body: tree.Body) -> None:
        for statement in body:
            _STATEMENTS[type(statement)](self, statement)

    def _jump(self, statement: tree.Jump) -> None:
        word = statement.word
        self.b.branch(self._exit if word == "RETURN" else self._loops[-1][word == "CONTINUE"])
        self.b.position_at_end(self._function.append_basic_block())

    def _assignment(self, statement: tree.Assignment) -> None:
        target = statement.target
        if target is None:
            self._value(statement.value)
        else:
            self._give(statement.value, lambda: self._place(target))

    def _if(self, statement: tree.If) -> None:
        after = self._function.append_basic_block()
        for condition, body in statement.branches:
            self._branch(self._value(condition), body, after)
        self._body(statement.otherwise)
        self.b.branch(after)
        self.b.position_at_end(after)

    def _branch(self, holds: Any, body: tree.Body, after: ir.Block) -> None:
        then, otherwise = (self._function.append_basic_block() for _ in range(2))
        self.b.cbranch(holds, then, otherwise)
        self.b.position_at_end(then)
        self._body(body)
        self.b.branch(after)
        self.b.position_at_end(otherwise)

    def _case(self, statement: tree.Case) -> None:
        after = self._function.append_basic_block()
        selector, kind = self._value(statement.selector), statement.selector.type
        compare = lowering.comparison(self.b, base_of(kind))
        for (_, body), ranges in zip(statement.branches, statement.ranges, strict=True):
            found: Any = FALSE
            for low, high in ranges:
                inside = compare(">=", selector, ir.Constant(selector.type, low))
                inside = self.b.and_(inside, compare("<=", selector, ir.Constant(selector.type, high)))
                found = self.b.or_(found, inside)
            self._branch(found, body, after)
        self._body(statement.otherwise)
        self.b.branch(after)
        self.b.position_at_end(after)

    def _rounds(self, body: tree.Body, after: ir.Block, again: ir.Block) -> int:
        """Build the body of a loop, then go on in ``again``; how much a round counts."""
        before, self._cost = self._cost, 1
        self._loops.append((after, again))
        self._body(body)
        self._loops.pop()
        self.b.branch(again)
        self.b.position_at_end(again)
        cost, self._cost = self._cost, before
        return cost

    def _for(self, statement: tree.For) -> None:
        kind = statement.variable.type
        place, last = self._place(statement.variable), self._value(statement.last)
        first = self._value(statement.first)
        self._store(first, place, kind)
        compare = lowering.comparison(self.b, base_of(kind))
        body, again, after = (self._function.append_basic_block() for _ in range(3))
        up = statement.by > 0
        self.b.cbranch(compare("<=" if up else ">=", first, last), body, after)
        self.b.position_at_end(body)
        cost = self._rounds(statement.body, after, again)
        known = isinstance(statement.first, tree.Literal) and isinstance(statement.last, tree.Literal)
        total = cost * len(range(first.constant, last.constant + 1, abs(statement.by))) if known else FREE + 1
        if total > FREE:
            self._spend(statement.line, cost)
        self._cost += total if total <= FREE else cost
        now, by = self._loaded(place, kind), ir.Constant(last.type, abs(statement.by))
        left = self.b.sub(last, now) if up else self.b.sub(now, last)
        self._store(self.b.add(now, by) if up else self.b.sub(now, by), place, kind)
        self.b.cbranch(self.b.icmp_unsigned(">=", left, by), body, after)
        self.b.position_at_end(after)

    def _while(self, statement: tree.While) -> None:
        test, body, again, after = (self._function.append_basic_block() for _ in range(4))
        self.b.branch(body if statement.test_after else test)
        self.b.position_at_end(test)
        condition = self._value(statement.condition)
        self.b.cbranch(condition, *((after, body) if statement.test_after else (body, after)))
        self.b.position_at_end(body)
        cost = self._rounds(statement.body, after, again)
        self._spend(statement.line, cost)
        self._cost += cost
        self.b.branch(test)
        self.b.position_at_end(after)


_STATEMENTS: dict[type[tree.Statement], Any] = {
    tree.Assignment: UnitBuilder._assignment, tree.If: UnitBuilder._if,
    tree.Case: UnitBuilder._case, tree.For: UnitBuilder._for, tree.While: UnitBuilder._while,
    tree.Jump: UnitBuilder._jump,
}  # fmt: skip
