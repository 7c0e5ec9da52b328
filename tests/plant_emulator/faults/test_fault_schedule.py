"""Any sequence of injections, clearings and looks keeps the schedule and its trace consistent."""

from collections import Counter

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from plant_emulator.core.faults.kinds import (
    CameraFrozen,
    EncoderStuck,
    Fault,
    PayloadDrop,
    SupplyLost,
    ValveStuck,
)
from plant_emulator.core.faults.schedule import FaultSchedule, Injection
from protocol.errors import RequestRefused

FEW: list[Fault] = [
    SupplyLost(),
    PayloadDrop(),
    CameraFrozen(),
    ValveStuck(joint="lift"),
    ValveStuck(joint="tilt"),
    EncoderStuck(joint="lift"),
]


class Schedule(RuleBasedStateMachine):
    """Drives a schedule in time steps and keeps books of its own: which numbers should be in force."""

    def __init__(self) -> None:
        super().__init__()
        self.schedule = FaultSchedule()
        self.now = 0
        self.known: dict[int, Injection] = {}

    @rule(
        fault=st.sampled_from(FEW),
        delay=st.none() | st.integers(-2, 6),
        duration=st.none() | st.integers(-1, 6),
    )
    def inject(self, fault: Fault, delay: int | None, duration: int | None) -> None:
        start = None if delay is None else self.now + delay
        from_ns = self.now if start is None else start
        until = None if duration is None else from_ns + duration
        clash = any(
            one.fault.name == fault.name
            and (one.end_ns is None or from_ns < one.end_ns)
            and (until is None or one.start_ns < until)
            for one in self.known.values()
        )
        absurd = (delay is not None and delay < 0) or (duration is not None and duration <= 0)
        before = list(self.schedule.changes)
        if clash or absurd:
            with pytest.raises(RequestRefused) as refusal:
                self.schedule.inject(fault, self.now, start, duration)
            assert refusal.value.cause == ("refused.fault_time" if absurd else "refused.fault_present")
            assert self.schedule.changes == before
            return
        injection = self.schedule.inject(fault, self.now, start, duration)
        assert injection.number not in self.known
        self.known[injection.number] = injection

    @rule(which=st.integers(0, 100))
    def clear(self, which: int) -> None:
        if not self.known:
            return
        number = sorted(self.known)[which % len(self.known)]
        assert self.schedule.clear(number, self.now) == self.known.pop(number)

    @rule()
    def clear_all(self) -> None:
        self.schedule.clear_all(self.now)
        self.known.clear()

    @rule(step=st.integers(0, 4))
    def let_pass(self, step: int) -> None:
        for _ in range(step + 1):
            self.schedule.settle(self.now)
            for number, one in list(self.known.items()):
                if one.end_ns is not None and one.end_ns <= self.now:
                    del self.known[number]
            wanted = {number for number, one in self.known.items() if one.start_ns <= self.now}
            assert {one.number for one in self.schedule.active} == wanted
            assert self.schedule.next_ns() > self.now
            self.now += 1
        self.now -= 1

    @invariant()
    def one_of_a_name_is_in_force(self) -> None:
        names = Counter(one.fault.name for one in self.schedule.active)
        assert all(count == 1 for count in names.values())
        assert {one.number for one in self.schedule.all()} == set(self.known)

    @invariant()
    def the_trace_is_a_life(self) -> None:
        lives: dict[int, list[str]] = {}
        for change in self.schedule.changes:
            lives.setdefault(change.injection.number, []).append(change.phase)
        for number, phases in lives.items():
            life = phases[1:] if phases[0] == "planned" else phases
            assert life in ([], ["began"], ["began", "ended"], ["withdrawn"])
            assert (life in ([], ["began"])) == (number in self.known)
        times = [change.time_ns for change in self.schedule.changes]
        assert times == sorted(times)


TestSchedule = Schedule.TestCase
TestSchedule.settings = settings(max_examples=60, stateful_step_count=30, deadline=None)
