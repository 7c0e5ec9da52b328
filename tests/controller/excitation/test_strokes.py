"""Strokes on a toy valve: they end by themselves, stay small, and every misbehaviour is named."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from controller.core.excitation.plan import (
    Measured,
    Phase,
    StrokeKind,
    begun,
    driven,
)
from controller.core.excitation.strokes import excite, room_for
from tests.controller.excitation.toy_valve import DT_S, FULL_SPEED, LSB, START, ToyValve, plan_for, tried


@hypothesis_settings(max_examples=4, deadline=None)
@given(
    deadband=st.floats(0.0, 0.12),
    skew=st.floats(0.8, 1.2),
    play=st.floats(0.0, 0.05),
    gain=st.floats(0.75, 1.25),  # at 1.4 the guard of the travel may end it, by 0.1 mrad
)
def test_every_valve_is_tried_out_inside_the_limits(
    deadband: float, skew: float, play: float, gain: float
) -> None:
    plan = plan_for(5)
    closed = min(play, 1.5 * deadband * min(skew, 1.0))  # else no command but a contrary one closes it
    valve = ToyValve(5, deadband, deadband * skew, closed, gain)
    state, failure, samples = tried(valve, plan)
    assert failure is None
    assert state.phase is Phase.ENDED
    assert state.stroke == len(plan.strokes)
    turned = np.array([sample.q[5] for sample in samples]) - START[5]
    assert np.abs(turned).max() < 2.2 * plan.limits.travel[5]
    assert np.abs(np.diff([sample.valve for sample in samples])).max() < 0.3
    assert max(abs(sample.valve) for sample in samples) <= plan.limits.spool_max


def test_an_excitation_ends_where_it_began() -> None:
    valve = ToyValve(2, 0.01, 0.008)
    tried(valve, plan_for(2))
    assert abs(valve.q[2] - START[2]) < 0.02


@pytest.mark.parametrize(
    ("creep", "swing", "rests"), [(0.0, 0.0, True), (1.1e-3, 0.0, True), (0.0, 6e-3, False)]
)
def test_a_joint_that_creeps_rests_and_one_that_swings_does_not(
    creep: float, swing: float, rests: bool
) -> None:
    """Creep and swing in rad/s; the swing is a long boom's."""
    plan = plan_for(4)
    noise = 0.3 * LSB * np.random.default_rng(3).standard_normal((1000, 6))
    state, omega = begun(START), 2.0 * np.pi * 1.2
    for k in range(1000):
        q = START.copy()
        q[4] += creep * DT_S * k - swing / omega * np.cos(omega * DT_S * k)
        state, failure = excite(plan, state, Measured(np.rint((q + noise[k]) / LSB) * LSB, 100.0), DT_S)
        assert failure is None
        if state.phase is not Phase.RESTING:
            break
    assert (state.phase is not Phase.RESTING) is rests


def test_the_sense_with_room_is_taken() -> None:
    valve = ToyValve(3)
    valve.q[3] = np.radians(84.0)
    _, failure, samples = tried(valve, plan_for(3))
    assert failure is None
    assert max(sample.q[3] for sample in samples) < np.radians(89.5)


@pytest.mark.parametrize(
    ("valve", "cause"),
    [
        (ToyValve(5, dead=True), "commissioning.no_motion"),
        (ToyValve(5, swapped=True), "commissioning.wrong_way"),
        (ToyValve(5, stop_at=0.03), "commissioning.blocked"),
        (ToyValve(5, swing_rad_s=0.02), "commissioning.oscillates"),
    ],
)
def test_what_goes_wrong_is_named_and_the_valve_is_centred(valve: ToyValve, cause: str) -> None:
    state, failure, _ = tried(valve, plan_for(5))
    assert failure is not None
    assert (failure.cause, failure.joint) == (cause, 5)
    assert state.phase is Phase.ENDED
    assert state.spool == 0.0


def test_a_joint_without_room_is_not_moved() -> None:
    plan = plan_for(0)
    narrow = plan._replace(limits=plan.limits._replace(joint_range=np.radians([[-2.0] * 6, [2.0] * 6])))
    valve = ToyValve(0)
    state, failure, samples = tried(valve, narrow)
    assert failure is not None
    assert failure.cause == "commissioning.no_room"
    assert all(sample.valve == 0.0 for sample in samples)
    assert state.phase is Phase.ENDED


@pytest.mark.parametrize(("q", "sense", "room"), [(0.5, -1.0, None), (-0.5, 1.0, None), (0.0, 1.0, None),
                                                  (0.7, 1.0, 1.7), (-0.7, 1.0, 1.7)])  # fmt: skip
def test_strokes_turn_to_where_there_is_room(q: float, sense: float, room: float | None) -> None:
    """0.8 rad are wanted on one side and half of that on the other, of a range of 2 rad."""
    limits = plan_for(5).limits._replace(
        joint_range=np.array([[-1.0] * 6, [1.0] * 6]), travel=np.full(6, 0.5)
    )
    found, failure = room_for(limits, 5, q)
    assert found == sense
    assert (failure and failure.value) == (room and pytest.approx(room))


def test_a_joint_that_creeps_behind_its_closed_valve_is_tried_out_all_the_same() -> None:
    class Creeping(ToyValve):
        def step(self, command: float) -> None:
            super().step(command)
            self.q[5] -= 3e-6  # 0.3 mrad/s, as a wrist under its own weight

    state, failure, _ = tried(Creeping(5, 0.08, 0.08), plan_for(5))
    assert failure is None
    assert state.phase is Phase.ENDED


class Sinking(ToyValve):
    """Another joint sinks behind its closed valve by ``sinks`` rad/s, and answers to its own valve."""

    sinks = 3e-3
    other_at = 0.06  # its deadband

    def drive(self, joint: int, command: float) -> None:
        self.q[4] -= DT_S * self.sinks
        if joint == 4:
            super().step(0.0)
            self.q[4] += DT_S * FULL_SPEED * np.sign(command) * max(abs(command) - self.other_at, 0.0)
        else:
            super().step(command)


def test_a_joint_that_sinks_is_brought_back_between_strokes() -> None:
    plan, valve = plan_for(5), Sinking(5, 0.02, 0.02)
    state, furthest, returns = begun(valve.seen()), 0.0, 0
    while state.phase is not Phase.ENDED:
        before = state.phase
        state, failure = excite(plan, state, Measured(valve.seen(), 100.0), DT_S)
        assert failure is None
        returns += state.phase is Phase.RETURNING and before is not Phase.RETURNING
        if state.phase is not Phase.ENDED:
            valve.drive(driven(plan, state), state.spool)
        furthest = max(furthest, abs(float(valve.q[4] - START[4])))
    assert state.stroke == len(plan.strokes)
    assert returns > 3
    assert furthest < 0.08  # 0.3 rad without


def test_a_sinking_joint_that_cannot_be_brought_back_is_named() -> None:
    plan, valve = plan_for(5), Sinking(5, 0.02, 0.02)
    valve.other_at = 0.5
    state, failure = begun(valve.seen()), None
    while failure is None:
        state, failure = excite(plan, state, Measured(valve.seen(), 100.0), DT_S)
        valve.drive(driven(plan, state), state.spool)
    assert (failure.cause, failure.joint) in (
        ("commissioning.no_motion", 4),
        ("commissioning.wrong_way", 4),
    )
    assert state.spool == 0.0


def test_strokes_go_out_and_back() -> None:
    plan = plan_for(1)
    kinds = [stroke.kind for stroke in plan.strokes]
    assert kinds == sorted(kinds)
    assert kinds.count(StrokeKind.SEARCH) == 2
    assert [stroke.outward for stroke in plan.strokes] == [True, False] * (len(plan.strokes) // 2)
