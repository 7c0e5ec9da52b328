"""How turns of slew, lift and tilt move a tool whose axes are held, by the arm's nominal dimensions."""

import math

import numpy as np

from nominal_arm.dimensions import BoomDimensions
from vision_pc.core.se3 import Array


def slew_lever(X_BT: Array) -> Array:
    """Displacement (3,) of the TCP at ``X_BT`` in B for each radian of slew, m/rad."""
    return np.array([-X_BT[1, 3], X_BT[0, 3], 0.0])


def slew_angles(X_BT: Array, wrist_to_tool_m: float) -> Array:
    """Slew angles (N,) rad of poses (N, 4, 4): the wrist's centre lies on the slew plane."""
    wrist = X_BT[:, :3, 3] - wrist_to_tool_m * X_BT[:, :3, 2]
    return np.asarray(np.unwrap(np.arctan2(wrist[:, 1], wrist[:, 0])))


def boom_levers(X_BT: Array, dimensions: BoomDimensions) -> Array:
    """Displacement of the wrist, and of a tool whose axes are held, in B (3, 3) at the pose (4, 4): columns
    for a radian of slew, lift and tilt.
    """
    wrist = X_BT[:3, 3] - dimensions.wrist_to_tool * X_BT[:3, 2]
    slew = math.atan2(wrist[1], wrist[0])
    forward = np.array([math.cos(slew), math.sin(slew), 0.0])
    raising = np.array([math.sin(slew), -math.cos(slew), 0.0])
    lift = dimensions.lift_pivot[0] * forward + np.array([0.0, 0.0, dimensions.lift_pivot[1]])
    tilt = lift + _lift_to_tilt(wrist - lift, forward, dimensions)
    turns = np.cross(raising, np.array([wrist - lift, wrist - tilt]))
    return np.column_stack([np.array([-wrist[1], wrist[0], 0.0]), *turns])


def _lift_to_tilt(to_wrist: Array, forward: Array, dimensions: BoomDimensions) -> Array:
    """Vector (3,) from lift to tilt, elbow up; straight where the wrist is out of the nominal reach."""
    along, up = float(to_wrist @ forward), float(to_wrist[2])
    distance = math.hypot(along, up)
    cosine = (dimensions.boom**2 + distance**2 - dimensions.forearm**2) / (2.0 * dimensions.boom * distance)
    angle = math.atan2(up, along) + math.acos(min(max(cosine, -1.0), 1.0))
    return np.asarray(dimensions.boom * (math.cos(angle) * forward + np.array([0.0, 0.0, math.sin(angle)])))


def joint_turns(X_BT: Array, Y_BT: Array, dimensions: BoomDimensions) -> Array:
    """Turns (3,) rad of slew, lift and tilt that are in the small step between two poses (4, 4)."""
    back = dimensions.wrist_to_tool
    step = Y_BT[:3, 3] - X_BT[:3, 3] - back * (Y_BT[:3, 2] - X_BT[:3, 2])
    return np.asarray(np.linalg.solve(boom_levers(X_BT, dimensions), step), dtype=np.float64)
