"""Simulated time as the vision PC's programs see it. Nothing else lets time pass in lockstep."""

from collections.abc import Callable, Coroutine
from typing import Any, Protocol, TypeVar

T = TypeVar("T")


class Stepped(Protocol):
    """A world that passes time in cycles."""

    @property
    def time_ns(self) -> int: ...
    @property
    def vision_ns(self) -> int: ...
    def step(self) -> None: ...


def run(program: Coroutine[Any, Any, T]) -> T:
    """The result of ``program``, none of whose awaits waits for the outside."""
    try:
        program.send(None)
    except StopIteration as done:
        result: T = done.value
        return result
    raise RuntimeError("a program in lockstep waited for something outside of simulated time")


class LockstepClock:
    """Implements ``vision_pc.application.ports.Clock`` by letting the world's cycles pass."""

    def __init__(self, world: Stepped) -> None:
        self._world = world

    @property
    def now_ns(self) -> int:
        """The time on vision's clock."""
        return self._world.vision_ns

    @property
    def time_ns(self) -> int:
        """The simulated time."""
        return self._world.time_ns

    def advance(self) -> None:
        """Let one controller cycle pass."""
        self._world.step()

    def advance_until(self, happened: Callable[[], bool], timeout_s: float) -> bool:
        """Let cycles pass until ``happened()``. Return False when ``timeout_s`` have passed first."""
        deadline_ns = self.now_ns + round(1e9 * timeout_s)
        while not happened():
            if self.now_ns >= deadline_ns:
                return False
            self.advance()
        return True

    def wake(self) -> None:
        """Return at once: who waits looks again after every cycle anyway."""

    def flush(self) -> None:
        """Return at once: the world takes what the link has to send with its next cycle."""

    async def until(self, happened: Callable[[], bool], timeout_s: float) -> bool:
        """Implements the port; it never waits for the outside."""
        return self.advance_until(happened, timeout_s)
