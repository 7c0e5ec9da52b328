"""Memory of pictures that is used again, and a fingerprint of results to the last bit."""

import hashlib
import struct
import sys
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

_POOLED = 16  # more at once are held by what waits for the garbage collector, and are not kept
_UNUSED = 2  # references to a buffer that nobody else holds: the pool's and the question's


class BufferPool:
    """At most 16 byte buffers of one size, each handed out again only when no picture made of it is left."""

    def __init__(self) -> None:
        self._buffers: list[NDArray[np.uint8]] = []

    def take(self, size: int) -> NDArray[np.uint8]:
        """A buffer (size,) that nobody reads."""
        self._buffers = [buffer for buffer in self._buffers if len(buffer) == size]
        for index in range(len(self._buffers)):
            if sys.getrefcount(self._buffers[index]) == _UNUSED:
                return self._buffers[index]
        buffer = np.empty(size, dtype=np.uint8)
        if len(self._buffers) < _POOLED:
            self._buffers.append(buffer)
        return buffer


_SIZE = 16


def digest(*values: Any) -> str:
    """BLAKE2b of ``values`` in hexadecimal: numbers, arrays, strings, None, and tuples and mappings of them.

    Floats and arrays enter with all their bits, mappings in the order of their keys. Raises TypeError for
    anything else.
    """
    made = hashlib.blake2b(digest_size=_SIZE)
    for value in values:
        _add(made, value)
    return made.hexdigest()


def _add(made: Any, value: Any) -> None:
    match value:
        case None:
            made.update(b"n")
        case bool() | int() | np.integer() | np.bool_():
            made.update(f"i{int(value)}".encode())
        case float() | np.floating():
            made.update(b"f" + struct.pack("<d", float(value)))
        case str():
            made.update(f"s{len(value)}:{value}".encode())
        case np.ndarray():
            whole = np.ascontiguousarray(value, dtype=np.float64)
            made.update(f"a{whole.shape}".encode() + whole.tobytes())
        case Mapping():
            _add(made, tuple(sorted(value.items())))
        case tuple() | list():
            made.update(f"t{len(value)}".encode())
            for item in value:
                _add(made, item)
        case _:
            raise TypeError(f"no digest of {type(value).__name__}")
