"""a·b + c, rounded once: sums of products that come out the same on every processor, without BLAS."""

from collections.abc import Callable
from fractions import Fraction
from typing import Any

from numba.core import types
from numba.extending import intrinsic, overload


def fused(a: float, b: float, c: float) -> float:
    """a·b + c, rounded once; in a kernel it is one instruction."""
    try:
        return float(Fraction(a) * Fraction(b) + Fraction(c))
    except (OverflowError, ValueError):  # beyond the range, infinite or no number
        return a * b + c


def _typed(context: Any, a: Any, b: Any, c: Any) -> tuple[Any, Callable[..., Any]]:
    def lowered(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.fma(*values)

    return types.float64(types.float64, types.float64, types.float64), lowered


_fused: Any = intrinsic(_typed)
overload(fused)(lambda a, b, c: lambda a, b, c: _fused(a, b, c))
