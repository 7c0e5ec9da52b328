"""Parking: how joints at the end of their way come to rest with valves shut, and are held where they are.

A continuous law hunts at a deadband: its integral winds up while nothing moves, and unwinds too late. Here
the joint law has its time to arrive. Then, or when it did not, the valve is shut, and a joint that is outside
its band is jogged. Nothing winds up, and a joint in position has its valve in the centre. Once the arm is
settled no joint is brought nearer any more: a jog takes a joint through its backlash and swings the boom, so
the tool goes on by millimetres for a tenth of a milliradian. Only what gravity makes creep is held.
"""

import math

import numpy as np

from controller.core.kinematics.rotations import Array
from controller.core.parking.jogs import jog_spool, start_jog
from controller.core.parking.joint import FOLLOW, SHUT, Joint, Joints, ParkingLaw
from controller.core.servo.servo_step import (
    LEFT,
    PT1,
    Q_CMD,
    QD_CMD,
    VALVES,
    ServoConstants,
    ServoInput,
    full_spool_speeds,
    servo_step,
)
from foundation.compiled import kernel

_ERROR_FILTER_S = 0.5  # [D] the encoder's noise dithers its digits: their mean is good for a tenth of one
_RATE_FILTER_S = 0.5  # [D] of the speed of a joint that is shut,
_RELAXES_S = 2.0  # [M] which goes on for so long: friction lets go of compressed oil
_CREEP_FILTER_S = 3.0  # [D] of the slow creep of a settled joint: good for a microradian
_WATCHED_S = 8.0  # [D] so long a settled joint is watched before it is moved
_ARRIVED_RAD = 9.6e-5  # [D] two digits: until the arm is settled, no joint is brought nearer
_HELD_RAD = 4.8e-5  # [D] a digit: nor is a settled one held nearer
_PART = 0.5  # [M] of its way: a slew near its place, which relaxes by as much again
_AGAIN_RAD = 7e-6  # [E] a settled joint that has dragged its encoder on by so much since its last jog creeps


@kernel
def control_step(
    constants: ServoConstants,
    law: ParkingLaw,
    given: ServoInput,
    speeds: Array,
    settled: bool,
    out: Array,
    joints: Joints,
) -> tuple[bool, bool]:
    """``servo_step`` with parking in place of the joint law, joint by joint; what it returns.

    ``speeds`` (6,): of the joints (rad/s). ``joints`` (6,) of JOINT is written to, unless commands are not
    finite. A joint stands still when, besides, its valve is shut for good.
    """
    finite, stands = servo_step(constants, given, law.dt_s, out)
    if not finite:
        return False, False
    servo, J_BT, gains = constants.joints, given.tool.J_BT, np.empty(2)
    full = full_spool_speeds(constants.drives, given.q_meas, constants.rated, given.circuit, given.slow_load)
    for i in range(6):
        joint = joints[i]
        lever = max(math.sqrt(J_BT[0, i] ** 2 + J_BT[1, i] ** 2 + J_BT[2, i] ** 2), 1e-3)
        least, most = (_HELD_RAD, _ARRIVED_RAD) if settled else (_ARRIVED_RAD, law.band_most)
        band = min(max(law.band / lever, least), most)
        seen = (out[LEFT, i], given.felt.load[i], speeds[i])
        joint.since += law.dt_s
        if joint.phase == FOLLOW and not _has_arrived(law, joint, i, seen, band):
            stands = False
            continue
        joint.away += law.dt_s
        for side in range(2):
            slope = servo.curve[i, side, 1, 1] / servo.curve[i, side, 1, 0]
            gains[side] = servo.flow_gain[i, side] * slope * full[i, side]
        spool, rests = joint_spool(law, joint, i, seen, band, settled, gains)
        stands = stands and rests
        out[VALVES, i] = max(-servo.limit, min(servo.limit, spool))
        out[Q_CMD, i], out[QD_CMD, i], out[PT1, i] = given.q_meas[i], 0.0, 0.0
    return True, stands


@kernel
def _has_arrived(
    law: ParkingLaw, joint: Joint, i: int, seen: tuple[float, float, float], band: float
) -> bool:
    """Whether the joint law is done with joint ``i``, which then is shut."""
    error, load, _ = seen
    joint.inside = joint.inside + law.dt_s if abs(error) < band else 0.0
    if joint.inside < 2.0 * law.shutting[i] and joint.since < law.patience:
        return False
    joint.phase, joint.since, joint.rate = SHUT, 0.0, 0.0
    joint.error, joint.oil = error, error - law.oil_spring[i] * load
    return True


@kernel
def joint_spool(
    law: ParkingLaw,
    joint: Joint,
    i: int,
    seen: tuple[float, float, float],
    band: float,
    settled: bool,
    gains: Array,
) -> tuple[float, bool]:
    """The spool command of joint ``i`` behind a shut valve, or in a jog, and whether it may stay where it is.

    ``seen`` and ``gains``: see ``jog_spool``; ``band`` (rad): error that is small enough.
    """
    if joint.phase != SHUT:
        return float(jog_spool(law, joint, i, seen, gains)), False
    error, load, _ = seen
    pause, before = 2.0 * law.shutting[i], joint.error
    keep = math.exp(-law.dt_s / min(max(0.3 * joint.since, 0.02), _ERROR_FILTER_S))
    joint.error = keep * before + (1.0 - keep) * error
    joint.oil = keep * joint.oil + (1.0 - keep) * (error - law.oil_spring[i] * load)
    if settled:
        keep = math.exp(-law.dt_s / _CREEP_FILTER_S)
        joint.slow = keep * joint.slow + (1.0 - keep) * error
    else:
        joint.slow = joint.place = joint.mark = joint.error
    if joint.since < pause:
        return 0.0, False
    joint.rate += ((joint.error - before) / law.dt_s - joint.rate) * law.dt_s / _RATE_FILTER_S
    watched = joint.since - pause
    way = _way_to_hold(law, joint, i, band, watched) if settled else _way_there(law, joint, i, band)
    off = abs(way) > 0.0
    # how far a joint goes on that leaves its place is told by waiting: a jog for a guess makes it hunt
    waits = _RELAXES_S if way * joint.rate > 0.0 else _RATE_FILTER_S
    if not off or watched < waits:
        return 0.0, not off and watched > _RELAXES_S
    joint.mark = joint.slow
    return float(start_jog(law, joint, i, way)), False


@kernel
def _way_there(law: ParkingLaw, joint: Joint, i: int, band: float) -> float:
    """How far (rad, with its sign) joint ``i`` has to be moved before it may settle; 0: it may."""
    off = joint.error + joint.rate * _RELAXES_S
    least = band if law.loaded[i] > 0.0 and joint.away < law.stays else max(law.tolerance, band)
    if abs(off) <= least:
        return 0.0
    relaxes = law.loaded[i] == 0.0 and abs(off) < 2.0 * law.tolerance
    return float(_PART * off if relaxes else off)


@kernel
def _way_to_hold(law: ParkingLaw, joint: Joint, i: int, band: float, watched: float) -> float:
    """How far (rad, with its sign) settled joint ``i`` has to be moved lest it creep away; 0: not now.

    A joint without load is left alone. One that sinks drags its encoder only when it has sunk through the
    play before it, so it is raised by more than the encoder shows, and not again before that moves on.
    """
    sense = 1.0 if joint.slow > joint.place else -1.0
    crept = sense * (joint.slow - joint.place)
    joint.mark = sense * min(sense * joint.mark, sense * joint.slow)
    again = sense * (joint.slow - joint.mark) > _AGAIN_RAD
    if law.loaded[i] == 0.0 or watched < _WATCHED_S or crept < band or not again:
        return 0.0
    return float(sense * min(crept, 2.0 * band))
