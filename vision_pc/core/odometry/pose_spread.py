"""How well a pose is known in pictures of a camera that nobody here knows.

The solution weighs views by a floor that depths of any recording deserve, so its own covariance tells of that
floor. What a pose truly errs by follows from what its points truly do, each with the hold that it has on the
pose (Huber 1967; for few points MacKinnon and White 1985).
"""

import numpy as np

from vision_pc.core import se3
from vision_pc.core.odometry.keyframes.keyframe import Indices
from vision_pc.core.odometry.keyframes.keyframe_map import KeyframeMap
from vision_pc.core.se3 import Array

_FEW_POINTS = 75.0  # [E] of so few the variance is larger by that of the points: one may hold the pose aside
_TIMES = (0.7, 0.7, 0.7, 0.7, 2.0, 4.0)  # [E] of the variance; last the two in which points hold a pose least


def covariance(
    keyframe_map: KeyframeMap, ids: Indices, X_CC0: Array, errors_px: Array, weights: Array, noise_px: float
) -> Array:
    """The covariance (6×6), [δp; δθ] in C0, of a camera at ``X_CC0`` that the points ``ids`` (n,) hold with
    ``weights`` (2, n) of views of ``noise_px`` that miss by ``errors_px`` (2, n, 2).

    What ``of_points`` tells, more where points are few, and in the two directions in which they hold the pose
    least, a turn counted by how far it moves what is at their depth: what patches err by together ends up
    there, and there alone are single poses three and more of their standard deviations off.
    """
    alone = of_points(keyframe_map, ids, X_CC0, errors_px, weights, noise_px)
    depth = float(np.median(se3.apply(X_CC0, keyframe_map.points[ids])[:, 2]))
    unit = np.outer(size := np.array([1.0, 1.0, 1.0, depth, depth, depth]), size)
    values, axes = np.linalg.eigh(alone * unit)  # rising
    times = np.array(_TIMES) + (_FEW_POINTS / len(ids)) ** 2
    return np.asarray((axes * (times * values)) @ axes.T / unit)


def of_points(
    keyframe_map: KeyframeMap, ids: Indices, X_CC0: Array, errors_px: Array, weights: Array, noise_px: float
) -> Array:
    """The same of many points: what depths err by as well as they are known, and what points do miss by, as
    if each were left out. It has drawn the pose towards itself.
    """
    rates = _by_points(keyframe_map.pose_rates(ids, X_CC0))
    precisions = _by_points(np.repeat((weights / noise_px)[:, :, None] ** 2, 2, axis=2))
    pulls = precisions[..., None] * rates  # of a px that a view misses by
    information = np.einsum("nik,nil->kl", pulls, rates)
    known = np.linalg.inv(information)
    moved = _by_points(keyframe_map.sensitivity(ids, X_CC0) * keyframe_map.told_stds(ids)[:, None])
    hold = np.einsum("nik,kl,njl->nij", rates, known, pulls)
    alone = np.linalg.solve(np.eye(hold.shape[1]) - hold, _by_points(errors_px)[..., None])[..., 0]
    scores = np.einsum("knid,kni->knd", np.stack([pulls, pulls]), np.stack([moved, alone])).reshape(-1, 6)
    return np.asarray(known @ scores.T @ scores @ known)


def held_by(keyframe_map: KeyframeMap, ids: Indices, X_CC0: Array, weights: Array) -> dict[int, Array]:
    """How (6×6) the pose goes with what all points of a keyframe have in common, by the numbers of those that
    first showed points: where one alone shows what is near, it alone moves the camera aside.
    """
    rates = _by_points(keyframe_map.pose_rates(ids, X_CC0))
    precisions = _by_points(np.repeat(weights[:, :, None] ** 2, 2, axis=2))
    shares = np.einsum("nik,nil->nkl", precisions[..., None] * rates, rates)
    known, shown_by = np.linalg.inv(shares.sum(axis=0)), keyframe_map.shown_by(ids)
    return {int(number): known @ shares[shown_by == number].sum(axis=0) for number in np.unique(shown_by)}


def _by_points(views: Array) -> Array:
    """Views (2, n, 2, ...) of both eyes as the four numbers of each point (n, 4, ...)."""
    return np.swapaxes(views, 0, 1).reshape(views.shape[1], 4, *views.shape[3:])
