"""Buffers for pictures that are used again: fresh memory costs a third of what filling it does."""

import sys

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
