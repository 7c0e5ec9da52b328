"""Parking on one joint behind a poor valve: inches, nudges, and when the arm rests."""

import math

import numpy as np
import pytest

from controller.core.parking.joint import (
    FOLLOW,
    JOG,
    PULSE,
    SHUT,
    joints_at_start,
    joints_in_motion,
    offsets_from_place,
)
from controller.core.parking.parking import phase_spool
from controller.core.parking.rest import arm_parked, is_parked, watch_creep
from tests.controller.parking.poor_joint import (
    BAND_RAD,
    DT_S,
    GAINS,
    Joint,
    poor_law,
    resting,
)


@pytest.mark.parametrize("known", [0.8, 1.0, 1.2])
@pytest.mark.parametrize("error", [2e-3, -6e-4])
def test_it_comes_to_rest_inside_its_band_with_the_valve_shut(known: float, error: float) -> None:
    rest = resting(poor_law(0.08 * known, 0.01), Joint(error, 0.08, 0.0), 40.0, parked=False)
    last = round(5.0 / DT_S)
    assert np.abs(rest.errors[-last:]).max() < 2e-4
    assert not rest.spools[-last:].any()


@pytest.mark.parametrize(("creep", "half_play"), [(-5e-6, 0.0), (-1e-6, 6e-5), (2e-6, 6e-5)])
def test_a_parked_joint_that_creeps_is_nudged_within_the_play_of_its_encoder(
    creep: float, half_play: float
) -> None:
    """Ten minutes of a load that sinks: never to the other side, nor far beyond play and bands."""
    rest = resting(poor_law(0.08, 0.002), Joint(0.0, 0.081, creep, half_play), 600.0)
    assert np.ptp(rest.errors) < 5.0 * BAND_RAD < abs(600.0 * creep)
    opened = rest.spools[rest.spools != 0.0]
    assert opened.size > 0
    assert (np.sign(opened) == -np.sign(creep)).all()
    assert set(rest.phases) == {SHUT, PULSE}
    assert (rest.spools != 0.0).mean() < 0.15


def test_a_parked_joint_that_stands_is_left_where_it_rests() -> None:
    """Nudging it would take it through the play before its encoder, by more than it is off."""
    law, state = poor_law(0.08, 0.004), joints_at_start(poor_law(0.08, 0.004))
    state["phase"], state["band"], state["error"], state["watch"]["quiet"] = (
        SHUT,
        BAND_RAD,
        1.4 * BAND_RAD,
        100.0,
    )
    state["jog"]["end"] = state["error"]
    assert is_parked(state)
    here = arm_parked(state)
    assert (here["place"] == 1.4 * BAND_RAD).all()
    assert not offsets_from_place(here).any()
    for error in (0.4 * BAND_RAD, 3.0 * BAND_RAD):
        for _ in range(1000):
            here["since"][0] += DT_S
            here["pulse"]["since"][0] += DT_S
            here["error"][0] = here["jog"]["end"][0] = 1.4 * BAND_RAD + error  # it moved once, and stands
            assert phase_spool(law, here, 0, 1.4 * BAND_RAD + error, 50.0, GAINS) == 0.0
    unloaded = law._replace(loaded=np.zeros(6))
    here["jog"]["end"][0], here["watch"]["error"][0] = 0.0, 1.4 * BAND_RAD + 3.0 * BAND_RAD
    assert phase_spool(unloaded, here, 0, 1.4 * BAND_RAD + 3.0 * BAND_RAD, 50.0, GAINS) == 0.0
    assert phase_spool(law, here, 0, 1.4 * BAND_RAD + 3.0 * BAND_RAD, 50.0, GAINS) > 0.0


def test_a_parked_joint_that_was_pushed_far_away_is_brought_back() -> None:
    rest = resting(poor_law(0.08, 0.002), Joint(2e-3, 0.08, -4e-6), 60.0)
    assert JOG in rest.phases
    assert np.abs(rest.errors[-2000:]).max() < 7.0 * BAND_RAD


def test_the_arm_rests_when_every_joint_does() -> None:
    law = poor_law(0.08, 0.004)
    state = joints_at_start(law)
    state["phase"], state["band"], state["watch"]["quiet"] = SHUT, BAND_RAD, 11.0
    assert is_parked(state)
    for part, name, value in (
        (None, "phase", JOG),
        (None, "phase", FOLLOW),
        ("watch", "quiet", 9.0),
        (None, "error", 2.0 * BAND_RAD),
    ):
        restless = state.copy()
        (restless if part is None else restless[part])[name][3] = value
        assert not is_parked(restless)
        restless["watch"]["away"] = 301.0  # as it is, then; but not while the joint law still drives
        assert is_parked(restless) == (name != "phase" or value != FOLLOW)


def test_what_moves_the_tool_is_not_quiet_nor_is_a_slew_whose_oil_relaxes() -> None:
    law = poor_law(0.08, 0.004)._replace(loaded=np.array([0.0, 1.0, 1.0, 1.0, 1.0, 1.0]))
    state = joints_at_start(law)

    def quiet_after(joint: int, error: float, load: float) -> float:
        state["watch"]["error"][joint], state["watch"]["load"][joint] = error, load
        watch_creep(law, state[joint], joint, 5.0, error, load)
        return float(state["watch"]["quiet"][joint])

    for joint in (0, 1):
        quiet_after(joint, 1e-3, 50.0)
        assert [quiet_after(joint, 1e-3 + 1.9e-5, 50.0) for _ in range(3)][-1] == pytest.approx(3 * DT_S)
        assert quiet_after(joint, 1e-3 + 2.1e-5, 50.0) == 0.0
    assert quiet_after(1, 1e-3 + 2.1e-5, 51.0) > 0.0
    assert quiet_after(0, 1e-3 + 2.1e-5, 50.06) == 0.0


def test_a_slew_whose_pressure_the_pump_shakes_is_quiet() -> None:
    """By its filtered load: two bar at 20 Hz are no oil that relaxes, a twentieth of it that stays is."""
    law, state = poor_law(0.08, 0.004)._replace(loaded=np.zeros(6)), joints_at_start(poor_law(0.08, 0.004))
    state["watch"]["load"] = state["watch"]["load_at"] = 50.0
    for scan in range(2000):
        watch_creep(law, state[0], 0, 5.0, 0.0, 50.0 + 2.0 * math.sin(2.0 * math.pi * 20.0 * DT_S * scan))
    assert state["watch"]["quiet"][0] == pytest.approx(2000 * DT_S)
    for _ in range(2000):
        watch_creep(law, state[0], 0, 5.0, 0.0, 50.1)
    assert state["watch"]["quiet"][0] < 1900 * DT_S


def test_where_the_joint_moves_is_learned_within_what_is_known() -> None:
    law = poor_law(0.08, 0.004)
    near = resting(law, Joint(2e-3, 0.085, -3e-4), 60.0, parked=False)
    assert near.state["valve"]["edge"][0, 0] == pytest.approx(0.085, abs=0.004)
    assert near.state["valve"]["doubt"][0, 0] < 0.004
    far = resting(law, Joint(2e-3, 0.12, 0.0), 30.0, parked=False)
    assert far.state["phase"][0] == JOG  # it never moved: the valve stays as far open as it is known
    assert far.spools[-1] == pytest.approx(0.08 + 3.0 * 0.004)


def test_a_motion_takes_the_joints_back_and_forgets_nothing() -> None:
    state = joints_at_start(poor_law(0.08, 0.004))
    state["phase"], state["valve"]["edge"], state["rest"], state["place"] = (
        SHUT,
        0.0777,
        1.0,
        1e-4,
    )
    state["jog"]["sense"], state["pulse"]["error"] = 1.0, 1e-4
    after = joints_in_motion(state)
    assert (after["phase"] == FOLLOW).all()
    assert (after["valve"]["edge"] == 0.0777).all()
    assert not after["rest"].any()
    assert not after["place"].any()
    assert not after["pulse"]["error"].any()
    assert (state["phase"] == SHUT).all()
