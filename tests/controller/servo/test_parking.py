"""Parking on one joint behind a poor valve: overlap known within a fifth, hysteresis, delay, lag, creep."""

import math
from collections import deque
from typing import NamedTuple

import numpy as np
import pytest

from controller.core.servo.parking import (
    BAND,
    DOUBT,
    EDGE,
    ERROR,
    FOLLOWING,
    HASTE,
    KEPT,
    OPEN,
    PARKED,
    PHASE,
    PLACE,
    SHUT,
    SHUT_AT,
    SINCE,
    SPEED,
    STATE_ROWS,
    ParkingLaw,
    _inched,
    _watched,
    at_rest,
    parked_here,
    parking_begun,
    parking_ended,
)

DT_S, GAIN, DIGIT, BAND_RAD = 0.005, 0.4, 4.8e-5, 1e-4
GAINS = np.full(2, GAIN)
DELAY_S, LAG_S = 0.012, 0.057
ONES = np.ones(6)


def _law(deadband: float, spread: float) -> ParkingLaw:
    late = DELAY_S + LAG_S + 1.5 * DT_S
    return ParkingLaw(
        band=4e-4,
        band_least=7e-5,
        band_most=2e-4,
        slowest=4e-4,
        fastest=1e-2,
        patience=6.0,
        deadband=np.full((6, 2), deadband),
        spread=np.full((6, 2), spread),
        latest=(late + 0.15) * ONES,
        shutting=(late + 0.03) * ONES,
        loaded=ONES,
        rest=3.0,
        dt_s=DT_S,
    )


class Rest(NamedTuple):
    """Errors (rad) and spool commands of every scan."""

    errors: np.ndarray
    spools: np.ndarray
    state: np.ndarray


def _parked(law: ParkingLaw, error: float, true_edge: float, creep: float, seconds: float) -> Rest:
    """A joint ``error`` off its place whose valve opens at ``true_edge``; it creeps by itself (rad/s)."""
    rng, state = np.random.default_rng(5), parking_begun(law)
    state[PHASE, 0], state[BAND, 0], state[PARKED, 0], state[ERROR, 0] = SHUT, BAND_RAD, 1.0, error
    commands = deque([0.0] * round(DELAY_S / DT_S), maxlen=round(DELAY_S / DT_S))
    angle, seen, spool, errors, spools = -error, -error, 0.0, [], []
    for _ in range(round(seconds / DT_S)):
        before, seen = seen, DIGIT * round((angle + rng.normal(0.0, 0.3 * DIGIT)) / DIGIT)
        keep = math.exp(-DT_S / 0.03)
        state[SPEED, 0] = keep * state[SPEED, 0] + (1.0 - keep) * (seen - before) / DT_S
        state[SINCE, 0] += DT_S
        if state[PHASE, 0] == KEPT:
            break
        if state[PHASE, 0] == SHUT:
            command = _watched(law, state, 0, -seen, GAINS)
        else:
            command = _inched(law, state, 0, -seen, GAINS)
        late = commands[0]
        commands.append(command)
        spool += (late - spool) * (1.0 - math.exp(-DT_S / LAG_S))
        beyond = max(abs(spool) - true_edge, 0.0)
        angle += DT_S * (math.copysign(GAIN * beyond, spool) + creep)
        errors.append(-angle)
        spools.append(command)
    return Rest(np.array(errors), np.array(spools), state)


@pytest.mark.parametrize("known", [0.8, 1.0, 1.2])
@pytest.mark.parametrize("error", [2e-3, -6e-4])
def test_it_comes_to_rest_inside_its_band_with_the_valve_shut(known: float, error: float) -> None:
    rest = _parked(_law(0.08 * known, 0.01), error, true_edge=0.08, creep=0.0, seconds=20.0)
    last = round(5.0 / DT_S)
    assert np.abs(rest.errors[-last:]).max() < 2e-4
    assert not rest.spools[-last:].any()


@pytest.mark.parametrize(("creep", "bands", "mean"), [(-5e-5, 3.0, 1.0), (-2e-5, 2.5, 1.0), (4e-6, 2.5, 2.0)])
def test_a_creeping_joint_is_kept_near_its_place(creep: float, bands: float, mean: float) -> None:
    rest = _parked(_law(0.08, 0.008), 0.0, true_edge=0.083, creep=creep, seconds=120.0)
    settled = rest.errors[round(20.0 / DT_S) :]
    assert np.abs(settled).max() < bands * BAND_RAD
    assert abs(settled.mean()) < mean * BAND_RAD
    opened = rest.spools[rest.spools != 0.0]
    assert opened.size > 0
    assert (np.sign(opened) == -np.sign(creep)).all()  # never to the other side: no hunting
    assert (rest.spools != 0.0).mean() < 0.5


@pytest.mark.parametrize("creep", [-1e-3, 2e-4])
def test_a_joint_that_leaks_too_fast_is_given_back_to_the_joint_law(creep: float) -> None:
    rest = _parked(_law(0.08, 0.008), 0.0, true_edge=0.083, creep=creep, seconds=60.0)
    assert rest.state[PHASE, 0] == KEPT
    assert len(rest.errors) < 30.0 / DT_S
    slow = _parked(_law(0.08, 0.008), 0.0, true_edge=0.083, creep=0.02 * creep, seconds=60.0)
    assert slow.state[PHASE, 0] != KEPT


def test_a_parked_joint_that_stands_is_left_where_it_rests() -> None:
    """An inch would take it through the play before its encoder, by more than it is off."""
    law, state = _law(0.08, 0.004), parking_begun(_law(0.08, 0.004))
    state[PHASE], state[BAND], state[ERROR], state[SINCE] = SHUT, BAND_RAD, 1.4 * BAND_RAD, 100.0
    state[SHUT_AT] = state[ERROR]
    assert at_rest(law, state)
    here = parked_here(state)
    assert (here[PLACE] == 1.4 * BAND_RAD).all()
    for _ in range(2000):
        here[SINCE, 0] += DT_S
        assert _watched(law, here, 0, 1.4 * BAND_RAD + 1.5e-4, GAINS) == 0.0
    for _ in range(2000):
        here[SINCE, 0] += DT_S
        if _watched(law, here, 0, 1.4 * BAND_RAD + 2.5e-4, GAINS) != 0.0:
            break
    assert here[PHASE, 0] == OPEN


def test_the_arm_rests_when_every_joint_does() -> None:
    law = _law(0.08, 0.004)._replace(loaded=np.array([0.0, 1.0, 1.0, 0.0, 1.0, 1.0]))
    state = parking_begun(law)
    state[PHASE], state[BAND], state[SINCE] = SHUT, BAND_RAD, 2.0
    state[SINCE, [0, 3]] = 5.0
    assert at_rest(law, state)
    for row, value in ((PHASE, OPEN), (PHASE, FOLLOWING), (SINCE, 2.0), (ERROR, 2.0 * BAND_RAD)):
        restless = state.copy()
        restless[row, 3] = value
        assert not at_rest(law, restless)
    leaking = state.copy()
    leaking[PHASE, 4], leaking[SINCE, 4], leaking[ERROR, 4] = KEPT, 0.1, 3e-4
    assert at_rest(law, leaking)


def test_where_the_joint_moves_is_learned_within_what_is_known() -> None:
    law = _law(0.08, 0.004)
    near = _parked(law, 2e-3, true_edge=0.085, creep=-3e-4, seconds=60.0)
    assert near.state[EDGE, 0] == pytest.approx(0.085, abs=0.004)
    assert near.state[DOUBT, 0] < 0.004
    far = _parked(law, 2e-3, true_edge=0.12, creep=0.0, seconds=30.0)
    assert far.state[PHASE, 0] == OPEN  # it never moved: the valve stays as far open as it is known
    assert far.spools[-1] == pytest.approx(0.08 + 3.0 * 0.004)


def test_a_motion_takes_the_joints_back_and_forgets_nothing() -> None:
    state = parking_begun(_law(0.08, 0.004))
    state[PHASE], state[EDGE], state[PARKED], state[PLACE], state[HASTE] = SHUT, 0.0777, 1.0, 1e-4, 3.0
    after = parking_ended(state)
    assert (after[PHASE] == FOLLOWING).all()
    assert (after[EDGE] == 0.0777).all()
    assert not after[[PARKED, PLACE, HASTE]].any()
    assert state.shape == (STATE_ROWS, 6)
    assert (state[PHASE] == SHUT).all()
