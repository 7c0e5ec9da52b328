"""What every camera shares: a thread that produces pairs, and an event loop that always gets the newest
one.
"""

import asyncio
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import AsyncIterator
from typing import NamedTuple

from protocol.errors import LinkLost
from vision_pc.config.vision import CameraSettings
from vision_pc.core.perception.freshness import Repeats
from vision_pc.core.types import StereoPair

_RATE_OVER = 20  # pairs over which the rate is measured
_JOIN_S = 1.0


class SourceStatus(NamedTuple):
    """How the camera is doing. ``age_ms`` since the newest pair was captured, None before the first.

    ``frames`` delivered, ``dropped`` never came although numbered, ``reconnects`` after the first connection,
    ``trouble`` the present cause (``link.…``) or None.
    """

    connected: bool
    age_ms: float | None
    frames: int
    dropped: int
    reconnects: int
    rate_hz: float
    trouble: str | None


class CameraSource(ABC):
    """Pairs from a camera. The thread in ``_produce`` blocks; everything else belongs to the event loop.

    Capture times are on this machine's monotonic clock. A camera that goes silent, repeats itself or was
    never there is told by ``LinkLost`` from whoever waits for a pair, never by an old picture.
    """

    def __init__(self, settings: CameraSettings) -> None:
        self._settings = settings
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._produce, name=f"camera-{settings.source}", daemon=True)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._arrived = asyncio.Event()
        self._newest: StereoPair | None = None
        self._captures: deque[int] = deque(maxlen=_RATE_OVER)
        self._frames = 0
        self._dropped = 0
        self._reconnects = -1
        self._started_ns = 0
        self._trouble: str | None = "link.camera_missing"
        self._repeats = Repeats(settings.frozen_frames)

    async def start(self) -> None:
        """Start the camera's thread and return at once. Pairs come as soon as the camera is there."""
        self._loop = asyncio.get_running_loop()
        self._started_ns = time.monotonic_ns()
        self._thread.start()

    async def close(self) -> None:
        """End the thread. Returns when it has ended."""
        self._stop.set()
        if self._thread.is_alive():
            await asyncio.to_thread(self._thread.join, _JOIN_S)

    @property
    def newest(self) -> StereoPair | None:
        """The newest pair, None before the first."""
        return self._newest

    def status(self) -> SourceStatus:
        """How the camera is doing now."""
        trouble = self._trouble_now()
        span_ns = self._captures[-1] - self._captures[0] if len(self._captures) > 1 else 0
        return SourceStatus(
            connected=trouble is None and self._newest is not None,
            age_ms=None if self._newest is None else (time.monotonic_ns() - self._newest.capture_ns) / 1e6,
            frames=self._frames,
            dropped=self._dropped,
            reconnects=max(self._reconnects, 0),
            rate_hz=0.0 if span_ns <= 0 else 1e9 * (len(self._captures) - 1) / span_ns,
            trouble=trouble,
        )

    async def pair_after(self, capture_ns: int) -> StereoPair:
        """The first pair to arrive that was captured after ``capture_ns``, or the newest if it was.

        Raises LinkLost: ``link.camera_missing``, ``link.camera_silent``, ``link.camera_frozen`` or what the
        stream was refused for (``frame.…``).
        """
        waits_from_ns = time.monotonic_ns()
        while not self._fresh_after(capture_ns):
            self._arrived.clear()
            left_s = self._settings.stale_ms / 1e3 - (time.monotonic_ns() - waits_from_ns) / 1e9
            if left_s <= 0.0:
                raise self._lost()
            try:
                async with asyncio.timeout(left_s):
                    await self._arrived.wait()
            except TimeoutError:
                continue  # judge once more: the loop above raises
        assert self._newest is not None
        return self._newest

    def _fresh_after(self, capture_ns: int) -> bool:
        """Whether there is a pair captured since, alive, and not older than the limit."""
        if self._newest is None or self._newest.capture_ns <= capture_ns:
            return False
        return self._trouble != "link.camera_frozen" and self._age_ms() <= self._settings.stale_ms

    async def pairs(self) -> AsyncIterator[StereoPair]:
        """Newest pairs from now on; what comes while the caller is busy is skipped. Raises as
        ``pair_after``.
        """
        capture_ns = time.monotonic_ns()
        while True:
            pair = await self.pair_after(capture_ns)
            capture_ns = pair.capture_ns
            yield pair

    def _trouble_now(self) -> str | None:
        since_ns = self._started_ns if self._newest is None else self._newest.capture_ns
        if self._trouble is None and time.monotonic_ns() - since_ns > self._settings.stale_ms * 1e6:
            return "link.camera_silent"
        return self._trouble

    def _lost(self) -> LinkLost:
        cause = self._trouble_now() or "link.camera_silent"
        age = (
            "no picture ever came"
            if self._newest is None
            else f"newest picture is {self._age_ms():.0f} ms old"
        )
        return LinkLost(
            cause, f"camera ({self._settings.source}): {age}, limit {self._settings.stale_ms:g} ms"
        )

    def _age_ms(self) -> float:
        assert self._newest is not None
        return (time.monotonic_ns() - self._newest.capture_ns) / 1e6

    @abstractmethod
    def _produce(self) -> None:
        """Runs in the thread until ``_stop`` is set, calling ``_deliver``, ``_is_there`` and ``_is_gone``."""

    def _is_there(self) -> None:
        """From the thread: a connection stands."""
        self._call(self._set_connected)

    def _is_gone(self, cause: str) -> None:
        """From the thread: the connection ended or could not be made."""
        self._call(self._set_trouble, cause)

    def _deliver(self, pair: StereoPair, dropped: int = 0) -> None:
        """From the thread: a pair, before which ``dropped`` never came."""
        self._call(self._publish, pair, dropped)

    def _call(self, function: object, *arguments: object) -> None:
        if self._loop is None or self._stop.is_set():
            return
        try:
            self._loop.call_soon_threadsafe(function, *arguments)  # type: ignore[arg-type]
        except RuntimeError:  # the loop was closed while the thread was on its way
            self._stop.set()

    def _set_connected(self) -> None:
        self._reconnects += 1
        self._trouble = None
        self._started_ns = time.monotonic_ns()

    def _set_trouble(self, cause: str) -> None:
        self._trouble = cause
        self._arrived.set()

    def _publish(self, pair: StereoPair, dropped: int) -> None:
        self._frames += 1
        self._dropped += dropped
        self._captures.append(pair.capture_ns)
        self._repeats.add(pair.left)
        if self._repeats.frozen:
            self._trouble = "link.camera_frozen"
        elif self._trouble == "link.camera_frozen":
            self._trouble = None
        self._newest = pair
        self._arrived.set()
