"""When the arm has come to rest, and is parked: from then on no joint is brought nearer to its reference.

A jog takes a joint through the backlash behind its encoder and swings the boom: the tool goes on by
millimetres for a tenth of a milliradian. So a joint that has been calm inside the tolerance stays where it
is, and the arm *rests* when all of them do. Only then does it count as settled.
"""

import math

import numpy as np

from controller.core.kinematics.rotations import Array
from controller.core.parking.joint import (
    ARM_RESTS,
    FOLLOW,
    JOG,
    JOINT_RESTS,
    MOVES,
    PULSE,
    SHUT,
    Joint,
    Joints,
    ParkingLaw,
)
from foundation.compiled import kernel

ARRIVED_RAD = 9.6e-5  # [D] two digits: until the arm is parked, no joint is brought nearer
_PUSHED_RAD = 9.6e-5  # [D] two digits: a resting joint that others have pushed so far is judged anew
_CREEP_FILTER_S = 3.0  # [D] of the slow creep of a parked joint: good for a microradian
_QUIET_S = 10.0  # [D] the arm is parked when no joint moved for so long,
_LONGEST_S = 300.0  # [D] or when its joints have been away from the joint law for so long
_QUIET_BAR = 0.05  # [E] with a slew of 4 cm³/degree 0.01 mrad of its friction


@kernel
def watch_creep(law: ParkingLaw, joint: Joint, i: int, lever: float, error: float, load: float) -> None:
    """Count how long joint ``i`` has moved the tool by no more than the quiet, and been off the joint law.

    One without load relaxes within the backlash before its encoder; the oil, ``load`` (bar), tells how long.
    """
    watch = joint.watch
    keep = math.exp(-law.dt_s / _CREEP_FILTER_S)
    watch.error = keep * watch.error + (1.0 - keep) * error
    watch.load = keep * watch.load + (1.0 - keep) * load
    watch.away += law.dt_s
    watch.quiet += law.dt_s
    relaxes = law.loaded[i] == 0.0 and abs(watch.load - watch.load_at) > _QUIET_BAR
    if relaxes or abs(watch.error - watch.quiet_at) > law.quiet / lever:
        watch.quiet, watch.quiet_at, watch.load_at = 0.0, watch.error, watch.load


@kernel
def judge_rest(law: ParkingLaw, joint: Joint, i: int, lever: float) -> None:
    """Count how long joint ``i`` has been calm; let it rest where it is, or judge it anew."""
    watch, phase = joint.watch, joint.phase
    watch.calm += law.dt_s
    if phase == JOG or abs(joint.error - watch.calm_at) > law.calm_travel / lever:
        watch.calm, watch.calm_at = 0.0, joint.error
    if phase != SHUT or joint.rest == ARM_RESTS:
        return
    off, error = abs(joint.error - joint.place), joint.error
    outside = abs(error) > law.settled
    if joint.rest == JOINT_RESTS and (outside or off > _PUSHED_RAD):
        joint.rest, joint.place, watch.calm = MOVES, 0.0, 0.0
    elif joint.rest == MOVES and watch.calm > law.calm and not outside:
        joint.rest = JOINT_RESTS
        joint.place = joint.pulse.error = watch.error = joint.error


def unsettled_joints(joints: Joints) -> Array:
    """Which joints (6,) do not rest yet."""
    return np.asarray((joints["phase"] != SHUT) | (joints["rest"] == MOVES))


def may_stop_here(law: ParkingLaw, joints: Joints) -> bool:
    """Whether no joint is on its way, and all are near enough: an arm whose time is over may stay so."""
    moves = np.isin(joints["phase"], (FOLLOW, JOG, PULSE))
    return bool(not moves.any() and (np.abs(joints["error"]) <= law.settled).all())


def arm_rested(joints: Joints) -> Joints:
    """``joints`` with the arm at rest: all stay where they are."""
    here = joints.copy()
    anew = joints["rest"] == MOVES
    here["place"] = np.where(anew, joints["error"], joints["place"])
    for part in (here["pulse"], here["watch"]):
        part["error"] = np.where(anew, joints["error"], part["error"])
    here["rest"] = ARM_RESTS
    return here


@kernel
def is_parked(joints: Joints) -> bool:
    """Whether no joint moves the tool any more, each shut near its place; or it never will."""
    rests = too_long = True
    for i in range(6):
        joint = joints[i]
        near = abs(joint.error - joint.place) < 1.5 * joint.band
        rests = rests and joint.phase == SHUT and near and joint.watch.quiet > _QUIET_S
        too_long = too_long and joint.phase != FOLLOW and joint.watch.away > _LONGEST_S
    return bool(rests or too_long)


def arm_parked(joints: Joints) -> Joints:
    """``joints`` with the arm parked: from now on they are kept where they rest."""
    here = joints.copy()
    shut = joints["phase"] == SHUT
    here["rest"], here["place"] = ARM_RESTS, np.where(shut, joints["error"], 0.0)
    here["pulse"]["error"] = here["watch"]["error"] = here["place"]
    here["creep"] = np.where(shut, 0.0, joints["creep"])
    return here
