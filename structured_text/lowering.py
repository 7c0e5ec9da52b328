"""Pieces of LLVM that need no state: types, copies, comparisons, conversions, standard functions."""

from collections.abc import Callable
from typing import Any

from llvmlite import ir

from structured_text import library
from structured_text.types import BOOL, FLOAT, SIGNED, Elementary, Type, base_of

BYTE, WORD, BIT, POINTER = ir.IntType(8), ir.IntType(64), ir.IntType(1), ir.PointerType()
FALSE = ir.Constant(BIT, 0)
_FLOATS = {4: ir.FloatType(), 8: ir.DoubleType()}


def stored(kind: Type) -> Any:
    """The LLVM type of a scalar in memory."""
    base = base_of(kind)
    return _FLOATS[base.size] if base.kind == FLOAT else ir.IntType(8 * base.size)


def register(kind: Type) -> Any:
    """The LLVM type of a scalar in a register."""
    return BIT if base_of(kind) is BOOL else stored(kind)


def number(value: int) -> Any:
    """An offset."""
    return ir.Constant(WORD, value)


def intrinsic(module: ir.Module, name: str, kind: Any, count: int = 1) -> Any:
    """An intrinsic function of LLVM on ``count`` numbers of one type."""
    return module.declare_intrinsic(f"llvm.{name}", [kind], ir.FunctionType(kind, [kind] * count))


def copied(b: ir.IRBuilder, target: Any, source: Any, size: int) -> None:
    """Copy bytes; both may be the same."""
    signature = ir.FunctionType(ir.VoidType(), [POINTER, POINTER, WORD, BIT])
    move = b.module.declare_intrinsic("llvm.memmove.p0.p0.i64", (), signature)
    b.call(move, [target, source, number(size), FALSE])


def cleared(b: ir.IRBuilder, target: Any, size: int) -> None:
    """Fill with zeros."""
    signature = ir.FunctionType(ir.VoidType(), [POINTER, BYTE, WORD, BIT])
    fill = b.module.declare_intrinsic("llvm.memset.p0.i64", (), signature)
    b.call(fill, [target, BYTE(0), number(size), FALSE])


def comparison(b: ir.IRBuilder, base: Elementary) -> Callable[[str, Any, Any], Any]:
    """Compares two of ``base`` by a sign of the language; what is no number is equal to nothing."""
    signs = {"=": "==", "<>": "!="}
    if base.kind == FLOAT:
        unordered, ordered = b.fcmp_unordered, b.fcmp_ordered
        return lambda sign, x, y: (unordered if sign == "<>" else ordered)(signs.get(sign, sign), x, y)
    compare = b.icmp_signed if base.kind == SIGNED else b.icmp_unsigned
    return lambda sign, x, y: compare(signs.get(sign, sign), x, y)


def widened(b: ir.IRBuilder, value: Any, base: Elementary) -> Any:
    """A whole number with 64 bits."""
    if value.type.width == 64:
        return value
    return (b.sext if base.kind == SIGNED else b.zext)(value, WORD)


def converted(
    b: ir.IRBuilder, word: str, values: list[Any], kinds: list[Elementary]
) -> tuple[Any, Any] | None:
    """The converted value, and whether it fits (None: always); None where ``word`` converts nothing."""
    pair = library.conversion(word)
    if pair is None:
        return None
    value, source, target = values[0], kinds[0], pair[1]
    goal = register(target)
    if target is BOOL:
        return (value if source is BOOL else b.icmp_unsigned("!=", value, ir.Constant(value.type, 0))), None
    if source is BOOL:
        return b.zext(value, goal), None
    if FLOAT in (source.kind, target.kind):
        return _with_float(b, value, source, target)
    low, high = target.range
    fits = _between(b, value, source, low, high)
    if goal.width > value.type.width:
        return (b.sext if source.kind == SIGNED else b.zext)(value, goal), fits
    return (value if goal.width == value.type.width else b.trunc(value, goal)), fits


def _with_float(b: ir.IRBuilder, value: Any, source: Elementary, target: Elementary) -> tuple[Any, Any]:
    goal = register(target)
    if source.kind == target.kind:
        if source.size == target.size:
            return value, None
        return (b.fpext if target.size > source.size else b.fptrunc)(value, goal), None
    if target.kind == FLOAT:
        return (b.sitofp if source.kind == SIGNED else b.uitofp)(value, goal), None
    low, high = target.range
    whole = b.call(
        intrinsic(b.module, "rint", value.type), [value]
    )  # to the even neighbour, as IEC 60559 has it
    fits = b.and_(
        b.fcmp_ordered(">=", whole, ir.Constant(value.type, float(low))),
        b.fcmp_ordered("<", whole, ir.Constant(value.type, float(high + 1))),
    )
    safe = b.select(fits, whole, ir.Constant(value.type, 0.0))
    return (b.fptosi if target.kind == SIGNED else b.fptoui)(safe, goal), fits


def _between(b: ir.IRBuilder, value: Any, source: Elementary, low: int, high: int) -> Any:
    """Whether a whole number lies between both; None where it must."""
    least, most = source.range
    compare = comparison(b, source)
    tests = []
    if least < low:
        tests.append(compare(">=", value, ir.Constant(value.type, low)))
    if most > high:
        tests.append(compare("<=", value, ir.Constant(value.type, high)))
    return None if not tests else tests[0] if len(tests) == 1 else b.and_(*tests)


def is_defined(b: ir.IRBuilder, word: str, value: Any) -> Any:
    """Whether the function ``word`` of real numbers is defined for ``value``; None where it always is."""
    low, high = library.REAL_FUNCTIONS.get(word, (None, None))
    tests = []
    if low is not None:
        tests.append(b.fcmp_ordered(">=", value, ir.Constant(value.type, low)))
    if high is not None:
        tests.append(b.fcmp_ordered("<=", value, ir.Constant(value.type, high)))
    return None if not tests else tests[0] if len(tests) == 1 else b.and_(*tests)


def chosen(b: ir.IRBuilder, module: ir.Module, word: str, values: list[Any], kinds: list[Elementary]) -> Any:
    """ABS, MIN, MAX, LIMIT, SEL and the shifts."""
    if word in library.SHIFTS:
        return _shifted(b, module, word, values, kinds)
    if word == "SEL":
        return b.select(values[0], values[2], values[1])
    if word == "ABS":
        return (
            b.call(intrinsic(module, "fabs", values[0].type), values) if kinds[0].kind == FLOAT else values[0]
        )
    compare = comparison(b, kinds[0])
    if word == "LIMIT":
        above = b.select(compare("<", values[1], values[0]), values[0], values[1])
        return b.select(compare(">", above, values[2]), values[2], above)
    first, second = values
    return b.select(compare("<" if word == "MIN" else ">", second, first), second, first)


def _shifted(
    b: ir.IRBuilder, module: ir.Module, word: str, values: list[Any], kinds: list[Elementary]
) -> Any:
    """By more than its bits, or by less than 0, a shift leaves nothing; a rotation goes round."""
    value, by = values
    width = ir.Constant(WORD, value.type.width)
    count = widened(b, by, kinds[1])
    within = b.icmp_unsigned("<", count, width)
    turn = b.urem(count, width)
    turn = turn if value.type.width == 64 else b.trunc(turn, value.type)
    if word in ("ROL", "ROR"):
        kind = intrinsic(module, "fshl" if word == "ROL" else "fshr", value.type, 3)
        return b.call(kind, [value, value, turn])
    moved = b.shl(value, turn) if word == "SHL" else b.lshr(value, turn)
    return b.select(within, moved, ir.Constant(value.type, 0))
