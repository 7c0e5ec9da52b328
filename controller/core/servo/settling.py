"""When a joint's integral stops, and when the arm is settled: from then on the tool stays where it is.

(4) with (5) is integral action around (6). While a joint crosses the play before its encoder nothing is seen
to move, and an integral that goes on winds up until the joint has crossed all of it: millimetres at the tool.
So the integral of a joint stops once its error is inside the dead zone, and begins again only beyond the
tolerance. The arm is settled when every joint has stood still inside the tolerance for long enough.
"""

import math
from typing import NamedTuple

import numpy as np

from controller.core.kinematics.rotations import Array
from foundation.compiled import kernel

ERROR_FILTER_S = 0.5  # [D] the encoder's noise dithers its digits: their mean is good for a tenth of one
# Of the tolerance, within ``settled.time_ms``: a joint that has moved on by no more stands still. Of a
# quarter, within 2 s, machines settle 4 s later and the tool moves on as far.
STILL = 0.4  # [D]


class Settling(NamedTuple):
    """What is remembered of the joints from scan to scan, (6,) each.

    ``held``: 1 where the integral has stopped. ``error``: the joint-equivalent error, filtered (rad);
    ``stood``: that, when the joint was last found to move.
    """

    held: Array
    error: Array
    stood: Array


MOVING = Settling(np.zeros(6), np.zeros(6), np.zeros(6))


@kernel
def settle_joint(
    i: int, before: Settling, error: float, zones: tuple[float, float], dt_s: float
) -> tuple[float, float, float, bool]:
    """``held``, ``error`` and ``stood`` of joint ``i``, and whether it stands still inside the tolerance.

    ``error`` (rad) now; ``zones`` (rad): where its integral stops, and the tolerance, where it begins again.
    """
    dead_zone, tolerance = zones
    held, stood = before.held[i], before.stood[i]
    keep = math.exp(-dt_s / ERROR_FILTER_S)
    filtered = keep * before.error[i] + (1.0 - keep) * error
    if abs(error) <= dead_zone:
        held = 1.0
    elif abs(filtered) > tolerance:
        held = 0.0
    still = abs(filtered - stood) <= STILL * tolerance
    return held, filtered, stood if still else filtered, still and abs(filtered) <= tolerance
