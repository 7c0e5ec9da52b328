"""Soft real time: the plant advances one period at each absolute deadline, in the loop that serves it."""

import time
from collections.abc import Callable
from typing import Any

from foundation.periods import DurationHistogram, PeriodicTimer, percent_missed
from plant_emulator.core.plant import Plant


class Integrator:
    """Steps ``plant`` every ``period_ns``. In missed periods, which are counted, its time stands still.

    ``after_step`` is called with the deadline (CLOCK_MONOTONIC ns) that the plant's state now belongs to.
    ``lateness`` of the periods served, against the oldest deadline unserved; ``missed``: periods skipped.
    """

    def __init__(self, plant: Plant, period_ns: int, after_step: Callable[[int], None]) -> None:
        self.lateness = DurationHistogram()
        self.missed = 0
        self._plant = plant
        self._period_ns = period_ns
        self._after_step = after_step
        self._timer: PeriodicTimer | None = None

    def start(self) -> None:
        """Begin at the next whole period of the monotonic clock."""
        first = (time.monotonic_ns() // self._period_ns + 1) * self._period_ns
        self._timer = PeriodicTimer(first, self._period_ns, self._expire)

    def stop(self) -> None:
        """Stand still."""
        if self._timer is not None:
            self._timer.close()
            self._timer = None

    def as_dict(self) -> dict[str, Any]:
        """The statistics by name, unit in the name."""
        served = self.lateness.count
        return {
            "periods_served": served,
            "periods_missed": self.missed,
            "missed_percent": percent_missed(served, self.missed),
            **self.lateness.as_dict("late"),
        }

    def _expire(self) -> None:
        timer = self._timer
        passed = 0 if timer is None else timer.passed()
        if timer is None or passed == 0:
            return
        missed = passed - 1
        self.lateness.add(time.monotonic_ns() - (timer.deadline_ns - missed * self._period_ns))
        self.missed += missed
        self._plant.advance(self._period_ns)
        self._after_step(timer.deadline_ns)


class SlowCycle:
    """Says when something slower than the integrator is due: at most once a step; late ones are dropped."""

    def __init__(self, interval_ns: int) -> None:
        self._interval_ns = interval_ns
        self._next_ns = 0
        self.dropped = 0

    def due(self, now_ns: int) -> bool:
        """Return True once an interval."""
        if now_ns < self._next_ns:
            return False
        if self._next_ns:
            late = (now_ns - self._next_ns) // self._interval_ns
            self.dropped += late
            self._next_ns += (late + 1) * self._interval_ns
        else:
            self._next_ns = now_ns + self._interval_ns
        return True
