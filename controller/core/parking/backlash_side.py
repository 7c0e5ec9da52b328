"""On which side of the backlash before its encoder a joint stands, and how far off it is left for that.

A joint drags its encoder along. One that overshot stands on the side of its last turn; bringing it back takes
it through its whole backlash first, and the encoder shows nothing of that. So a joint is brought back only
when it is farther off than its backlash is wide, and by what any joint may be off.
"""

import math

import numpy as np

from controller.core.kinematics.rotations import Array
from controller.core.parking.joint import Joint, Joints, ParkingLaw
from foundation.compiled import kernel

_FILTER_S = 0.05  # [D] of the encoder: a third of its noise
_TURNED_RAD = 9.6e-5  # [D] two digits: a joint that came back by less may not have


@kernel
def follow_backlash_sides(joints: Joints, q_meas: Array, dt_s: float) -> None:
    """Follow the sense in which each encoder, at ``q_meas`` (6,), went last; in motion, too."""
    keep = math.exp(-dt_s / _FILTER_S)
    for i in range(6):
        side = joints[i].side
        if side.angle == 0.0 and side.furthest == 0.0:  # the first scan
            side.angle = side.furthest = q_meas[i]
        side.angle = keep * side.angle + (1.0 - keep) * q_meas[i]
        beyond = side.angle - side.furthest
        if side.sense * beyond > 0.0:
            side.furthest = side.angle
        elif abs(beyond) > _TURNED_RAD:
            turn_towards(joints[i], 1.0 if beyond > 0.0 else -1.0)


@kernel
def turn_towards(joint: Joint, sense: float) -> None:
    """The joint is on its way to the side of a turn in ``sense``, ±1."""
    joint.side.sense, joint.side.furthest = sense, joint.side.angle


@kernel
def allowed_offset(law: ParkingLaw, joint: Joint, i: int, off: float, least: float) -> float:
    """How far off (rad) joint ``i``, which is ``off`` (rad), may stay: by ``least``, and its backlash.

    A loaded one only where it was raised too far, and never so far that the arm would not be settled: it
    sinks by itself, and being raised brings it to the same side each time.
    """
    if off * joint.side.sense >= 0.0 or (law.loaded[i] > 0.0 and off > 0.0):
        return least
    most = least + law.backlash[i]
    return float(most if law.loaded[i] == 0.0 else min(most, max(least, law.settled)))


@kernel
def overshot(law: ParkingLaw, joint: Joint, i: int, off: float) -> bool:
    """Whether joint ``i``, ``off`` (rad), passed its end by less than what it is left at for its backlash."""
    passed = law.loaded[i] == 0.0 and law.backlash[i] > 0.0 and off * joint.side.sense < 0.0
    return bool(passed and abs(off) <= allowed_offset(law, joint, i, off, law.settled))


def all_within(law: ParkingLaw, joints: Joints, off: Array, least: float) -> bool:
    """Whether all joints, ``off`` (6,) rad, may stay: within ``least``, and the slew within its backlash."""
    passed = (off * joints["side"]["sense"] < 0.0) & (law.loaded == 0.0)
    most = np.where(passed, least + law.backlash, least)
    return bool((np.abs(off) <= most).all())
