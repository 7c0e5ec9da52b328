"""Simulated time as the vision PC's programs see it. Nothing else lets time pass in lockstep."""

import types
from collections.abc import Callable, Coroutine, Generator
from typing import Any, NamedTuple, Protocol, TypeVar

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


class _Wait(NamedTuple):
    """What a program in the background waits for."""

    happened: Callable[[], bool]
    until_ns: int


class LockstepClock:
    """Implements ``Clock``, ``Worker``, ``Background`` and ``LinkTransport`` of the application's ports.

    Whoever waits in the foreground lets the world's cycles pass. Programs in the background go on after each
    cycle in which what they wait for has happened. Computing takes no simulated time.
    """

    def __init__(self, world: Stepped) -> None:
        self._world = world
        self._works: list[LockstepWork] = []
        self._in_background = False

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
        if self._in_background:
            raise RuntimeError("only the foreground lets simulated time pass")
        self._world.step()
        for work in list(self._works):
            self._go_on(work)

    def advance_until(self, happened: Callable[[], bool], timeout_s: float) -> bool:
        """Let cycles pass until ``happened()``. Return False when ``timeout_s`` have passed first."""
        until_ns = self.now_ns + round(1e9 * timeout_s)
        while not happened():
            if self.now_ns >= until_ns:
                return False
            self.advance()
        return True

    def wake(self) -> None:
        """Return at once: who waits looks again after every cycle anyway."""

    def flush(self) -> None:
        """Return at once: the world takes what the link has to send with its next cycle."""

    async def until(self, happened: Callable[[], bool], timeout_s: float) -> bool:
        """Wait for ``happened()``. Return False when ``timeout_s`` have passed first."""
        if not self._in_background:
            return self.advance_until(happened, timeout_s)
        if not happened():
            await _suspended(_Wait(happened, self.now_ns + round(1e9 * timeout_s)))
        return happened()

    async def run(self, work: Callable[[], T]) -> T:
        """What ``work`` returns."""
        return work()

    def start(self, program: Coroutine[Any, Any, None]) -> "LockstepWork":
        """Start ``program`` in the background: it runs at once, until it first waits."""
        work = LockstepWork(program, self)
        self._works.append(work)
        self._go_on(work)
        return work

    def _go_on(self, work: "LockstepWork") -> None:
        self._in_background = True
        try:
            work.go_on(self.now_ns)
        finally:
            self._in_background = False
        if work.ended:
            self._works.remove(work)

    def leave(self, work: "LockstepWork") -> None:
        """Do not go on with ``work``."""
        if work in self._works:
            self._works.remove(work)


class LockstepWork:
    """Implements ``vision_pc.application.ports.BackgroundWork`` in simulated time."""

    def __init__(self, program: Coroutine[Any, Any, None], clock: LockstepClock) -> None:
        self._program = program
        self._clock = clock
        self._wait: _Wait | None = None
        self._error: Exception | None = None
        self._ended = False

    @property
    def ended(self) -> bool:
        """Return True if the program has returned or raised."""
        return self._ended

    def go_on(self, now_ns: int) -> None:
        """Run the program until it waits for what has not happened yet."""
        while not self._ended and (
            self._wait is None or self._wait.happened() or now_ns >= self._wait.until_ns
        ):
            try:
                waits_for = self._program.send(None)
            except StopIteration:
                self._ended = True
            except Exception as error:
                self._ended, self._error = True, error
            else:
                if not isinstance(waits_for, _Wait):
                    raise RuntimeError("a program in lockstep waited for something outside of simulated time")
                self._wait = waits_for

    async def join(self) -> None:
        """Let time pass until the end. Raises what the program raised."""
        while not self._ended:
            self._clock.advance()
        if self._error is not None:
            raise self._error

    async def cancel(self) -> None:
        """End the program where it waits."""
        self._program.close()
        self._ended = True
        self._clock.leave(self)


@types.coroutine
def _suspended(wait: _Wait) -> Generator[_Wait, None, None]:
    yield wait
