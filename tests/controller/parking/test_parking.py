"""Parking on one joint behind a poor valve: jogs, rest, and what holds a joint that creeps."""

import numpy as np
import pytest

from controller.config import ControllerConfig
from controller.core.parking.joint import JOG, ParkingLaw
from controller.core.servo_settings import parking_law
from foundation.configuration import load
from nominal_arm.commissioned import MeasuredNumber
from tests.controller.parking.poor_joint import BAND_RAD, DT_S, OIL_RAD_BAR, ONES, Joint, poor_law, resting
from tests.support.paths import CONFIGS

LAW = poor_law()
SLEW = LAW._replace(loaded=0.0 * ONES)
LAST = round(10.0 / DT_S)


@pytest.mark.parametrize(
    ("error", "edge", "oil"),
    [(2e-3, 0.08, 1.0), (2e-3, 0.07, 1.4), (2e-3, 0.09, 0.7), (-7e-4, 0.07, 0.7), (-7e-4, 0.09, 1.4)],
)
def test_a_joint_comes_to_rest_in_a_few_jogs(error: float, edge: float, oil: float) -> None:
    """Also where the oil, or the valve's edge, is not what is known of it."""
    rest = resting(SLEW, Joint(error, edge, oil=oil * OIL_RAD_BAR), 40.0)
    assert np.abs(rest.errors[-LAST:]).max() < LAW.tolerance
    assert not rest.spools[-LAST:].any()
    assert rest.rests[-LAST:].all()
    assert rest.openings <= 8
    assert (rest.errors * np.sign(error)).min() > -0.5 * abs(error) - 2.0 * BAND_RAD


def test_the_encoder_alone_lets_too_much_oil_through() -> None:
    """Why jogs are metered by the oil: friction hides what has passed, until it is far too much."""
    metered, blind = (resting(law, Joint(2e-3), 40.0) for law in (SLEW, SLEW._replace(oil_spring=0.0 * ONES)))
    assert metered.errors.min() > -3.0 * BAND_RAD
    assert blind.errors.min() < metered.errors.min() - 3.0 * BAND_RAD


def test_what_compressed_oil_will_move_is_waited_for() -> None:
    rest = resting(SLEW, Joint(8e-4, squeezed=8e-4), 20.0)
    assert rest.openings <= 3
    assert rest.errors.min() > -2.0 * BAND_RAD


def test_a_joint_that_sticks_is_freed_by_the_oil_that_adds_up() -> None:
    stuck = resting(SLEW, Joint(6e-4, sticks=3e-3), 60.0)
    assert abs(stuck.errors[-1]) < 3.0 * BAND_RAD
    assert stuck.openings <= 10


def test_a_loaded_joint_is_brought_nearer_until_it_may_stay() -> None:
    """Outside its band it does not rest, until it was jogged for so long that the tolerance is enough."""
    near = resting(LAW, Joint(2e-4), 1.0)
    assert not near.rests.any()
    assert resting(LAW, Joint(2e-4), 8.0).openings > 0
    late = resting(LAW._replace(stays=0.0), Joint(2e-4), 8.0)
    assert late.rests[-1]
    assert late.openings == 0


@pytest.mark.parametrize(("creep", "half_play"), [(-5e-6, 0.0), (-1e-6, 6e-5), (2e-6, 6e-5)])
def test_a_settled_joint_that_creeps_is_held_within_the_play_of_its_encoder(
    creep: float, half_play: float
) -> None:
    """Ten minutes of a load that sinks: never to the other side, nor far beyond play and bands."""
    rest = resting(LAW, Joint(0.0, 0.081, creep, half_play), 600.0, settled=True)
    assert np.ptp(rest.errors) < 5.0 * BAND_RAD < abs(600.0 * creep)
    opened = rest.spools[rest.spools != 0.0]
    assert opened.size > 0
    assert (np.sign(opened) == -np.sign(creep)).all()
    assert opened.size < 0.15 * rest.spools.size


def test_a_settled_joint_stays_where_it_is() -> None:
    """Off its reference, and one without a load also when it creeps: a jog costs the play of its encoder."""
    assert not resting(LAW, Joint(2.5e-4), 60.0, settled=True).spools.any()
    assert not resting(SLEW, Joint(0.0, creep=2e-6), 60.0, settled=True).spools.any()


def test_a_valve_that_passes_nothing_is_not_opened_beyond_where_it_surely_would() -> None:
    far = resting(LAW, Joint(2e-3, 0.5), 30.0)
    assert far.record["phase"][0] == JOG
    assert far.spools[-1] == pytest.approx(0.16, abs=1e-4)


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

    def parks(config: ControllerConfig, enabled: bool) -> ParkingLaw | None:
        parking = config.parking.model_copy(update={"enabled": enabled})
        return parking_law(config.model_copy(update={"parking": parking}))

    assert parks(mixed, False) is None
    assert parks(usual, True) is not None
