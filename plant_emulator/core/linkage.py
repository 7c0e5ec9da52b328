"""From joint angle to actuator position: cylinder linkages on lift and tilt, rotary actuators elsewhere.

A cylinder spans the triangle of two sides ``base`` and ``lever`` about the joint's pivot:
x = √(L² + l² + 2 L l cos(θ − θ0)) − x0 (geometry of the published HIAB XS 031 model).
"""

import math

from numba import njit

CYLINDER = 0.0
ROTARY = 1.0


@njit(cache=True, error_model="numpy")
def actuator_position(
    angle: float, kind: float, base: float, lever: float, angle0: float, length0: float
) -> float:
    """Piston position (m) or vane angle (rad) from its retracted end, at joint ``angle``."""
    if kind == ROTARY:
        return angle - angle0
    return math.sqrt(base * base + lever * lever + 2.0 * base * lever * math.cos(angle - angle0)) - length0


@njit(cache=True, error_model="numpy")
def actuator_lever(
    angle: float, kind: float, base: float, lever: float, angle0: float, length0: float
) -> float:
    """dx/dθ (m/rad for a cylinder, 1 for a rotary actuator) at joint ``angle``."""
    if kind == ROTARY:
        return 1.0
    reduced = angle - angle0
    length = math.sqrt(base * base + lever * lever + 2.0 * base * lever * math.cos(reduced))
    return -base * lever * math.sin(reduced) / length


def cylinder_angle(position: float, base: float, lever: float, angle0: float, length0: float) -> float:
    """The joint angle (rad) at piston ``position``, on the branch where extension raises the angle."""
    length = position + length0
    cosine = (length * length - base * base - lever * lever) / (2.0 * base * lever)
    return angle0 - math.acos(cosine)
