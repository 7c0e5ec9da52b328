"""When an arm behind shut valves counts as at rest, and what it still does then."""

import numpy as np
import pytest

from controller.core.parking.joint import (
    ARM_RESTS,
    FOLLOW,
    JOG,
    JOINT_RESTS,
    PULSE,
    SHUT,
    ParkingLaw,
    joints_at_start,
)
from controller.core.parking.parking import needs_move
from controller.core.parking.rest import arm_rested, judge_rest, may_stop_here, unsettled_joints
from controller.core.scan_types import ScanEvent
from controller.core.standing import _at_rest

DT_S, LEVER_M, WAY_M, CALM_S, LEAVES_RAD = 0.005, 5.0, 2e-4, 3.0, 2.7e-4
ONES, GAINS = np.ones(6), np.full(2, 0.4)
LAW = ParkingLaw(
    band=4e-4, band_least=7e-5, band_most=2e-4, slowest=4e-4, fastest=1e-2, patience=6.0,
    calm_travel=WAY_M, calm=CALM_S, settled=LEAVES_RAD, give_up=30.0, quiet=1e-4,
    deadband=np.full((6, 2), 0.08), spread=np.full((6, 2), 0.004), latest=0.3 * ONES, shutting=0.2 * ONES,
    loaded=np.array([0.0, 1.0, 1.0, 1.0, 1.0, 1.0]),
    oil_spring=3e-4 * ONES,
    surely_open=np.full((6, 2), 0.16), dt_s=DT_S,
)  # fmt: skip


def _shut_at(error: float) -> np.ndarray:
    state = joints_at_start(LAW)
    state["phase"], state["error"], state["band"] = SHUT, error, 1e-4
    return state


def _passed(state: np.ndarray, seconds: float) -> None:
    for _ in range(round(seconds / DT_S)):
        for joint in range(6):
            judge_rest(LAW, state[joint], joint, LEVER_M)


def test_a_joint_rests_where_it_has_been_calm_for_long_enough() -> None:
    state = _shut_at(1.5e-4)
    _passed(state, CALM_S - 0.1)
    assert not state["rest"].any()
    state["error"][1] += 1.1 * WAY_M / LEVER_M  # this one has moved the tool by more than is calm,
    state["error"][2] += 0.9 * WAY_M / LEVER_M  # this one by less
    _passed(state, 0.2)
    assert state["rest"].tolist() == [JOINT_RESTS, 0.0, *[JOINT_RESTS] * 4]
    assert state["place"][2] == state["pulse"]["error"][2] == state["watch"]["error"][2] == state["error"][2]
    _passed(state, CALM_S)
    assert (state["rest"] == JOINT_RESTS).all()


@pytest.mark.parametrize("phase", [JOG, FOLLOW, PULSE])
def test_a_joint_with_its_valve_open_does_not_rest(phase: float) -> None:
    state = _shut_at(0.0)
    state["phase"][3] = phase
    _passed(state, 2.0 * CALM_S)
    assert state["rest"][3] == 0.0
    assert unsettled_joints(state)[3]
    assert unsettled_joints(state).sum() == 1


def test_a_joint_outside_the_tolerance_never_rests() -> None:
    state = _shut_at(-1.01 * LEAVES_RAD)
    _passed(state, 2.0 * CALM_S)
    assert not state["rest"].any()
    assert unsettled_joints(state).all()
    assert not may_stop_here(LAW, state)


def test_a_resting_joint_that_others_push_is_judged_anew_until_the_arm_rests() -> None:
    state = _shut_at(0.0)
    _passed(state, 1.1 * CALM_S)
    pushed = state.copy()
    pushed["error"][2] = 1.1e-4
    here = arm_rested(pushed)
    _passed(pushed, DT_S)
    assert pushed["rest"][2] == pushed["place"][2] == 0.0
    assert unsettled_joints(pushed).tolist() == [False, False, True, False, False, False]
    _passed(here, DT_S)
    assert here["rest"][2] == ARM_RESTS


def test_an_arm_that_does_not_come_to_rest_stays_as_it_is_and_tells_which_joint() -> None:
    state, events = _shut_at(0.0), list[ScanEvent]()
    _passed(state, 1.1 * CALM_S)
    state["rest"][0], state["watch"]["calm"][0] = 0.0, 1.2
    assert not _at_rest(LAW, False, LAW.give_up - 0.1, state, events)[0]
    for phase in (JOG, PULSE, FOLLOW):
        moving = state.copy()
        moving["phase"][3] = phase
        assert not _at_rest(LAW, False, LAW.give_up + 0.1, moving, events)[0]
    far = state.copy()
    far["error"][0] = 1.1 * LEAVES_RAD
    assert not _at_rest(LAW, False, LAW.give_up + 0.1, far, events)[0]
    assert events == []
    rests, here = _at_rest(LAW, False, LAW.give_up + 0.1, state, events)
    assert rests
    assert (here["rest"] == ARM_RESTS).all()
    assert events == [ScanEvent("restless", "SLEW", 1.2, CALM_S)]
    assert _at_rest(LAW, True, LAW.give_up + 0.2, here, events) == (True, here)
    assert len(events) == 1


@pytest.mark.parametrize("joint", [0, 3])
def test_a_joint_that_still_leaves_its_place_is_waited_for(joint: int) -> None:
    """A wrist that went on by 1 mrad/s for a moment was brought back by twice of what it was off, and then
    from the other side, for as long as anybody waited (a crane, 44751)."""
    state, off = _shut_at(0.0), 5e-4
    state["oil"]["rate"][joint] = 1e-4  # and on
    due = [
        needs_move(LAW, state[joint], joint, (off, 0.0, watched), False) for watched in (0.4, 0.7, 1.9, 2.1)
    ]
    assert due == [False, False, False, True]
    state["oil"]["rate"][joint] = -1e-4  # it comes by itself, and off says how far
    due = [needs_move(LAW, state[joint], joint, (off, 0.0, watched), False) for watched in (0.4, 0.7)]
    assert due == [False, True]
