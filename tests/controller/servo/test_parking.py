"""Parking on one joint behind a poor valve: overlap known within a fifth, hysteresis, delay, lag, creep."""

import math
from collections import deque
from typing import NamedTuple

import numpy as np
import pytest

from controller.core.servo.coming_to_rest import at_rest, listened, parked_here
from controller.core.servo.parking import _moved
from controller.core.servo.parking_state import (
    AFTER,
    BAND,
    BIAS,
    CREPT,
    DOUBT,
    DRIFT,
    EDGE,
    ERROR,
    FELT,
    FOLLOWING,
    HASTE,
    HELD,
    KEPT,
    LOAD,
    MARK,
    NUDGE,
    NUDGED,
    OPEN,
    PARKED,
    PHASE,
    PLACE,
    PUSH,
    QUIET,
    RESTED,
    SENSE,
    SHUT,
    SHUT_AT,
    SINCE,
    SPEED,
    STATE_ROWS,
    STEADY,
    ParkingLaw,
    off_place,
    parking_begun,
    parking_ended,
)
from controller.core.servo.small_moves import nudge_begun
from protocol.process_image import VALVE_FULL_SCALE

DT_S, GAIN, DIGIT, BAND_RAD = 0.005, 0.4, 4.8e-5, 1e-4
GAINS = np.full(2, GAIN)
DELAY_S, LAG_S = 0.012, 0.057
ONES = np.ones(6)
BAR_RAD = 5e3  # friction before it slides is a spring: 0.2 bar for 40 µrad


def _law(deadband: float, spread: float) -> ParkingLaw:
    late = DELAY_S + LAG_S + 1.5 * DT_S
    return ParkingLaw(
        band=4e-4,
        band_least=7e-5,
        band_most=2e-4,
        slowest=4e-4,
        fastest=1e-2,
        patience=6.0,
        calm_way=2e-4,
        calm=3.0,
        leaves=2.7e-4,
        stays=30.0,
        quiet=1e-4,
        deadband=np.full((6, 2), deadband),
        spread=np.full((6, 2), spread),
        latest=(late + 0.15) * ONES,
        shutting=(late + 0.03) * ONES,
        loaded=ONES,
        rest=3.0 * ONES,
        keeping=1.5 * ONES,
        exact=0.0 * ONES,
        felt=0.0 * ONES,
        oil=0.0 * ONES,
        play=0.0 * ONES,
        highest=np.full((6, 2), 2.0 * deadband),
        dt_s=DT_S,
    )


class Rest(NamedTuple):
    """Errors (rad), true and by the encoder, spool commands and phases of every scan."""

    errors: np.ndarray
    seen: np.ndarray
    spools: np.ndarray
    phases: np.ndarray
    state: np.ndarray


class Joint(NamedTuple):
    """A joint ``error`` off whose valve opens at ``edge``; it creeps by itself (rad/s).

    ``half_play``: before its encoder (rad); ``ramp``: of the creep (rad/s²).
    """

    error: float
    edge: float
    creep: float
    half_play: float = 0.0
    ramp: float = 0.0


def _rest(law: ParkingLaw, joint: Joint, seconds: float, parked: bool = True) -> Rest:
    rng, state = np.random.default_rng(5), parking_begun(law)
    state[PHASE, 0], state[BAND, 0], state[PARKED, 0] = SHUT, BAND_RAD, float(parked)
    state[ERROR, 0] = state[CREPT, 0] = joint.error
    commands = deque([0.0] * round(DELAY_S / DT_S), maxlen=round(DELAY_S / DT_S))
    angle, seen, spool = -joint.error, -joint.error, 0.0
    shaft = angle + math.copysign(joint.half_play, joint.creep)
    rows = []
    for scan in range(round(seconds / DT_S)):
        shaft = min(max(shaft, angle - joint.half_play), angle + joint.half_play)
        before, seen = seen, DIGIT * round((shaft + rng.normal(0.0, 0.3 * DIGIT)) / DIGIT)
        keep = math.exp(-DT_S / 0.03)
        state[SPEED, 0] = keep * state[SPEED, 0] + (1.0 - keep) * (seen - before) / DT_S
        state[[SINCE, AFTER], 0] += DT_S
        listened(law, state, 0, 4.0, -seen, 50.0)
        command = _moved(law, state, 0, -seen, 50.0 + BAR_RAD * angle, GAINS)
        late = commands[0]
        commands.append(round(command * VALVE_FULL_SCALE) / VALVE_FULL_SCALE)
        spool += (late - spool) * (1.0 - math.exp(-DT_S / LAG_S))
        beyond = max(abs(spool) - joint.edge, 0.0)
        angle += DT_S * (math.copysign(GAIN * beyond, spool) + joint.creep + joint.ramp * DT_S * scan)
        rows.append((-angle, -shaft, command, state[PHASE, 0]))
    return Rest(*np.array(rows).T, state)


@pytest.mark.parametrize("known", [0.8, 1.0, 1.2])
@pytest.mark.parametrize("error", [2e-3, -6e-4])
def test_it_comes_to_rest_inside_its_band_with_the_valve_shut(known: float, error: float) -> None:
    rest = _rest(_law(0.08 * known, 0.01), Joint(error, 0.08, 0.0), 40.0, parked=False)
    last = round(5.0 / DT_S)
    assert np.abs(rest.errors[-last:]).max() < 2e-4
    assert not rest.spools[-last:].any()


@pytest.mark.parametrize("half_play", [0.0, 6e-5])
@pytest.mark.parametrize("creep", [-5e-6, -1e-6, 2e-6])
def test_a_parked_joint_that_creeps_is_nudged_within_the_play_of_its_encoder(
    creep: float, half_play: float
) -> None:
    """Ten minutes of a load that sinks: never to the other side, nor far beyond play and bands."""
    rest = _rest(_law(0.08, 0.002), Joint(0.0, 0.081, creep, half_play), 600.0)
    assert np.ptp(rest.errors) < 5.0 * BAND_RAD < abs(600.0 * creep)
    opened = rest.spools[rest.spools != 0.0]
    assert opened.size > 0
    assert (np.sign(opened) == -np.sign(creep)).all()
    assert set(rest.phases) == {SHUT, NUDGED}
    assert (rest.spools != 0.0).mean() < 0.15


def test_a_parked_joint_is_nudged_by_what_it_creeps_not_by_what_it_crept() -> None:
    """A crane's loads crept thirty times as fast before the arm was parked: weak nudges were taken for strong
    ones, and with each of a dozen in ten minutes the encoders sank by a part of a digit."""
    law, state = _law(0.08, 0.004), parking_begun(_law(0.08, 0.004))
    state[PHASE], state[BAND], state[SENSE], state[AFTER] = SHUT, BAND_RAD, 1.0, 100.0
    state[DRIFT], state[NUDGE], state[PUSH] = 8e-6, 0.04, 0.03
    here = parked_here(_law(0.08, 0.004), state)
    rng, creep = np.random.default_rng(3), 2.5e-7
    for scan in range(round(400.0 / DT_S)):
        here[[SINCE, AFTER], 0] += DT_S
        error = creep * DT_S * scan + rng.normal(0.0, 0.3 * DIGIT)
        listened(law, here, 0, 4.0, error, 50.0)
        if _moved(law, here, 0, error, 50.0, GAINS) > 0.0:
            break
    assert here[PHASE, 0] == NUDGED
    assert here[DRIFT, 0] == pytest.approx(creep, rel=0.2)
    assert here[PUSH, 0] > 0.03


@pytest.mark.parametrize(("after", "grows"), [(5.0, False), (40.0, True)])
def test_a_nudge_that_did_not_hold_says_nothing_of_how_strong_it_was(after: float, grows: bool) -> None:
    """Between a drive's end and its look oil still relaxes: each nudge was due again within seconds and
    twice as strong, until one of 1.7 bar took a crane's lift through its play, the tool by 5 mm."""
    state = parking_begun(_law(0.08, 0.004))
    state[BAND], state[SENSE], state[DRIFT], state[NUDGE], state[PUSH] = BAND_RAD, 1.0, 4e-6, 0.04, 0.3
    pushes = []
    for _ in range(8):
        state[AFTER, 0] = after
        nudge_begun(state, 0, state[MARK, 0] + 4e-6 * after, 1.0, 50.0)
        pushes.append(state[PUSH, 0])
    assert (pushes[0] > 0.3) == grows
    assert max(pushes) <= 0.8  # a crane's lift rises by 0.15 mrad


def test_a_parked_joint_that_stands_is_left_where_it_rests() -> None:
    """Nudging it would take it through the play before its encoder, by more than it is off."""
    law, state = _law(0.08, 0.004), parking_begun(_law(0.08, 0.004))
    state[PHASE], state[BAND], state[ERROR], state[QUIET] = SHUT, BAND_RAD, 1.4 * BAND_RAD, 100.0
    state[SHUT_AT] = state[ERROR]
    assert at_rest(state)
    here = parked_here(_law(0.08, 0.004), state)
    assert (here[PLACE] == 1.4 * BAND_RAD).all()
    assert not off_place(here).any()
    for error in (0.4 * BAND_RAD, 3.0 * BAND_RAD):
        for _ in range(1000):
            here[[SINCE, AFTER], 0] += DT_S
            here[ERROR, 0] = here[SHUT_AT, 0] = 1.4 * BAND_RAD + error  # it moved once, and stands
            assert _moved(law, here, 0, 1.4 * BAND_RAD + error, 50.0, GAINS) == 0.0
    unloaded = law._replace(loaded=np.zeros(6))
    here[SHUT_AT, 0], here[CREPT, 0] = 0.0, 1.4 * BAND_RAD + 3.0 * BAND_RAD
    assert _moved(unloaded, here, 0, 1.4 * BAND_RAD + 3.0 * BAND_RAD, 50.0, GAINS) == 0.0
    assert _moved(law, here, 0, 1.4 * BAND_RAD + 3.0 * BAND_RAD, 50.0, GAINS) > 0.0


def test_a_kept_joint_near_its_goal_stays_there_once_the_arm_is_parked() -> None:
    """Two joints of a crane that crept the last tenth of a milliradian took the tool 2 mm along."""
    state = parking_begun(_law(0.08, 0.004))
    state[PHASE], state[ERROR] = KEPT, [1.4e-4, -1.4e-4, 1.5e-4, 4e-4, 0.0, -2e-5]
    here = parked_here(_law(0.08, 0.004), state)
    assert here[PLACE].tolist() == [1.4e-4, -1.4e-4, 0.0, 0.0, 0.0, -2e-5]
    assert not off_place(here)[[0, 1, 4, 5]].any()


def test_the_valve_of_a_kept_joint_stays_as_it_is_when_the_arm_is_parked() -> None:
    """What pushed it to its goal, and what its load told, ended at once: a crane's lift sank by 0.6 mm."""
    law = _law(0.02, 0.001)._replace(exact=ONES, felt=ONES / BAR_RAD)
    state = parking_begun(law)
    state[PHASE], state[SENSE], state[QUIET], state[ERROR] = KEPT, [1.0, -1.0, 1.0, 1.0, 1.0, 1.0], 40.0, 3e-5
    state[LOAD], state[FELT], state[BIAS] = 50.3, 50.0, 4e-4
    here = parked_here(law, state)
    assert not off_place(here).any()
    for joint in range(2):
        before, after = (
            np.mean([_moved(law, at, joint, 3e-5, 50.3, GAINS) for _ in range(200)]) for at in (state, here)
        )
        assert after == pytest.approx(before, abs=0.3 / VALVE_FULL_SCALE)


@pytest.mark.parametrize(("seen", "left"), [(0.0, 0.6), (-5e-5, 0.3), (5e-5, 0.6)])
def test_a_load_that_fell_is_remembered_unless_the_encoder_says_otherwise(seen: float, left: float) -> None:
    """A lift sank by 0.1 mrad in three minutes, within its play: its load told, and was forgotten in one."""
    law = _law(0.02, 0.001)._replace(exact=ONES, felt=1e-4 * ONES)
    state = parking_begun(law)
    state[PHASE], state[SENSE], state[PARKED], state[FELT] = KEPT, 1.0, 2.0, 50.0
    for scan in range(scans := round(150.0 / DT_S)):
        _moved(law, state, 0, seen, load := 50.0 - 0.5 * scan / scans, GAINS)
    assert (state[FELT, 0] - load) / 0.5 == pytest.approx(left, abs=0.15)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_parked_joint_whose_load_tells_that_it_sinks_is_caught_sooner(side: float) -> None:
    """Between a spool's edges an opening does next to nothing; a lift sank by 1 mm on the way there."""
    law = _law(0.02, 0.001)._replace(exact=ONES, felt=1e-4 * ONES)

    def learned(bar: float, seen: float = 0.0, parked: float = 2.0) -> float:
        """What the bias changes by in a second, times its usual rate (rad/s)."""
        state = parking_begun(law)
        state[PHASE], state[SENSE], state[PARKED], state[FELT] = KEPT, side, parked, 50.0
        state[ERROR], state[QUIET] = side * seen, 40.0
        for _ in range(round(1.0 / DT_S)):
            _moved(law, state, 0, side * seen, 50.0 - side * bar, GAINS)
        return float(state[BIAS, 0]) / bar

    usual = learned(0.12)
    assert learned(0.5) == pytest.approx(4.0 * usual, rel=0.05)
    assert learned(0.5, parked=0.0) == pytest.approx(usual, rel=0.05)
    assert 0.0 < learned(0.5, seen=-2.6e-5) < usual  # the encoder tells otherwise


def test_a_parked_joint_that_was_pushed_far_away_is_brought_back() -> None:
    rest = _rest(_law(0.08, 0.002), Joint(2e-3, 0.08, -4e-6), 60.0)
    assert OPEN in rest.phases
    assert np.abs(rest.errors[-2000:]).max() < 7.0 * BAND_RAD


@pytest.mark.parametrize("creep", [-1e-3, 4e-4])
def test_a_joint_that_leaks_too_fast_is_kept_by_an_opening(creep: float) -> None:
    """Steadily on one side of the overlap, and still: within a third of the play before its encoder.

    One step of the valve's word is 12 µrad/s here, a hundred times what would leave it there.
    """
    rest = _rest(_law(0.08, 0.004), Joint(0.0, 0.083, creep, 5e-5), 120.0, parked=False)
    assert rest.state[PHASE, 0] == KEPT
    settled = round(30.0 / DT_S)
    assert np.ptp(rest.errors[-settled:]) < 0.33 * BAND_RAD
    assert (np.sign(rest.spools[-settled:]) == -np.sign(creep)).all()
    slow = _rest(_law(0.08, 0.002), Joint(0.0, 0.083, 0.02 * creep), 90.0, parked=False)
    assert slow.state[PHASE, 0] != KEPT


def test_a_valve_that_passes_small_flows_keeps_a_loaded_joint_that_is_felt() -> None:
    law, joint = _law(0.02, 0.001), Joint(0.0, 0.0205, -1e-5, 5e-5)
    assert _rest(law, joint, 30.0, parked=False).state[PHASE, 0] != KEPT
    felt = law._replace(exact=ONES, felt=ONES / BAR_RAD)
    assert _rest(felt, joint, 30.0, parked=False).state[PHASE, 0] == KEPT
    for lacks in ("exact", "felt", "loaded"):
        less = felt._replace(**{lacks: 0.0 * ONES})
        assert _rest(less, joint, 30.0, parked=False).state[PHASE, 0] != KEPT


def test_a_kept_joint_is_felt_within_the_play_before_its_encoder() -> None:
    """Oil drains away for minutes, and with it what the valve has to pass; the encoder sees little of it."""
    law = _law(0.02, 0.001)._replace(exact=ONES, rest=1e3 * ONES)
    joint = Joint(0.0, 0.0205, -2e-5, 6e-5, -1e-6)
    unfelt, felt = (
        _rest(one, joint, 150.0, parked=False) for one in (law, law._replace(felt=ONES / BAR_RAD))
    )
    moved = [np.ptp(rest.errors[round(60.0 / DT_S) :]) for rest in (unfelt, felt)]
    assert felt.state[PHASE, 0] == KEPT
    assert moved[1] < 0.6 * moved[0]
    assert moved[1] < 6e-5


def test_a_kept_joint_whose_leak_turns_over_is_kept_on_the_other_side() -> None:
    law = _law(0.02, 0.001)._replace(exact=ONES, felt=ONES / BAR_RAD)
    rest = _rest(law, Joint(0.0, 0.0205, -2e-5, 5e-5, 1e-6), 150.0, parked=False)
    assert (np.sign(rest.spools[-100:]) == -1.0).all()
    assert rest.spools.max() > 0.0
    assert np.abs(rest.errors[-100:]).max() < 2e-4
    assert np.abs(rest.errors).max() < 5e-4


def test_the_arm_rests_when_every_joint_does() -> None:
    law = _law(0.08, 0.004)
    state = parking_begun(law)
    state[PHASE], state[BAND], state[QUIET] = SHUT, BAND_RAD, 11.0
    assert at_rest(state)
    for row, value in ((PHASE, OPEN), (PHASE, FOLLOWING), (QUIET, 9.0), (ERROR, 2.0 * BAND_RAD)):
        restless = state.copy()
        restless[row, 3] = value
        assert not at_rest(restless)
        restless[HELD] = 301.0  # as it is, then; but not while the joint law still drives
        assert at_rest(restless) == (value != FOLLOWING or row != PHASE)
    leaking = state.copy()
    leaking[PHASE, 4], leaking[ERROR, 4] = KEPT, 3e-4
    assert not at_rest(leaking)
    leaking[QUIET, 4] = 36.0
    assert not at_rest(leaking)  # what its valve has to pass still changes
    leaking[STEADY, 4] = 36.0
    assert at_rest(leaking)


@pytest.mark.parametrize(("drift", "steady"), [(1.5e-7, True), (1e-6, False)])
def test_a_kept_joint_whose_leak_still_changes_does_not_rest(drift: float, steady: bool) -> None:
    """Quiet by its encoder, a lift whose oil drained away was parked, and sank within its play."""
    law = _law(0.02, 0.001)._replace(exact=ONES, felt=ONES / BAR_RAD)
    state = parking_begun(law)
    state[PHASE, 0] = KEPT
    for scan in range(round(60.0 / DT_S)):
        state[BIAS, 0] = 1e-4 + drift * DT_S * scan
        listened(law, state, 0, 5.0, 0.0, 50.0)
    assert (state[STEADY, 0] > 35.0) == steady
    assert state[QUIET, 0] > 35.0


def test_what_moves_the_tool_is_not_quiet_nor_is_a_slew_whose_oil_relaxes() -> None:
    law = _law(0.08, 0.004)._replace(loaded=np.array([0.0, 1.0, 1.0, 1.0, 1.0, 1.0]))
    state = parking_begun(law)

    def quiet_after(joint: int, error: float, load: float) -> float:
        state[CREPT, joint], state[LOAD, joint] = error, load
        listened(law, state, joint, 5.0, error, load)
        return float(state[QUIET, joint])

    for joint in (0, 1):
        quiet_after(joint, 1e-3, 50.0)
        assert [quiet_after(joint, 1e-3 + 1.9e-5, 50.0) for _ in range(3)][-1] == pytest.approx(3 * DT_S)
        assert quiet_after(joint, 1e-3 + 2.1e-5, 50.0) == 0.0
    assert quiet_after(1, 1e-3 + 2.1e-5, 51.0) > 0.0
    assert quiet_after(0, 1e-3 + 2.1e-5, 50.06) == 0.0


def test_a_slew_whose_pressure_the_pump_shakes_is_quiet() -> None:
    """By its filtered load: two bar at 20 Hz are no oil that relaxes, a twentieth of it that stays is."""
    law, state = _law(0.08, 0.004)._replace(loaded=np.zeros(6)), parking_begun(_law(0.08, 0.004))
    state[LOAD] = state[RESTED] = 50.0
    for scan in range(2000):
        listened(law, state, 0, 5.0, 0.0, 50.0 + 2.0 * math.sin(2.0 * math.pi * 20.0 * DT_S * scan))
    assert state[QUIET, 0] == pytest.approx(2000 * DT_S)
    for _ in range(2000):
        listened(law, state, 0, 5.0, 0.0, 50.1)
    assert state[QUIET, 0] < 1900 * DT_S


def test_where_the_joint_moves_is_learned_within_what_is_known() -> None:
    law = _law(0.08, 0.004)._replace(rest=1e-3 * ONES)
    near = _rest(law, Joint(2e-3, 0.085, -3e-4), 60.0, parked=False)
    assert near.state[EDGE, 0] == pytest.approx(0.085, abs=0.004)
    assert near.state[DOUBT, 0] < 0.004
    far = _rest(law, Joint(2e-3, 0.12, 0.0), 30.0, parked=False)
    assert far.state[PHASE, 0] == OPEN  # it never moved: the valve stays as far open as it is known
    assert far.spools[-1] == pytest.approx(0.08 + 3.0 * 0.004)


def test_a_motion_takes_the_joints_back_and_forgets_nothing() -> None:
    state = parking_begun(_law(0.08, 0.004))
    state[PHASE], state[EDGE], state[PARKED], state[PLACE], state[HASTE] = SHUT, 0.0777, 1.0, 1e-4, 3.0
    state[SENSE], state[MARK] = 1.0, 1e-4
    after = parking_ended(state)
    assert (after[PHASE] == FOLLOWING).all()
    assert (after[EDGE] == 0.0777).all()
    assert not after[[PARKED, PLACE, HASTE, MARK]].any()
    assert state.shape == (STATE_ROWS, 6)
    assert (state[PHASE] == SHUT).all()
