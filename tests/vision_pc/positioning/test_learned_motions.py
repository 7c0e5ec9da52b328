"""Drives on joints that do not answer in a band wider than the controller believes: adapted, and told."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from tests.vision_pc.program_settings import BOOM, shipped
from tests.vision_pc.synthetic import SyntheticRig, draw, forward, inverse_kinematics, silent
from vision_pc.application.results import positioning_json
from vision_pc.config.programs import LocalErrorModelSettings
from vision_pc.core.calibration.boom_levers import boom_levers
from vision_pc.core.calibration.local_error_model import (
    record_local_track,
)
from vision_pc.core.calibration.orientation import adjust_orientation
from vision_pc.core.ports import ArmView
from vision_pc.core.positioning.corrected_positioning import (
    CorrectedResult,
    look_then_move_corrected,
)
from vision_pc.core.positioning.look_then_move import Ended
from vision_pc.core.positioning.predicted_end import (
    after_corrections,
    end_by_look,
    expected_residual,
    worth_correcting,
)
from vision_pc.core.se3 import Array, transform
from vision_pc.core.types import Look

PROGRAMS = shipped()
_INTEGRAL_1_S = 0.35
_NEAR = (10, 12, 16, 20)  # whose objects leave room for turning back


def settings(**take_up: Any) -> LocalErrorModelSettings:
    changed = PROGRAMS.local_map.take_up.model_dump() | take_up
    return LocalErrorModelSettings.model_validate(PROGRAMS.local_map.model_dump() | {"take_up": changed})


class BandedRig(SyntheticRig):
    """Each joint follows its command only outside ±``band``; a slow integral brings the command on."""

    def __init__(self, seed: int, band_rad: Sequence[float], **changes: Any) -> None:
        super().__init__(draw(np.random.default_rng(seed), servo_std=5e-5, **changes), seed)
        self.band = np.concatenate([band_rad, np.full(3, 1e-5)])
        self.q_ref = self.q.copy()
        self.stuck = False

    async def follow(
        self, waypoints: Sequence[Array], segment_s: float = 0.0, dwell_s: float = 0.0
    ) -> ArmView:
        self.motions += 1
        for X in waypoints:
            begin, goal = self.q_ref.copy(), inverse_kinematics(X, self.q_ref)
            steps = max(int(np.linalg.norm(goal - begin) / 0.1 / self.period_s), int(segment_s * 10), 3)
            for k in range(1, steps + 1):
                self._follow(begin + k / steps * (goal - begin))
            for _ in range(int(dwell_s / self.period_s)):
                self._follow(goal)
        for _ in range(60):
            if np.abs(self.q - self.q_ref).max() < 3e-4:
                break
            self._follow(self.q_ref)
        for _ in range(7):
            self.advance(self.q)
        return await self.view()

    async def view(self) -> ArmView:
        return (await super().view())._replace(X_BT_cmd=forward(self.q_ref))

    def _follow(self, q_ref: Array) -> None:
        left = q_ref - self.q
        left = np.sign(left) * np.maximum(np.abs(left) - 1.2e-4, 0.0)
        self.q_cmd = self.q_cmd + (q_ref - self.q_ref) + _INTEGRAL_1_S * self.period_s * left
        self.q_ref = q_ref
        answered = self.q if self.stuck else np.clip(self.q, self.q_cmd - self.band, self.q_cmd + self.band)
        self.advance(answered)


async def one_look(arm: SyntheticRig, local_map: LocalErrorModelSettings) -> CorrectedResult:
    await adjust_orientation(arm, arm, silent, PROGRAMS.orientation)
    track = await record_local_track(arm, arm, silent, local_map, BOOM)
    return await look_then_move_corrected(arm, arm, silent, PROGRAMS.positioning, local_map, BOOM, track)


def worst(arm: SyntheticRig) -> float:
    return float(np.abs(arm.true_error(PROGRAMS.positioning.clearance_m)[:2]).max())


async def test_an_arm_that_cannot_be_brought_on_is_named_and_told_beforehand() -> None:
    arm = BandedRig(10, [6e-3, 2.7e-3, 2.4e-3])
    local_map = settings()
    await adjust_orientation(arm, arm, silent, PROGRAMS.orientation)
    track = await record_local_track(arm, arm, silent, local_map, BOOM)
    arm.stuck = True
    result = await look_then_move_corrected(arm, arm, silent, PROGRAMS.positioning, local_map, BOOM, track)
    assert result.positioning.ended is Ended.NOT_RESOLVED
    assert result.seen.inside < 0.01
    assert not result.positioning.final.inside
    assert result.positioning.steps[-1].expected.inside < 0.5
    most = PROGRAMS.positioning.corrections + 1 + PROGRAMS.positioning.outside
    assert len(result.positioning.steps) <= most


class HuntingRig(BandedRig):
    """Its slew goes to and fro by 2 mrad where it should rest, ``from_motion`` on."""

    from_motion = 0

    async def view(self) -> ArmView:
        hunts = self.motions >= self.from_motion
        return (await super().view())._replace(unrest=np.array([2e-3, 0.0, 0.0, 0.0, 0.0, 0.0]) * hunts)


@pytest.mark.parametrize("later", [False, True])
async def test_an_arm_that_hunts_is_not_promised_to_stand_inside(later: bool) -> None:
    arm = HuntingRig(10, [6e-3, 2.7e-3, 2.4e-3])
    await adjust_orientation(arm, arm, silent, PROGRAMS.orientation)
    arm.from_motion = 10_000 if later else 0
    track = await record_local_track(arm, arm, silent, settings(), BOOM)
    arm.from_motion = 0
    positioning = PROGRAMS.positioning
    result = await look_then_move_corrected(arm, arm, silent, positioning, settings(), BOOM, track)
    reach = float(np.linalg.norm(track.X_BT_now[:2, 3]))
    told = result.positioning.steps[0].expected
    assert (told.inside > 0.9) is later  # nothing was seen of it before
    if not later:
        assert told.std_m[0] > 0.5 * 2e-3 * reach * 0.9
    assert result.seen.inside < 0.9  # of the end, odometry knows where it was, not where it will be


async def test_what_drives_leave_alike_is_expected_of_the_next_also_where_a_slew_passes_its_end() -> None:
    rig = BandedRig(10, [0.0, 0.0, 0.0])
    track = await record_local_track(rig, rig, silent, settings(), BOOM)
    residual = settings().take_up.residual_rad
    passed = np.array([[2.4 * residual, 0.0, 0.0]] * 3)
    levers = boom_levers(track.X_BT_now, BOOM)
    expected = expected_residual(track._replace(joint_residuals=passed), BOOM, settings())
    assert expected == pytest.approx(1.75 / 1.85 * levers @ passed[0])  # nearly all of what is left each time
    moved_on = np.array([np.zeros(3)] * 3 + [passed[0]] * 2)
    newest = expected_residual(track._replace(joint_residuals=moved_on), BOOM, settings())
    assert 0.7 < np.linalg.norm(newest) / np.linalg.norm(levers @ passed[0]) < 0.8  # what was before fades
    far = np.array([*passed, [9.0 * residual, 0.0, 0.0]])  # one that was stopped on its way is unlike them
    assert expected_residual(track._replace(joint_residuals=far), BOOM, settings()) == pytest.approx(expected)


def _stopped(ends: Array, thresholds: list[float]) -> Array:
    """Of drawn ends (n, drives, 2) the one that is kept: the first nearer than its threshold, or the last."""
    inside = np.linalg.norm(ends, axis=2) <= [*thresholds, np.inf]
    return np.asarray(ends[np.arange(len(ends)), inside.argmax(axis=1)])


@pytest.mark.parametrize("spread_mm", [0.3, 0.8, 2.0])
def test_what_fine_corrections_leave_is_what_drawn_ones_leave(spread_mm: float) -> None:
    """And no thresholds that are wider or narrower throughout leave less, but by the nudge's own floor."""
    variance, nudge, drives = 1e-6 * spread_mm**2, 6e-4, 5
    ends = np.random.default_rng(3).normal(0.0, 1e-3 * spread_mm, (40_000, drives, 2))
    thresholds = [worth_correcting(variance, nudge, left) for left in range(drives - 1, 0, -1)]
    assert min(thresholds) >= nudge
    assert thresholds == sorted(thresholds)  # with fewer drives left more is kept
    left = _stopped(ends, thresholds).var()
    assert after_corrections(variance, nudge, drives) == pytest.approx(left, rel=0.03)
    for factor in (0.7, 1.4):
        others = [max(nudge, factor * threshold) for threshold in thresholds]
        assert left < 1.01 * _stopped(ends, others).var()


@pytest.mark.parametrize(("missed_mm", "corrected"), [(0.1, True), (4.0, False)])
async def test_an_end_is_corrected_only_where_drives_leave_less(missed_mm: float, corrected: bool) -> None:
    """The same arm and object, whose way in two parts ends outside the nudge; what drives left differs."""
    arm = BandedRig(10, [3e-4, 1.5e-4, 1.2e-4])
    await adjust_orientation(arm, arm, silent, PROGRAMS.orientation)
    track = await record_local_track(arm, arm, silent, settings(), BOOM)
    residuals = 1e-3 * missed_mm * np.random.default_rng(1).choice([-1.0, 1.0], (12, 3))
    positioning = PROGRAMS.positioning.model_copy(update={"nudge_m": 3e-4})
    result = await look_then_move_corrected(
        arm, arm, silent, positioning, settings(), BOOM, track._replace(residuals=residuals)
    )
    assert (len(result.positioning.steps) > 2) is corrected


@pytest.mark.parametrize(
    ("missed_mm", "depth_mm", "corrections", "stays"),
    [(9.0, 0.0, 5, True), (0.1, 0.0, 5, False), (9.0, 30.0, 5, False), (9.0, 0.0, 0, False)],
)
async def test_a_tool_that_stands_nearer_than_drives_end_stays(
    missed_mm: float, depth_mm: float, corrections: int, stays: bool
) -> None:
    """A look shows 2 mm: of six drives that leave 9 mm each the best would end farther off."""
    arm = BandedRig(10, [3e-3, 1.5e-3, 1.2e-3])
    await adjust_orientation(arm, arm, silent, PROGRAMS.orientation)
    track = await record_local_track(arm, arm, silent, settings(), BOOM)
    changed = {"corrections": corrections, "aim_m": 0.0, "nudge_m": 3e-4, "axis_std_rad": 0.0}
    positioning, local_map = PROGRAMS.positioning.model_copy(update=changed), settings()
    residuals = 1e-3 * missed_mm * np.random.default_rng(1).choice([-1.0, 1.0], (12, 3))
    track = track._replace(residuals=residuals)
    off = np.array([1.2e-3, -1.6e-3, 1e-3 * depth_mm])
    look = await arm.look()
    goal = look.X_CM[:3, 3] + off + [0.0, 0.0, positioning.clearance_m]
    look = look._replace(X_CO=transform(look.X_CO[:3, :3], goal))
    seen = arm.look

    async def first_look() -> Look:
        arm.look = seen  # type: ignore[method-assign]
        return look

    arm.look, before = first_look, arm.motions  # type: ignore[method-assign]
    result = await look_then_move_corrected(arm, arm, silent, positioning, local_map, BOOM, track)
    assert (result.positioning.ended is Ended.NEAR_ENOUGH) is stays
    assert (arm.motions == before) is stays
    if stays:
        assert (result.positioning.steps, len(result.positioning.looks)) == ((), 1)
        assert result.expected is result.seen
        assert result.seen.mean_m == pytest.approx(off)
        assert result.seen.std_m == pytest.approx(np.sqrt(np.diag(look.cov_CM + look.cov_CO)[:3]))
        assert result.track is track
        told = positioning_json(result)
        assert (told["steps"], told["ended"], told["expected"]) == ([], "near_enough", told["seen"])


async def test_the_clearance_is_kept_along_an_axis_that_is_known_to_a_pixel() -> None:
    arm = BandedRig(10, [0.0, 0.0, 0.0])
    track = await record_local_track(arm, arm, silent, settings(), BOOM)
    look = await arm.look()
    stated = (PROGRAMS.positioning.model_copy(update={"axis_std_rad": std}) for std in (0.004, 0.0))
    aside, exact = (end_by_look(np.zeros(3), look, track, each) for each in stated)
    grown = np.diag(aside.covariance - exact.covariance)
    assert grown == pytest.approx([(0.004 * PROGRAMS.positioning.clearance_m) ** 2] * 2 + [0.0])
