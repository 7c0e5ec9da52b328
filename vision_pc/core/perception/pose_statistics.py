"""Statistics on SE(3): a robust mean of measured poses, with the covariance of its noise and its bias."""

from typing import NamedTuple

import numpy as np

from protocol.errors import MeasurementFailed
from vision_pc.core import se3
from vision_pc.core.se3 import Array

_ROBUST_ROUNDS = 10
_CHI2_MEDIAN_6 = 5.348  # median of χ² with six degrees of freedom


class MeanPose(NamedTuple):
    """A robust mean pose, the covariance of its noise and of a single frame's, and the bias all frames
    share.
    """

    X: Array
    noise: Array
    frame_noise: Array
    bias: Array


def robust_mean(
    measured: list[tuple[Array | None, Array | None, Array | None]],
    wanted: int,
    what: str,
    huber: float,
    reason: str = "not_seen",
) -> tuple[MeanPose, int]:
    """The mean of the poses that were measured, and how many they are; raises when fewer than ``wanted``.

    Raises MeasurementFailed: ``measurement.{what}_{reason}``.
    """
    seen = [(X, C, B) for X, C, B in measured if X is not None and C is not None and B is not None]
    if len(seen) < wanted:
        raise MeasurementFailed(
            f"measurement.{what}_{reason}",
            f"look: {what} seen in {len(seen)} of {len(measured)} frames, at least {wanted} are wanted"
            + ("" if reason == "not_seen" else f"; elsewhere {reason.replace('_', ' ')}"),
        )
    information = [np.asarray(np.linalg.inv(C), dtype=np.float64) for _, C, _ in seen]
    X = _medoid([pose for pose, _, _ in seen], information)
    weights, spread = np.ones(len(seen)), 1.0
    for _ in range(_ROBUST_ROUNDS):
        deltas = [se3.local(X, pose) for pose, _, _ in seen]
        noise_distances = np.array(
            [float(d @ np.linalg.solve(C - B, d)) for d, (_, C, B) in zip(deltas, seen, strict=True)]
        )
        spread = max(1.0, float(np.median(noise_distances)) / _CHI2_MEDIAN_6)
        weights = np.minimum(1.0, huber * np.sqrt(6.0 * spread / np.maximum(noise_distances, 1e-12)))
        total = np.sum([w * L for w, L in zip(weights, information, strict=True)], axis=0)
        pull = np.sum([w * L @ d for w, L, d in zip(weights, information, deltas, strict=True)], axis=0)
        X = se3.retract(X, np.linalg.solve(total, pull))
    gains = [np.linalg.solve(total, w * L) for w, L in zip(weights, information, strict=True)]
    noise = spread * np.sum([G @ (C - B) @ G.T for G, (_, C, B) in zip(gains, seen, strict=True)], axis=0)
    bias = np.sum([G @ B for G, (_, _, B) in zip(gains, seen, strict=True)], axis=0)
    frame_noise = spread * np.mean([C - B for _, C, B in seen], axis=0)
    return MeanPose(X, noise, frame_noise, 0.5 * (bias + bias.T)), len(seen)


def _medoid(poses: list[Array], information: list[Array]) -> Array:
    """The pose with the least sum of (unsquared) distances to all others: a start that no outlier can
    pull.
    """

    def distance(X: Array) -> float:
        deltas = [se3.local(X, Y) for Y in poses]
        return sum(float(np.sqrt(d @ L @ d)) for d, L in zip(deltas, information, strict=True))

    return min(poses, key=distance)
