"""Faults begin and end when they should, and any sequence of injections, clearings and looks keeps the
schedule and its trace consistent.
"""

from collections import Counter

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from plant_emulator.core.faults.kinds import (
    CameraFrozen,
    CouplerSilent,
    EncoderStuck,
    Fault,
    PayloadDrop,
    SupplyLost,
    ValveSlow,
    ValveStuck,
)
from plant_emulator.core.faults.schedule import FaultSchedule, Injection
from plant_emulator.core.plant import Plant
from protocol.errors import RequestRefused
from protocol.process_image import CONTROL_ENABLE, ValveImage
from tests.plant_emulator.plant_world import plant_config

LIFT_UP = (0.0, 0.3, 0.0, 0.0, 0.0, 0.0)
MS = 1_000_000

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
        assert self.schedule.clear(number, self.now) == [self.known.pop(number)]

    @rule()
    def clear_all(self) -> None:
        self.schedule.clear(None, self.now)
        self.known.clear()

    @rule(step=st.integers(0, 4))
    def let_pass(self, step: int) -> None:
        for _ in range(step + 1):
            self.schedule.settle(self.now)
            for number, one in list(self.known.items()):
                if one.end_ns is not None and one.end_ns <= self.now:
                    del self.known[number]
            expected = {number for number, one in self.known.items() if one.start_ns <= self.now}
            assert {one.number for one in self.schedule.active} == expected
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


def test_a_planned_fault_begins_and_ends_at_its_simulated_times() -> None:
    plant = Plant(plant_config(), seed=1)
    plant.inject(ValveStuck(joint="lift"), start_ns=10 * MS, duration_ns=5 * MS)
    seen = []
    for _ in range(20):
        plant.advance(MS)
        seen.append(bool(plant.truth().faults))
    assert [k + 1 for k, broken in enumerate(seen) if broken] == [10, 11, 12, 13, 14]
    assert [(c.phase, c.time_ns) for c in plant.faults.changes] == [
        ("planned", 0), ("began", 10 * MS), ("ended", 15 * MS)
    ]  # fmt: skip
    assert plant.faults.changes[1].as_dict() == {
        "number": 1, "name": "valve_stuck.lift", "phase": "began", "time_ns": 10 * MS,
        "start_ns": 10 * MS, "end_ns": 15 * MS, "fault": {"kind": "valve_stuck", "joint": "lift"},
    }  # fmt: skip


def test_planning_ahead_and_injecting_in_time_are_the_same_to_the_last_bit() -> None:
    ahead, in_time, split = (Plant(plant_config(), seed=3) for _ in range(3))
    fault: Fault = ValveSlow(joint="lift", bandwidth_share=0.2)
    ahead.inject(fault, 100 * MS, 50 * MS)
    split.inject(fault, 100 * MS, 50 * MS)
    for plant in (ahead, in_time, split):
        plant.write(ValveImage(1, CONTROL_ENABLE, LIFT_UP))
    ahead.advance(200 * MS)
    for _ in range(200):
        split.advance(MS)
    in_time.advance(100 * MS)
    number = in_time.inject(fault).number
    in_time.advance(50 * MS)
    in_time.clear(number)
    in_time.advance(50 * MS)
    np.testing.assert_array_equal(ahead._state, in_time._state)
    np.testing.assert_array_equal(ahead._state, split._state)
    assert ahead.read() == in_time.read()._replace(plant_cycle=1)


def test_an_unknown_number_and_one_fault_too_many_are_refused() -> None:
    schedule = FaultSchedule()
    with pytest.raises(RequestRefused) as refusal:
        schedule.clear(99, 11)
    assert refusal.value.cause == "refused.no_such_fault"
    for start in range(64):
        schedule.inject(CouplerSilent(), 11, 100 + start, 1)
    with pytest.raises(RequestRefused) as refusal:
        schedule.inject(PayloadDrop(), 11)
    assert refusal.value.cause == "refused.too_many_faults"


def test_a_fault_due_to_end_before_anybody_looked_still_leaves_its_trace() -> None:
    schedule = FaultSchedule()
    schedule.inject(SupplyLost(), 0, 10, 5)
    assert schedule.settle(100)
    assert schedule.of_kind(SupplyLost) == SupplyLost()
    assert schedule.next_ns() == 15  # it ends at the next look
    assert schedule.settle(100)
    assert schedule.of_kind(SupplyLost) is None
