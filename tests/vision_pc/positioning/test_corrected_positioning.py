"""Best mode on the synthetic arm: local map, one look, mid-course correction."""

from typing import Any

import numpy as np
import pytest

from protocol.errors import MeasurementFailed
from tests.vision_pc.program_settings import BOOM, shipped
from tests.vision_pc.synthetic import Q_START, SyntheticRig, draw, forward, silent
from vision_pc.config.programs import LocalErrorModelSettings
from vision_pc.core.calibration.local_error_model import (
    fit_error_model,
    record_local_track,
    refuse_poor_track,
    solve_step,
    three_legs,
    track_of,
)
from vision_pc.core.calibration.orientation import adjust_orientation
from vision_pc.core.positioning.corrected_positioning import look_then_move_corrected
from vision_pc.core.se3 import transform
from vision_pc.core.types import WatchSample

PROGRAMS = shipped()
MAP = PROGRAMS.local_map


def changed(**changes: Any) -> LocalErrorModelSettings:
    return LocalErrorModelSettings.model_validate(MAP.model_dump() | changes)


def rig(seed: int, **changes: Any) -> SyntheticRig:
    return SyntheticRig(draw(np.random.default_rng(seed), **changes), seed)


async def one_look(
    seed: int, settings: LocalErrorModelSettings, corrections: int | None = None, **changes: Any
) -> tuple[SyntheticRig, Any]:
    arm = rig(seed, **changes)
    await adjust_orientation(arm, arm, silent, PROGRAMS.orientation)
    track = await record_local_track(arm, arm, silent, settings, BOOM)
    positioning = PROGRAMS.positioning
    if corrections is not None:
        positioning = positioning.model_copy(update={"corrections": corrections})
    result = await look_then_move_corrected(arm, arm, silent, positioning, settings, BOOM, track)
    return arm, result


@pytest.mark.slow("ten runs")
async def test_one_look_inside_5_mm_over_seeds_and_the_measured_miss_is_true() -> None:
    errors, misses = [], []
    for seed in range(10):
        arm, result = await one_look(seed, MAP)
        error = arm.true_error(PROGRAMS.positioning.clearance_m)
        errors.append(np.abs(error[:2]).max())
        misses.append(np.linalg.norm(result.measured_residual_m[:2] - error[:2]))
        assert 2 <= len(result.positioning.steps) <= PROGRAMS.positioning.corrections + 1
    assert np.median(errors) < 0.002
    assert max(errors) < 0.005
    assert np.median(misses) < 0.0012  # odometry's scale is off by up to 0.1 %


async def test_the_correction_is_what_helps_with_a_poor_model() -> None:
    """Driven in one go, every error of the model counts for the whole way."""
    squares = {1: 0.0, 0: 0.0}
    for seed in range(8):
        for corrections in squares:
            arm, _ = await one_look(seed, changed(leg_m=0.05, goal_std_limit_m=1.0), corrections)
            squares[corrections] += float((arm.true_error(PROGRAMS.positioning.clearance_m)[:2] ** 2).sum())
    assert squares[1] < 0.7 * squares[0]


async def test_the_map_sees_what_a_rotation_cannot() -> None:
    """Stretched kinematics: the map's coefficients are the stretch, and the step undoes it."""
    X = forward(Q_START)
    stretch = np.diag([0.01, -0.012, 0.008])
    corners = np.array([P[:3, 3] for P in three_legs(X, 0.2)])
    at = np.linspace(0.0, 3.0, 90)
    p = np.column_stack([np.interp(at, range(4), corners[:, k]) for k in range(3)])
    true = X[:3, 3] + (p - X[:3, 3]) @ (np.eye(3) + stretch)
    X_BT = [transform(X[:3, :3], q) for q in p]
    first = transform(X[:3, :3], true[0])
    X_C0C = [np.linalg.inv(first) @ transform(X[:3, :3], q) for q in true]
    second = 1_000_000_000
    samples = [
        WatchSample(i * second, b, c, None, None) for i, (b, c) in enumerate(zip(X_BT, X_C0C, strict=True))
    ]
    track = track_of(tuple(samples))
    settings = changed(play_std=1e-6, noise_std_m=1e-4, strain_std=0.02, sway_s=0.0)
    fitted = fit_error_model(track, np.zeros(3), BOOM, settings)
    assert fitted.residual_m < 5e-4
    for d in (np.array([0.1, 0.0, 0.0]), np.array([0.0, -0.1, 0.05])):  # in the camera, parallel to the tool
        x, _ = solve_step(fitted, d)
        assert np.allclose((np.eye(3) + stretch) @ x, X[:3, :3] @ d, atol=3e-4)


async def test_a_goal_that_is_not_known_is_refused_and_nothing_moves() -> None:
    arm = rig(0)
    track = await record_local_track(arm, arm, silent, MAP, BOOM)
    before, vague = arm.motions, changed(goal_std_limit_m=1e-5)
    with pytest.raises(MeasurementFailed) as refused:
        await look_then_move_corrected(arm, arm, silent, PROGRAMS.positioning, vague, BOOM, track)
    assert refused.value.cause == "measurement.ill_conditioned"
    assert arm.motions == before


async def test_an_open_loop_step_is_one_motion_and_corrections_end_when_odometry_sees_no_residual() -> None:
    for corrections, drives in ((0, 1), (1, 2)):
        positioning = PROGRAMS.positioning.model_copy(update={"corrections": corrections})
        arm = rig(1)
        track = await record_local_track(arm, arm, silent, MAP, BOOM)
        result = await look_then_move_corrected(arm, arm, silent, positioning, MAP, BOOM, track)
        assert len(result.positioning.steps) == drives


async def test_every_drive_ends_on_the_same_flank_of_the_slews_play_although_it_swings() -> None:
    """A run over the end and back again crosses the play; at a slow pace there is none."""

    async def flanks(settings: LocalErrorModelSettings) -> set[float]:
        ends = set()
        for seed in range(4):
            arm = rig(seed, servo_std=0.0)
            arm.slew_swings = 8e-4
            track = await record_local_track(arm, arm, silent, settings, BOOM)
            ends.add(round(arm.slew_play, 9))
            for corrections in (0, 1):
                positioning = PROGRAMS.positioning.model_copy(update={"corrections": corrections})
                result = await look_then_move_corrected(arm, arm, silent, positioning, settings, BOOM, track)
                track = result.track
                ends.add(round(arm.slew_play, 9))
        return ends

    assert len(await flanks(MAP)) == 1
    assert len(await flanks(changed(take_up=MAP.take_up.model_dump() | {"slew_rad": 0.0}))) > 1


async def test_what_the_slews_servo_leaves_at_every_end_is_reckoned_with() -> None:
    """A slew that always runs on by 0.4 mrad, 1.6 mm: seen once, half of it is believed."""
    positioning = PROGRAMS.positioning.model_copy(update={"corrections": 0})
    for seed in range(3):
        errors = []
        for runs_on in (0.0, 4e-4):
            arm = rig(seed, servo_std=0.0, odometry_std_m=0.0, odometry_std=0.0)
            arm.slew_runs_on = runs_on
            track = await record_local_track(arm, arm, silent, MAP, BOOM)
            await look_then_move_corrected(arm, arm, silent, positioning, MAP, BOOM, track)
            errors.append(arm.true_error(positioning.clearance_m))
        assert np.linalg.norm(errors[1] - errors[0]) < 1e-3


async def test_a_track_is_stale_once_the_arm_moved_elsewhere() -> None:
    arm = rig(0)
    track = await record_local_track(arm, arm, silent, MAP, BOOM)
    X = (await arm.view()).X_BT
    await arm.move_to(transform(X[:3, :3], X[:3, 3] + np.array([0.0, 0.02, 0.0])))
    before = arm.motions
    with pytest.raises(MeasurementFailed) as refused:
        await look_then_move_corrected(arm, arm, silent, PROGRAMS.positioning, MAP, BOOM, track)
    assert refused.value.cause == "measurement.calibration_stale"
    assert arm.motions == before


async def test_the_extended_track_serves_the_next_move() -> None:
    arm, result = await one_look(3, MAP)
    assert len(result.track.X_BT) > 60
    again = await look_then_move_corrected(arm, arm, silent, PROGRAMS.positioning, MAP, BOOM, result.track)
    assert again.positioning.final.inside


async def test_lost_odometry_is_refused() -> None:
    arm = rig(1)
    arm.lose_odometry_after = 40
    with pytest.raises(MeasurementFailed) as refused:
        await record_local_track(arm, arm, silent, MAP, BOOM)
    assert refused.value.cause == "measurement.odometry_lost"


@pytest.mark.parametrize(
    ("flat", "count", "cause"), [(0.0, 60, "ill_conditioned"), (1.0, 15, "too_few_samples")]
)
def test_flat_and_short_tracks_are_refused(flat: float, count: int, cause: str) -> None:
    u = np.linspace(0.0, 1.0, count)
    points = np.column_stack([0.2 * u, 0.1 * np.sin(6.0 * u), flat * 0.2 * u**3])
    samples = [
        WatchSample(i, transform(np.eye(3), p), transform(np.eye(3), p), None, None)
        for i, p in enumerate(points)
    ]
    with pytest.raises(MeasurementFailed) as refused:
        refuse_poor_track(track_of(tuple(samples)))
    assert refused.value.cause == f"measurement.{cause}"
