"""The space in which the tool may be: a box in B, less a cylinder about the slewing axis."""

import math
from typing import NamedTuple

import numpy as np

from controller.core.kinematics.rotations import Array
from foundation.compiled import kernel


class Workspace(NamedTuple):
    """Bounds of p_BT (m): ``low`` and ``high`` (3,), least distance ``radius_min`` from the slewing axis."""

    low: Array
    high: Array
    radius_min: float


def widened(space: Workspace, margin_m: float) -> Workspace:
    """``space``, larger by ``margin_m`` on every side."""
    return Workspace(space.low - margin_m, space.high + margin_m, space.radius_min - margin_m)


@kernel
def outside(space: Workspace, p: Array) -> tuple[float, float]:
    """The coordinate of ``p`` that leaves the workspace, and its bound (m); equal when it is inside."""
    for axis in range(3):
        if p[axis] < space.low[axis]:
            return p[axis], space.low[axis]
        if p[axis] > space.high[axis]:
            return p[axis], space.high[axis]
    radius = math.hypot(p[0], p[1])
    if radius < space.radius_min:
        return radius, space.radius_min
    return 0.0, 0.0


@kernel
def opened(space: Workspace, p: Array) -> Workspace:
    """The workspace, widened to contain ``p``: an arm that stands outside may come back, no further out."""
    radius = min(space.radius_min, math.hypot(p[0], p[1]))
    return Workspace(np.minimum(space.low, p), np.maximum(space.high, p), radius)
