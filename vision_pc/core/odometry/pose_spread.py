"""How well a pose is known that points of a map hold: by what they truly do.

The solution weighs views by a floor that depths of any recording deserve, so its own covariance tells of that
floor. What a pose truly errs by follows from what its points miss by, each with the hold that it has on the
pose (Huber 1967; for few points MacKinnon and White 1985).
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from vision_pc.core import se3
from vision_pc.core.odometry.keyframes.keyframe import Indices
from vision_pc.core.odometry.keyframes.keyframe_map import SHARED, KeyframeMap
from vision_pc.core.se3 import Array

_RIGHT_COLUMN = np.array([0.0, 0.0, 1.0, 0.0])  # of a point's views: columns and rows of left and right eye


class PoseSpread(NamedTuple):
    """How far a pose may be off, [δp; δθ] in C0.

    ``covariance`` (6×6): by its own points, if keyframes are where they are thought to be. ``by_offset``
    (6,): how it goes by a px of an offset that all disparities share (right columns, picture minus model),
    and ``views_by_offset`` (2, n, 2) what its views then miss by. ``held_by``: how
    (6×6) it goes with what all points of a keyframe have in common, by the numbers of the keyframes that
    first showed points: where one alone shows what is near, it alone moves the camera aside.
    """

    covariance: Array
    by_offset: Array
    views_by_offset: Array
    held_by: Mapping[int, Array]


EXACT = PoseSpread(np.zeros((6, 6)), np.zeros(6), np.zeros((2, 0, 2)), {})
"""Of the camera that C0 is."""


def pose_spread(
    keyframe_map: KeyframeMap, ids: Indices, X_CC0: Array, errors_px: Array, weights: Array, noise_px: float
) -> PoseSpread:
    """The spread of a camera at ``X_CC0`` that the points ``ids`` (n,) hold with ``weights`` (2, n) of views
    of ``noise_px`` that miss by ``errors_px`` (2, n, 2).

    The covariance is that of many points: what depths err by as well as they are known, and what points do
    miss by, as if each were left out. It has drawn the pose towards itself. Twice that, as patches err by
    together what each alone does not show.
    """
    rates = _by_points(keyframe_map.pose_rates(ids, X_CC0))
    pulls = _by_points(np.repeat((weights / noise_px)[:, :, None] ** 2, 2, axis=2))[..., None] * rates
    of_points = np.swapaxes(pulls, 1, 2) @ rates  # information (n, 6, 6)
    known = np.linalg.inv(of_points.sum(axis=0))
    by_depth = _by_points(keyframe_map.sensitivity(ids, X_CC0))
    moved = by_depth * keyframe_map.reported_stds(ids)[:, None]
    hold = rates @ known @ np.swapaxes(pulls, 1, 2)
    alone = np.linalg.solve(np.eye(hold.shape[1]) - hold, _by_points(errors_px)[..., None])[..., 0]
    scores = np.vstack([_pull(pulls, moved), _pull(pulls, alone)])
    carried = keyframe_map.carried_by_offset(ids, se3.inverse(X_CC0)[:3, 3])
    missed: Array = _RIGHT_COLUMN - by_depth * keyframe_map.depths_by_offset(ids)[:, None]
    missed += (rates @ carried[..., None])[..., 0]
    by_offset = known @ _pull(pulls, missed).sum(axis=0)
    shown_by = keyframe_map.shown_by(ids)
    return PoseSpread(
        SHARED * known @ scores.T @ scores @ known,
        by_offset,
        np.swapaxes((missed - rates @ by_offset).reshape(-1, 2, 2), 0, 1),
        {int(k): known @ of_points[shown_by == k].sum(axis=0) for k in np.unique(shown_by)},
    )


def _pull(pulls: Array, views: Array) -> Array:
    """How each point draws the pose (n, 6) that its ``views`` (n, 4) px miss by."""
    return np.asarray((views[:, None, :] @ pulls)[:, 0])


def _by_points(views: Array) -> Array:
    """Views (2, n, 2, ...) of both eyes as the four numbers of each point (n, 4, ...)."""
    return np.swapaxes(views, 0, 1).reshape(views.shape[1], 4, *views.shape[3:])
