"""What parking remembers of a joint from scan to scan, and the law by which it parks.

A joint is a record with named parts: its state at rest, and one part for each thing that is learned of it.
Angles are rad, loads bar, times s, spools shares of the full stroke; errors are reference minus encoder.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controller.core.kinematics.rotations import Array

# Phases. FOLLOW: the joint law drives it. SHUT: its valve is in the centre. JOG: its valve opens until it has
# moved. PULSE: its valve opens until the load pressure has changed.
FOLLOW, SHUT, JOG, PULSE = range(4)

# How far a joint has come to rest: not yet; this joint; the whole arm.
MOVES, JOINT_RESTS, ARM_RESTS = range(3)


def _record(fields: list[Any]) -> np.dtype[np.void]:
    """A record of named fields, each at an address that its processor reads in one go."""
    return np.dtype(fields, align=True)


_WATCH = _record(
    [
        ("error", "f8"),  # filtered for seconds: the creep
        ("load", "f8"),  # filtered for seconds
        ("inside", "f8"),  # for how long a joint that follows has been inside its band
        ("away", "f8"),  # for how long the joint law has not driven it
        ("quiet", "f8"),  # for how long ``error`` has been about ``quiet_at``, and ``load`` about ``load_at``
        ("quiet_at", "f8"),
        ("load_at", "f8"),
        ("calm", "f8"),  # for how long it has been near ``calm_at``
        ("calm_at", "f8"),
    ]
)
_JOG = _record(
    [
        ("sense", "f8"),  # ±1, of the last move of any kind
        ("spool", "f8"),  # without its sign
        ("start", "f8"),  # error at which it began
        ("end", "f8"),  # error when the joint had come to rest after it
        ("seen", "i8"),  # the joint moved
        ("fine", "i8"),  # shorter than can be watched well
    ]
)
_PULSE = _record(
    [
        ("error", "f8"),  # ``watch.error`` at the last one
        ("load", "f8"),  # at which it began
        ("since", "f8"),  # time since
        ("dragged", "f8"),  # for how long the joint has dragged its encoder along since
        ("spool", "f8", (2,)),  # where the next begins, raising and lowering; 0 before the first
        ("push", "f8", (2,)),  # change of the load that ends it
    ]
)
_OIL = _record(
    [
        ("error", "f8"),  # error less what the oil is compressed by: it changes by what flows alone
        ("start", "f8"),  # that, when the valve opened
        ("rate", "f8"),  # of the oil through an open valve, of the error of a shut joint (rad/s)
        ("travel", "f8"),  # that the last jog was for
    ]
)
_VALVE = _record([("edge", "f8", (2,)), ("doubt", "f8", (2,))])  # where it opens, raising and lowering
JOINT = _record(
    [
        ("phase", "i8"),
        ("since", "f8"),  # time in this phase
        ("speed", "f8"),  # filtered (rad/s)
        ("error", "f8"),  # filtered
        ("band", "f8"),  # error that is small enough
        ("rest", "i8"),
        ("place", "f8"),  # error where it came to rest; 0 before
        ("creep", "f8"),  # of the shut joint, as a rate of its error (rad/s)
        ("watch", _WATCH),
        ("jog", _JOG),
        ("pulse", _PULSE),
        ("oil", _OIL),
        ("valve", _VALVE),
    ],
)
Joint = Any  # one record of an array of JOINT
Joints = NDArray[np.void]  # six of them

_EARLY = 0.1  # [E] of its deadband, before its edge: there a metered jog begins, however well that is known


class ParkingLaw(NamedTuple):
    """Constants of parking; arrays are (6,) or (6, 2): raising and lowering.

    ``band`` (m, of the tool at the joint's lever) between ``band_least`` and ``band_most`` (rad): error at
    which a shut joint is moved. ``slowest``, ``fastest``: of a jog (rad/s). ``patience`` (s): time that the
    joint law has to arrive. ``calm_travel`` (m), ``calm`` (s): a joint rests that moved the tool by no more
    for so long, and is brought back when it is ``settled`` (rad) off. ``give_up`` (s): after a motion, an
    arm that does not come to rest counts as resting. ``quiet`` (m): the arm is parked when no joint moved the
    tool by more in 10 s. ``deadband``, ``spread``: what is known of it when it opens (spool). ``latest`` (s):
    from a command until motion is seen; ``shutting`` (s): how long a joint moves on when its valve is told
    to shut. ``loaded``: 1 where gravity makes a joint creep, 0 where it only relaxes. ``oil_spring``
    (rad/bar): how far a joint moves with its valve shut as the load falls; 0: jogs are not metered.
    ``surely_open``: spool beyond which a valve is open. ``dt_s``: of a scan.
    """

    band: float
    band_least: float
    band_most: float
    slowest: float
    fastest: float
    patience: float
    calm_travel: float
    calm: float
    settled: float
    give_up: float
    quiet: float
    deadband: Array
    spread: Array
    latest: Array
    shutting: Array
    loaded: Array
    oil_spring: Array
    surely_open: Array
    dt_s: float


def joints_at_start(law: ParkingLaw | None) -> Joints:
    """Six records of JOINT before the first move: every valve as it is known."""
    joints = np.zeros(6, dtype=JOINT)
    if law is not None:
        early = np.where(law.oil_spring[:, None] > 0.0, _EARLY * law.deadband, 0.0)
        joints["valve"]["edge"] = law.deadband
        joints["valve"]["doubt"] = np.maximum(law.spread, early)
    return joints


def joints_in_motion(joints: Joints) -> Joints:
    """``joints`` when a motion begins: the joint law drives all of them; what was learned is kept."""
    moving = joints.copy()
    for name in ("since", "place", "creep"):
        moving[name] = 0.0
    moving["phase"], moving["rest"] = FOLLOW, MOVES
    for part, names in _FORGOTTEN.items():
        for name in names:
            moving[part][name] = 0.0
    return moving


_FORGOTTEN = {
    "watch": ("inside", "away", "quiet", "calm"),
    "pulse": ("error", "since"),
}
"""Part → what of it a motion makes untrue."""


def offsets_from_place(joints: Joints) -> Array:
    """How far (rad) each joint (6,) is off its place, by its filtered encoder."""
    return np.asarray(joints["error"] - joints["place"])
