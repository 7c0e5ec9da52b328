"""How well a pose is known after a way: what odometry gets wrong adds up from keyframe to keyframe."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from vision_pc.core import se3
from vision_pc.core.odometry.pose_spread import PoseSpread
from vision_pc.core.se3 import Array

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
