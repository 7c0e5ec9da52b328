"""Parking: how joints at the end of their way come to rest with valves shut, and are kept where they are.

A continuous law hunts at a deadband: its integral winds up while nothing moves, and unwinds too late. Here
the joint law has its time to arrive. Then, or when it did not, the valve is shut; a joint that leaves its
band is brought back by an inch: the valve is opened further and further in one direction until the joint
moves, and shut before it gets there. Nothing winds up, and a joint in position has its valve in the centre.
Once the arm is parked, what gravity makes creep is nudged, or kept.
"""

import math

import numpy as np

from controller.core.kinematics.rotations import Array
from controller.core.servo.coming_to_rest import ARRIVED_RAD, calm_counted, listened
from controller.core.servo.drives import full_spool_speeds
from controller.core.servo.flanks import came_too_far, flanks_followed, left_at, turned_to
from controller.core.servo.keeping import FAR_RAD, kept, kept_begun
from controller.core.servo.metering import eased, learned, metered, metered_begun
from controller.core.servo.parking_state import (
    AFTER,
    BAND,
    CAME,
    CREPT,
    DRAGS,
    DRIFT,
    EASE,
    ERROR,
    FOLLOWING,
    HASTE,
    HELD,
    KEPT,
    LOAD,
    MARK,
    NUDGED,
    OIL,
    OIL_AT,
    OPENING,
    PARKED,
    PHASE,
    PLACE,
    RATE,
    SENSE,
    SHUT,
    SHUT_AT,
    SINCE,
    SPEED,
    ParkingLaw,
)
from controller.core.servo.servo_step import (
    LEFT,
    PT1,
    Q_CMD,
    QD_CMD,
    VALVES,
    ServoConstants,
    ServoInput,
    servo_step,
)
from controller.core.servo.small_moves import (
    inch_begun,
    inched,
    nudge_begun,
    nudged,
    shut,
)
from foundation.compiled import kernel

_SPEED_FILTER_S = 0.03
_ERROR_FILTER_S = 0.5  # the encoder's noise dithers its digits: their mean is good for a tenth of one
_RATE_FILTER_S = 0.5  # of the speed of a metered joint that is shut,
_RELAXES_S = 2.0  # which goes on for so long: friction lets go of compressed oil
_RATE_S = 1.0  # a creep that was watched for this long is believed by half
_HASTES = 3.0  # moves in a row that were due too soon tell a joint that leaks from one that still relaxes
_WATCHED_S = 4.0  # so long a parked joint is watched before it is nudged
_NUDGED_AT = 0.5  # of the band: a parked joint that crept so far is nudged
_NEAR_RAD = 5e-4  # from there on a valve that passes small flows steadily keeps a joint that is felt
_PART = 0.5  # of its way: a slew near its place, which relaxes by as much again
_DRAGS_RAD = 3e-6  # from there on a joint drags its encoder along again, and its creep shows
_AGAIN_RAD = 7e-6  # beyond where its encoder was at the last nudge: by the slow filter; its noise is 1 µrad


@kernel
def drive_step(
    constants: ServoConstants,
    law: ParkingLaw,
    given: ServoInput,
    turned: Array,
    stands: bool,
    out: Array,
    state: Array,
) -> tuple[bool, bool]:
    """``servo_step``, and while the arm ``stands`` ``park_step``; ``state`` follows the flanks in both.

    One kernel, because telling the types of ``given`` takes longer than the arithmetic. After commands that
    are not finite ``state`` is as it was.
    """
    finite, inside = servo_step(constants, given, law.dt_s, out)
    if finite:
        flanks_followed(state, given.q_meas, law.dt_s)
        if stands:
            park_step(constants, law, given, turned, out, state)
    return finite, inside


@kernel
def park_step(
    constants: ServoConstants, law: ParkingLaw, given: ServoInput, turned: Array, out: Array, state: Array
) -> None:
    """Put parking in place of the joint law in ``out`` (of ``servo_step``), joint by joint.

    ``turned`` (6,): what the joints turned since the scan before (rad). ``state`` is written to.
    """
    joints, J_BT = constants.joints, given.tool.J_BT
    speeds = full_spool_speeds(
        constants.drives, given.q_meas, constants.rated, given.circuit, given.slow_load
    )
    gains = np.empty(2)
    for i in range(6):
        lever = max(math.sqrt(J_BT[0, i] ** 2 + J_BT[1, i] ** 2 + J_BT[2, i] ** 2), 1e-3)
        least = law.band_least if state[PARKED, i] > 0.0 else ARRIVED_RAD
        if law.loaded[i] == 0.0:
            least = law.band_most
        state[BAND, i] = min(max(law.band / lever, least), law.band_most)
        keep = math.exp(-law.dt_s / _SPEED_FILTER_S)
        state[SPEED, i] = keep * state[SPEED, i] + (1.0 - keep) * turned[i] / law.dt_s
        state[SINCE, i] += law.dt_s
        state[AFTER, i] += law.dt_s
        if state[PHASE, i] == FOLLOWING and not _arrived(law, state, i, out[LEFT, i], given.felt.load[i]):
            continue
        for side in range(2):
            slope = joints.curve[i, side, 1, 1] / joints.curve[i, side, 1, 0]
            gains[side] = joints.flow_gain[i, side] * slope * speeds[i, side]
        spool = _moved(law, state, i, out[LEFT, i], given.felt.load[i], gains)
        listened(law, state, i, lever, out[LEFT, i], given.felt.load[i])
        calm_counted(law, state, i, lever)
        out[VALVES, i] = max(-joints.limit, min(joints.limit, spool))
        out[Q_CMD, i], out[QD_CMD, i], out[PT1, i] = given.q_meas[i], 0.0, 0.0


@kernel
def _moved(law: ParkingLaw, state: Array, i: int, error: float, load: float, gains: Array) -> float:
    """The spool command of joint ``i``, which is ``error`` (rad) off, by its phase."""
    phase = state[PHASE, i]
    if phase == SHUT:
        return float(_watched(law, state, i, error, load, gains))
    if phase == KEPT:
        return float(kept(law, state, i, error, load, gains))
    if phase == NUDGED:
        return float(nudged(law, state, i, error, load, gains))
    if law.oil[i] > 0.0:
        return float(metered(law, state, i, error, load, gains))
    return float(inched(law, state, i, error, gains))


@kernel
def _arrived(law: ParkingLaw, state: Array, i: int, error: float, load: float) -> bool:
    """Whether the joint law is done with joint ``i``, which then is shut.

    Or must not go on: a joint that came too far would be taken back through its play, on to its other flank.
    """
    state[HELD, i] = state[HELD, i] + law.dt_s if abs(error) < state[BAND, i] else 0.0
    waits = state[HELD, i] < 2.0 * law.shutting[i] and state[SINCE, i] < law.patience
    if waits and not came_too_far(law, state, i, error):
        return False
    shut(state, i, error)
    state[DRIFT, i], state[HELD, i], state[CREPT, i] = 0.0, 0.0, error
    state[OIL, i], state[LOAD, i] = error - law.oil[i] * load, load
    # one that has stood since the start is at ease; those of loaded joints are learned at rest
    if state[CAME, i] == 0.0 and law.loaded[i] == 0.0:
        state[EASE, i] = law.oil[i] * load
    return True


@kernel
def _watched(law: ParkingLaw, state: Array, i: int, error: float, load: float, gains: Array) -> float:
    """A shut valve: wait for the joint to rest, watch its creep, move it when it has left its band."""
    since, pause, before = state[SINCE, i], 2.0 * law.shutting[i], state[ERROR, i]
    keep = math.exp(-law.dt_s / min(max(0.3 * since, 0.02), _ERROR_FILTER_S))
    state[ERROR, i] = keep * before + (1.0 - keep) * error
    state[OIL, i] = keep * state[OIL, i] + (1.0 - keep) * (error - law.oil[i] * load)
    if since < pause:
        state[SHUT_AT, i], state[OIL_AT, i], state[RATE, i] = state[ERROR, i], state[OIL, i], 0.0
        return 0.0
    metered_joint = law.oil[i] > 0.0
    if metered_joint and state[OPENING, i] > 0.0:
        learned(law, state, i, gains)
    state[RATE, i] += ((state[ERROR, i] - before) / law.dt_s - state[RATE, i]) * law.dt_s / _RATE_FILTER_S
    watched = since - pause
    rate = (state[ERROR, i] - state[SHUT_AT, i]) / max(watched, 1e-3)
    off = state[ERROR, i] - state[PLACE, i]
    if metered_joint and state[PARKED, i] == 0.0:
        off += state[RATE, i] * _RELAXES_S
    if metered_joint and law.play[i] > 0.0:
        spool = eased(law, state, i, load)
        if state[PHASE, i] != SHUT:
            return float(spool)
    if not _due(law, state, i, off, rate, watched):
        return 0.0
    return float(_moved_again(law, state, i, (error, load, off, rate, watched), gains))


@kernel
def _moved_again(
    law: ParkingLaw, state: Array, i: int, seen: tuple[float, float, float, float, float], gains: Array
) -> float:
    """The first spool command of what brings shut joint ``i`` back.

    ``seen``: error (rad), load (bar), how far off it is (rad), its rate (rad/s), for how long that was
    watched (s). A parked joint is nudged when it creeps, and only then: an inch takes it through its play, of
    which the encoder sees nothing. One without load is left alone.
    """
    error, load, off, rate, watched = seen
    sense = 1.0 if off > 0.0 else -1.0
    gain = gains[0 if sense > 0.0 else 1]
    leak = rate if law.oil[i] == 0.0 else (state[OIL, i] - state[OIL_AT, i]) / max(watched, 1e-3)
    hasty = _hasty(law, state, i, sense, leak)
    state[HASTE, i] = state[HASTE, i] + 1.0 if hasty else min(state[HASTE, i], 0.0)
    steadily = law.exact[i] > 0.0 and law.felt[i] > 0.0 and law.loaded[i] > 0.0 and abs(off) < _NEAR_RAD
    if steadily or state[HASTE, i] >= _HASTES:
        kept_begun(state, i, leak, load)
        return float(kept(law, state, i, error, load, gains))
    if state[PARKED, i] > 0.0 and abs(off) < FAR_RAD:
        _creep_seen(state, i, sense)
        return float(nudge_begun(law, state, i, state[CREPT, i], sense, load))
    if law.oil[i] > 0.0:
        relaxes = law.loaded[i] == 0.0 and abs(off) < 2.0 * law.leaves
        turned_to(state, i, sense)
        return float(metered_begun(state, i, _PART * off if relaxes else off))
    trust = watched / (watched + _RATE_S)
    drift = trust * rate + (1.0 - trust) * state[DRIFT, i]
    return float(inch_begun(state, i, off, drift, sense, gain))


@kernel
def _creep_seen(state: Array, i: int, sense: float) -> None:
    """Believe how fast joint ``i`` crept while it dragged its encoder; after a nudge that stands for a while.

    The longer the way, the more. What it crept by before the arm was parked is forgotten then: oil relaxed.
    """
    seen = max(sense * (state[CREPT, i] - state[MARK, i]) - _DRAGS_RAD, 0.0)
    trust = 1.0 if state[DRIFT, i] == 0.0 else seen / (seen + _AGAIN_RAD - _DRAGS_RAD)
    creep = sense * seen / max(state[DRAGS, i], _WATCHED_S)
    state[DRIFT, i] += trust * (creep - state[DRIFT, i])
    state[DRAGS, i] = 0.0


@kernel
def _hasty(law: ParkingLaw, state: Array, i: int, sense: float, leak: float) -> bool:
    """Whether loaded joint ``i``, which leaks by ``leak`` (rad/s), has to be moved again too soon."""
    crept = state[SINCE, i] < 4.0 * law.shutting[i]
    crept = crept or abs(state[ERROR, i] - state[SHUT_AT, i]) > 0.5 * state[BAND, i]
    fast = sense * leak * law.rest[i] > 2.0 * state[BAND, i]
    return bool(law.loaded[i] > 0.0 and crept and fast and sense == state[SENSE, i])


@kernel
def _due(law: ParkingLaw, state: Array, i: int, off: float, rate: float, watched: float) -> bool:
    """Whether shut joint ``i``, ``off`` its place (rad) and moving at ``rate`` (rad/s), has to be moved."""
    if state[PARKED, i] == 0.0 and law.oil[i] > 0.0:
        least = state[BAND, i] if law.loaded[i] > 0.0 else max(law.leaves, state[BAND, i])
        # how far one goes on that leaves its place is told by waiting: an inch for a guess makes it hunt
        waits = _RELAXES_S if off * state[RATE, i] > 0.0 else _RATE_FILTER_S
        return bool(watched > waits and abs(off) > left_at(law, state, i, off, least))
    if state[PARKED, i] == 0.0:
        return bool(max(abs(off + rate * min(watched, law.latest[i])), abs(off)) > state[BAND, i])
    sense = 1.0 if off > 0.0 else -1.0
    if watched < _WATCHED_S:
        return False
    crept = sense * (state[CREPT, i] - state[PLACE, i]) > _NUDGED_AT * state[BAND, i] and off * rate > 0.0
    # what the encoder saw of the last nudge is taken off
    state[MARK, i] = sense * min(sense * state[MARK, i], sense * state[CREPT, i])
    moved = sense * (state[CREPT, i] - state[MARK, i])
    state[DRAGS, i] = state[DRAGS, i] + law.dt_s if moved > _DRAGS_RAD else 0.0
    again = moved > _AGAIN_RAD
    return bool(law.loaded[i] > 0.0 and crept and again and not (state[PHASE] == NUDGED).any())
