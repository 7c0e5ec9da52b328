"""Parking: how joints at the end of their way come to rest with valves shut, and are kept where they are.

A continuous law hunts at a deadband: its integral winds up while nothing moves, and unwinds too late. Here
the joint law has its time to arrive. Then, or when it did not, the valve is shut; a joint that leaves its
band is brought back by an inch: the valve is opened further and further in one direction until the joint
moves, and shut before it gets there. Nothing winds up, and a joint in position has its valve in the centre.
"""

import math
from typing import NamedTuple

import numpy as np

from controller.core.kinematics.rotations import Array
from controller.core.servo.drives import full_spool_speeds
from controller.core.servo.servo_step import LEFT, PT1, Q_CMD, QD_CMD, VALVES, ServoConstants, ServoInput
from foundation.compiled import kernel

# Rows of the state (STATE_ROWS, 6), a column for each joint.
# PHASE: FOLLOWING the joint law, SHUT, or OPEN; SINCE: how long (s). SPEED: of the joint, filtered (rad/s);
# ERROR: filtered (rad); HELD: how long the following joint has been inside its band (s); BAND: that (rad).
# Of the last inch, SENSE: ±1; OPENED: spool, without its sign; FROM: error at which it began (rad); SEEN: 1
# once the joint moved in it. Of the shut joint, SHUT_AT: error when it had come to rest (rad); DRIFT: its
# creep, as a rate of the error (rad/s). Learned, raising and lowering: EDGE, the spool at which the joint
# moves; DOUBT, how far before it an inch begins.
PHASE, SINCE, SPEED, ERROR, HELD, BAND, SENSE, OPENED, FROM, SEEN, SHUT_AT, DRIFT = range(12)
EDGE, DOUBT, STATE_ROWS = 12, 14, 16

FOLLOWING, SHUT, OPEN = 0.0, 1.0, 2.0

_SEEN_RAD = 9.6e-5  # two digits of a 17 bit encoder: less may be noise
_SPEED_FILTER_S, _ERROR_FILTER_S = 0.03, 0.05
_RATE_S = 0.3  # a creep that was watched for this long is believed by half
_BEYOND = 0.7  # of the band: how far beyond its place a creeping joint is put
_CREEPS_1_S = 0.2  # of its band in a second: from there on a joint is put beyond its place
_SURE = 3.0  # standard deviations: further from its known deadband no edge is sought


class ParkingLaw(NamedTuple):
    """Constants of parking; arrays are (6,) or (6, 2): raising and lowering.

    ``band`` (m, of the tool at the joint's lever) between ``band_least`` and ``band_most`` (rad): error at
    which a shut joint begins an inch. ``slowest``, ``fastest``: of an inch (rad/s). ``patience`` (s): time
    that the joint law has to arrive. ``deadband``, ``spread``: what is known of it when it opens (spool).
    ``latest`` (s): from a command until motion is seen; ``shutting`` (s): how long a joint moves on when its
    valve is told to shut. ``dt_s``: of a scan.
    """

    band: float
    band_least: float
    band_most: float
    slowest: float
    fastest: float
    patience: float
    deadband: Array
    spread: Array
    latest: Array
    shutting: Array
    dt_s: float


def parking_begun(law: ParkingLaw | None) -> Array:
    """The state (STATE_ROWS, 6) before the first inch: every valve as it is known."""
    state = np.zeros((STATE_ROWS, 6))
    if law is not None:
        state[EDGE : EDGE + 2], state[DOUBT : DOUBT + 2] = law.deadband.T, law.spread.T
    return state


def parking_ended(state: Array) -> Array:
    """``state`` when a motion begins: the joint law drives all joints; what was learned is kept."""
    follows = state.copy()
    follows[PHASE], follows[SINCE], follows[HELD] = FOLLOWING, 0.0, 0.0
    return follows


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
    for i in range(6):
        lever = math.sqrt(J_BT[0, i] ** 2 + J_BT[1, i] ** 2 + J_BT[2, i] ** 2)
        state[BAND, i] = min(max(law.band / max(lever, 1e-3), law.band_least), law.band_most)
        keep = math.exp(-law.dt_s / _SPEED_FILTER_S)
        state[SPEED, i] = keep * state[SPEED, i] + (1.0 - keep) * turned[i] / law.dt_s
        state[SINCE, i] += law.dt_s
        if state[PHASE, i] == FOLLOWING and not _arrived(law, state, i, out[LEFT, i]):
            continue
        if state[PHASE, i] == SHUT:
            spool = _watched(law, state, i, out[LEFT, i])
        else:
            side = 0 if state[SENSE, i] > 0.0 else 1
            slope = joints.curve[i, side, 1, 1] / joints.curve[i, side, 1, 0]
            gain = joints.flow_gain[i, side] * slope * speeds[i, side]
            spool = _inched(law, state, i, out[LEFT, i], gain)
        out[VALVES, i] = max(-joints.limit, min(joints.limit, spool))
        out[Q_CMD, i], out[QD_CMD, i], out[PT1, i] = given.q_meas[i], 0.0, 0.0


@kernel
def _arrived(law: ParkingLaw, state: Array, i: int, error: float) -> bool:
    """Whether the joint law is done with joint ``i``, which then is shut."""
    state[HELD, i] = state[HELD, i] + law.dt_s if abs(error) < state[BAND, i] else 0.0
    if state[HELD, i] < 2.0 * law.shutting[i] and state[SINCE, i] < law.patience:
        return False
    state[PHASE, i], state[SINCE, i], state[ERROR, i] = SHUT, 0.0, error
    return True


@kernel
def _watched(law: ParkingLaw, state: Array, i: int, error: float) -> float:
    """A shut valve: wait for the joint to rest, watch its creep, begin an inch before it leaves its band."""
    since, pause = state[SINCE, i], 2.0 * law.shutting[i]
    keep = math.exp(-law.dt_s / min(max(0.3 * since, 0.02), _ERROR_FILTER_S))
    state[ERROR, i] = keep * state[ERROR, i] + (1.0 - keep) * error
    if since < pause:
        state[SHUT_AT, i] = state[ERROR, i]
        return 0.0
    watched = since - pause
    rate = (state[ERROR, i] - state[SHUT_AT, i]) / max(watched, 1e-3)
    trust = watched / (watched + _RATE_S)
    drift = trust * rate + (1.0 - trust) * state[DRIFT, i]
    ahead = state[ERROR, i] + drift * (law.latest[i] + _ERROR_FILTER_S)
    if max(abs(ahead), abs(state[ERROR, i])) <= state[BAND, i]:
        return 0.0
    sense = 1.0 if ahead > 0.0 else -1.0
    side = 0 if sense > 0.0 else 1
    state[DRIFT, i] = drift
    state[PHASE, i], state[SINCE, i], state[SENSE, i] = OPEN, 0.0, sense
    state[FROM, i], state[SEEN, i] = error, 0.0
    state[OPENED, i] = max(state[EDGE + side, i] - state[DOUBT + side, i], 0.0)
    return float(sense * state[OPENED, i])


@kernel
def _inched(law: ParkingLaw, state: Array, i: int, error: float, gain: float) -> float:
    """An opening valve: further until the joint moves, shut before it gets there. ``gain``: rad/s a spool.

    The speed rises such that half the way is left when motion is seen, faster in doubt or against a creep.
    """
    sense = state[SENSE, i]
    side, latest = 0 if sense > 0.0 else 1, law.latest[i]
    beyond = _BEYOND * state[BAND, i] if sense * state[DRIFT, i] > _CREEPS_1_S * state[BAND, i] else 0.0
    way = max(sense * state[FROM, i] + beyond, _SEEN_RAD)
    speed = max(sense * state[SPEED, i], 0.0)
    creep = max(sense * state[DRIFT, i], 0.0)
    rise = way / (latest * latest) + creep / latest + gain * state[DOUBT + side, i]
    if sense * (state[FROM, i] - error) > _SEEN_RAD:
        state[SEEN, i] = 1.0
    if speed < min(max(way / (3.0 * latest), law.slowest), law.fastest):
        highest = law.deadband[i, side] + _SURE * law.spread[i, side]
        state[OPENED, i] = min(state[OPENED, i] + rise / gain * law.dt_s, highest)
    goes_on = max(speed - creep, 0.0) * law.shutting[i] if state[SEEN, i] > 0.0 else 0.0  # else noise
    if sense * error > goes_on - beyond:
        return float(sense * state[OPENED, i])
    if state[SEEN, i] > 0.0:
        ahead = 0.5 * rise * min(latest, state[SINCE, i])  # the opening went on before its speed was seen
        _learn(law, state, i, state[OPENED, i] - (ahead + speed) / gain)
        state[DOUBT + side, i] = max(0.5 * state[DOUBT + side, i], (law.slowest + 0.5 * ahead) / gain)
    state[PHASE, i], state[SINCE, i], state[ERROR, i] = SHUT, 0.0, error
    return 0.0


@kernel
def _learn(law: ParkingLaw, state: Array, i: int, edge: float) -> None:
    """Believe by half that joint ``i`` moves from ``edge`` on, as far as it is known at all."""
    side = 0 if state[SENSE, i] > 0.0 else 1
    middle, doubt = law.deadband[i, side], _SURE * law.spread[i, side]
    believed = state[EDGE + side, i] + 0.5 * (edge - state[EDGE + side, i])
    state[EDGE + side, i] = min(max(believed, middle - doubt, 0.0), middle + doubt)
