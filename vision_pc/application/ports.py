"""What the application needs from outside: a clock, frames, a transport, a log, a place to compute.

The service implements these ports with an event loop, sockets and threads; lockstep implements them by
letting simulated time pass. Everything above them is the same code.
"""

from collections.abc import Callable, Coroutine, Sequence
from contextlib import AbstractContextManager
from typing import Any, NamedTuple, Protocol, TypeVar

from foundation.event_log import Level
from protocol.channel import LinkStatistics
from protocol.clock_offset import OffsetEstimate
from protocol.faults import CommandCode
from protocol.reference_messages import Acknowledgement, State
from vision_pc.core.perception.watch import Sensor
from vision_pc.core.ports import Arm
from vision_pc.core.se3 import Array
from vision_pc.core.targets.keeper import KeptTarget, TargetKeeper
from vision_pc.core.targets.sighting import Click
from vision_pc.core.targets.target import TargetObservation
from vision_pc.core.types import (
    CameraCalibration,
    CameraFrame,
    FrameObservation,
    Look,
    StereoPair,
    WatchHealth,
    WatchSample,
)

T = TypeVar("T")
FrameT_co = TypeVar("FrameT_co", bound=CameraFrame, covariant=True)
F = TypeVar("F", bound=CameraFrame)
FrameT_contra = TypeVar("FrameT_contra", bound=CameraFrame, contravariant=True)


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


class LinkTransport(Protocol):
    """Carries a ``ReferenceLink``'s datagrams: it calls the link's ``outgoing``, ``receive`` and ``tick``."""

    def flush(self) -> None:
        """Send what the link has to send; its next deadline may have changed as well."""
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


class Controller(Protocol):
    """The controller behind the reference link; ``ReferenceLink`` implements it."""

    @property
    def connected(self) -> bool: ...
    @property
    def state(self) -> State: ...
    @property
    def state_age_ns(self) -> int: ...
    @property
    def clock_offset(self) -> OffsetEstimate | None: ...
    @property
    def authenticated(self) -> bool: ...
    @property
    def tries_valves(self) -> bool: ...
    @property
    def statistics(self) -> LinkStatistics: ...
    @property
    def home(self) -> Array | None: ...
    def begin_anew(self) -> None: ...
    async def command(self, code: CommandCode) -> Acknowledgement: ...
    async def next_state(self) -> State: ...


class StoppableArm(Arm, Protocol):
    """An arm that can be halted after a program ended early."""

    async def halt(self) -> None: ...


class CameraStatus(NamedTuple):
    """How a camera is doing. ``age_ms`` since the newest frame was captured, None before the first.

    ``frames`` delivered, ``dropped`` never came although numbered, ``reconnects`` after the first connection,
    ``trouble`` the present cause (``link.…``) or None, ``detail`` what is known of it beyond that.
    """

    connected: bool
    age_ms: float | None
    frames: int
    rate_hz: float
    dropped: int = 0
    reconnects: int = 0
    trouble: str | None = None
    detail: str = ""


class Seen(NamedTuple):
    """What one pair shows, the camera that took it, and which marker is the tool's."""

    observation: FrameObservation
    camera: CameraCalibration
    tool_id: int


class Camera(Protocol):
    """The stereo camera's health, its newest picture, and what was seen in one."""

    def status(self) -> CameraStatus: ...
    async def latest_png(self) -> bytes: ...

    async def look_alone(self, frames: int | None = None) -> Look:
        """A look without a controller: where the arm is, and whether it rests, nobody tells.

        Raises MeasurementFailed and LinkLost as ``Eyes.look``.
        """
        ...

    def seen(self) -> Seen | None:
        """What was measured in a picture last, None before the first measurement."""
        ...

    async def observe(self) -> None:
        """Measure in the newest picture, if it was not. Raises LinkLost when the camera never gave one."""
        ...

    async def pair_after(self, capture_ns: int) -> StereoPair:
        """The first pair captured after ``capture_ns``. Raises LinkLost."""
        ...

    @property
    def targets(self) -> TargetKeeper:
        """The targets that were clicked."""
        ...

    @property
    def carries(self) -> bool:
        """Whether a motion must be watched, because targets are kept and nobody watches."""
        ...

    async def target_at(self, click: Click, frame_id: int | None) -> KeptTarget:
        """Measure what a click means, and keep it. Raises TargetRefused, RequestRefused, LinkLost."""
        ...

    async def detected_holes(self, diameter_mm: float | None) -> tuple[int, list[TargetObservation]]:
        """The number of the newest picture and all holes in it. Raises LinkLost."""
        ...


class Worker(Protocol):
    """Where long computations run, so that the link is not held up."""

    async def run(self, work: Callable[[], T]) -> T:
        """The result of ``work``. Raises what it raises."""
        ...


class BackgroundWork(Protocol):
    """A program that runs beside the one that started it."""

    @property
    def ended(self) -> bool:
        """Return True if the program has returned or raised."""
        ...

    async def join(self) -> None:
        """Wait for the end. Raises what the program raised."""
        ...

    async def cancel(self) -> None:
        """End the program where it waits, and wait for that; does nothing if it has ended."""
        ...


class Background(Protocol):
    """Starts programs that run beside the present one."""

    def start(self, program: Coroutine[Any, Any, None]) -> BackgroundWork:
        """Start ``program``."""
        ...


class Runtime(NamedTuple):
    """How the vision PC's programs wait, compute and run side by side."""

    clock: Clock
    worker: Worker
    background: Background


class Attendant(Protocol):
    """What goes along with every look and watch of the eyes."""

    @property
    def object_wanted(self) -> bool:
        """Whether a watch of markers that never sees the object's has failed."""
        ...

    def looking(self) -> AbstractContextManager[Callable[[Look], None]]:
        """A block around a look, in which it is told what was seen. Raises what refuses the look."""
        ...

    def watching(self) -> AbstractContextManager[Callable[[tuple[WatchSample, ...]], None]]:
        """A block around a watch, in which it is told the samples; left untold, it has failed."""
        ...


class FrameSource(Protocol[FrameT_co]):
    """Frames of a camera as they arrive."""

    @property
    def newest(self) -> FrameT_co | None:
        """The newest frame, None before the first."""
        ...

    async def frame_after(self, capture_ns: int) -> FrameT_co:
        """The first frame to arrive that was captured after ``capture_ns``, or the newest if it was.

        Raises LinkLost: ``link.camera_missing``, ``link.camera_silent``, ``link.camera_frozen`` or what the
        stream was refused for (``frame.…``).
        """
        ...

    def status(self) -> CameraStatus:
        """How the camera is doing now."""
        ...


class StateSource(Protocol):
    """The controller's states, for who combines them with frames."""

    @property
    def state(self) -> State:
        """The newest state. Raises LinkLost when there is no session."""
        ...

    async def pose_at(self, local_ns: int) -> Array:
        """X_BT (4, 4) at ``local_ns`` of our clock; waits for the state after it. Raises LinkLost."""
        ...


class EyesRecord(Protocol[FrameT_contra]):
    """What is kept of looks and watches for the record."""

    def pictured(self, frame: FrameT_contra, observation: FrameObservation) -> None:
        """Keep the last frame of a look, whatever becomes of the look."""
        ...

    def looked(self, look: Look) -> None:
        """Keep a look that succeeded."""
        ...

    def watched(self, health: WatchHealth) -> None:
        """Keep what a watch missed, whatever becomes of it."""
        ...


class SightRecorder(Protocol[F]):
    """Records measurements as they are made, so that they can be made again and compared."""

    def tapped(self, sensor: Sensor[F]) -> Sensor[F]:
        """A sensor that measures as ``sensor`` does, and records what it is asked and what it finds."""
        ...

    def looked(self, look: Look, observations: Sequence[FrameObservation]) -> None:
        """Record a look that succeeded, and what was observed in each of its frames."""
        ...
