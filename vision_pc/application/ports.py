"""What eyes and link need from outside: a clock that can wait, a transport for datagrams, a log.

The service implements these ports with an event loop, sockets and threads; lockstep implements them by
letting simulated time pass. Everything above them is the same code.
"""

from collections.abc import Callable
from typing import Any, Protocol


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

    def write(self, event: str, **fields: Any) -> None:
        """Write one event."""
        ...
