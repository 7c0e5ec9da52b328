"""What the application needs from outside: a clock, frames, a log, a place to compute.

The service implements these ports with an event loop, sockets and threads; lockstep implements them by
letting simulated time pass. Everything above them is the same code.
"""

from collections.abc import Awaitable, Callable, Coroutine, Sequence
from typing import Any, NamedTuple, Protocol, TypeVar

from foundation.event_log import Level
from vision_pc.core.perception.watch import Sensor
from vision_pc.core.ports import Arm
from vision_pc.core.types import (
    CameraCalibration,
    CameraFrame,
    FrameObservation,
    Look,
)

T = TypeVar("T")
F = TypeVar("F", bound=CameraFrame)


class Clock(Protocol):
    """The time of the vision PC, and the only place where its programs wait."""

    @property
    def now_ns(self) -> int:
        """The time on the vision PC's clock."""
        ...

    def wake(self) -> None:
        """Have everybody who waits look again: something has happened."""
        ...

    async def until(self, happened: Callable[[], bool], timeout_s: float) -> bool:
        """Wait for ``happened()``. Return False when ``timeout_s`` have passed first."""
        ...


class Log(Protocol):
    """Where events are written for the record."""

    def write(self, event: str, level: Level = "info", /, **fields: Any) -> None:
        """Write one event."""
        ...


class HealthyLog(Log, Protocol):
    """A log that says whether events can still be recorded."""

    @property
    def healthy(self) -> bool: ...


class StoppableArm(Arm, Protocol):
    """An arm that can be halted after a program ended early."""

    async def halt(self) -> None: ...


class CameraStatus(NamedTuple):
    """How a camera is doing. ``age_ms`` since the newest frame was captured, None before the first.

    ``frames`` delivered, ``dropped`` never came although numbered, ``reconnects`` after the first connection,
    ``trouble`` the present cause (``link.…``) or None, ``detail`` what is known of it beyond that;
    ``heard_at_s``: when the newest frame came, s since 1970, 0 before the first.
    """

    connected: bool
    age_ms: float | None
    frames: int
    rate_hz: float
    dropped: int = 0
    reconnects: int = 0
    trouble: str | None = None
    detail: str = ""
    heard_at_s: float = 0.0


class Seen(NamedTuple):
    """What one pair shows, the camera that took it, and which marker is the tool's."""

    observation: FrameObservation
    camera: CameraCalibration
    tool_id: int


class Worker(Protocol):
    """Where long computations run, so that the link is not held up."""

    async def run(self, work: Callable[[], T]) -> T:
        """The result of ``work``. Raises what it raises."""
        ...


class Background(Protocol):
    """Starts programs that run beside the present one."""

    def start(self, program: Coroutine[Any, Any, None]) -> Callable[[], Awaitable[None]]:
        """Start ``program``, which raises nothing.

        Return what ends it where it waits, and waits for that; it does nothing once the program has ended.
        """
        ...


class Runtime(NamedTuple):
    """How the vision PC's programs wait, compute and run side by side."""

    clock: Clock
    worker: Worker
    background: Background


class SightRecorder(Protocol[F]):
    """Records measurements as they are made, so that they can be made again and compared."""

    def tapped(self, sensor: Sensor[F]) -> Sensor[F]:
        """A sensor that measures as ``sensor`` does, and records what it is asked and what it finds."""
        ...

    def looked(self, look: Look, observations: Sequence[FrameObservation]) -> None:
        """Record a look that succeeded, and what was observed in each of its frames."""
        ...
