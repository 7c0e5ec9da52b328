"""Parking: how joints at the end of their way come to rest with valves shut, and are kept where they are.

A continuous law hunts at a deadband: its integral winds up while nothing moves, and unwinds too late. Here
the joint law has its time to arrive. Then, or when it did not, the valve is shut; a joint that leaves its
band is brought back by a jog: the valve is opened further and further in one direction until the joint moves,
and shut before it gets there. Nothing winds up, and a joint in position has its valve in the centre. Once the
arm is parked, what gravity makes creep is pulsed.
"""

import math

import numpy as np

from controller.core.kinematics.rotations import Array
from controller.core.parking.jogs import jog_spool, pulse_spool, shut_valve, start_jog, start_pulse
from controller.core.parking.joint import FOLLOW, MOVES, PULSE, SHUT, Joint, Joints, ParkingLaw
from controller.core.parking.metering import metered_spool, start_metered
from controller.core.parking.rest import ARRIVED_RAD, judge_rest, watch_creep
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

_SPEED_FILTER_S = 0.03  # [D]
_ERROR_FILTER_S = 0.5  # [D] the encoder's noise dithers its digits: their mean is good for a tenth of one
_RATE_FILTER_S = 0.5  # [D] of the speed of a metered joint that is shut,
_RELAXES_S = 2.0  # [M] which goes on for so long: friction lets go of compressed oil
_RATE_S = 1.0  # [D] a creep that was watched for this long is believed by half
_WATCHED_S = 4.0  # [D] so long a parked joint is watched before it is moved
_PULSED_AT = 0.5  # [D] of the band: a parked joint that crept so far is moved
_FAR_RAD = 1e-3  # [D] a parked joint that went so far is jogged back
_PART = 0.5  # [M] of its way: a slew near its place, which relaxes by as much again
_DRAGS_RAD = 3e-6  # [E] from there on a joint drags its encoder along again, and its creep shows
_AGAIN_RAD = 7e-6  # [E] beyond where its encoder was at the last pulse; the slow filter's noise is 1 µrad


@kernel
def control_step(
    constants: ServoConstants,
    law: ParkingLaw,
    given: ServoInput,
    turned: Array,
    stands: bool,
    out: Array,
    joints: Joints,
) -> tuple[bool, bool]:
    """``servo_step``, and while the arm ``stands`` ``park_step``.

    One kernel, because telling the types of ``given`` takes longer than the arithmetic. After commands that
    are not finite ``joints`` (6,) of JOINT are as they were.
    """
    finite, inside = servo_step(constants, given, law.dt_s, out)
    if finite and stands:
        park_step(constants, law, given, turned, out, joints)
    return finite, inside


@kernel
def park_step(
    constants: ServoConstants, law: ParkingLaw, given: ServoInput, turned: Array, out: Array, joints: Joints
) -> None:
    """Put parking in place of the joint law in ``out`` (of ``servo_step``), joint by joint.

    ``turned`` (6,): what the joints turned since the scan before (rad). ``joints`` is written to.
    """
    servo, J_BT = constants.joints, given.tool.J_BT
    speeds = full_spool_speeds(
        constants.drives, given.q_meas, constants.rated, given.circuit, given.slow_load
    )
    gains = np.empty(2)
    for i in range(6):
        joint, error, load = joints[i], out[LEFT, i], given.felt.load[i]
        lever = max(math.sqrt(J_BT[0, i] ** 2 + J_BT[1, i] ** 2 + J_BT[2, i] ** 2), 1e-3)
        least = law.band_least if joint.rest > MOVES else ARRIVED_RAD
        if law.loaded[i] == 0.0:
            least = law.band_most
        joint.band = min(max(law.band / lever, least), law.band_most)
        keep = math.exp(-law.dt_s / _SPEED_FILTER_S)
        joint.speed = keep * joint.speed + (1.0 - keep) * turned[i] / law.dt_s
        joint.since += law.dt_s
        joint.pulse.since += law.dt_s
        if joint.phase == FOLLOW and not _has_arrived(law, joint, i, error, load):
            continue
        for side in range(2):
            slope = servo.curve[i, side, 1, 1] / servo.curve[i, side, 1, 0]
            gains[side] = servo.flow_gain[i, side] * slope * speeds[i, side]
        spool = phase_spool(law, joints, i, error, load, gains)
        watch_creep(law, joint, i, lever, error, load)
        judge_rest(law, joint, i, lever)
        out[VALVES, i] = max(-servo.limit, min(servo.limit, spool))
        out[Q_CMD, i], out[QD_CMD, i], out[PT1, i] = given.q_meas[i], 0.0, 0.0


@kernel
def phase_spool(law: ParkingLaw, joints: Joints, i: int, error: float, load: float, gains: Array) -> float:
    """The spool command of joint ``i``, which is ``error`` (rad) off under ``load`` (bar), by its phase."""
    joint = joints[i]
    if joint.phase == SHUT:
        return float(_shut_spool(law, joints, i, error, load, gains))
    if joint.phase == PULSE:
        return float(pulse_spool(law, joint, i, error, load, gains))
    if law.oil_spring[i] > 0.0:
        return float(metered_spool(law, joint, i, error, load, gains))
    return float(jog_spool(law, joint, i, error, gains))


@kernel
def _has_arrived(law: ParkingLaw, joint: Joint, i: int, error: float, load: float) -> bool:
    """Whether the joint law is done with joint ``i``, which then is shut."""
    watch, oil = joint.watch, joint.oil
    watch.inside = watch.inside + law.dt_s if abs(error) < joint.band else 0.0
    if watch.inside < 2.0 * law.shutting[i] and joint.since < law.patience:
        return False
    shut_valve(joint, error)
    joint.creep, watch.away, watch.error = 0.0, 0.0, error
    oil.error, watch.load = error - law.oil_spring[i] * load, load
    return True


@kernel
def _shut_spool(law: ParkingLaw, joints: Joints, i: int, error: float, load: float, gains: Array) -> float:
    """The spool command of a shut valve: wait for the joint to rest, watch its creep, move it when due."""
    joint = joints[i]
    jog, oil, metered = joint.jog, joint.oil, law.oil_spring[i] > 0.0
    pause, before = 2.0 * law.shutting[i], joint.error
    keep = math.exp(-law.dt_s / min(max(0.3 * joint.since, 0.02), _ERROR_FILTER_S))
    joint.error = keep * before + (1.0 - keep) * error
    oil.error = keep * oil.error + (1.0 - keep) * (error - law.oil_spring[i] * load)
    if joint.since < pause:
        jog.end, oil.rate = joint.error, 0.0
        return 0.0
    oil.rate += ((joint.error - before) / law.dt_s - oil.rate) * law.dt_s / _RATE_FILTER_S
    watched = joint.since - pause
    rate = (joint.error - jog.end) / max(watched, 1e-3)
    off = joint.error - joint.place
    if metered and joint.rest == MOVES:
        off += oil.rate * _RELAXES_S
    pulsing = (joints["phase"] == PULSE).any()
    if not needs_move(law, joint, i, (off, rate, watched), pulsing):
        return 0.0
    return float(next_move(law, joint, i, (load, off, rate, watched)))


@kernel
def next_move(law: ParkingLaw, joint: Joint, i: int, seen: tuple[float, float, float, float]) -> float:
    """The first spool command of what brings shut joint ``i`` back.

    ``seen``: load (bar), how far off it is (rad), its rate (rad/s), for how long that was watched (s). A
    parked joint is pulsed when it creeps, and only then: a jog takes it through its backlash, of which the
    encoder sees nothing. One without load is left alone.
    """
    load, off, rate, watched = seen
    sense = 1.0 if off > 0.0 else -1.0
    if joint.rest > MOVES and abs(off) < _FAR_RAD:
        _measure_creep(joint, sense)
        return float(start_pulse(law, joint, i, joint.watch.error, sense, load))
    if law.oil_spring[i] > 0.0:
        relaxes = law.loaded[i] == 0.0 and abs(off) < 2.0 * law.settled
        return float(start_metered(joint, _PART * off if relaxes else off))
    trust = watched / (watched + _RATE_S)
    drift = trust * rate + (1.0 - trust) * joint.creep
    return float(start_jog(joint, off, drift, sense))


@kernel
def _measure_creep(joint: Joint, sense: float) -> None:
    """Believe how fast the joint crept while it dragged its encoder; after a pulse that stands for a while.

    The longer the way, the more. What it crept by before the arm was parked is forgotten: oil relaxed.
    """
    seen = max(sense * (joint.watch.error - joint.pulse.error) - _DRAGS_RAD, 0.0)
    trust = 1.0 if joint.creep == 0.0 else seen / (seen + _AGAIN_RAD - _DRAGS_RAD)
    creep = sense * seen / max(joint.pulse.dragged, _WATCHED_S)
    joint.creep += trust * (creep - joint.creep)
    joint.pulse.dragged = 0.0


@kernel
def needs_move(
    law: ParkingLaw, joint: Joint, i: int, seen: tuple[float, float, float], pulsing: bool
) -> bool:
    """Whether shut joint ``i`` has to be moved.

    ``seen``: how far it is off its place (rad), its rate (rad/s), for how long that was watched (s).
    ``pulsing``: another joint is pulsed now; one at a time.
    """
    off, rate, watched = seen
    if joint.rest == MOVES and law.oil_spring[i] > 0.0:
        least = joint.band if law.loaded[i] > 0.0 else max(law.settled, joint.band)
        # how far one goes on that leaves its place is told by waiting: a jog for a guess makes it hunt
        waits = _RELAXES_S if off * joint.oil.rate > 0.0 else _RATE_FILTER_S
        return bool(watched > waits and abs(off) > least)
    if joint.rest == MOVES:
        return bool(max(abs(off + rate * min(watched, law.latest[i])), abs(off)) > joint.band)
    sense, watch, pulse = 1.0 if off > 0.0 else -1.0, joint.watch, joint.pulse
    if watched < _WATCHED_S:
        return False
    crept = sense * (watch.error - joint.place) > _PULSED_AT * joint.band and off * rate > 0.0
    # what the encoder saw of the last pulse is taken off
    pulse.error = sense * min(sense * pulse.error, sense * watch.error)
    moved = sense * (watch.error - pulse.error)
    pulse.dragged = pulse.dragged + law.dt_s if moved > _DRAGS_RAD else 0.0
    return bool(law.loaded[i] > 0.0 and crept and moved > _AGAIN_RAD and not pulsing)
