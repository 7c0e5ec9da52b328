"""The space in which the tool may be: a box in B, less a cylinder about the slewing axis."""

import math
from typing import NamedTuple

import numpy as np

from controller.core.kinematics.rotations import Array, Vector
from foundation.compiled import kernel


class WorkspaceBounds(NamedTuple):
    """Bounds of p_BT (m): ``box`` (3, 2) low and high; least distance ``radius_min`` from the slew axis."""

    box: Array
    radius_min: float


def widened(space: WorkspaceBounds, margin_m: float) -> WorkspaceBounds:
    """``space``, larger by ``margin_m`` on every side."""
    return WorkspaceBounds(space.box + np.array([-margin_m, margin_m]), space.radius_min - margin_m)


@kernel
def outside(space: WorkspaceBounds, p: Vector) -> tuple[float, float]:
    """The coordinate of ``p`` that leaves the workspace, and its bound (m); equal when it is inside."""
    for axis in range(3):
        low, high = space.box[axis, 0], space.box[axis, 1]
        if p[axis] < low:
            return p[axis], low
        if p[axis] > high:
            return p[axis], high
    radius = math.hypot(p[0], p[1])
    if radius < space.radius_min:
        return radius, space.radius_min
    return 0.0, 0.0


@kernel
def opened(space: WorkspaceBounds, p: Vector) -> WorkspaceBounds:
    """The workspace, widened to contain ``p``: an arm that stands outside may come back, no further out."""
    box = space.box.copy()
    for axis in range(3):
        box[axis, 0], box[axis, 1] = min(box[axis, 0], p[axis]), max(box[axis, 1], p[axis])
    return WorkspaceBounds(box, min(space.radius_min, math.hypot(p[0], p[1])))
