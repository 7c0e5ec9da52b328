"""What parking remembers of a joint from scan to scan, and the law by which it parks.

Angles are rad, loads bar, times s, spools shares of the full stroke; errors are reference minus encoder.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controller.core.kinematics.rotations import Array

# Phases. FOLLOW: the joint law drives it. SHUT: its valve is in the centre. JOG: its valve is open until
# enough oil has passed.
FOLLOW, SHUT, JOG = range(3)

JOINT = np.dtype(
    [
        ("phase", "i8"),
        ("since", "f8"),  # time in this phase
        ("inside", "f8"),  # for how long the joint law has had it inside its band
        ("away", "f8"),  # time since the joint law let go of it
        ("error", "f8"),  # filtered
        ("oil", "f8"),  # error less what the oil is compressed by: it changes by what flows alone
        ("rate", "f8"),  # of the oil through an open valve, of the error of a shut joint (rad/s)
        ("sense", "f8"),  # of the jog: ±1
        ("spool", "f8"),  # of the jog, without its sign
        ("start", "f8"),  # error when the jog began
        ("oil_start", "f8"),  # ``oil`` then
        ("travel", "f8"),  # that the jog is for
        ("slow", "f8"),  # error of a settled joint, filtered for seconds: its creep
        ("place", "f8"),  # error at which the joint settled
        ("mark", "f8"),  # least ``slow``, away from ``place``, since the last jog
    ],
    align=True,
)
Joint = Any  # one record of an array of JOINT
Joints = NDArray[np.void]  # six of them


class ParkingLaw(NamedTuple):
    """Constants of parking; arrays are (6,) or (6, 2): raising and lowering.

    ``band`` (m, of the tool at the joint's lever), at most ``band_most`` (rad): error at which a shut joint
    is jogged. ``slowest``: of a jog (rad/s). ``patience`` (s): time that the joint law has to arrive.
    ``tolerance`` (rad): error with which a joint may stay when it has been jogged for ``stays`` (s).
    ``early`` (spool): where a jog begins, ``doubt`` before the valve is known to open; ``surely_open``:
    beyond it a valve is open. ``latest`` (s): from a command until motion is seen; ``shutting`` (s): how long
    a joint moves on when its valve is told to shut. ``loaded``: 1 where gravity makes a joint creep, 0 where
    it only relaxes. ``oil_spring`` (rad/bar): how far a joint moves with its valve shut as the load falls; 0:
    the encoder alone ends its jogs. ``dt_s``: of a scan.
    """

    band: float
    band_most: float
    slowest: float
    patience: float
    tolerance: float
    stays: float
    early: Array
    doubt: Array
    surely_open: Array
    latest: Array
    shutting: Array
    loaded: Array
    oil_spring: Array
    dt_s: float


def joints_in_motion() -> Joints:
    """Six records of JOINT that the joint law drives."""
    return np.zeros(6, dtype=JOINT)
