"""Image-space adjustment: X and Z from the corners in the pictures themselves, robot noise included.

A pose estimated from one small marker is far noisier along and about the line of sight than across it.
Minimising pixels weighs that by itself. The robot's own noise enters as one unknown motion of the hand per
sample, held by its standard deviation (six unknowns each, eliminated sample by sample).
"""

from typing import NamedTuple

import cv2
import numpy as np

from protocol.errors import MeasurementFailed
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.samples import CornerViews, PosePairs
from vision_pc.core.hand_eye.solvers import maximum_likelihood as ml
from vision_pc.core.hand_eye.solvers.maximum_likelihood import Equations
from vision_pc.core.hand_eye.solvers.result import HandEyeResult
from vision_pc.core.se3 import Array

_STEPS = 30
_HUBER = 3.0  # in standard deviations
_LEAST_PIXEL = 1e-4


class RobotNoise(NamedTuple):
    """Standard deviation a component of the robot's pose of the hand, rad and m."""

    rotation: float
    translation: float


class BundleResult(NamedTuple):
    """X, Z (4, 4); ``covariance`` (6, 6) of X's perturbation; ``pixel_noise`` px a coordinate, estimated;

    ``sample_rms_px`` (n,) in the caller's order, NaN for samples that were left out.
    """

    X: Array
    Z: Array
    covariance: Array
    pixel_noise: float
    sample_rms_px: Array


class _Sample(NamedTuple):
    """One sample's normal equations: whitened residual, slopes by (X, Z) and by the hand's own motion."""

    r: Array
    J: Array
    L: Array
    raw: Array


def adjust(pairs: PosePairs, start: HandEyeResult, robot: RobotNoise | None = None) -> BundleResult:
    """The adjusted calibration from ``start`` (whose outliers stay out) and the corners in ``pairs``.

    Raises MeasurementFailed: ``measurement.hand_eye.no_corners`` without corners or with too few of them,
    ``.singular`` when they leave X undetermined.
    """
    if pairs.corners is None:
        raise MeasurementFailed(
            "measurement.hand_eye.no_corners", "image-space adjustment needs the corners of each sample"
        )
    used = start.inliers[np.array(pairs.order)]
    X, Z = start.X, start.Z
    sigma, hands = 1.0, np.zeros((len(pairs), 6))
    for step_number in range(_STEPS):
        samples = [
            _sample(pairs, pairs.corners, k, X, Z, hands[k], sigma, robot)
            for k in map(int, np.flatnonzero(used))
        ]
        information, gradient, eliminated = _reduced(samples, hands[used], robot)
        try:
            step = np.asarray(-np.linalg.solve(information, gradient), dtype=np.float64)
        except np.linalg.LinAlgError as error:
            raise MeasurementFailed(
                "measurement.hand_eye.singular", "the corners leave X undetermined"
            ) from error
        X, Z = ml.moved(X, Z, step, tied=False)
        hands[used] = [
            _hand_update(e, step, hand, robot) for e, hand in zip(eliminated, hands[used], strict=True)
        ]
        absorbed = sum(
            float(np.sum(block * (s.L.T @ s.L))) for s, (block, _, _) in zip(samples, eliminated, strict=True)
        )
        new_sigma = max(_pixel_noise(samples, 12.0 + absorbed), _LEAST_PIXEL)
        settled = abs(new_sigma / sigma - 1.0) < 1e-6 and float(step @ information @ step) < 1e-12
        sigma = new_sigma
        if settled and step_number > 1:
            break
    rms = np.full(len(pairs), np.nan)
    rms[used] = [float(np.sqrt(np.mean(np.sum(s.raw.reshape(-1, 2) ** 2, axis=-1)))) for s in samples]
    back = np.argsort(np.array(pairs.order))
    return BundleResult(X, Z, np.asarray(np.linalg.inv(information)[:6, :6]), sigma, rms[back])


def _sample(
    pairs: PosePairs,
    corners: CornerViews,
    k: int,
    X: Array,
    Z: Array,
    hand: Array,
    sigma: float,
    robot: RobotNoise | None,
) -> _Sample:
    """The whitened pixel residuals of sample k and their slopes."""
    equations = Equations(pairs.H[k : k + 1], pairs.P[k : k + 1], np.ones(1), pairs.setup)
    levers = ml.robot_levers(equations, X, Z)[0]
    pose = ml.predicted(equations.H, X, Z)[0]
    seen = np.isfinite(corners.pixels[k]).all(axis=-1)
    if seen.sum() < 3:
        raise MeasurementFailed(
            "measurement.hand_eye.no_corners", f"sample {pairs.names[k]}: fewer than 3 corners"
        )
    shift = levers @ hand if robot is not None else np.zeros(6)
    turned = corners.points_P[seen] @ pose[:3, :3].T
    turned = turned + np.cross(shift[3:], turned)
    points = turned + pose[:3, 3] + shift[:3]
    pixels, slopes = cv2.projectPoints(points, np.zeros(3), np.zeros(3), corners.K, corners.distortion)
    by_point = slopes[:, 3:6].reshape(-1, 2, 3)
    by_pose = np.concatenate([by_point, -by_point @ stacks.hat(turned)], axis=-1).reshape(-1, 6)
    raw = (pixels.reshape(-1, 2) - corners.pixels[k][seen]).reshape(-1)
    sizes = np.repeat(np.linalg.norm(raw.reshape(-1, 2), axis=-1), 2) / sigma
    weight = np.sqrt(np.where(sizes > _HUBER, _HUBER / np.maximum(sizes, 1e-300), 1.0)) / sigma
    by_unknown = -ml.jacobian(equations, X, Z, np.zeros((1, 6)))[0]
    return _Sample(
        weight * raw, weight[:, None] * (by_pose @ by_unknown), weight[:, None] * (by_pose @ levers), raw
    )


def _reduced(
    samples: list[_Sample], hands: Array, robot: RobotNoise | None
) -> tuple[Array, Array, list[tuple[Array, Array, Array]]]:
    """Information and gradient over (X, Z) without the hands' own motions; and what restores those."""
    information, gradient = np.zeros((12, 12)), np.zeros(12)
    eliminated = []
    for sample, hand in zip(samples, hands, strict=True):
        information += sample.J.T @ sample.J
        gradient += sample.J.T @ sample.r
        if robot is None:
            eliminated.append((np.zeros((6, 6)), np.zeros((6, 12)), np.zeros(6)))
            continue
        prior = np.diag([robot.translation**-2.0] * 3 + [robot.rotation**-2.0] * 3)
        block = np.asarray(np.linalg.inv(sample.L.T @ sample.L + prior), dtype=np.float64)
        cross = sample.L.T @ sample.J
        slope = sample.L.T @ sample.r + prior @ hand
        information -= cross.T @ block @ cross
        gradient -= cross.T @ block @ slope
        eliminated.append((block, cross, slope))
    return information, gradient, eliminated


def _hand_update(
    eliminated: tuple[Array, Array, Array], step: Array, hand: Array, robot: RobotNoise | None
) -> Array:
    block, cross, slope = eliminated
    return hand if robot is None else hand - block @ (slope + cross @ step)


def _pixel_noise(samples: list[_Sample], unknowns: float) -> float:
    """The pixel noise a coordinate, from the median residual: a few bad corners do not count."""
    sizes = np.concatenate([np.linalg.norm(s.raw.reshape(-1, 2), axis=-1) for s in samples])
    degrees = 2.0 * len(sizes)
    return float(np.median(sizes)) / 1.1774 * float(np.sqrt(degrees / max(degrees - unknowns, 1.0)))
