"""Loads of four texels at once, and hints which memory will be wanted: compilers of Python have no word for
either.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numba.core import cgutils, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from foundation.compiled import allocation_free

ir: Any = cgutils.ir  # type: ignore[attr-defined]  # llvmlite, as numba has it
Grey = NDArray[np.uint8]
Pairs = NDArray[np.uint16]
Words = NDArray[np.int32]
Real32 = NDArray[np.float32]

_READ, _INTO_EVERY_CACHE, _DATA = 0, 3, 1
_STEP = 8  # pixels between hints: half a line of the cache, where two texels come to a pixel
_LINE = 16  # float32 in a line of the cache


def _typed(context: Any, words: Any, index: Any) -> tuple[Any, Callable[..., Any]]:
    """``prefetch(words, index)`` as numba types and generates it."""

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        array = context.make_array(words)(context, builder, arguments[0])
        place = builder.gep(array.data, [arguments[1]])
        byte, number = ir.IntType(8).as_pointer(), ir.IntType(32)
        wanted = ir.FunctionType(ir.VoidType(), [byte, number, number, number])
        function = _declared(builder.module, wanted, "llvm.prefetch.p0")
        hints = [ir.Constant(number, value) for value in (_READ, _INTO_EVERY_CACHE, _DATA)]
        builder.call(function, [builder.bitcast(place, byte), *hints])
        return context.get_dummy_value()

    return types.void(words, index), generate


def _typed_load(context: Any, pairs: Any, index: Any) -> tuple[Any, Callable[..., Any]]:
    """``load_both(pairs, index)`` as numba types and generates it."""

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        array = context.make_array(pairs)(context, builder, arguments[0])
        place = builder.gep(array.data, [arguments[1]])
        both = builder.load(builder.bitcast(place, ir.IntType(32).as_pointer()))
        both.align = 2  # a pair may begin anywhere
        return both

    return types.int32(pairs, index), generate


_declared: Any = cgutils.get_or_insert_function
_prefetch: Any = intrinsic(_typed)
load_both: Any = intrinsic(_typed_load)
"""The pair at an index (intp) and, in the upper 16 bits, the one after it, which must be there: int32."""


def pairs_of(texture: Grey) -> Pairs:
    """Each texel (height, width) and, in the upper 8 bits, the one below it; below the last is the first."""
    pairs = texture.astype(np.uint16)
    pairs |= np.roll(pairs, -1, axis=0) << 8
    return pairs


@allocation_free
def fetch_ahead(texture: Pairs, words: Words, ahead: int, count: int) -> None:
    """Hint that the pairs ``ahead`` of the indices ``words`` will be wanted; a hint may be wrong."""
    last = np.int32(texture.shape[0] - 1)
    for j in range(0, count, _STEP):
        _prefetch(texture, np.intp(min(max(words[j] + ahead, np.int32(0)), last)))


@allocation_free
def fetch_line(values: Real32, first: int, count: int) -> None:
    """Hint that ``count`` of ``values`` from the flat place ``first`` on will be wanted, if that many are."""
    for k in range(first, min(first + count, values.size), _LINE):
        _prefetch(values, np.intp(k))
