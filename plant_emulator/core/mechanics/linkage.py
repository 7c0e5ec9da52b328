"""From joint angle to actuator position: cylinder linkages on lift and tilt, rotary actuators elsewhere.

A cylinder spans the triangle of two sides ``base`` and ``lever`` about the joint's pivot:
x = √(L² + l² + 2 L l cos(θ − θ0)) − x0 (geometry of the published HIAB XS 031 model).
"""

import math

from foundation.compiled import allocation_free

CYLINDER = 0.0
ROTARY = 1.0


@allocation_free
def actuator_reach(
    angle: float, kind: float, base: float, lever: float, angle0: float, length0: float
) -> tuple[float, float]:
    """Piston position (m) or vane angle (rad) from its retracted end at joint ``angle``, and its slope dx/dθ.

    The slope is the lever arm of a cylinder (m/rad), and 1 for a rotary actuator.
    """
    if kind == ROTARY:
        return angle - angle0, 1.0
    reduced, sides = angle - angle0, base * lever
    length = math.sqrt(base * base + lever * lever + 2.0 * sides * math.cos(reduced))
    return length - length0, -sides * math.sin(reduced) / length


@allocation_free
def actuator_position(
    angle: float, kind: float, base: float, lever: float, angle0: float, length0: float
) -> float:
    """Piston position (m) or vane angle (rad) from its retracted end, at joint ``angle``."""
    return actuator_reach(angle, kind, base, lever, angle0, length0)[0]


@allocation_free
def actuator_lever(
    angle: float, kind: float, base: float, lever: float, angle0: float, length0: float
) -> float:
    """dx/dθ (m/rad for a cylinder, 1 for a rotary actuator) at joint ``angle``."""
    return actuator_reach(angle, kind, base, lever, angle0, length0)[1]
