"""Simulated time as the vision PC's programs see it. Nothing else lets time pass in lockstep."""

import hashlib
import json
import types
from collections.abc import Awaitable, Callable, Coroutine, Generator
from typing import Any, NamedTuple, Protocol, TypeVar

from controller.core.scan import scan
from controller.core.scan_types import ControllerView, ScanInput, ScanOutput, initial_state
from controller.core.settings import ScanSettings
from plant_emulator.core.plant import Plant
from protocol.faults import CommandCode, Reason
from protocol.process_image import decode_sensors, decode_valves, encode_sensors, encode_valves
from protocol.reference_messages import FLAG_SETTLED, Command, ReferencePath, ReferencePose
from testbed.reporting.console import plain


class RunLog:
    """Events in order. Two runs are the same exactly when their digests are."""

    def __init__(self) -> None:
        self.events: list[dict[str, Any]] = []

    def add(self, time_ns: int, event: str, **fields: Any) -> None:
        """Append the event to the log."""
        self.events.append({"time_ns": time_ns, "event": event, **plain(fields)})

    def digest(self) -> str:
        """SHA-256 of all lines so far, in hexadecimal; floats enter it with all their digits."""
        lines = [json.dumps(event, sort_keys=True) + "\n" for event in self.events]
        return hashlib.sha256("".join(lines).encode()).hexdigest()


class ClosedLoop:
    """Plant and controller in turn, one FC 23 exchange a cycle: the last scan's valves out, sensors in."""

    def __init__(self, settings: ScanSettings, plant: Plant) -> None:
        self.settings = settings
        self.plant = plant
        self.state = initial_state(settings)
        self.now_ns = 0
        self.outputs: ScanOutput | None = None
        self._words: list[int] | None = None
        self._ids = 0

    @property
    def view(self) -> ControllerView:
        assert self.outputs is not None
        return self.outputs.view

    def step(self, *requests: Command | ReferencePose | ReferencePath) -> ScanOutput:
        """One cycle."""
        cycle_ns = round(self.settings.cycle_s * 1e9)
        if self._words is not None:
            self.plant.write(decode_valves(self._words))
        sensors = decode_sensors(encode_sensors(self.plant.read()))
        now_ns, dt_s = self.now_ns, self.settings.cycle_s
        inputs = ScanInput(now_ns, now_ns, dt_s, sensors, requests, True)
        self.state, self.outputs = scan(self.settings, self.state, inputs)
        self._words = encode_valves(self.outputs.valves)
        self.plant.advance(cycle_ns)
        self.now_ns += cycle_ns
        return self.outputs

    def run(self, seconds: float) -> None:
        """Cycles for ``seconds``."""
        for _ in range(round(seconds / self.settings.cycle_s)):
            self.step()

    def command(self, code: CommandCode) -> Reason:
        """The answer to a command."""
        return self.refer(lambda number: Command(number, code))

    def enable(self) -> None:
        """Enabled, or an assertion."""
        self.step()
        assert self.command(CommandCode.ENABLE) is Reason.ACCEPTED

    def refer(self, make: Callable[[int], Command | ReferencePose | ReferencePath]) -> Reason:
        """The answer to the request that ``make`` gives for a fresh command id."""
        self._ids += 1
        return self.step(make(self._ids)).acknowledgements[0].reason

    def settle(self, timeout_s: float) -> float:
        """Seconds from now until the motion is done and settled; asserts that it comes to that."""
        for cycles in range(round(timeout_s / self.settings.cycle_s)):
            if self.view.motion_done and self.view.flags & FLAG_SETTLED:
                return cycles * self.settings.cycle_s
            self.step()
        raise AssertionError(f"not settled within {timeout_s} s: {self.view}")


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
    """Implements ``Clock``, ``Worker`` and ``Background`` of the application's ports.

    Whoever waits in the foreground lets the world's cycles pass. Programs in the background go on after each
    cycle in which what they wait for has happened. Computing takes no simulated time.
    """

    def __init__(self, world: Stepped) -> None:
        self._world = world
        self._works: dict[Coroutine[Any, Any, None], _Wait] = {}
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
        for program in list(self._works):
            self._go_on(program)

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

    async def until(self, happened: Callable[[], bool], timeout_s: float) -> bool:
        """Wait for ``happened()``. Return False when ``timeout_s`` have passed first."""
        if not self._in_background:
            return self.advance_until(happened, timeout_s)
        if not happened():
            await _suspend(_Wait(happened, self.now_ns + round(1e9 * timeout_s)))
        return happened()

    async def run(self, work: Callable[[], T]) -> T:
        """What ``work`` returns."""
        return work()

    def start(self, program: Coroutine[Any, Any, None]) -> Callable[[], Awaitable[None]]:
        """Start ``program`` in the background: it runs at once, until it first waits. Return what ends it."""
        self._works[program] = _Wait(lambda: True, 0)
        self._go_on(program)

        async def end() -> None:
            program.close()
            self._works.pop(program, None)

        return end

    def _go_on(self, program: Coroutine[Any, Any, None]) -> None:
        """Run the program until it waits for what has not happened yet."""
        self._in_background = True
        try:
            while self._works[program].happened() or self.now_ns >= self._works[program].until_ns:
                waits_for = program.send(None)
                if not isinstance(waits_for, _Wait):
                    raise RuntimeError("a program in lockstep waited for something outside of simulated time")
                self._works[program] = waits_for
        except StopIteration:
            del self._works[program]
        finally:
            self._in_background = False


@types.coroutine
def _suspend(wait: _Wait) -> Generator[_Wait, None, None]:
    yield wait
