"""Frames of a camera as they arrive: the newest at any time, and the cause when none comes.

Every camera of the service and the emulated ones in lockstep put their frames here; what is fresh, silent or
frozen is judged here alone.
"""

import time
from collections import deque
from typing import Generic, TypeVar

from protocol.errors import LinkLost
from vision_pc.application.ports import CameraStatus, Clock
from vision_pc.config.camera import CameraSettings
from vision_pc.core.types import CameraFrame

F = TypeVar("F", bound=CameraFrame)
_RATE_OVER = 20  # frames over which the rate is measured


class CameraFeed(Generic[F]):
    """Frames of a camera as they arrive. Capture times are on this machine's clock.

    ``newest``: the newest frame, None before the first. Who waits for a frame of a camera that is silent,
    repeats itself or was never there gets ``LinkLost``, never an old frame.
    """

    def __init__(self, settings: CameraSettings, clock: Clock) -> None:
        self._settings = settings
        self._clock = clock
        self.newest: F | None = None
        self._captures: deque[int] = deque(maxlen=_RATE_OVER)
        self._frames = 0
        self._heard_at_s = 0.0
        self._dropped = 0
        self._reconnects = -1
        self._started_ns = clock.now_ns
        self._trouble: str | None = "link.camera_missing"
        self._detail = ""

    def status(self) -> CameraStatus:
        """How the camera is doing now."""
        trouble = self._trouble_now()
        span_ns = self._captures[-1] - self._captures[0] if len(self._captures) > 1 else 0
        return CameraStatus(
            connected=trouble is None and self.newest is not None,
            age_ms=None if self.newest is None else self._age_ms(),
            frames=self._frames,
            rate_hz=0.0 if span_ns <= 0 else 1e9 * (len(self._captures) - 1) / span_ns,
            dropped=self._dropped,
            reconnects=max(self._reconnects, 0),
            trouble=trouble,
            detail=self._detail if trouble is not None else "",
            heard_at_s=self._heard_at_s,
        )

    async def frame_after(self, capture_ns: int) -> F:
        """The first frame to arrive that was captured after ``capture_ns``, or the newest if it was.

        Raises LinkLost: ``link.camera_missing``, ``link.camera_silent``, ``link.camera_frozen`` or what the
        stream was refused for (``frame.…``).
        """
        if not await self._clock.until(lambda: self._fresh_after(capture_ns), self._settings.stale_ms / 1e3):
            raise self._link_lost()
        assert self.newest is not None
        return self.newest

    # The camera's side.
    def connected(self) -> None:
        """Note that a connection to the camera stands."""
        self._reconnects += 1
        self._trouble, self._detail = None, ""
        self._started_ns = self._clock.now_ns

    def lost(self, cause: str, detail: str = "") -> None:
        """Note that the connection ended or could not be made; ``detail`` says more than the cause."""
        self._trouble, self._detail = cause, detail

    def publish(self, frame: F, dropped: int = 0, frozen: bool = False) -> None:
        """Take a frame before which ``dropped`` never came; ``frozen``: it only repeats the one before."""
        self._frames += 1
        self._heard_at_s = time.time()
        self._dropped += dropped
        self._captures.append(frame.capture_ns)
        if frozen:
            self._trouble = "link.camera_frozen"
        elif self._trouble == "link.camera_frozen":
            self._trouble = None
        self.newest = frame
        self._clock.wake()

    def _fresh_after(self, capture_ns: int) -> bool:
        """Return True if there is a frame captured since, alive, and not older than the limit."""
        if self.newest is None or self.newest.capture_ns <= capture_ns:
            return False
        return self._trouble != "link.camera_frozen" and self._age_ms() <= self._settings.stale_ms

    def _trouble_now(self) -> str | None:
        since_ns = self._started_ns if self.newest is None else self.newest.capture_ns
        if self._trouble is None and self._clock.now_ns - since_ns > self._settings.stale_ms * 1e6:
            return "link.camera_silent"
        return self._trouble

    def _link_lost(self) -> LinkLost:
        cause = self._trouble_now() or "link.camera_silent"
        age = (
            "no picture ever came"
            if self.newest is None
            else f"newest picture is {self._age_ms():.0f} ms old"
        )
        return LinkLost(
            cause,
            f"camera ({self._settings.source}): {age}, limit {self._settings.stale_ms:g} ms"
            + (f"; {self._detail}" if self._detail else ""),
        )

    def _age_ms(self) -> float:
        assert self.newest is not None
        return (self._clock.now_ns - self.newest.capture_ns) / 1e6
