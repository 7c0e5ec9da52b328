"""Trajectory matching on the synthetic arm: path, rotation, what it tells of itself, what it refuses."""

import math
from typing import Any

import numpy as np
import pytest

from protocol.errors import MeasurementFailed
from tests.vision_pc.program_settings import shipped
from tests.vision_pc.synthetic import Q_START, SyntheticRig, Truth, draw, forward, silent
from vision_pc.config.programs import TrajectorySettings
from vision_pc.core.calibration.local_calibration import LocalCalibration
from vision_pc.core.calibration.trajectory_matching import (
    associated_trajectories,
    asymmetric_path,
    calibrate,
    refuse_poor_path,
    trajectory_matching,
)
from vision_pc.core.se3 import Array, angle_between, exp_so3, log_so3, transform
from vision_pc.core.types import WatchSample

SETTINGS = shipped().trajectory
ODOMETRY = shipped().local_map
RIGID: dict[str, Any] = {"encoder_offset": np.zeros(6), "compliance": np.zeros(2), "play": 0.0}


def changed(**changes: Any) -> TrajectorySettings:
    return TrajectorySettings.model_validate(SETTINGS.model_dump() | changes)


def truth(seed: int, **changes: Any) -> Truth:
    return draw(np.random.default_rng(seed), **changes)


async def calibrated(
    t: Truth, seed: int, settings: TrajectorySettings = SETTINGS
) -> tuple[LocalCalibration, Array]:
    """The calibration, and the true R_BC."""
    arm = SyntheticRig(t, seed)
    noisy = ODOMETRY.model_copy(update={"odometry_std_m": t.odometry_std_m})
    calibration = await trajectory_matching(arm, arm, silent, settings, noisy)
    return calibration, arm.X_BC_true()[:3, :3]


def mount(degrees: float, axis: tuple[float, float, float] = (0.0, 1.0, 0.0)) -> Array:
    direction = np.array(axis) / np.linalg.norm(axis)
    return transform(exp_so3(direction * math.radians(degrees)), [-0.2, -0.05, -0.4])


def test_path_follows_17_to_19() -> None:
    X = forward(Q_START)
    starts = asymmetric_path(X, changed(placement="starts_here", segments_m=(0.3, 0.1, 0.05)))
    n, s = X[:3, 0], X[:3, 1]
    diagonal = (n + s) / math.sqrt(2.0)
    steps = np.diff([P[:3, 3] for P in starts], axis=0)
    assert np.allclose(steps, [0.3 * n, 0.1 * diagonal, 0.05 * n])
    assert np.allclose(starts[0], X)
    ends = asymmetric_path(X, changed(placement="ends_here", segments_m=(0.3, 0.1, 0.05)))
    assert np.allclose(ends[-1], X)
    assert np.allclose(np.diff([P[:3, 3] for P in ends], axis=0), steps)
    assert all(np.allclose(P[:3, :3], X[:3, :3]) for P in ends)


@pytest.mark.parametrize("seed", range(6))
async def test_a_rigid_arm_is_calibrated_to_a_tenth_of_a_degree_with_any_mount_and_glitches(
    seed: int,
) -> None:
    calibration, R_BC = await calibrated(truth(seed, **RIGID, glitch_share=0.05), seed)
    assert math.degrees(angle_between(calibration.R_BC, R_BC)) < 0.15
    assert calibration.inlier_share > 0.85


@pytest.mark.parametrize("seed", range(6))
async def test_a_bending_arm_is_calibrated_under_2_degrees(seed: int) -> None:
    """Not to the true R_BC but to what the arm's own model makes of it, with 5 mrad of offset a joint."""
    calibration, R_BC = await calibrated(truth(seed), seed)
    assert math.degrees(angle_between(calibration.R_BC, R_BC)) < 2.0


async def test_15_degrees_of_mount_leak_into_the_papers_form_but_not_into_the_default() -> None:
    default, paper = [], []
    for seed in range(6):
        t = truth(seed, X_TC=mount(15.0), **RIGID)
        for errors, settings in ((default, SETTINGS), (paper, changed(method="paper", association="none"))):
            calibration, R_BC = await calibrated(t, seed, settings)
            errors.append(math.degrees(angle_between(calibration.R_BC, R_BC)))
    assert np.median(default) <= 0.5
    assert np.median(paper) > 3.0


async def test_half_a_metre_of_lever_arm_does_no_harm_to_the_default() -> None:
    """Tool turning by a degree along the path: with the lever left in, the match would bend."""
    errors = []
    for seed in range(6):
        t = truth(seed, X_TC=transform(exp_so3([0.05, -0.1, 0.02]), [-0.3, -0.2, -0.35]), **RIGID)
        calibration, R_BC = await calibrated(t, seed)
        errors.append(math.degrees(angle_between(calibration.R_BC, R_BC)))
    assert max(errors) <= 0.3


def turning_samples(lever: float, turn_rad: float) -> tuple[tuple[WatchSample, ...], Array]:
    """A path along which the tool also turns, seen without noise from a long lever; and R_BC at its end."""
    path = asymmetric_path(forward(Q_START), SETTINGS)
    X_TC = transform(exp_so3([0.1, 0.2, -0.1]), [-lever, 0.0, 0.0])
    samples = []
    X_BC0 = None
    corners = np.array([P[:3, 3] for P in path])
    for u in np.linspace(0.0, 1.0, 80):
        p = np.array([np.interp(u, np.linspace(0, 1, len(corners)), corners[:, k]) for k in range(3)])
        X_BT = transform(path[0][:3, :3] @ exp_so3([0.0, 0.0, turn_rad * u]), p)
        X_BC = X_BT @ X_TC
        X_BC0 = X_BC if X_BC0 is None else X_BC0
        X_CM = np.linalg.inv(X_TC)
        samples.append(WatchSample(int(1e8 * len(samples)), X_BT, np.linalg.inv(X_BC0) @ X_BC, X_CM, None))
    return tuple(samples), (X_BT @ X_TC)[:3, :3]


def test_the_lever_arm_is_removed_exactly() -> None:
    samples, R_BC = turning_samples(0.5, math.radians(3.0))
    calibration = calibrate(associated_trajectories(samples, SETTINGS), SETTINGS)
    assert angle_between(calibration.R_BC, R_BC) < 1e-6
    paper = changed(method="paper", association="time")
    biased = calibrate(associated_trajectories(samples, paper), paper)
    assert math.degrees(angle_between(biased.R_BC, R_BC)) > 1.0


def test_the_least_number_of_pictures_suffices_and_the_least_known_axis_decides() -> None:
    samples, _ = turning_samples(0.5, math.radians(3.0))
    enough = changed(minimum_samples=len(samples))
    stds = np.array([2e-3, 1e-3, 3e-3])
    calibration = calibrate(associated_trajectories(samples, enough), enough)._replace(
        covariance=np.diag(stds**2)
    )
    assert calibration.rotation_std() == pytest.approx(3e-3)
    np.testing.assert_allclose(
        calibration.goal_covariance(np.array([2.0, 0.0, 0.0])), np.diag([0.0, 6e-3, 2e-3]) ** 2
    )


def test_the_calibration_is_carried_along_when_the_tool_turns() -> None:
    samples, _ = turning_samples(0.5, math.radians(3.0))
    calibration = calibrate(associated_trajectories(samples, SETTINGS), SETTINGS)
    turned = samples[-1].X_BT @ transform(exp_so3([0.2, 0.0, 0.0]), [0.0] * 3)
    X_TC = transform(exp_so3([0.1, 0.2, -0.1]), [0.0] * 3)
    assert angle_between(calibration.rotation_at(turned), (turned @ X_TC)[:3, :3]) < 1e-6


async def test_the_stated_uncertainty_covers_the_error_of_a_noisy_rigid_arm() -> None:
    scores = []
    for seed in range(20):
        t = truth(seed, **RIGID, odometry_std_m=0.002)
        calibration, R_BC = await calibrated(t, seed)
        error = log_so3(calibration.R_BC @ R_BC.T)
        scores.append(error @ np.linalg.solve(calibration.covariance, error) / 3.0)
    # pessimistic by design for white noise: the samples are counted as few
    assert 0.01 < np.mean(scores) < 1.5


async def test_table_3_residuals_are_those_of_the_trajectories() -> None:
    calibration, _ = await calibrated(truth(0), 0)
    assert np.all(calibration.residuals.mean_m < calibration.residuals.maximum_m)
    assert np.all(calibration.residuals.maximum_m < 0.02)
    assert calibration.samples > 50
    assert calibration.method == "points/time"


@pytest.mark.parametrize(
    ("changes", "cause"),
    [
        ({"segments_m": (0.3, 0.02)}, "path_straight"),
        ({"segments_m": (0.2, 0.2, 0.2, 0.2, 0.2)}, "path_symmetric"),
        ({"segments_m": (0.2, 0.2, 0.2, 0.2), "association": "none"}, "path_symmetric"),
        ({"segments_m": (0.2, 0.2), "turn_deg": 175.0}, "path_closed"),
    ],
)
async def test_poor_paths_are_refused_before_the_arm_moves(changes: dict[str, Any], cause: str) -> None:
    arm = SyntheticRig(truth(0), 0)
    with pytest.raises(MeasurementFailed) as refused:
        await trajectory_matching(arm, arm, silent, changed(**changes), ODOMETRY)
    assert refused.value.cause == f"measurement.{cause}"
    assert arm.motions == 0


async def test_lost_odometry_is_refused() -> None:
    arm = SyntheticRig(truth(0), 0)
    arm.lose_odometry_after = 30
    with pytest.raises(MeasurementFailed) as refused:
        await trajectory_matching(arm, arm, silent, SETTINGS, ODOMETRY)
    assert refused.value.cause == "measurement.odometry_lost"


async def test_too_few_pictures_are_refused() -> None:
    arm = SyntheticRig(truth(0), 0, rate_hz=1.0, speed=0.5)
    with pytest.raises(MeasurementFailed) as refused:
        await trajectory_matching(arm, arm, silent, changed(minimum_samples=60), ODOMETRY)
    assert refused.value.cause == "measurement.too_few_samples"


async def test_an_unseen_tool_marker_is_refused() -> None:
    arm = SyntheticRig(truth(0, missed_share=1.0), 0)
    with pytest.raises(MeasurementFailed) as refused:
        await trajectory_matching(arm, arm, silent, SETTINGS, ODOMETRY)
    assert refused.value.cause == "measurement.tool_not_seen"


@pytest.mark.parametrize(
    ("damage", "cause"),
    [
        (lambda x, rng: np.zeros_like(x), "path_too_short"),  # a frozen camera
        (lambda x, rng: 2.0 * x, "scale_mismatch"),  # a wrong baseline
        (lambda x, rng: x + rng.normal(0, 0.06, x.shape), "match_poor"),
    ],
)
def test_a_match_not_to_be_trusted_is_refused(damage: Any, cause: str) -> None:
    samples, _ = turning_samples(0.0, 0.0)
    pair = associated_trajectories(samples, SETTINGS)
    X = pair.X_C0C.copy()
    X[:, :3, 3] = damage(X[:, :3, 3], np.random.default_rng(0))
    with pytest.raises(MeasurementFailed) as refused:
        calibrate(pair._replace(X_C0C=X), changed(method="points"))
    assert refused.value.cause == f"measurement.{cause}"


def test_a_nearly_straight_track_is_refused_as_such() -> None:
    samples, _ = turning_samples(0.0, 0.0)
    settings = changed(segments_m=(0.5, 0.012, 0.02))
    with pytest.raises(MeasurementFailed) as refused:
        refuse_poor_path(asymmetric_path(samples[0].X_BT, settings), settings)
    assert refused.value.cause == "measurement.path_straight"
    with pytest.raises(MeasurementFailed) as refused:
        calibrate(associated_trajectories(samples, SETTINGS), changed(condition_limit=5.0))
    assert refused.value.cause == "measurement.ill_conditioned"
