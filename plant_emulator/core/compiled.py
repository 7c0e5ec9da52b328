"""How the plant's kernels are compiled: to machine code, once, and without a memory allocator.

numba counts every array that a function takes out of a tuple or slices; in kernels of a microsecond the
counting took half of the time. Without its run-time system there is nothing to count with, and code that
would allocate does not compile: the hot loop is free of allocation by construction. Arithmetic stays strictly
IEEE 754 (no ``fastmath``), so that a rerun repeats bit for bit.

numba keys its cache on the file of the compiled function alone: who changes a kernel touches
``right_hand_side.py`` too.
"""

from collections.abc import Callable
from typing import Any, TypeVar

from numba import njit

Function = TypeVar("Function", bound=Callable[..., Any])


def kernel(function: Function) -> Function:
    """``function`` compiled to machine code when first called, and cached."""
    options: dict[str, Any] = {"cache": True, "error_model": "numpy", "_nrt": False}
    compiled: Function = njit(**options)(function)
    return compiled
