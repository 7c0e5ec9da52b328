"""A joint that leaks is kept by an opening on one side of its valve's overlap."""

import numpy as np
import pytest

from controller.core.parking.jogs import FAR_RAD
from controller.core.parking.joint import HOLD, SHUT, joints_at_start, joints_in_motion, offsets_from_place
from controller.core.parking.parking import phase_spool
from controller.core.parking.rest import arm_parked, watch_creep
from protocol.process_image import VALVE_FULL_SCALE
from tests.controller.parking.poor_joint import BAND_RAD, BAR_RAD, DT_S, GAINS, ONES, Joint, poor_law, resting


def test_a_kept_joint_near_its_goal_stays_there_once_the_arm_is_parked() -> None:
    """Two joints of a crane that crept the last tenth of a milliradian took the tool 2 mm along."""
    state = joints_at_start(poor_law(0.08, 0.004))
    state["phase"], state["error"] = HOLD, [1.4e-4, -1.4e-4, 1.5e-4, 4e-4, 0.0, -2e-5]
    here = arm_parked(poor_law(0.08, 0.004), state)
    assert here["place"].tolist() == [1.4e-4, -1.4e-4, 0.0, 0.0, 0.0, -2e-5]
    assert not offsets_from_place(here)[[0, 1, 4, 5]].any()


def test_the_valve_of_a_kept_joint_stays_as_it_is_when_the_arm_is_parked() -> None:
    """What pushed it to its goal, and what its load told, ended at once: a crane's lift sank by 0.6 mm."""
    law = poor_law(0.02, 0.001)._replace(exact=ONES, friction_spring=ONES / BAR_RAD)
    state = joints_at_start(law)
    state["phase"], state["jog"]["sense"], state["watch"]["quiet"], state["error"] = (
        HOLD,
        [1.0, -1.0, 1.0, 1.0, 1.0, 1.0],
        40.0,
        3e-5,
    )
    state["watch"]["load"], state["leak"]["load"], state["leak"]["bias"] = 50.3, 50.0, 4e-4
    here = arm_parked(law, state)
    assert not offsets_from_place(here).any()
    for joint in range(2):
        before, after = (
            np.mean([phase_spool(law, at, joint, 3e-5, 50.3, GAINS) for _ in range(200)])
            for at in (state, here)
        )
        assert after == pytest.approx(before, abs=0.3 / VALVE_FULL_SCALE)


@pytest.mark.parametrize(("seen", "left"), [(0.0, 0.6), (-5e-5, 0.3), (5e-5, 0.6)])
def test_a_load_that_fell_is_remembered_unless_the_encoder_says_otherwise(seen: float, left: float) -> None:
    """A lift sank by 0.1 mrad in three minutes, within its play: its load told, and was forgotten in one."""
    law = poor_law(0.02, 0.001)._replace(exact=ONES, friction_spring=1e-4 * ONES)
    state = joints_at_start(law)
    state["phase"], state["jog"]["sense"], state["rest"], state["leak"]["load"] = HOLD, 1.0, 2.0, 50.0
    for scan in range(scans := round(150.0 / DT_S)):
        phase_spool(law, state, 0, seen, load := 50.0 - 0.5 * scan / scans, GAINS)
    assert (state["leak"]["load"][0] - load) / 0.5 == pytest.approx(left, abs=0.15)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_parked_joint_whose_load_tells_that_it_sinks_is_caught_sooner(side: float) -> None:
    """Between a spool's edges an opening does next to nothing; a lift sank by 1 mm on the way there."""
    law = poor_law(0.02, 0.001)._replace(exact=ONES, friction_spring=1e-4 * ONES)

    def learn_from_metered(bar: float, seen: float = 0.0, parked: float = 2.0) -> float:
        """What the bias changes by in a second, times its usual rate (rad/s)."""
        state = joints_at_start(law)
        state["phase"] = HOLD
        state["jog"]["sense"] = side
        state["rest"] = parked
        state["leak"]["load"] = 50.0
        state["error"], state["watch"]["quiet"] = side * seen, 40.0
        for _ in range(round(1.0 / DT_S)):
            phase_spool(law, state, 0, side * seen, 50.0 - side * bar, GAINS)
        return float(state["leak"]["bias"][0]) / bar

    usual = learn_from_metered(0.12)
    assert learn_from_metered(0.5) == pytest.approx(4.0 * usual, rel=0.05)
    assert learn_from_metered(0.5, parked=0.0) == pytest.approx(usual, rel=0.05)
    assert 0.0 < learn_from_metered(0.5, seen=-2.6e-5) < usual  # the encoder tells otherwise


@pytest.mark.parametrize("creep", [-1e-3, 4e-4])
def test_a_joint_that_leaks_too_fast_is_kept_by_an_opening(creep: float) -> None:
    """Steadily on one side of the overlap, and still: within a third of the play before its encoder.

    One step of the valve's word is 12 µrad/s here, a hundred times what would leave it there.
    """
    rest = resting(poor_law(0.08, 0.004), Joint(0.0, 0.083, creep, 5e-5), 120.0, parked=False)
    assert rest.state["phase"][0] == HOLD
    settled = round(30.0 / DT_S)
    assert np.ptp(rest.errors[-settled:]) < 0.33 * BAND_RAD
    assert (np.sign(rest.spools[-settled:]) == -np.sign(creep)).all()
    slow = resting(poor_law(0.08, 0.002), Joint(0.0, 0.083, 0.02 * creep), 90.0, parked=False)
    assert slow.state["phase"][0] != HOLD


def test_a_valve_that_passes_small_flows_keeps_a_loaded_joint_that_is_felt() -> None:
    law, joint = poor_law(0.02, 0.001), Joint(0.0, 0.0205, -1e-5, 5e-5)
    assert resting(law, joint, 30.0, parked=False).state["phase"][0] != HOLD
    felt = law._replace(exact=ONES, friction_spring=ONES / BAR_RAD)
    assert resting(felt, joint, 30.0, parked=False).state["phase"][0] == HOLD
    for lacks in ("exact", "friction_spring", "loaded"):
        less = felt._replace(**{lacks: 0.0 * ONES})
        assert resting(less, joint, 30.0, parked=False).state["phase"][0] != HOLD


def test_a_kept_joint_is_felt_within_the_play_before_its_encoder() -> None:
    """Oil drains away for minutes, and with it what the valve has to pass; the encoder sees little of it."""
    law = poor_law(0.02, 0.001)._replace(exact=ONES, leak_time=1e3 * ONES)
    joint = Joint(0.0, 0.0205, -2e-5, 6e-5, -1e-6)
    unfelt, felt = (
        resting(one, joint, 150.0, parked=False)
        for one in (law, law._replace(friction_spring=ONES / BAR_RAD))
    )
    moved = [np.ptp(rest.errors[round(60.0 / DT_S) :]) for rest in (unfelt, felt)]
    assert felt.state["phase"][0] == HOLD
    assert moved[1] < 0.6 * moved[0]
    assert moved[1] < 6e-5


def test_a_kept_joint_whose_leak_turns_over_is_kept_on_the_other_side() -> None:
    law = poor_law(0.02, 0.001)._replace(exact=ONES, friction_spring=ONES / BAR_RAD)
    rest = resting(law, Joint(0.0, 0.0205, -2e-5, 5e-5, 1e-6), 150.0, parked=False)
    assert (np.sign(rest.spools[-100:]) == -1.0).all()
    assert rest.spools.max() > 0.0
    assert np.abs(rest.errors[-100:]).max() < 2e-4
    assert np.abs(rest.errors).max() < 5e-4


@pytest.mark.parametrize(("drift", "steady"), [(1.5e-7, True), (1e-6, False)])
def test_a_kept_joint_whose_leak_still_changes_does_not_rest(drift: float, steady: bool) -> None:
    """Quiet by its encoder, a lift whose oil drained away was parked, and sank within its play."""
    law = poor_law(0.02, 0.001)._replace(exact=ONES, friction_spring=ONES / BAR_RAD)
    state = joints_at_start(law)
    state["phase"][0] = HOLD
    for scan in range(round(60.0 / DT_S)):
        state["leak"]["bias"][0] = 1e-4 + drift * DT_S * scan
        watch_creep(law, state[0], 0, 5.0, 0.0, 50.0)
    assert (state["leak"]["steady"][0] > 35.0) == steady
    assert state["watch"]["quiet"][0] > 35.0


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_joint_that_its_opening_carries_off_is_kept_no_more(side: float) -> None:
    """A crane's tilt went to and fro by 30 mrad while kept: no edge was where it was believed."""
    law = poor_law(0.08, 0.004)
    rest = resting(law, Joint(0.0, 0.05, side * -1e-3, 5e-5), 60.0, parked=False, phase=HOLD)
    assert 1e-3 < np.abs(rest.errors).max() < 2.5e-3
    assert np.abs(rest.errors[-round(30.0 / DT_S) :]).max() < FAR_RAD


@pytest.mark.parametrize(("phase", "off", "is_kept"), [(SHUT, 0.0, True), (HOLD, 1.1 * FAR_RAD, False)])
def test_a_joint_that_was_lost_is_not_kept_again_before_the_next_motion(
    phase: float, off: float, is_kept: bool
) -> None:
    """It leaks too fast for inches in either, and is told to again and again."""
    rest = resting(poor_law(0.08, 0.004), Joint(off, 0.083, -1e-3, 5e-5), 60.0, parked=False, phase=phase)
    shut = rest.phases.tolist().index(SHUT)
    assert (HOLD in rest.phases[shut:]) == is_kept
    assert joints_in_motion(rest.state)["jog"]["repeats"][0] == 0.0
