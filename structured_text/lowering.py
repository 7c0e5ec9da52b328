"""Pieces of LLVM that need no state: types, copies, comparisons, conversions, standard functions."""

from collections.abc import Callable
from functools import reduce
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


def resized(b: ir.IRBuilder, value: Any, goal: Any) -> Any:
    """A real number as ``goal``."""
    if value.type == goal:
        return value
    return (b.fpext if goal == _FLOATS[8] else b.fptrunc)(value, goal)


def converted(b: ir.IRBuilder, word: str, value: Any, source: Elementary) -> tuple[Any, Any]:
    """``value`` as the conversion ``word`` leaves it, and whether it fits (None: always).

    Between whole numbers and bit strings the bits are kept: cut off, or filled up by the sign.
    """
    target = (library.conversion(word) or (None, source))[1]
    goal = register(target)
    if target is BOOL:
        return comparison(b, source)("<>", value, ir.Constant(value.type, 0)), None
    if source.kind == target.kind == FLOAT:
        return resized(b, value, goal), None
    if target.kind == FLOAT:
        return (b.sitofp if source.kind == SIGNED else b.uitofp)(value, goal), None
    if source.kind != FLOAT:
        widen = b.sext if source.kind == SIGNED else b.zext
        return (b.trunc if goal.width < value.type.width else widen)(value, goal), None
    low, high = target.range
    # A half goes to the even neighbour, as IEC 60559 has it.
    rounding = "trunc" if word.startswith("TRUNC") else "rint"
    whole = b.call(intrinsic(b.module, rounding, value.type), [value])
    fits = b.and_(
        b.fcmp_ordered(">=", whole, ir.Constant(value.type, float(low))),
        b.fcmp_ordered("<", whole, ir.Constant(value.type, float(high + 1))),
    )
    safe = b.select(fits, whole, ir.Constant(value.type, 0.0))
    return (b.fptosi if target.kind == SIGNED else b.fptoui)(safe, goal), fits


def is_finite(b: ir.IRBuilder, value: Any) -> Any:
    """Whether a real number is one."""
    size = b.call(intrinsic(b.module, "fabs", value.type), [value])
    return b.fcmp_ordered("<", size, ir.Constant(value.type, float("inf")))


def is_defined(b: ir.IRBuilder, word: str, value: Any) -> Any:
    """Whether the function ``word`` of real numbers is defined for ``value``; None where it always is."""
    if word in ("SIN", "COS", "TAN"):
        return is_finite(b, value)
    bounds = zip((">=", "<="), library.REAL_FUNCTIONS.get(word, (None, None)), strict=True)
    tests = [
        b.fcmp_ordered(sign, value, ir.Constant(value.type, bound))
        for sign, bound in bounds
        if bound is not None
    ]
    return reduce(b.and_, tests) if tests else None


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
    sign = "<" if word == "MIN" else ">"
    return reduce(lambda x, y: b.select(compare(sign, y, x), y, x), values)


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
