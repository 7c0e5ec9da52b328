"""How well a pose is known in pictures of a camera that nobody here knows.

The solution weighs views by a floor that depths of any recording deserve, so its own covariance tells of that
floor. What a pose truly errs by follows from what its points truly do, each with the hold that it has on the
pose (Huber 1967; for few points MacKinnon and White 1985).
"""

import numpy as np

from vision_pc.core.odometry.keyframes.keyframe import Indices
from vision_pc.core.odometry.keyframes.keyframe_map import KeyframeMap
from vision_pc.core.se3 import Array

_IN_COMMON = 4.0  # [E] points err together: depths were learnt at the same poses, patches are alike
_FEW_POINTS = 75.0  # [E] with so few that is by one more


def covariance(
    keyframe_map: KeyframeMap, ids: Indices, X_CC0: Array, errors_px: Array, weights: Array, noise_px: float
) -> Array:
    """The covariance (6×6), [δp; δθ] in C0, of a camera at ``X_CC0`` that the points ``ids`` (n,) hold with
    ``weights`` (2, n) of views of ``noise_px`` that miss by ``errors_px`` (2, n, 2).

    What ``of_points`` tells, and what points have in common.
    """
    alone = of_points(keyframe_map, ids, X_CC0, errors_px, weights, noise_px)
    return (_IN_COMMON + (_FEW_POINTS / len(ids)) ** 2) * alone


def of_points(
    keyframe_map: KeyframeMap, ids: Indices, X_CC0: Array, errors_px: Array, weights: Array, noise_px: float
) -> Array:
    """The same as if points had nothing in common: what depths err by as well as they are known, and what
    points do miss by, as if each were left out. It has drawn the pose towards itself.
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


def _by_points(views: Array) -> Array:
    """Views (2, n, 2, ...) of both eyes as the four numbers of each point (n, 4, ...)."""
    return np.swapaxes(views, 0, 1).reshape(views.shape[1], 4, *views.shape[3:])
