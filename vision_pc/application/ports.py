"""What the application needs from outside: a clock, a transport, a log, an arm, a camera and a controller.

The service implements these ports with an event loop, sockets and threads; lockstep implements them by
letting simulated time pass. Everything above them is the same code.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

from foundation.event_log import Level
from protocol.channel import LinkStatistics
from protocol.clock_offset import OffsetEstimate
from protocol.faults import CommandCode
from protocol.reference_messages import Acknowledgement, State
from vision_pc.core.ports import Arm


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
    def statistics(self) -> LinkStatistics: ...
    async def command(self, code: CommandCode) -> Acknowledgement: ...
    async def next_state(self) -> State: ...


class StoppableArm(Arm, Protocol):
    """An arm that can be halted after a program ended early."""

    async def halt(self) -> None: ...


class CameraStatus(NamedTuple):
    """Whether fresh pairs come, and how; ``trouble`` is the cause when they do not."""

    connected: bool
    age_ms: float | None
    frames: int
    rate_hz: float
    dropped: int = 0
    reconnects: int = 0
    trouble: str | None = None


class Camera(Protocol):
    """The stereo camera's health, and its newest picture."""

    def status(self) -> CameraStatus: ...
    async def latest_png(self) -> bytes: ...
