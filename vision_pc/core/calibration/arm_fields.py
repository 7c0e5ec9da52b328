"""How a slewing boom's usual errors move its tool: displacement fields of known shape, each of unknown size.

An error δ of the lift's or tilt's zero rotates everything beyond that joint about its axis r (horizontal,
across the slewing plane): the TCP at p moves by δ r × (p − root). Gravity bends a link as a load at its tip
bends a cantilever. Deflection F L³/(3 E I) over slope F L²/(2 E I) is 2 L / 3: the tip moves as if the link
had a hinge at a third of its length from the root. The moment grows with the horizontal reach from there, so
that the TCP moves by κ · reach · r × (p − hinge).

The shapes follow from the arm's nominal dimensions; the local error model estimates the four sizes. They hold
beyond the calibration path, where an affine model alone is wrong by millimetres.
Source: this derivation, first order in the errors; the chain is Mäkinen et al. 2023, Table 1.
"""

import numpy as np

from nominal_arm.dimensions import BoomDimensions
from vision_pc.core.se3 import Array

FIELDS = ("lift offset", "tilt offset", "boom bending", "forearm bending")
_HINGE = 1.0 / 3.0  # of a link from its root: equivalent hinge of a cantilever loaded at its tip


def error_fields(X_BT: Array, dimensions: BoomDimensions) -> Array:
    """Displacement of the TCP in B, (n, 3, 4), for a unit of each of ``FIELDS`` at the poses (n, 4, 4).

    Units: m per rad of zero offset; m per rad of bending at one metre of reach.
    """
    p = X_BT[:, :3, 3]
    wrist, forward, raising, lift, tilt = _skeleton(X_BT, dimensions)
    fields = [np.cross(raising, p - root) for root in (lift, tilt)]
    for root, tip in ((lift, tilt), (tilt, wrist)):
        hinge = root + _HINGE * (tip - root)
        reach = ((wrist - hinge) * forward).sum(axis=1)
        fields.append(np.cross(raising, p - hinge) * reach[:, None])
    return np.stack(fields, axis=2)


def boom_levers(X_BT: Array, dimensions: BoomDimensions) -> Array:
    """Displacement of the wrist, and of a tool whose axes are held, in B (3, 3) at the pose (4, 4): columns
    for a radian of slew, lift and tilt.
    """
    wrist, _, raising, lift, tilt = (rows[0] for rows in _skeleton(X_BT[None], dimensions))
    turns = (
        np.array([-wrist[1], wrist[0], 0.0]),
        *(np.cross(raising, wrist - root) for root in (lift, tilt)),
    )
    return np.column_stack(turns)


def joint_turns(X_BT: Array, Y_BT: Array, dimensions: BoomDimensions) -> Array:
    """Turns (3,) rad of slew, lift and tilt that are in the small step between two poses (4, 4)."""
    back = dimensions.wrist_to_tool
    step = Y_BT[:3, 3] - X_BT[:3, 3] - back * (Y_BT[:3, 2] - X_BT[:3, 2])
    return np.asarray(np.linalg.solve(boom_levers(X_BT, dimensions), step), dtype=np.float64)


def _skeleton(X_BT: Array, dimensions: BoomDimensions) -> tuple[Array, Array, Array, Array, Array]:
    """Wrist, unit vectors forward and of what turns forward into up, lift and tilt pivots, each (n, 3)."""
    wrist = np.asarray(X_BT[:, :3, 3] - dimensions.wrist_to_tool * X_BT[:, :3, 2])
    slew = np.arctan2(wrist[:, 1], wrist[:, 0])
    zero = np.zeros_like(slew)
    forward = np.column_stack([np.cos(slew), np.sin(slew), zero])
    raising = np.column_stack([np.sin(slew), -np.cos(slew), zero])
    lift = dimensions.lift_pivot[0] * forward + np.array([0.0, 0.0, dimensions.lift_pivot[1]])
    tilt = lift + _to_tilt(wrist - lift, forward, dimensions)
    return wrist, forward, raising, lift, tilt


def _to_tilt(to_wrist: Array, forward: Array, dimensions: BoomDimensions) -> Array:
    """Vectors (n, 3) from lift to tilt, elbow up; straight where the wrist is out of the nominal reach."""
    along, up = (to_wrist * forward).sum(axis=1), to_wrist[:, 2]
    distance = np.hypot(along, up)
    cosine = (dimensions.boom**2 + distance**2 - dimensions.forearm**2) / (2.0 * dimensions.boom * distance)
    angle = np.arctan2(up, along) + np.arccos(np.clip(cosine, -1.0, 1.0))
    to_tilt = dimensions.boom * np.cos(angle)[:, None] * forward
    to_tilt[:, 2] += dimensions.boom * np.sin(angle)
    return np.asarray(to_tilt)
