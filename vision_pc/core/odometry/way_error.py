"""What odometry gets wrong along its way, added up: a covariance from the map's first pair on."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from vision_pc.core import se3
from vision_pc.core.se3 import Array
from vision_pc.core.types import OdometryPose

_NOTHING = np.zeros((6, 6))
_ASTRAY = 0.004  # [E] of what an offset does to a pose, in every direction: depths are not linear in it


class _Keyframe(NamedTuple):
    """Where a keyframe is, and the ``root`` (6×6) of that place's covariance without what an offset does: of
    errors that all keyframes before it made alike.
    """

    place: Array
    root: Array


class WayError:
    """Adds up what odometry gets wrong along its way: each keyframe's error goes on into what is seen from
    it, until what was there before holds the pose again; and an offset of all disparities,
    ``disparity_std_px``, bends the way. ``begins`` (6×6): of the map's first pair.

    Errors of keyframes add up as if all went the same way. On a road one after the other turns to the same
    side by a ten-thousandth: the same houses are beside it, and each is matched as the one before.
    """

    def __init__(self, disparity_std_px: float, begins: Array = _NOTHING) -> None:
        self._std_px = disparity_std_px
        self._keyframes: dict[int, _Keyframe] = {0: _Keyframe(np.zeros(3), _root(begins))}

    def after(self, pose: OdometryPose, made: int | None) -> Array:
        """The covariance (6×6) of ``pose`` in its C0; ``made``: the number of the keyframe that it became."""
        place = pose.X_C0C[:3, 3]
        held = self._held(pose.held_by or {0: np.eye(6)}, place)
        total = pose.covariance + held @ held.T
        if made is not None:
            self._keyframes[made] = _Keyframe(place, held + _root(pose.covariance))
        by_offset = np.zeros(6) if pose.by_offset is None else pose.by_offset
        bent = np.outer(by_offset, by_offset)
        bent[:3, :3] += _ASTRAY**2 * (by_offset[:3] @ by_offset[:3]) * np.eye(3)
        bent[3:, 3:] += _ASTRAY**2 * (by_offset[3:] @ by_offset[3:]) * np.eye(3)
        return np.asarray(total + self._std_px**2 * bent)

    def _held(self, held_by: Mapping[int, Array], place: Array) -> Array:
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
