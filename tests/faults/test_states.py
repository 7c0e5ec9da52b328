"""The scan against the oracle: random commands, references, silences and faults, compared step by step."""

from functools import cache

import pytest
from hypothesis import HealthCheck
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from controller.core.settings import ScanSettings, settings_from
from protocol.faults import CommandCode, FaultCode
from protocol.process_image import CONTROL_ENABLE, STATUS_SENSOR_FAULT
from protocol.reference_messages import FLAG_EMERGENCY_LATCHED
from tests.controller.obedient_plant import Bench
from tests.faults.oracle import Doing, Oracle
from tests.faults.rig import settings_of

ZERO = (0.0,) * 6
# Scans of 10 ms. A ramp takes 12, a motion 32, a stream without a reference goes stale after 100: well before
# that all are sure to last, well after it all are sure to have ended; in between nothing is asked.
_LASTS = {Doing.STOPPING: 8, Doing.DISABLING: 8, Doing.FAILING: 8, Doing.MOVING: 26, Doing.STREAMING: 90}
_GONE_AFTER = 40
_QUICK = (
    "controller.cycle_ms=10",
    "controller.motion.stop_min_s=0.12",
    "controller.motion.stop_acceleration_m_s2=20",
    "controller.motion.stop_turn_acceleration_deg_s2=1000",
    "controller.motion.acceleration_m_s2=8",
    "controller.streaming.silence_ms=200",
)
_MOTION_S = 0.32
RUNS = {"checked": 0, "steps": 0}


@cache
def quick() -> ScanSettings:
    """A controller whose ramps and motions are short: the states are the same, and sooner."""
    settings = settings_of(1, (*_QUICK, f"controller.motion.duration_min_s={_MOTION_S - 0.02}"))
    return settings_from(settings.arm, settings.controller)


class Group(RuleBasedStateMachine):
    """Bench and oracle side by side; ``age``: scans since what is under way began."""

    def __init__(self) -> None:
        super().__init__()
        self.bench = Bench(quick())
        self.oracle = Oracle()
        self.age = 0
        RUNS["checked"] += 1

    @initialize()
    def first_image(self) -> None:
        self.scan()

    def scan(self, *requests: object) -> None:
        """One scan, and the end of what has surely ended."""
        self.bench.step(*requests)  # type: ignore[arg-type]
        self.age += 1
        RUNS["steps"] += 1

    def certain(self) -> None:
        """Time passes where it is not sure whether something still lasts."""
        lasts = _LASTS.get(self.oracle.doing)
        if lasts is None or self.age < lasts:
            return
        stale = self.oracle.doing is Doing.STREAMING
        for _ in range(_GONE_AFTER if not stale else 30):
            self.scan()
        if stale:
            self.oracle.broke(FaultCode.REFERENCE_STALE)
        else:
            self.oracle.rested()
        self.age = 0

    def following(self, before: Doing) -> None:
        if self.oracle.doing is not before:
            self.age = 0

    @rule(code=st.sampled_from(CommandCode))
    def command(self, code: CommandCode) -> None:
        self.certain()
        before = self.oracle.doing
        expected = self.oracle.command(code, plant=not self.bench.silent, link=self.bench.link_alive)
        assert self.bench.command(code) is expected
        self.age += 1
        self.following(before)

    @rule(z=st.floats(-0.01, 0.01))
    def refer(self, z: float) -> None:
        self.certain()
        expected = self.oracle.reference(link=self.bench.link_alive)
        assert self.bench.refer(self.bench.shifted(z=z), _MOTION_S).reason is expected
        self.age = 0 if self.oracle.doing is Doing.MOVING and expected == 0 else self.age + 1

    @rule(scans=st.integers(1, 12))
    def wait(self, scans: int) -> None:
        for _ in range(scans):
            self.certain()
            self.scan()

    @rule()
    def wait_long(self) -> None:
        self.certain()
        while self.oracle.doing in _LASTS:
            self.scan()
            self.certain()

    @rule()
    def link_falls_silent_for_a_scan(self) -> None:
        self.certain()
        before = self.oracle.doing
        self.oracle.link_fell_silent()
        self.bench.link_alive = False
        self.scan()
        self.bench.link_alive = True
        self.following(before)

    @rule()
    def plant_falls_silent(self) -> None:
        self.certain()
        self.bench.silent = True
        if self.oracle.doing is Doing.STREAMING and self.age > 60:
            return  # it would go stale before the silence is noticed
        for _ in range(11):
            self.scan()
        self.oracle.broke(FaultCode.PLANT_LINK_LOST)
        self.age = 0

    @precondition(lambda self: self.bench.silent)
    @rule()
    def plant_comes_back(self) -> None:
        self.certain()
        self.bench.silent = False
        self.scan()

    @precondition(lambda self: not self.bench.silent)
    @rule()
    def a_sensor_reports_a_fault_for_a_scan(self) -> None:
        self.certain()
        self.bench.status |= STATUS_SENSOR_FAULT
        self.oracle.broke(FaultCode.PLANT_STATUS)
        self.scan()
        self.bench.status &= ~STATUS_SENSOR_FAULT
        self.scan()

    @invariant()
    def agrees(self) -> None:
        if not self.bench.outputs:
            return
        self.certain()
        view, valves = self.bench.last.view, self.bench.last.valves
        assert (view.group_state, view.fault) == (self.oracle.group, self.oracle.fault)
        assert bool(view.flags & FLAG_EMERGENCY_LATCHED) == self.oracle.emergency
        assert bool(valves.control & CONTROL_ENABLE) == self.oracle.live
        if not self.oracle.live:
            assert valves.valves == ZERO


def judged(runs: int, steps: int) -> None:
    """Asserts agreement in ``runs`` random lives; prints how many there were."""
    RUNS.update(checked=0, steps=0)
    profile = hypothesis_settings(
        max_examples=runs,
        stateful_step_count=steps,
        deadline=None,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
        database=None,
    )
    run_state_machine_as_test(Group, settings=profile)  # type: ignore[no-untyped-call]
    print(f"\nstates against the oracle: {RUNS['checked']} runs, {RUNS['steps']} scans, no difference")
    assert RUNS["checked"] >= runs


def test_the_group_agrees_with_the_oracle() -> None:
    judged(100, 20)


@pytest.mark.experiment
def test_the_group_agrees_with_the_oracle_in_2000_runs() -> None:
    judged(2000, 40)
