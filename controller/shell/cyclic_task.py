"""The cycle: a body awaited once a period, at absolute deadlines."""

import asyncio
from collections.abc import Awaitable, Callable

from controller.core.scan import scan
from controller.core.scan_types import ScanInput, initial_state
from controller.core.settings import ScanSettings
from foundation import clock
from foundation.periods import DurationHistogram, PeriodicTimer
from protocol.faults import CommandCode
from protocol.pose import Pose
from protocol.process_image import COUNTS_PER_TURN, STATUS_SUPPLY_ON, STATUS_VALVES_ENABLED, SensorImage
from protocol.reference_messages import Command, ReferencePath, ReferencePose, Request, StreamedPose
from protocol.session_events import StreamedPoseReceived

_POSE_DEG = (0.0, 50.0, -75.0, 0.0, -25.0, 0.0)


def warm_up(settings: ScanSettings) -> None:
    """Enable, follow streamed references, move, re-plan, stop."""
    state = initial_state(settings)
    a, b, c, d, e, f = (round(angle / 360.0 * COUNTS_PER_TURN) for angle in _POSE_DEG)
    for cycle in range(10):
        here = state.tool
        x, y, z = here.p_BT.tolist()
        w, i, j, k = here.quaternion.tolist()
        goal = ReferencePose(cycle, Pose((x, y, z + 0.01 * cycle), (w, i, j, k)), 0.0)
        script: dict[int, Request] = {
            1: Command(cycle, CommandCode.ENABLE),
            2: Command(cycle, CommandCode.START_STREAM),
            5: Command(cycle, CommandCode.END_STREAM),
            6: goal,
            7: ReferencePath(cycle, (goal.X_BT_ref,), 3.0, 0.0),
            8: Command(cycle, CommandCode.STOP),
        }
        streamed = StreamedPoseReceived(StreamedPose(2, cycle, 0, goal.X_BT_ref), 0, 0)
        requests = (script[cycle],) if cycle in script else ()
        status = STATUS_SUPPLY_ON | STATUS_VALVES_ENABLED
        image = SensorImage(
            cycle, state.cycle, status, (a, b, c, d, e, f), ((50.0, 50.0),) * 6, 190.0, 10.0, 40.0
        )
        state, _ = scan(settings, state, ScanInput(0, 0, settings.cycle_s, image, requests, True, streamed))


class CyclicTask:
    """Awaits ``body(dt_ns)`` once a period; ``dt_ns`` is the whole number of periods since the call before.

    ``phase_ns``: how far into the period ``second_part`` lets the body go on. ``lateness``: how late after
    its deadline each call began, since the start; ``recent``: the same since its reader last cleared it.
    ``overruns``: periods skipped.
    """

    def __init__(self, period_ns: int, body: Callable[[int], Awaitable[None]], phase_ns: int = 0) -> None:
        self.lateness = DurationHistogram()
        self.recent = DurationHistogram()
        self.overruns = 0
        self._period_ns = period_ns
        self._phase_ns = phase_ns
        self._body = body
        self._stopping = False
        self._starts: _Deadlines | None = None
        self._phases: _Deadlines | None = None

    def stop(self) -> None:
        """Let ``run`` return after the present call."""
        self._stopping = True
        if self._starts is not None:
            self._starts.wake()

    async def run(self) -> None:
        """Call the body until ``stop``. An exception of the body ends the task and is passed on."""
        first_ns = clock.now_ns() + self._period_ns
        self._starts = starts = _Deadlines(first_ns, self._period_ns)
        if self._phase_ns > 0 and clock.followed() is None:
            self._phases = _Deadlines(first_ns + self._phase_ns, self._period_ns)
        try:
            while not self._stopping:
                passed = await starts.passed()
                if passed == 0:
                    continue
                late_ns = clock.now_ns() - starts.timer.deadline_ns
                self.lateness.add(late_ns)
                self.recent.add(late_ns)
                self.overruns += passed - 1
                with clock.current().holding():
                    await self._body(passed * self._period_ns)
        finally:
            starts.timer.close()
            if self._phases is not None:
                self._phases.timer.close()

    async def second_part(self) -> None:
        """Return once ``phase_ns`` of the body's period have passed; at once when they have, or it is 0."""
        if self._phases is None or self._starts is None:
            return
        due_ns = self._starts.timer.deadline_ns + self._phase_ns
        while self._phases.timer.deadline_ns < due_ns:
            await self._phases.passed()


class _TickTimer:
    """As PeriodicTimer, by the plant's clock."""

    def __init__(self, first_ns: int, period_ns: int, on_ready: Callable[[], None]) -> None:
        self.deadline_ns = first_ns - period_ns
        self._period_ns = period_ns
        self._on_ready = on_ready
        self._next = clock.current().call_at(first_ns, on_ready)

    def passed(self) -> int:
        """How many deadlines have passed since the last call."""
        count = (clock.now_ns() - self.deadline_ns) // self._period_ns
        if count:
            self.deadline_ns += count * self._period_ns
            self._next = clock.current().call_at(self.deadline_ns + self._period_ns, self._on_ready)
        return count

    def close(self) -> None:
        """Stop calling."""
        self._next.cancel()


class _Deadlines:
    """A periodic timer that can be awaited, by one at a time."""

    def __init__(self, first_ns: int, period_ns: int) -> None:
        self._woken: asyncio.Future[None] | None = None
        kind = _TickTimer if clock.followed() else PeriodicTimer
        self.timer: PeriodicTimer | _TickTimer = kind(first_ns, period_ns, self.wake)

    async def passed(self) -> int:
        """How many deadlines have passed since the last call, after waiting for one; 0 after ``wake``."""
        passed = self.timer.passed()
        if passed == 0:
            self._woken = asyncio.get_running_loop().create_future()
            await self._woken
            passed = self.timer.passed()
        return passed

    def wake(self) -> None:
        """End the waiting."""
        if self._woken is not None and not self._woken.done():
            self._woken.set_result(None)
