"""A slew that is brought back at its end: the tool then stands to the other side of its encoder."""

from collections.abc import Iterator
from itertools import cycle, repeat
from typing import Any

import numpy as np
import pytest

from tests.vision_pc.program_settings import BOOM, shipped
from tests.vision_pc.synthetic import SyntheticRig, draw, silent
from vision_pc.config.programs import LocalErrorModelSettings
from vision_pc.core.calibration.arm_fields import boom_levers
from vision_pc.core.calibration.local_error_model import LocalTrack, fit_error_model, record_local_track
from vision_pc.core.calibration.orientation import adjust_orientation
from vision_pc.core.ports import ArmView
from vision_pc.core.positioning.corrected_positioning import (
    CorrectedResult,
    _needs_another_motion,
    look_then_move_corrected,
)
from vision_pc.core.positioning.learned_servo import expected_side, servo_spread, turned_share
from vision_pc.core.se3 import Array

PROGRAMS = shipped()
MAP, POSITIONING = PROGRAMS.local_map, PROGRAMS.positioning
_HALF = 8e-4  # rad, of the backlash: 6 mm from side to side
_BACK = 3e-4  # rad, that the encoder shows: less than is waited for


def settings(**changes: Any) -> LocalErrorModelSettings:
    adaptive = MAP.adaptive.model_dump() | {"enabled": True} | changes
    asked = {"adaptive": adaptive, "play_std": 8e-4}
    return LocalErrorModelSettings.model_validate(MAP.model_dump() | asked)


class BroughtBackRig(SyntheticRig):
    """The backlash lies before the encoder, which turns only once the joint has come through all of it.

    ``back`` says of each motion that ends with a take-up whether its slew is brought back afterwards.
    """

    def __init__(self, seed: int, back: Iterator[bool]) -> None:
        super().__init__(draw(np.random.default_rng(seed), servo_std=2e-5, play=_HALF), seed)
        self.back = back

    def advance(self, q: Array) -> None:
        turn = float(q[0] - self.q[0])
        side = float(np.clip(self.slew_play + turn * _HALF / MAP.reversal_rad, -_HALF, _HALF))
        self.slew_play = side + turn  # of which the rig's own play takes the turn
        super().advance(q)
        self.slew_play = side

    async def move_to(self, X_BT_ref: Array, duration_s: float = 0.0) -> ArmView:
        await super().move_to(X_BT_ref, duration_s)
        if duration_s and next(self.back):
            self.advance(self.q - np.eye(6)[0] * _BACK)
        for _ in range(10):
            self.advance(self.q)
        return await self.view()


async def calibrated(seed: int, back: Iterator[bool]) -> tuple[BroughtBackRig, LocalTrack]:
    arm = BroughtBackRig(seed, repeat(False))
    await adjust_orientation(arm, arm, silent, PROGRAMS.orientation)
    track = await record_local_track(arm, arm, silent, settings(), BOOM)
    arm.back = back
    return arm, track


async def one_look(seed: int, back: Iterator[bool]) -> tuple[BroughtBackRig, CorrectedResult]:
    arm, track = await calibrated(seed, back)
    return arm, await look_then_move_corrected(arm, arm, silent, POSITIONING, settings(), BOOM, track)


def worst_m(arm: SyntheticRig) -> float:
    return float(np.abs(arm.true_error(POSITIONING.clearance_m)[:2]).max())


@pytest.mark.parametrize("back", [(True, False), (False, True), (True,), (False,)], ids=str)
async def test_whichever_side_drives_end_on_a_correction_ends_inside(back: tuple[bool, ...]) -> None:
    """Where ends take turns every correction missed by the whole backlash, as long as none was foreseen."""
    arm, _ = await one_look(10, cycle(back))
    assert worst_m(arm) < 2.5e-3


async def test_what_is_told_before_moving_counts_the_backlash_that_the_legs_showed() -> None:
    arm, track = await calibrated(10, repeat(False))
    fitted = fit_error_model(track, (await arm.look()).X_CM[:3, 3], BOOM, settings())
    reach = float(np.linalg.norm(boom_levers(track.X_BT_now, BOOM)[:, 0]))
    assert np.sqrt(fitted.backlash_m2) == pytest.approx(2.0 * _HALF * reach, rel=0.25)
    still = servo_spread(track, settings()).variance
    counted = servo_spread(track, settings(), fitted.backlash_m2).variance
    turned = turned_share(track)
    aside = 0.5 * turned * (1.0 - turned) * fitted.backlash_m2
    assert counted - still == pytest.approx(aside, rel=1e-6)
    assert np.sqrt(counted) > 3.0 * np.sqrt(still)


async def test_the_side_that_is_expected_is_the_likelier_one() -> None:
    _, track = await calibrated(10, repeat(False))
    assert track.sides.tolist() == [-1.0]
    assert expected_side(track) == -1.0
    few, many = (track._replace(sides=np.array([-1.0] + [1.0] * turned)) for turned in (1, 2))
    assert (expected_side(few), expected_side(many)) == (-1.0, 1.0)
    assert 0.0 < turned_share(track) < turned_share(few) < 0.5 <= turned_share(many) < 1.0


@pytest.mark.parametrize(
    ("off_mm", "corrections", "drives"), [(4.5, 5, 6), (6.5, 5, 10), (6.5, 0, 1)], ids=str
)
async def test_what_odometry_sees_outside_the_tolerance_is_driven_again_unless_one_shot_was_asked_for(
    off_mm: float, corrections: int, drives: int
) -> None:
    _, track = await calibrated(10, repeat(False))
    local_map = settings(outside=4, useless=10)
    asked = POSITIONING.model_copy(update={"corrections": corrections})
    residuals, parts = [np.array([0.5, 0.0, 0.5])], 2 if corrections else 1
    while _needs_another_motion(residuals, parts, track, asked, local_map, 0.0):
        residuals.append(np.array([1e-3 * off_mm, 0.0, 0.0]))
    assert len(residuals) - 1 == drives
