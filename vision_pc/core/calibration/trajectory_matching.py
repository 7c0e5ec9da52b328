"""Range adjustment by trajectory matching (Mäkinen et al. 2023, 3.2.2).

The arm drives a planar, asymmetric path. Two traces of it are kept: the camera's, by stereo odometry, and the
tool's, by the rigid kinematic model at the encoders, associated in time. Coarse frame alignment and the
hybrid mixture match give the rotation from camera axes to base axes, which turns what a look measures into
a reference.

Two forms. ``paper``: poses of camera and tool are matched as they are, so that the camera's body is taken for
parallel to the tool's; a lever arm or a mount rotation then biases the result. ``points`` (default): the tool
marker's track m_i = t_i + R_i m is matched to the tool's track, which removes the lever arm, and positions
alone, which leaves the mount rotation out of it; it comes out as a result (R_TC) instead.
"""

import math
from typing import NamedTuple

import numpy as np

from protocol.errors import MeasurementFailed
from vision_pc.config.programs import (
    LocalErrorModelSettings,
    TrajectorySettings,
)
from vision_pc.core.calibration.local_calibration import (
    LocalCalibration,
    residual_table,
    rotation_covariance,
    settled_pose,
)
from vision_pc.core.calibration.object_motion import refuse_moving_object
from vision_pc.core.perception.watch import AT_REST
from vision_pc.core.point_set_matching.coarse import asymmetry, coarse_alignment, path_frame
from vision_pc.core.point_set_matching.hybrid_mixture import (
    MixtureMatch,
    full_poses,
    match_trajectories,
    positions_only,
)
from vision_pc.core.ports import Arm, Eyes, Report
from vision_pc.core.se3 import Array, transform
from vision_pc.core.types import WatchSample

_UNASSOCIATED_POINTS = 120  # every point against every point: enough of them, and still quick
_TWIN_LIMIT = 0.02  # of the extent: nearer to its own twin than this, an unordered path has two answers


class TrajectoryPair(NamedTuple):
    """The two traces, associated in time: camera X_C0C and tool X_BT, each (N, 4, 4); p_CM (3,) or None."""

    X_C0C: Array
    X_BT: Array
    p_CM: Array | None


async def trajectory_matching(
    arm: Arm, eyes: Eyes, report: Report, settings: TrajectorySettings, odometry: LocalErrorModelSettings
) -> LocalCalibration:
    """The local calibration from one planar path; the arm rests at the path's end.

    ``odometry``: how well odometry measures. Raises MeasurementFailed for a straight or symmetric path (then
    nothing moves), lost odometry, too few samples, a match that is ill-conditioned, and an object that moves
    while the camera goes to the path's beginning and back; errors of arm and eyes pass through.
    """
    X_BT_now = (await arm.view()).X_BT
    path = asymmetric_path(X_BT_now, settings)
    refuse_poor_path(path, settings)
    length, returns = sum(settings.segments_m), settings.placement == "ends_here"
    async with eyes.watch(markers=settings.method == "points", odometry=True) as watch:
        if returns:
            report(0.05, "driving to where the path begins")
            await arm.move_to(path[0])
        first = len(watch.samples) if returns else 0
        report(0.15, f"path of {len(settings.segments_m)} segments, {length:.2f} m")
        await arm.follow(path[1:], segment_s=settings.segment_s, dwell_s=settings.dwell_s)
    samples = watch.samples[first:]
    report(0.85, f"matching {len(samples)} samples")
    # Elsewhere the camera sees the object from another side, with other errors.
    stands = returns and refuse_moving_object(watch.samples, 2.0 * length, odometry)
    calibration = calibrate(associated_trajectories(samples, settings), settings)
    report(1.0, f"rotation known to {math.degrees(calibration.rotation_std()):.2f} deg")
    return calibration._replace(object_stands=stands)


def asymmetric_path(X_BT: Array, settings: TrajectorySettings) -> list[Array]:
    """The path's corners as X_BT poses, start included, orientation held, beginning or ending at ``X_BT``."""
    n, s, p = X_BT[:3, 0], X_BT[:3, 1], X_BT[:3, 3]
    corners = [p]
    for i, length in enumerate(settings.segments_m):
        xi = math.radians(settings.heading_deg + (settings.turn_deg if i % 2 else 0.0))
        corners.append(corners[-1] + length * math.cos(xi) * n + length * math.sin(xi) * s)  # (17) (18) (19)
    shift = p - corners[-1] if settings.placement == "ends_here" else np.zeros(3)
    return [transform(X_BT[:3, :3], corner + shift) for corner in corners]


def refuse_poor_path(path: list[Array], settings: TrajectorySettings) -> None:
    """Raises MeasurementFailed when the planned path cannot fix a rotation: straight, closed or symmetric."""
    points = _along(np.array([X[:3, 3] for X in path]), 80)
    path_frame(points)
    if settings.association == "none" and asymmetry(points) < _TWIN_LIMIT:
        raise MeasurementFailed(
            "measurement.path_symmetric",
            f"path: {asymmetry(points):.3f} extents from its mirrored twin, {_TWIN_LIMIT:g} is wanted",
        )


def associated_trajectories(samples: tuple[WatchSample, ...], settings: TrajectorySettings) -> TrajectoryPair:
    """The two traces where odometry held, with the tool marker's median position.

    Raises MeasurementFailed: ``measurement.too_few_samples``, ``.odometry_lost``, ``.tool_not_seen``.
    """
    held = [s for s in samples if s.X_C0C is not None]
    if len(samples) < settings.minimum_samples:
        raise MeasurementFailed(
            "measurement.too_few_samples",
            f"trajectory: {len(samples)} samples, at least {settings.minimum_samples} are wanted",
        )
    lost = 1.0 - len(held) / len(samples)
    if lost > _LOST_SHARE or len(held) < settings.minimum_samples:
        raise MeasurementFailed(
            "measurement.odometry_lost",
            f"trajectory: odometry lost in {len(samples) - len(held)} of {len(samples)} pictures, "
            f"limit {_LOST_SHARE:.0%}",
        )
    p_CM = None
    if settings.method == "points":
        sightings = [s.X_CM[:3, 3] for s in samples if s.X_CM is not None]
        if len(sightings) < 5:
            raise MeasurementFailed(
                "measurement.tool_not_seen",
                f"trajectory: tool marker seen in {len(sightings)} pictures, 5 are wanted",
            )
        p_CM = np.median(np.array(sightings), axis=0)
    X_C0C = np.array([s.X_C0C for s in held])
    return TrajectoryPair(X_C0C, np.array([s.X_BT for s in held]), p_CM)


def calibrate(pair: TrajectoryPair, settings: TrajectorySettings) -> LocalCalibration:
    """The local calibration from two associated traces.

    Raises MeasurementFailed when the path was poor or the match is not to be trusted
    (``measurement.match_poor``, ``.match_lost``, ``.scale_mismatch``, ``.ill_conditioned``).
    """
    x = pair.X_C0C[:, :3, 3]
    if pair.p_CM is not None:
        x = x + pair.X_C0C[:, :3, :3] @ pair.p_CM  # m_i = t_i + R_i m: the lever arm is gone
    y = pair.X_BT[:, :3, 3]
    R_cfa = coarse_alignment(x, y)
    match = _fine_match(pair, x @ R_cfa.T, R_cfa, settings)
    R_BC0 = match.R.T @ R_cfa  # R_fm R_cfa of (20): camera axes at the first picture, in B
    moved = (x @ R_cfa.T - match.t) @ match.R
    residuals = y - moved
    weights = _inliers(residuals, match)
    independent = 2 * len(settings.segments_m) + 1  # a smooth error is new at every corner and half-way
    covariance, condition = rotation_covariance(y, residuals, weights, independent)
    good = weights > 0.5
    scale = _extent(y[good]) / _extent(x[good])
    R_BC, R_TC = _rotations_at_end(R_BC0, pair, settings)
    calibration = LocalCalibration(
        R_BC, R_TC, covariance, residual_table(residuals), condition,
        f"{settings.method}/{settings.association}", len(y), float(good.mean()), _extent(y[good]), scale,
    )  # fmt: skip
    _refuse_poor_match(calibration, residuals[good], settings)
    return calibration


def _fine_match(pair: TrajectoryPair, x: Array, R_cfa: Array, settings: TrajectorySettings) -> MixtureMatch:
    """R_fm as the transpose of the match's R: ``x`` is the camera's track after coarse alignment."""
    every = np.arange(len(x))
    if settings.association == "none" and len(x) > _UNASSOCIATED_POINTS:
        every = np.linspace(0, len(x) - 1, _UNASSOCIATED_POINTS).astype(int)
    y = pair.X_BT[every, :3, 3]
    if settings.method == "paper":
        data = full_poses(x[every], R_cfa @ pair.X_C0C[every, :3, :3])
        model = full_poses(y, pair.X_BT[every, :3, :3])
    else:
        data, model = positions_only(x[every]), positions_only(y)
    return match_trajectories(data, model, np.eye(3), associated=settings.association == "time")


def _inliers(residuals: Array, match: MixtureMatch) -> Array:
    """Weights (N,), 1 within four standard deviations of the match, else 0; every sample, matched or not."""
    limit = 4.0 * math.sqrt(3.0) * max(match.sigma_m, 1e-4)
    return np.asarray(np.linalg.norm(residuals, axis=1) < limit, dtype=np.float64)


def _rotations_at_end(
    R_BC0: Array, pair: TrajectoryPair, settings: TrajectorySettings
) -> tuple[Array, Array | None]:
    """(R_BC at the path's end, R_TC): the paper takes the first for constant and has no second."""
    if settings.method == "paper":
        return R_BC0, None
    last = zip(pair.X_BT[-AT_REST:, :3, :3], pair.X_C0C[-AT_REST:, :3, :3], strict=True)
    bodies = np.array([transform(R_BT.T @ R_BC0 @ R_C0C, np.zeros(3)) for R_BT, R_C0C in last])
    R_TC: Array = settled_pose(bodies)[:3, :3]
    return pair.X_BT[-1, :3, :3] @ R_TC, R_TC


_LOST_SHARE, _OUTLIER_SHARE = 0.2, 0.4  # [D] of all samples
_RESIDUAL_M = 0.05  # [S] Mäkinen et al. 2023, Table 3: up to 58 mm on one axis
_SCALE_LIMIT = 0.2  # [D] log of kinematic over camera extent
_ROTATION_STD_DEG = 5.0  # [D] 26 mm over 0.3 m


def _refuse_poor_match(calibration: LocalCalibration, residuals: Array, settings: TrajectorySettings) -> None:
    outliers = 1.0 - calibration.inlier_share
    rms = float(np.sqrt((residuals**2).sum(axis=1).mean()))
    # The paper's form is not refused for its spread: a mount rotation leaks into it, a second look mends it.
    std_deg = math.degrees(calibration.rotation_std()) if settings.method == "points" else 0.0
    for cause, what, value, limit in (
        ("scale_mismatch", "scale error", abs(math.log(calibration.scale)), _SCALE_LIMIT),
        ("match_lost", "outlier share", outliers, _OUTLIER_SHARE),
        ("match_poor", "rms residual (m)", rms, _RESIDUAL_M),
        ("ill_conditioned", "condition", calibration.condition, settings.condition_limit),
        ("ill_conditioned", "rotation std (deg)", std_deg, _ROTATION_STD_DEG),
    ):
        if not value <= limit:
            raise MeasurementFailed(f"measurement.{cause}", f"matching: {what} {value:.4g}, limit {limit:g}")


def _extent(points: Array) -> float:
    """Rms distance (m) from the mean."""
    return float(np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean()))


def _along(corners: Array, count: int) -> Array:
    """``count`` points (count, 3) evenly along the polyline through ``corners`` (K, 3)."""
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    at = np.linspace(0.0, lengths[-1], count)
    return np.column_stack([np.interp(at, lengths, corners[:, axis]) for axis in range(3)])
