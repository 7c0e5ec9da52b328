"""A joint that came too far stays within its play, and oil that presses it on is let out in time."""

import math
from collections import deque
from typing import NamedTuple

import numpy as np
import pytest

from controller.commissioning import basis_of, commissioned_config
from controller.config import ControllerConfig
from controller.core.scan_types import ScanState, initial_state
from controller.core.servo.coming_to_rest import calm_counted, listened, may_stay, rested_here
from controller.core.servo.flanks import flanks_followed, left_at, stays_within
from controller.core.servo.metering import eased, let_out
from controller.core.servo.parking import _arrived as _done
from controller.core.servo.parking import _due, _moved
from controller.core.servo.parking_state import (
    AFTER,
    BAND,
    CAME,
    CREPT,
    EASE,
    EASE_AT,
    ERROR,
    OIL,
    OPEN,
    PARKED,
    PHASE,
    PLACE,
    SHUT,
    SINCE,
    SPEED,
    WENT,
    ParkingLaw,
    parking_begun,
    parking_ended,
)
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
    calm_way=2e-4, calm=3.0, leaves=LEAVES_RAD, stays=30.0, quiet=1e-4,
    deadband=np.full((6, 2), 0.08), spread=np.full((6, 2), 0.004),
    latest=(LATE_S + 0.3) * ONES, shutting=(LATE_S + 0.13) * ONES,
    loaded=np.array([0.0, 1.0, 1.0, 1.0, 1.0, 1.0]), rest=3.0 * ONES, keeping=1.5 * ONES, exact=0.0 * ONES,
    felt=0.0 * ONES, oil=OIL_RAD_BAR * ONES, play=PLAY_RAD * ONES, highest=np.full((6, 2), 0.16), dt_s=DT_S,
)  # fmt: skip
UNKNOWN = LAW._replace(play=0.0 * ONES)


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
    rng, state = np.random.default_rng(3), parking_begun(LAW)
    for angle in way:
        seen = DIGIT * np.round((0.7 + angle) / DIGIT + 0.3 * rng.standard_normal(6))
        flanks_followed(state, seen, DT_S)
    return float(state[CAME, 0])


def test_the_flank_is_that_of_the_last_turn_and_noise_is_none() -> None:
    still, there = np.zeros(20000), np.linspace(0.0, 2e-3, 400)
    assert _followed(still) == 0.0
    assert _followed(there) == 1.0
    assert _followed(-there) == -1.0
    assert _followed(np.r_[there, there[-1] + still]) == 1.0
    assert _followed(np.r_[there, there[-1] - 0.5 * DIGIT + still]) == 1.0
    assert _followed(np.r_[there, there[-1] - 4.0 * DIGIT + still[:400]]) == -1.0
    ended = parking_ended(parking_begun(LAW) + 1.0)
    assert ended[CAME, 0] == 1.0  # a motion that begins does not turn a joint
    assert ended[EASE, 0] == 1.0


@pytest.mark.parametrize("joint", [0, 2])
def test_a_joint_is_brought_back_only_from_beyond_its_play(joint: int) -> None:
    least = LEAVES_RAD if joint == 0 else BAND_RAD
    state = parking_begun(LAW)
    state[PHASE], state[BAND] = SHUT, BAND_RAD
    for came in (-1.0, 1.0):
        state[CAME] = came
        most = LEAVES_RAD + PLAY_RAD
        if joint != 0:  # a loaded joint sinks; raising it always ends on the same flank
            most = LEAVES_RAD if came > 0.0 else least
        for share, due in ((0.9, False), (1.1, True)):
            assert _due(LAW, state, joint, -came * share * most, 0.0, 2.0) is due, (came, share)
        for share, due in ((0.9, False), (1.1, True)):  # short of its place there is no play to go through
            assert _due(LAW, state, joint, came * share * least, 0.0, 2.0) is due, (came, share)
        assert _due(UNKNOWN, state, joint, -came * 1.1 * least, 0.0, 2.0)
    narrow = LAW._replace(play=1e-4 * ONES)
    assert left_at(narrow, state, joint, -3e-4, 1e-4) == pytest.approx(2e-4)
    assert left_at(LAW, state, joint, 3e-4, 1e-4) == 1e-4


@pytest.mark.parametrize("came", [-1.0, 1.0])
def test_the_joint_law_takes_no_joint_back_through_its_play(came: float) -> None:
    def shut(law: ParkingLaw, error: float, joint: int = 0) -> bool:
        state = parking_begun(law)
        state[BAND], state[CAME] = BAND_RAD, came
        return _done(law, state, joint, came * error, 0.0) and state[PHASE, joint] == SHUT

    most = LEAVES_RAD + PLAY_RAD
    assert shut(LAW, -0.1 * LEAVES_RAD)  # as soon as it has passed its end
    assert shut(LAW, -0.9 * most)
    assert not shut(LAW, -1.1 * most)  # farther off than its play is wide
    assert not shut(LAW, 0.9 * most)  # short of its end
    assert not shut(LAW, -0.9 * most, joint=2)  # a loaded joint sinks by itself
    assert not shut(UNKNOWN, -0.5 * LEAVES_RAD)


def test_an_arm_whose_slew_came_too_far_rests_and_is_settled_until_it_goes_on(
    arm: NominalArm, config: ControllerConfig
) -> None:
    settings = settings_from(arm, _machine(arm, config, {"slew": 0.5}))
    assert settings.parking is not None
    state = parking_begun(settings.parking)
    state[PHASE], state[BAND], state[CAME], state[ERROR, 0] = SHUT, BAND_RAD, 1.0, -9e-4
    short = state.copy()
    short[CAME] = -1.0
    for _ in range(round(1.1 * settings.parking.calm / DT_S)):
        for one in (state, short):
            calm_counted(settings.parking, one, 0, 4.0)
    assert state[PARKED, 0] > 0.0
    assert state[PLACE, 0] == -9e-4
    assert short[PARKED, 0] == 0.0
    assert may_stay(settings.parking, state)
    assert not may_stay(settings.parking, short)

    def settled(parking: np.ndarray, off: float, rests: bool = True) -> bool:
        begun: ScanState = initial_state(settings)
        standing = begun.standing._replace(rests=rests)
        left = np.array([off, 0.0, 2.9e-4, 0.0, 0.0, 0.0])
        return rests_settled(settings, begun._replace(parking=parking, standing=standing), left)

    here = rested_here(state)
    assert settled(here, -9e-4)
    assert not settled(here, -9e-4, rests=False)
    assert settled(here, -1.2e-3)
    assert not settled(here, -1.4e-3)
    assert not settled(here, 3.1e-4)
    assert not settled(short, -9e-4)
    assert stays_within(settings.parking, here, here[ERROR], LEAVES_RAD)


@pytest.mark.parametrize("came", [-1.0, 1.0])
def test_oil_that_presses_on_is_let_out_of_a_joint_at_its_place(came: float) -> None:
    def out(presses: float, error: float = 0.0, ease: float = 0.0) -> float:
        state = parking_begun(LAW)
        state[ERROR], state[OIL], state[EASE] = came * error, came * (error - presses), came * ease
        return came * let_out(LAW, state, 0)

    assert out(2e-3) == pytest.approx(-(2e-3 - 0.5 * LEAVES_RAD))
    assert out(0.9 * LEAVES_RAD) == 0.0  # it goes on by no more than it may be off
    assert out(2e-3, error=0.8 * LEAVES_RAD) == pytest.approx(-(2e-3 - 0.8 * LEAVES_RAD))  # keeps that
    assert out(2e-3, error=1.1 * LEAVES_RAD) == 0.0  # not there yet
    assert out(2e-3, error=-5e-4) == pytest.approx(-(2e-3 - 0.5 * LEAVES_RAD))
    assert out(2e-3, ease=6e-4) == pytest.approx(-(1.4e-3 - 0.5 * LEAVES_RAD))  # a load that stays
    assert out(-3e-4, ease=-9e-4) == pytest.approx(-(6e-4 - 0.5 * LEAVES_RAD))
    most = 1.4e-3 + 2.0 * LEAVES_RAD  # friction holds no more
    assert out(1e-3, ease=-4e-3) == pytest.approx(-(most - 0.5 * LEAVES_RAD))


def test_what_a_joint_is_loaded_with_is_learned_while_it_rests() -> None:
    state = parking_begun(LAW)
    state[PHASE], state[PARKED, 0], state[OIL, 1] = SHUT, 1.0, 0.0
    for _ in range(round(20.0 / DT_S)):
        assert eased(LAW, state, 0, 2.0) == 0.0
    assert state[EASE, 0] == pytest.approx(2.0 * OIL_RAD_BAR, rel=0.03)
    assert not state[EASE, 1:].any()
    state[PARKED, 0], state[OIL, 0] = 0.0, -3e-3
    assert eased(LAW, state, 0, 2.0) < 0.0
    assert state[PHASE].tolist() == [OPEN, *[SHUT] * 5]


def test_oil_is_let_out_of_a_raised_joint_where_its_load_is_known() -> None:
    """Gravity loads it with 57 bar, friction with 3 more while it is raised: it would creep on by those."""
    state = parking_begun(LAW)
    state[PHASE], state[PARKED, 1], state[CAME, 1], state[WENT, 1] = SHUT, 1.0, 1.0, 0.6
    state[EASE, 1], state[EASE_AT, 1] = (
        40.0 * OIL_RAD_BAR,
        0.5,
    )  # from elsewhere: it is not averaged with that
    assert eased(LAW, state, 1, 57.0) == 0.0
    assert (state[EASE, 1], state[EASE_AT, 1]) == (pytest.approx(57.0 * OIL_RAD_BAR), 0.6)
    state[PARKED, 1], state[ERROR, 1] = 0.0, 1e-4

    def out(bar: float, came: float = 1.0, at: float = 0.603) -> float:
        state[OIL, 1], state[CAME, 1], state[WENT, 1] = 1e-4 - bar * OIL_RAD_BAR, came, at
        return let_out(LAW, state, 1)

    assert out(60.0) == pytest.approx(-(3.0 * OIL_RAD_BAR - 0.5 * LEAVES_RAD))
    assert out(57.5) == 0.0
    assert out(70.0) == pytest.approx(-3.5 * LEAVES_RAD)  # what was learned is not wholly trusted
    assert out(60.0, came=-1.0) == 0.0  # lowered
    assert out(54.0) == 0.0  # it sinks, and is raised
    assert out(60.0, at=0.606) == 0.0  # gravity may be otherwise there
    state[EASE, 1] = 0.0
    assert out(60.0) == 0.0  # nothing was learned


def test_a_raised_joint_that_has_arrived_opens_its_valve_to_let_oil_out() -> None:
    """Before it is off its place at all; one whose play nobody has found waits until it is."""

    def spool(law: ParkingLaw) -> float:
        state = parking_begun(law)
        state[PHASE], state[SINCE], state[BAND] = SHUT, 1.0, BAND_RAD
        state[CAME, 1], state[WENT, 1], state[EASE, 1], state[EASE_AT, 1] = 1.0, 0.6, 57.0 * OIL_RAD_BAR, 0.6
        state[OIL, 1] = -60.0 * OIL_RAD_BAR
        return float(_moved(law, state, 1, 0.0, 60.0, GAINS))

    assert spool(LAW) < 0.0
    assert spool(UNKNOWN) == 0.0


class Arrived(NamedTuple):
    """True angles (rad) from where it arrived, in the sense in which it came; how often its valve opened."""

    angles: np.ndarray
    openings: int


def _arrived(law: ParkingLaw, came: float, squeezed: float, seconds: float = 40.0) -> Arrived:
    """A slew that arrives at its place on one flank of its play, ``squeezed`` (rad) of oil pressing on.

    Friction lets go of that within ``RELAXES_S``; the encoder is dragged along.
    """
    rng, state = np.random.default_rng(5), parking_begun(law)
    state[PHASE, 0], state[BAND, 0], state[CAME, 0] = SHUT, BAND_RAD, came
    commands = deque([0.0] * round(DELAY_S / DT_S), maxlen=round(DELAY_S / DT_S))
    half = 0.5 * PLAY_RAD
    angle, spool, seen, rows = came * half, 0.0, 0.0, []
    shaft, oil = 0.0, angle + came * squeezed
    for scan in range(round(seconds / DT_S)):
        shaft = min(max(shaft, angle - half), angle + half)
        before, seen = seen, DIGIT * round((shaft + rng.normal(0.0, 0.3 * DIGIT)) / DIGIT)
        keep = math.exp(-DT_S / 0.03)
        state[SPEED, 0] = keep * state[SPEED, 0] + (1.0 - keep) * (seen - before) / DT_S
        state[[SINCE, AFTER], 0] += DT_S
        load = (oil - angle) / OIL_RAD_BAR + 0.2 * math.sin(2.0 * math.pi * 20.0 * DT_S * scan)
        flanks_followed(state, np.full(6, 1.0 + seen), DT_S)
        if scan == 0:
            state[CREPT, 0], state[OIL, 0], state[CAME, 0] = -seen, -seen - OIL_RAD_BAR * load, came
        listened(law, state, 0, 4.0, -seen, load)
        command = _moved(law, state, 0, -seen, load, GAINS)
        calm_counted(law, state, 0, 4.0)
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
    known, unknown = (_arrived(law, came, squeezed) for law in (LAW, UNKNOWN))
    assert np.abs(known.angles).max() < 0.5 * PLAY_RAD
    assert known.openings <= 2
    assert np.ptp(unknown.angles) > 0.8 * PLAY_RAD


def test_the_play_comes_from_commissioning_and_only_behind_poor_valves(
    arm: NominalArm, config: ControllerConfig
) -> None:
    found = commissioned_config(arm, _machine(arm, config, {"slew": 0.5, "tilt": 0.2}))
    law = parking_law(found)
    assert law is not None
    assert law.play.tolist() == pytest.approx([1e-3, 0.0, 4e-4, 0.0, 0.0, 0.0])
    unseen = parking_law(found.model_copy(update={"commissioned": None}))
    assert unseen is not None
    assert not unseen.play.any()
    parking = config.parking.model_copy(update={"enabled": True})
    exact = parking_law(found.model_copy(update={"valves": config.valves, "parking": parking}))
    assert exact is not None
    assert not exact.play.any()
