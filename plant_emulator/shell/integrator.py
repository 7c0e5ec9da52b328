"""Soft real time: the plant advances one period at each absolute deadline, in the loop that serves it."""

import time
from collections.abc import Callable

from plant_emulator.core.plant import Plant
from plant_emulator.shell.lateness import Lateness
from plant_emulator.shell.timer import PeriodicTimer


class Integrator:
    """Steps ``plant`` every ``period_ns``. In missed periods, which are counted, its time stands still.

    ``after_step`` is called with the deadline (CLOCK_MONOTONIC ns) that the plant's state now belongs to.
    """

    def __init__(self, plant: Plant, period_ns: int, after_step: Callable[[int], None]) -> None:
        self.lateness = Lateness()
        self._plant = plant
        self._period_ns = period_ns
        self._after_step = after_step
        self._timer: PeriodicTimer | None = None

    def start(self) -> None:
        """Begin at the next whole period of the monotonic clock."""
        first = (time.monotonic_ns() // self._period_ns + 1) * self._period_ns
        self._timer = PeriodicTimer(first, self._period_ns, self._tick)

    def stop(self) -> None:
        """Stand still."""
        if self._timer is not None:
            self._timer.close()
            self._timer = None

    def _tick(self, deadline_ns: int, missed: int) -> None:
        first_missed_ns = (
            deadline_ns - missed * self._period_ns
        )  # late is late against the oldest one unserved
        self.lateness.add(time.monotonic_ns() - first_missed_ns, missed)
        self._plant.advance(self._period_ns)
        self._after_step(deadline_ns)


class Beat:
    """Tells when something slower than the integrator is due: at most once a step, late beats are dropped."""

    def __init__(self, interval_ns: int) -> None:
        self._interval_ns = interval_ns
        self._next_ns = 0
        self.dropped = 0

    def due(self, now_ns: int) -> bool:
        """Whether a beat has come since the last time that this returned True."""
        if now_ns < self._next_ns:
            return False
        if self._next_ns:
            late = (now_ns - self._next_ns) // self._interval_ns
            self.dropped += late
            self._next_ns += (late + 1) * self._interval_ns
        else:
            self._next_ns = now_ns + self._interval_ns
        return True
