"""When the arm has come to rest, and is parked: from then on no joint is brought nearer to its reference.

A jog takes a joint through the backlash behind its encoder and swings the boom: the tool goes on by
millimetres for a tenth of a milliradian. So a joint that has been calm inside the tolerance stays where it
is, and the arm *rests* when all of them do. Only then does it count as settled.
"""

import math

import numpy as np

from controller.core.kinematics.rotations import Array
from controller.core.parking.jogs import soft_gain
from controller.core.parking.joint import (
    ARM_RESTS,
    FOLLOW,
    HOLD,
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


ARRIVED_RAD = 9.6e-5  # [D] two digits: until the arm is parked, no joint is brought nearer
_PUSHED_RAD = 9.6e-5  # [D] two digits: a resting joint that others have pushed so far is judged anew
_NEARLY = 1.5  # [D] of ARRIVED_RAD: a held joint stays there
_CREEP_FILTER_S = 3.0  # [D] of the slow creep of a parked joint: good for a microradian
_QUIET_S = 10.0  # [D] the arm is parked when no joint moved for so long,
_HOLDS_S = 35.0  # [M] nor a held one, which by then leans on one side of the backlash before its encoder,
_LONGEST_S = 300.0  # [D] or when its joints have been away from the joint law for so long
_QUIET_BAR = 0.05  # [E] with a slew of 4 cm³/degree 0.01 mrad of its friction
_STEADY_RAD_S = 1e-5  # [M] and whose leak changes by no more: oil that drains away took a lift 1.5 mm along


@kernel
def watch_creep(law: ParkingLaw, joint: Joint, i: int, lever: float, error: float, load: float) -> None:
    """Count how long joint ``i`` has moved the tool by no more than the quiet, and been off the joint law.

    One without load relaxes within the backlash before its encoder; the oil, ``load`` (bar), tells how long.
    """
    watch, leak = joint.watch, joint.leak
    keep = math.exp(-law.dt_s / _CREEP_FILTER_S)
    watch.error = keep * watch.error + (1.0 - keep) * error
    watch.load = keep * watch.load + (1.0 - keep) * load
    watch.away += law.dt_s
    watch.quiet += law.dt_s
    relaxes = law.loaded[i] == 0.0 and abs(watch.load - watch.load_at) > _QUIET_BAR
    if relaxes or abs(watch.error - watch.quiet_at) > law.quiet / lever:
        watch.quiet, watch.quiet_at, watch.load_at = 0.0, watch.error, watch.load
    leak.steady += law.dt_s
    if law.friction_spring[i] > 0.0 and abs(leak.bias - leak.steady_at) > _STEADY_RAD_S:
        leak.steady, leak.steady_at = 0.0, leak.bias


@kernel
def judge_rest(law: ParkingLaw, joint: Joint, i: int, lever: float) -> None:
    """Count how long joint ``i`` has been calm; let it rest where it is, or judge it anew."""
    watch, phase = joint.watch, joint.phase
    here = watch.error if phase == HOLD else joint.error
    watch.calm += law.dt_s
    if phase == JOG or abs(here - watch.calm_at) > law.calm_travel / lever:
        watch.calm, watch.calm_at = 0.0, here
    if phase != SHUT or joint.rest == ARM_RESTS:
        return
    off, error = abs(joint.error - joint.place), joint.error
    outside = abs(error) > allowed_offset(law, joint, i, error, law.settled)
    if joint.rest == JOINT_RESTS and (outside or off > _PUSHED_RAD):
        joint.rest, joint.place, watch.calm = MOVES, 0.0, 0.0
    elif joint.rest == MOVES and watch.calm > law.calm and not outside:
        joint.rest = JOINT_RESTS
        joint.place = joint.pulse.error = watch.error = joint.error


def unsettled_joints(law: ParkingLaw, joints: Joints) -> Array:
    """Which joints (6,) do not rest yet."""
    shut = (joints["phase"] == SHUT) & (joints["rest"] > MOVES)
    calm = (joints["watch"]["calm"] > law.calm) & (np.abs(joints["error"]) < law.settled)
    return np.asarray(~(shut | ((joints["phase"] == HOLD) & calm)))


def may_stop_here(law: ParkingLaw, joints: Joints) -> bool:
    """Whether no joint is on its way, and all are near enough: an arm whose time is over may stay so."""
    moves = np.isin(joints["phase"], (FOLLOW, JOG, PULSE))
    return bool(not moves.any() and all_within(law, joints, joints["error"], law.settled))


def arm_rested(joints: Joints) -> Joints:
    """``joints`` with the arm at rest: those behind shut valves stay where they are."""
    here = joints.copy()
    shut = joints["phase"] != HOLD
    anew = shut & (joints["rest"] == MOVES)
    for part in (here, here["pulse"], here["watch"]):
        name = "place" if part is here else "error"
        part[name] = np.where(anew, joints["error"], part[name])
    here["rest"] = np.where(shut, ARM_RESTS, joints["rest"])
    return here


@kernel
def is_parked(joints: Joints) -> bool:
    """Whether no joint moves the tool any more, each shut near its place or held; or it never will."""
    rests = too_long = True
    for i in range(6):
        joint = joints[i]
        quiet = joint.watch.quiet
        near = abs(joint.error - joint.place) < 1.5 * joint.band
        stands = joint.phase == SHUT and near and quiet > _QUIET_S
        holds = joint.phase == HOLD and min(quiet, joint.leak.steady) > _HOLDS_S
        rests = rests and (stands or holds)
        too_long = too_long and joint.phase != FOLLOW and joint.watch.away > _LONGEST_S
    return bool(rests or too_long)


def arm_parked(law: ParkingLaw, joints: Joints) -> Joints:
    """``joints`` with the arm parked: from now on they are kept where they rest.

    A held joint that is near its goal, too: it would take minutes to creep there, and the tool with it. Its
    valve stays as it is: what held it there, against its error and its load, is bias now.
    """
    here = joints.copy()
    shut, held = joints["phase"] == SHUT, joints["phase"] == HOLD
    near = held & (np.abs(joints["error"]) < ARRIVED_RAD * _NEARLY)
    here["rest"], here["place"] = ARM_RESTS, np.where(shut | near, joints["error"], 0.0)
    sunk = law.friction_spring * (joints["leak"]["load"] - joints["watch"]["load"])
    moved = joints["jog"]["sense"] * (here["place"] - joints["place"] + sunk)
    here["leak"]["bias"] += np.where(near, soft_gain(law) * moved, 0.0)
    here["leak"]["load"] = np.where(near, joints["watch"]["load"], joints["leak"]["load"])
    here["pulse"]["error"] = here["watch"]["error"] = here["place"]
    here["creep"] = np.where(shut, 0.0, joints["creep"])
    return here
