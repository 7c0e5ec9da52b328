"""Metered inches on one joint whose friction holds it against compressed oil, and lets go of it slowly."""

import math
from collections import deque
from typing import NamedTuple

import numpy as np
import pytest

from controller.config import ControllerConfig
from controller.core.servo.coming_to_rest import listened
from controller.core.servo.metering import learned, metered_begun
from controller.core.servo.parking import _moved
from controller.core.servo.parking_state import (
    AFTER,
    BAND,
    CREPT,
    DOUBT,
    EDGE,
    ERROR,
    FROM,
    GIVES,
    OIL_AT,
    OIL_FROM,
    OPENED,
    OPENING,
    PHASE,
    SENSE,
    SHUT,
    SINCE,
    SPEED,
    WAY,
    ParkingLaw,
    parking_begun,
    parking_ended,
)
from controller.core.servo_settings import parking_law
from foundation.configuration import load
from nominal_arm.commissioned import MeasuredNumber
from tests.controller.servo.poor_joint import (
    BAND_RAD,
    DELAY_S,
    DIGIT,
    DT_S,
    GAIN,
    GAINS,
    LAG_S,
    ONES,
    poor_law,
)
from tests.support.paths import CONFIGS

OIL_RAD_BAR, RELAXES_S = 3.5e-4, 2.0
LATE_S = DELAY_S + LAG_S + 1.5 * DT_S
METERED = poor_law(0.08, 0.004)._replace(
    latest=(LATE_S + 0.3) * ONES,
    shutting=(LATE_S + 0.13) * ONES,
    loaded=0.0 * ONES,
    oil=OIL_RAD_BAR * ONES,
)


class Held(NamedTuple):
    """A joint ``error`` (rad) off whose valve opens at ``edge``; its oil is compressed by ``squeezed`` rad.

    ``sticks``: so much of it (rad) friction holds for good; what is beyond it lets go of within seconds.
    ``oil``: how far the joint moves a bar (rad).
    """

    error: float
    edge: float = 0.08
    squeezed: float = 0.0
    sticks: float = 0.0
    oil: float = OIL_RAD_BAR


class Way(NamedTuple):
    """True errors (rad) and spool commands of every scan, how often the valve was opened, the last state."""

    errors: np.ndarray
    spools: np.ndarray
    openings: int
    state: np.ndarray


def _way(law: ParkingLaw, joint: Held, seconds: float = 40.0) -> Way:
    """The joint follows its oil late; its load pressure, which the engine shakes, tells what lies between."""
    rng, state = np.random.default_rng(5), parking_begun(law)
    state[PHASE, 0], state[BAND, 0], state[ERROR, 0], state[CREPT, 0] = (
        SHUT,
        BAND_RAD,
        joint.error,
        joint.error,
    )
    commands = deque([0.0] * round(DELAY_S / DT_S), maxlen=round(DELAY_S / DT_S))
    angle, oil, spool, seen, rows = -joint.error, -joint.error + joint.squeezed, 0.0, -joint.error, []
    for scan in range(round(seconds / DT_S)):
        before, seen = seen, DIGIT * round((angle + rng.normal(0.0, 0.3 * DIGIT)) / DIGIT)
        keep = math.exp(-DT_S / 0.03)
        state[SPEED, 0] = keep * state[SPEED, 0] + (1.0 - keep) * (seen - before) / DT_S
        state[[SINCE, AFTER], 0] += DT_S
        load = (oil - angle) / joint.oil + 0.2 * math.sin(2.0 * math.pi * 20.0 * DT_S * scan)
        listened(law, state, 0, 4.0, -seen, load)
        command = _moved(law, state, 0, -seen, load, GAINS)
        late = commands[0]
        commands.append(command)
        spool += (late - spool) * (1.0 - math.exp(-DT_S / LAG_S))
        oil += DT_S * GAIN * math.copysign(max(abs(spool) - joint.edge, 0.0), spool)
        pulls = max(abs(oil - angle) - joint.sticks, 0.0)
        angle += DT_S * math.copysign(pulls, oil - angle) / RELAXES_S
        rows.append((-angle, command))
    errors, spools = np.array(rows).T
    openings = int((np.diff(np.r_[0.0, np.abs(spools) > 0.0]) > 0.0).sum())
    return Way(errors, spools, openings, state)


@pytest.mark.parametrize(
    ("error", "edge", "oil"),
    [(2e-3, 0.08, 1.0), (2e-3, 0.07, 1.4), (2e-3, 0.09, 0.7), (-7e-4, 0.07, 0.7), (-7e-4, 0.09, 1.4)],
)
def test_a_joint_comes_to_rest_in_a_few_inches(error: float, edge: float, oil: float) -> None:
    """Also where the oil, or the valve's edge, is not what is known of it."""
    way = _way(METERED, Held(error, edge, oil=oil * OIL_RAD_BAR))
    last = round(10.0 / DT_S)
    assert np.abs(way.errors[-last:]).max() < 2.0 * BAND_RAD
    assert not way.spools[-last:].any()
    assert way.openings <= 8
    assert (way.errors * np.sign(error)).min() > -0.5 * abs(error) - 2.0 * BAND_RAD


def test_the_encoder_alone_lets_too_much_oil_through() -> None:
    """Why inches are metered: friction hides what has passed, until it is far too much."""
    joint = Held(2e-3)
    metered, blind = (_way(law, joint) for law in (METERED, METERED._replace(oil=0.0 * ONES)))
    assert metered.errors.min() > -3.0 * BAND_RAD
    assert blind.errors.min() < -1e-3
    assert 2 * metered.openings < blind.openings


def test_what_compressed_oil_will_move_is_waited_for() -> None:
    """A joint that is on its way by itself is hardly helped."""
    way = _way(METERED, Held(8e-4, squeezed=8e-4), 20.0)
    assert way.openings <= 3
    assert way.errors.min() > -2.0 * BAND_RAD


def test_a_joint_that_sticks_gets_more_oil_each_time() -> None:
    stuck = _way(METERED, Held(6e-4, sticks=3e-3), 60.0)
    assert abs(stuck.errors[-1]) < 3.0 * BAND_RAD
    assert stuck.openings <= 8
    state = parking_begun(METERED)
    gives = []
    for moved in (0.0, 0.0, 0.9, 0.0):
        metered_begun(state, 0, 1e-3)
        gives.append(float(state[GIVES, 0]))
        state[FROM, 0], state[ERROR, 0] = 1e-3, 1e-3 * (1.0 - moved)
    assert gives == [1.0, 2.0, 4.0, 2.0]
    metered_begun(state, 0, -1e-3)  # it went too far: what stuck does no more
    assert state[GIVES, 0] == 1.0
    assert state[SENSE, 0] == -1.0


def test_where_the_edge_is_is_learned_from_what_has_passed() -> None:
    def after(passed: float) -> np.ndarray:
        state = parking_begun(METERED)
        state[SENSE], state[WAY], state[OPENING], state[OPENED] = 1.0, 1e-3, 0.5, 0.09
        state[OIL_FROM], state[OIL_AT] = 2e-3, 2e-3 - passed
        learned(METERED, state, 0, GAINS)
        return np.asarray(state[:, 0])

    assert after(1e-3)[EDGE] > 0.081
    assert after(1e-3)[EDGE + 1] == 0.08  # the other side's
    assert after(2e-3)[EDGE] == pytest.approx(0.08 - 0.1 * 0.08)  # a tenth at least
    assert after(6e-3)[EDGE] == pytest.approx(0.08 - 5e-3 / (GAIN * 0.5))
    assert after(1.0)[EDGE] == pytest.approx(0.5 * 0.08)
    assert after(1e-3)[DOUBT] == pytest.approx(0.5 * 0.1 * 0.08)
    assert after(1e-3)[OPENING] == 0.0


def test_a_motion_forgets_the_last_inch() -> None:
    """What it was for says nothing of the next one's friction; an inch that it cut short taught nothing."""
    state = parking_begun(METERED)
    state[WAY], state[GIVES], state[OPENING], state[EDGE] = 1e-3, 8.0, 0.4, 0.07
    after = parking_ended(state)
    assert not after[[WAY, OPENING]].any()
    assert (after[GIVES] == 1.0).all()
    assert (after[EDGE] == 0.07).all()


def test_a_valve_without_hysteresis_is_not_metered_nor_parked_by_itself() -> None:
    usual = load(ControllerConfig, CONFIGS / "controller.yaml")
    assert usual.parking.enabled == "auto"
    assert parking_law(usual) is None
    poor = usual.valves.lift.model_copy(update={"hysteresis": MeasuredNumber(value=0.04, std=0.004)})
    valves = usual.valves.model_copy(update={"lift": poor})
    mixed = usual.model_copy(update={"valves": valves})
    law = parking_law(mixed)
    assert law is not None
    assert law.oil[1] == pytest.approx(1e-3 * usual.parking.oil_mrad_bar[1])
    assert not law.oil[[0, 2, 3, 4, 5]].any()

    def asked(config: ControllerConfig, enabled: bool) -> ParkingLaw | None:
        parking = config.parking.model_copy(update={"enabled": enabled})
        return parking_law(config.model_copy(update={"parking": parking}))

    assert asked(mixed, False) is None
    assert asked(usual, True) is not None
