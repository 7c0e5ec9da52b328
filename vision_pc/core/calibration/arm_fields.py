"""How a slewing boom's usual errors move its tool: shapes known from the arm's drawing, sizes to be learnt.

Offsets of lift and tilt turn what lies beyond them; gravity bends boom and forearm the more the farther the
load is out. Over the reach of a calibration path each of these is a smooth field with one unknown size. They
tell a map how to go on beyond its path, where a straight line would miss by millimetres.
Source: the 13-parameter model of the local-calibration study, linearised; hinges as in its "formulas".
"""

import numpy as np

from nominal_arm.dimensions import BoomDimensions
from vision_pc.core.se3 import Array

FIELDS = ("lift offset", "tilt offset", "boom bending", "forearm bending")
_HINGE = 1.0 / 3.0  # of a link from its root: a hinge there bends as a tip-loaded cantilever does


def error_fields(X_BT: Array, dimensions: BoomDimensions) -> Array:
    """Displacement of the TCP in B, (n, 3, 4), for a unit of each of ``FIELDS`` at the poses (n, 4, 4).

    Metres per radian of the offsets, and per radian of bending for every metre that the wrist is out.
    """
    p = X_BT[:, :3, 3]
    wrist = p - dimensions.wrist_to_tool * X_BT[:, :3, 2]
    slew = np.arctan2(wrist[:, 1], wrist[:, 0])
    zero = np.zeros_like(slew)
    forward = np.column_stack([np.cos(slew), np.sin(slew), zero])
    raising = np.column_stack([np.sin(slew), -np.cos(slew), zero])  # turns forward into up
    lift = dimensions.lift_pivot[0] * forward + np.array([0.0, 0.0, dimensions.lift_pivot[1]])
    tilt = lift + _to_tilt(wrist - lift, forward, dimensions)
    fields = [np.cross(raising, p - root) for root in (lift, tilt)]
    for root, tip in ((lift, tilt), (tilt, wrist)):
        hinge = root + _HINGE * (tip - root)
        out = ((wrist - hinge) * forward).sum(axis=1)
        fields.append(np.cross(raising, p - hinge) * out[:, None])
    return np.stack(fields, axis=2)


def _to_tilt(to_wrist: Array, forward: Array, dimensions: BoomDimensions) -> Array:
    """From lift to tilt (n, 3), elbow up; stretched where the wrist is out of reach by bending alone."""
    along, up = (to_wrist * forward).sum(axis=1), to_wrist[:, 2]
    distance = np.hypot(along, up)
    cosine = (dimensions.boom**2 + distance**2 - dimensions.forearm**2) / (2.0 * dimensions.boom * distance)
    angle = np.arctan2(up, along) + np.arccos(np.clip(cosine, -1.0, 1.0))
    to_tilt = dimensions.boom * np.cos(angle)[:, None] * forward
    to_tilt[:, 2] += dimensions.boom * np.sin(angle)
    return np.asarray(to_tilt)
