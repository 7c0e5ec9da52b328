"""A joint that came too far stays within its play, and oil that presses it on is let out in time."""

import math
from collections import deque
from typing import NamedTuple

import numpy as np
import pytest

from controller.commissioning import basis_of, commissioned_config
from controller.config import ControllerConfig
from controller.core.parking.joint import SHUT, ParkingLaw, joints_at_start, joints_in_motion
from controller.core.parking.metering import decompression_spool, oil_to_release
from controller.core.parking.parking import phase_spool
from controller.core.parking.rest import (
    all_within,
    arm_rested,
    follow_backlash_sides,
    judge_rest,
    may_stop_here,
    watch_creep,
)
from controller.core.scan_types import ScanState, initial_state
from controller.core.servo_settings import parking_law
from controller.core.settings import settings_from
from controller.core.standing import rests_settled
from nominal_arm.commissioned import Commissioned, JointPlay, MeasuredNumber
from nominal_arm.description import NominalArm

DT_S, GAIN, DIGIT, BAND_RAD, OIL_RAD_BAR = 0.005, 0.4, 4.8e-5, 1e-4, 3.5e-4
LEAVES_RAD, PLAY_RAD, ONES, GAINS = 2.7e-4, 1.2e-3, np.ones(6), np.full(2, GAIN)
DELAY_S, LAG_S, RELAXES_S = 0.012, 0.057, 6.0
LATE_S = DELAY_S + LAG_S + 1.5 * DT_S
LAW = ParkingLaw(
    band=4e-4, band_least=7e-5, band_most=2e-4, slowest=4e-4, fastest=1e-2, patience=6.0,
    calm_travel=2e-4, calm=3.0, settled=LEAVES_RAD, give_up=30.0, quiet=1e-4,
    deadband=np.full((6, 2), 0.08), spread=np.full((6, 2), 0.004),
    latest=(LATE_S + 0.3) * ONES, shutting=(LATE_S + 0.13) * ONES,
    loaded=np.array([0.0, 1.0, 1.0, 1.0, 1.0, 1.0]),
    oil_spring=OIL_RAD_BAR * ONES, backlash=PLAY_RAD * ONES,
    surely_open=np.full((6, 2), 0.16), dt_s=DT_S,
)  # fmt: skip
UNKNOWN = LAW._replace(backlash=0.0 * ONES)


def _machine(arm: NominalArm, usual: ControllerConfig, half_mrad: dict[str, float]) -> ControllerConfig:
    """``usual`` with poor valves commissioned, and half of these joints' plays with them."""
    poor = MeasuredNumber(value=0.04, std=0.004)
    names = usual.valves.model_dump(include={"slew", "lift", "tilt", "wrist1", "wrist2", "wrist3"})
    valves = {name: getattr(usual.valves, name).model_copy(update={"hysteresis": poor}) for name in names}
    found = Commissioned(
        made_utc="2026-11-22T10:00:00Z",
        made_by="a test",
        basis=basis_of(arm, usual),
        valves=usual.valves.model_copy(update=valves),
        play_mrad=JointPlay(**{n: MeasuredNumber(value=h, std=0.1 * h) for n, h in half_mrad.items()}),
    )
    return usual.model_copy(update={"commissioned": found})


def _followed(way: np.ndarray) -> float:
    """The sense of the first joint after its encoder went ``way`` (rad), with an encoder's noise."""
    rng, state = np.random.default_rng(3), joints_at_start(LAW)
    for angle in way:
        seen = DIGIT * np.round((0.7 + angle) / DIGIT + 0.3 * rng.standard_normal(6))
        follow_backlash_sides(state, seen, DT_S)
    return float(state["side"]["sense"][0])


def test_the_flank_is_that_of_the_last_turn_and_noise_is_none() -> None:
    still, there = np.zeros(20000), np.linspace(0.0, 2e-3, 400)
    assert _followed(still) == 0.0
    assert _followed(there) == 1.0
    assert _followed(-there) == -1.0
    assert _followed(np.r_[there, there[-1] + still]) == 1.0
    assert _followed(np.r_[there, there[-1] - 0.5 * DIGIT + still]) == 1.0
    assert _followed(np.r_[there, there[-1] - 4.0 * DIGIT + still[:400]]) == -1.0
    turned = joints_at_start(LAW)
    turned["side"]["sense"], turned["oil"]["relaxed"] = 1.0, 1.0
    ended = joints_in_motion(turned)
    assert ended["side"]["sense"][0] == 1.0  # a motion that begins does not turn a joint
    assert ended["oil"]["relaxed"][0] == 1.0


def test_an_arm_whose_slew_came_too_far_rests_and_is_settled_until_it_goes_on(
    arm: NominalArm, config: ControllerConfig
) -> None:
    settings = settings_from(arm, _machine(arm, config, {"slew": 0.5}))
    assert settings.parking is not None
    state = joints_at_start(settings.parking)
    state["phase"], state["band"], state["side"]["sense"], state["error"][0] = SHUT, BAND_RAD, 1.0, -9e-4
    short = state.copy()
    short["side"]["sense"] = -1.0
    for _ in range(round(1.1 * settings.parking.calm / DT_S)):
        for one in (state, short):
            judge_rest(settings.parking, one[0], 0, 4.0)
    assert state["rest"][0] > 0.0
    assert state["place"][0] == -9e-4
    assert short["rest"][0] == 0.0
    assert may_stop_here(settings.parking, state)
    assert not may_stop_here(settings.parking, short)

    def settled(parking: np.ndarray, off: float, rests: bool = True) -> bool:
        begun: ScanState = initial_state(settings)
        standing = begun.standing._replace(rests=rests)
        left = np.array([off, 0.0, 2.9e-4, 0.0, 0.0, 0.0])
        return rests_settled(settings, begun._replace(parking=parking, standing=standing), left)

    here = arm_rested(state)
    assert settled(here, -9e-4)
    assert not settled(here, -9e-4, rests=False)
    assert settled(here, -1.2e-3)
    assert not settled(here, -1.4e-3)
    assert not settled(here, 3.1e-4)
    assert not settled(short, -9e-4)
    assert all_within(settings.parking, here, here["error"], LEAVES_RAD)


def test_oil_is_let_out_of_a_raised_joint_where_its_load_is_known() -> None:
    """Gravity loads it with 57 bar, friction with 3 more while it is raised: it would creep on by those."""
    state = joints_at_start(LAW)
    state["phase"], state["rest"][1], state["side"]["sense"][1], state["side"]["angle"][1] = (
        SHUT,
        1.0,
        1.0,
        0.6,
    )
    state["oil"]["relaxed"][1], state["oil"]["relaxed_at"][1] = (
        40.0 * OIL_RAD_BAR,
        0.5,
    )  # from elsewhere: it is not averaged with that
    assert decompression_spool(LAW, state[1], 1, 57.0) == 0.0
    assert (state["oil"]["relaxed"][1], state["oil"]["relaxed_at"][1]) == (
        pytest.approx(57.0 * OIL_RAD_BAR),
        0.6,
    )
    state["rest"][1], state["error"][1] = 0.0, 1e-4

    def out(bar: float, came: float = 1.0, at: float = 0.603) -> float:
        state["oil"]["error"][1], state["side"]["sense"][1], state["side"]["angle"][1] = (
            1e-4 - bar * OIL_RAD_BAR,
            came,
            at,
        )
        return oil_to_release(LAW, state[1], 1)

    assert out(60.0) == pytest.approx(-(3.0 * OIL_RAD_BAR - 0.5 * LEAVES_RAD))
    assert out(57.5) == 0.0
    assert out(70.0) == pytest.approx(-3.5 * LEAVES_RAD)  # what was learned is not wholly trusted
    assert out(60.0, came=-1.0) == 0.0  # lowered
    assert out(54.0) == 0.0  # it sinks, and is raised
    assert out(60.0, at=0.606) == 0.0  # gravity may be otherwise there
    state["oil"]["relaxed"][1] = 0.0
    assert out(60.0) == 0.0  # nothing was learned


class Arrived(NamedTuple):
    """True angles (rad) from where it arrived, in the sense in which it came; how often its valve opened."""

    angles: np.ndarray
    openings: int


def _has_arrived(law: ParkingLaw, came: float, squeezed: float, seconds: float = 40.0) -> Arrived:
    """A slew that arrives at its place on one flank of its play, ``squeezed`` (rad) of oil pressing on.

    Friction lets go of that within ``RELAXES_S``; the encoder is dragged along.
    """
    rng, state = np.random.default_rng(5), joints_at_start(law)
    state["phase"][0], state["band"][0], state["side"]["sense"][0] = SHUT, BAND_RAD, came
    commands = deque([0.0] * round(DELAY_S / DT_S), maxlen=round(DELAY_S / DT_S))
    half = 0.5 * PLAY_RAD
    angle, spool, seen, rows = came * half, 0.0, 0.0, []
    shaft, oil = 0.0, angle + came * squeezed
    for scan in range(round(seconds / DT_S)):
        shaft = min(max(shaft, angle - half), angle + half)
        before, seen = seen, DIGIT * round((shaft + rng.normal(0.0, 0.3 * DIGIT)) / DIGIT)
        keep = math.exp(-DT_S / 0.03)
        state["speed"][0] = keep * state["speed"][0] + (1.0 - keep) * (seen - before) / DT_S
        state["since"][0] += DT_S
        state["pulse"]["since"][0] += DT_S
        load = (oil - angle) / OIL_RAD_BAR + 0.2 * math.sin(2.0 * math.pi * 20.0 * DT_S * scan)
        follow_backlash_sides(state, np.full(6, 1.0 + seen), DT_S)
        if scan == 0:
            state["watch"]["error"][0], state["oil"]["error"][0], state["side"]["sense"][0] = (
                -seen,
                -seen - OIL_RAD_BAR * load,
                came,
            )
        watch_creep(law, state[0], 0, 4.0, -seen, load)
        command = phase_spool(law, state, 0, -seen, load, GAINS)
        judge_rest(law, state[0], 0, 4.0)
        late = commands[0]
        commands.append(command)
        spool += (late - spool) * (1.0 - math.exp(-DT_S / LAG_S))
        oil += DT_S * GAIN * math.copysign(max(abs(spool) - 0.08, 0.0), spool)
        angle += DT_S * (oil - angle) / RELAXES_S
        rows.append((came * angle - half, command))
    angles, spools = np.array(rows).T
    return Arrived(angles, int((np.diff(np.r_[0.0, np.abs(spools) > 0.0]) > 0.0).sum()))


@pytest.mark.parametrize("came", [-1.0, 1.0])
@pytest.mark.parametrize("squeezed", [8e-4, 2e-3])
def test_a_slew_that_arrives_with_compressed_oil_stays_on_its_flank(came: float, squeezed: float) -> None:
    """Without what is known of its play it goes too far, and comes back through all of it, unseen."""
    known, unknown = (_has_arrived(law, came, squeezed) for law in (LAW, UNKNOWN))
    assert np.abs(known.angles).max() < 0.5 * PLAY_RAD
    assert known.openings <= 2
    assert np.ptp(unknown.angles) > 0.8 * PLAY_RAD


def test_the_play_comes_from_commissioning_and_only_behind_poor_valves(
    arm: NominalArm, config: ControllerConfig
) -> None:
    found = commissioned_config(arm, _machine(arm, config, {"slew": 0.5, "tilt": 0.2}))
    law = parking_law(found)
    assert law is not None
    assert law.backlash.tolist() == pytest.approx([1e-3, 0.0, 4e-4, 0.0, 0.0, 0.0])
    unseen = parking_law(found.model_copy(update={"commissioned": None}))
    assert unseen is not None
    assert not unseen.backlash.any()
    parking = config.parking.model_copy(update={"enabled": True})
    exact = parking_law(found.model_copy(update={"valves": config.valves, "parking": parking}))
    assert exact is not None
    assert not exact.backlash.any()
