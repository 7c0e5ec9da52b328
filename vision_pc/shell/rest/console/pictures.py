"""Live pictures of both eyes for people: encoded once for all who watch, in a thread of its own."""

import asyncio
import struct
import time
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
from numpy.typing import NDArray

from foundation.periods import take_policy
from vision_pc.core.types import StereoPair

PICTURE_PERIOD_S = 0.095  # at most ten a second; a camera of ten a second loses none
HEADER = struct.Struct("<IQQII")
"""Bytes after this header, capture and encoding time (ns, vision's clock), frame, bytes of the left eye."""
_LEFT_QUALITY, _RIGHT_QUALITY = 80, 70
_RIGHT_SCALE = 0.5


class LivePictures:
    """Turns the newest pair into the bytes of one message: header, left eye, right eye at half its size."""

    def __init__(self, pair_after: Callable[[int], Awaitable[StereoPair]]) -> None:
        self._pair_after = pair_after
        self._shown_ns = 0
        self._thread: ThreadPoolExecutor | None = None

    async def next_message(self) -> bytes:
        """The message of the first pair after the last one. Raises LinkLost while the camera is silent."""
        pair = await self._pair_after(self._shown_ns)
        self._shown_ns = pair.capture_ns
        if self._thread is None:  # nobody watched before
            # Not the eyes' thread: a watcher must neither wait for a measurement nor hold one up.
            self._thread = ThreadPoolExecutor(1, "pictures", initializer=take_policy, initargs=("batch",))
        return await asyncio.get_running_loop().run_in_executor(self._thread, message, pair)


def message(pair: StereoPair) -> bytes:
    """The bytes of one pair."""
    left, right = encoded(pair.left, pair.right)
    return packed(pair.frame_id, pair.capture_ns, time.monotonic_ns(), left, right)


def encoded(left: NDArray[np.uint8], right: NDArray[np.uint8]) -> tuple[bytes, bytes]:
    """Both eyes as JPEG, the right one at half its size."""
    size = (round(right.shape[1] * _RIGHT_SCALE), round(right.shape[0] * _RIGHT_SCALE))
    smaller = np.asarray(cv2.resize(right, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    return _jpeg(left, _LEFT_QUALITY), _jpeg(smaller, _RIGHT_QUALITY)


def packed(frame_id: int, capture_ns: int, encoded_ns: int, left: bytes, right: bytes) -> bytes:
    """The message of two JPEG pictures; ``right`` is empty where there is none."""
    length = HEADER.size - 4 + len(left) + len(right)
    return HEADER.pack(length, capture_ns, encoded_ns, frame_id & 0xFFFFFFFF, len(left)) + left + right


def _jpeg(picture: NDArray[np.uint8], quality: int) -> bytes:
    _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return bytes(data)
