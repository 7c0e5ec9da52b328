"""How much wider a pose is told than its solution has it, in pictures of a camera that nobody here knows.

The solution weighs views by a floor that depths of any recording deserve. What views truly miss by is told by
what depths are known to, and by what is left in the views themselves: the larger counts.
"""

import numpy as np

from vision_pc.core.odometry.keyframes.keyframe import Indices
from vision_pc.core.odometry.keyframes.keyframe_map import SHARED, KeyframeMap
from vision_pc.core.se3 import Array

_TAILS = 1.5  # [E] of a pose's variance: single pictures are off by more than a normal error
_FEW_POINTS = 140.0  # [E] with so many a patch that is followed wrongly adds that variance again
_UNKNOWNS = 7  # of a pose and the map's size


def widened(
    keyframe_map: KeyframeMap, ids: Indices, X_CC0: Array, errors_px: Array, weights: Array, noise_px: float
) -> float:
    """What the covariance of a camera at ``X_CC0`` is multiplied by, which the points ``ids`` (n,) hold with
    ``weights`` (2, n) of views of ``noise_px`` that miss by ``errors_px`` (2, n, 2).
    """
    moved = np.linalg.norm(keyframe_map.sensitivity(ids, X_CC0), axis=2) * keyframe_map.told_stds(ids)
    missed = max(_expected(moved / noise_px, weights), _missed(errors_px * weights[:, :, None] / noise_px))
    return SHARED * missed * (_TAILS + (_FEW_POINTS / len(ids)) ** 2)


def _expected(moved: Array, weights: Array) -> float:
    """What views (2, n) miss by, squared, of what their ``weights`` expect of them, where depths as they are
    truly known move them by ``moved`` (2, n) of their noise: the floor that weighs them is above that.
    """
    information = weights**2
    truly = information * (1.0 + moved**2)
    return float((information * truly).sum() / information.sum())


def _missed(errors: Array) -> float:
    """The same by what they do miss by, ``errors`` (2, n, 2) of what is expected; 0 where none was seen."""
    seen = int((errors != 0.0).any(axis=2).sum())
    return float((errors**2).sum() / max(2 * seen - _UNKNOWNS, 1))
