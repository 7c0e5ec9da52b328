"""How well a pose is known that points of a map hold: by what they truly do, and by what
odometry got wrong on the way there.

The solution weighs views by a floor that depths of any recording deserve, so its own covariance tells of that
floor. What a pose truly errs by follows from what its points miss by, each with the hold that it has on the
pose (Huber 1967).
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from vision_pc.core import se3
from vision_pc.core.odometry.keyframes.keyframe import Indices
from vision_pc.core.odometry.keyframes.keyframe_map import SHARED, HeldViews, KeyframeMap
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
    keyframe_map: KeyframeMap, ids: Indices, X_CC0: Array, views: HeldViews, noise_px: float
) -> PoseSpread:
    """The spread of a camera at ``X_CC0`` that the points ``ids`` (n,) hold by ``views`` of ``noise_px``.

    The covariance is that of many points: what depths err by as well as they are known, and what points do
    miss by. Twice that, as patches err by together what each alone does not show.
    """
    rates = _by_points(keyframe_map.pose_rates(ids, X_CC0))
    pulls = _by_points(np.repeat((views.weights / noise_px)[:, :, None] ** 2, 2, axis=2))[..., None] * rates
    known = np.linalg.inv(_information(pulls, rates))
    by_depth = _by_points(views.by_depth)
    moved = by_depth * keyframe_map.reported_stds(ids)[:, None]
    scores = np.vstack([_drawn(pulls, moved), _drawn(pulls, _by_points(views.errors_px))])
    carried = keyframe_map.carried_by_offset(ids, se3.inverse(X_CC0)[:3, 3])
    missed = np.asarray(_RIGHT_COLUMN - by_depth * keyframe_map.depths_by_offset(ids)[:, None])
    missed = missed + (rates * carried[:, None, :]).sum(axis=2)
    by_offset = known @ _drawn(pulls, missed).sum(axis=0)
    shown_by = keyframe_map.shown_by(ids)
    of_keyframes = {int(k): shown_by == k for k in np.unique(shown_by)}
    return PoseSpread(
        SHARED * known @ scores.T @ scores @ known,
        by_offset,
        np.swapaxes((missed - rates @ by_offset).reshape(-1, 2, 2), 0, 1),
        {k: known @ _information(pulls[its], rates[its]) for k, its in of_keyframes.items()},
    )


def _information(pulls: Array, rates: Array) -> Array:
    """What points (n) tell of a pose (6×6)."""
    return np.asarray(pulls.reshape(-1, 6).T @ rates.reshape(-1, 6))


def _drawn(pulls: Array, views: Array) -> Array:
    """How each point draws the pose (n, 6) that its ``views`` (n, 4) px miss by."""
    return np.asarray((pulls * views[..., None]).sum(axis=1))


def _by_points(views: Array) -> Array:
    """Views (2, n, 2, ...) of both eyes as the four numbers of each point (n, 4, ...)."""
    return np.swapaxes(views, 0, 1).reshape(views.shape[1], 4, *views.shape[3:])


_NONLINEAR = 0.004  # [E] of what an offset does to a pose, in every direction: depths are not linear in it


class _Keyframe(NamedTuple):
    """Where a keyframe is, and the ``root`` (6×6) of that place's covariance without what an offset does: of
    errors that all keyframes before it made alike.
    """

    place: Array
    root: Array


class AccumulatedError:
    """The covariance of poses in C0: each keyframe's error goes on into what is seen from it, until what was
    there before holds the pose again; and an offset of all disparities, ``disparity_std_px``, bends the way.

    Errors of keyframes add up as if all went the same way. On a road one after the other turns to the same
    side by a ten-thousandth: the same houses are beside it, and each is matched as the one before.
    """

    def __init__(self, disparity_std_px: float) -> None:
        self._std_px = disparity_std_px
        self._keyframes: dict[int, _Keyframe] = {}

    def after(self, X_C0C: Array, spread: PoseSpread, made: int | None) -> Array:
        """The covariance (6×6) of a pose with this ``spread``; ``made``: the keyframe that it became."""
        place = X_C0C[:3, 3]
        root, by_offset = self._root_held(spread.held_by, place), spread.by_offset
        if made is not None:
            self._keyframes[made] = _Keyframe(place, root + _root(spread.covariance))
        bent = np.outer(by_offset, by_offset)
        for part in (slice(0, 3), slice(3, 6)):
            bent[part, part] += _NONLINEAR**2 * (by_offset[part] @ by_offset[part]) * np.eye(3)
        return np.asarray(spread.covariance + root @ root.T + self._std_px**2 * bent)

    def _root_held(self, held_by: Mapping[int, Array], place: Array) -> Array:
        """The root (6×6) of the covariance, at ``place``, of what keyframes got wrong and hand on: each what
        of it its points hold.
        """
        total = np.zeros((6, 6))
        for number, share in held_by.items():
            before, lever = self._keyframes[number], np.eye(6)
            lever[:3, 3:] = -se3.hat(place - before.place)
            total += share @ lever @ before.root
        return total


def _root(covariance: Array) -> Array:
    """The symmetric root (6×6) of a covariance: roots of like ones have like directions, and add up."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)
