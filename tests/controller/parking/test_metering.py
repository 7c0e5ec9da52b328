"""Metered inches on one joint whose friction holds it against compressed oil, and lets go of it slowly."""

import math
from collections import deque
from typing import NamedTuple

import numpy as np
import pytest

from controller.config import ControllerConfig
from controller.core.parking.joint import SHUT, ParkingLaw, joints_at_start
from controller.core.parking.parking import phase_spool
from controller.core.parking.rest import watch_creep
from controller.core.servo_settings import parking_law
from foundation.configuration import load
from nominal_arm.commissioned import MeasuredNumber
from tests.controller.parking.poor_joint import (
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
    oil_spring=OIL_RAD_BAR * ONES,
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
    rng, state = np.random.default_rng(5), joints_at_start(law)
    state["phase"][0], state["band"][0], state["error"][0], state["watch"]["error"][0] = (
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
        state["speed"][0] = keep * state["speed"][0] + (1.0 - keep) * (seen - before) / DT_S
        state["since"][0] += DT_S
        state["pulse"]["since"][0] += DT_S
        load = (oil - angle) / joint.oil + 0.2 * math.sin(2.0 * math.pi * 20.0 * DT_S * scan)
        watch_creep(law, state[0], 0, 4.0, -seen, load)
        command = phase_spool(law, state, 0, -seen, load, GAINS)
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
    assert np.abs(way.errors[-last:]).max() < METERED.settled
    assert not way.spools[-last:].any()
    assert way.openings <= 8
    assert (way.errors * np.sign(error)).min() > -0.5 * abs(error) - 2.0 * BAND_RAD


def test_the_encoder_alone_lets_too_much_oil_through() -> None:
    """Why inches are metered: friction hides what has passed, until it is far too much."""
    joint = Held(2e-3)
    metered, blind = (_way(law, joint) for law in (METERED, METERED._replace(oil_spring=0.0 * ONES)))
    assert metered.errors.min() > -3.0 * BAND_RAD
    assert blind.errors.min() < -1e-3
    assert 2 * metered.openings < blind.openings


def test_what_compressed_oil_will_move_is_waited_for() -> None:
    """A joint that is on its way by itself is hardly helped."""
    way = _way(METERED, Held(8e-4, squeezed=8e-4), 20.0)
    assert way.openings <= 3
    assert way.errors.min() > -2.0 * BAND_RAD


def test_a_joint_that_sticks_is_freed_by_the_oil_that_adds_up() -> None:
    stuck = _way(METERED, Held(6e-4, sticks=3e-3), 60.0)
    assert abs(stuck.errors[-1]) < 3.0 * BAND_RAD
    assert stuck.openings <= 10


def test_a_valve_without_hysteresis_is_not_metered_nor_parked_by_itself() -> None:
    usual = load(ControllerConfig, CONFIGS / "controller.yaml")
    assert usual.parking.enabled == "auto"
    assert parking_law(usual) is None
    poor = usual.valves.lift.model_copy(update={"hysteresis": MeasuredNumber(value=0.04, std=0.004)})
    valves = usual.valves.model_copy(update={"lift": poor})
    mixed = usual.model_copy(update={"valves": valves})
    law = parking_law(mixed)
    assert law is not None
    assert law.oil_spring[1] == pytest.approx(1e-3 * usual.parking.oil_mrad_bar[1])
    assert not law.oil_spring[[0, 2, 3, 4, 5]].any()

    def asked(config: ControllerConfig, enabled: bool) -> ParkingLaw | None:
        parking = config.parking.model_copy(update={"enabled": enabled})
        return parking_law(config.model_copy(update={"parking": parking}))

    assert asked(mixed, False) is None
    assert asked(usual, True) is not None
