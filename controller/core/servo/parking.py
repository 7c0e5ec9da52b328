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
# PHASE: FOLLOWING the joint law, SHUT, OPEN, or KEPT; SINCE: how long (s). SPEED: of the joint, filtered
# (rad/s); ERROR: filtered (rad); HELD: how long the following joint has been inside its band (s); BAND: that
# (rad). PARKED: 1 once the whole arm was at rest; PLACE: error where the joint rested then (rad), 0 before.
# Of the last inch, SENSE: ±1; OPENED: spool, without its sign; FROM: error at which it began (rad); SEEN: 1
# once the joint moved in it; FINE: 1 when it is shorter than can be watched well; HASTE: how many in a row
# went one way after short rests. Of the shut joint, SHUT_AT: error when it had come to rest (rad); DRIFT: its
# creep, as a rate of the error (rad/s). Learned, raising and lowering: EDGE, the spool at which the joint
# moves; DOUBT, how far before it an inch begins.
PHASE, SINCE, SPEED, ERROR, HELD, BAND, PARKED, PLACE = range(8)
SENSE, OPENED, FROM, SEEN, FINE, HASTE, SHUT_AT, DRIFT = range(8, 16)
EDGE, DOUBT, STATE_ROWS = 16, 18, 20

FOLLOWING, SHUT, OPEN, KEPT = 0.0, 1.0, 2.0, 3.0

_SEEN_RAD = 9.6e-5  # two digits of a 17 bit encoder: less may be noise
_SPEED_FILTER_S = 0.03
_ERROR_FILTER_S = 0.5  # the encoder's noise dithers its digits: their mean is good for a tenth of one
_RATE_S = 1.0  # a creep that was watched for this long is believed by half
_BEYOND = 0.3  # of the band: how far beyond its place a creeping joint is put
_CREEPS_1_S = 0.1  # of its band in a second: from there on a joint is put beyond its place
_SURE = 3.0  # standard deviations: further from its known deadband no edge is sought
_ARRIVED_RAD = 9.6e-5  # two digits: until the arm is parked, no joint is brought nearer
_RESTS_S = 4.0  # until a joint without load has come to rest with its oil: then the arm is parked
_LOADED_RESTS_S = 1.0  # the same of a joint that may creep: longer, and it would be due for an inch again
_GOES_ON_S = (
    20.0  # a creep that takes the joint out by then is corrected: once watched for a fifth of it, or known
)
_LEFT_RAD = 2e-4  # a parked joint that stands still is left alone so near, whatever its band
_FINE_RAD = 3e-4  # six digits: of a shorter way, speed tells nothing, and the inch takes its time
_FAST_FILTER_S = 0.05  # of the error while a valve is open
_LEAST_SEEN_RAD = 3e-5  # by that filter: six standard deviations of its noise
_EASY = 0.2  # of way / lateness²: a joint that is accelerated so overshoots by nothing when shut half way
_UNSURE_S = 2.0  # through the doubt about an edge
_HASTES = 4.0  # short rests in a row tell a joint that leaks too fast from one that still relaxes


class ParkingLaw(NamedTuple):
    """Constants of parking; arrays are (6,) or (6, 2): raising and lowering.

    ``band`` (m, of the tool at the joint's lever) between ``band_least`` and ``band_most`` (rad): error at
    which a shut joint begins an inch. ``slowest``, ``fastest``: of an inch (rad/s). ``patience`` (s): time
    that the joint law has to arrive. ``deadband``, ``spread``: what is known of it when it opens (spool).
    ``latest`` (s): from a command until motion is seen; ``shutting`` (s): how long a joint moves on when its
    valve is told to shut; ``loaded``: 1 where gravity makes a joint creep, 0 where
    parked it only relaxes. ``rest`` (s): a joint that leaks through twice its band in less is kept by the
    joint law. ``dt_s``: of a scan.
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
    loaded: Array
    rest: float
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
    follows[PHASE] = FOLLOWING
    follows[[SINCE, HELD, PARKED, PLACE, HASTE, DRIFT]] = 0.0
    return follows


def at_rest(law: ParkingLaw, state: Array) -> bool:
    """Whether every joint stands near its place with its valve shut, or is kept by the joint law."""
    long = state[SINCE] > np.where(law.loaded > 0.0, _LOADED_RESTS_S, _RESTS_S)
    rests = (state[PHASE] == SHUT) & long & (np.abs(state[ERROR]) < 1.5 * state[BAND])
    return bool((rests | (state[PHASE] == KEPT)).all())


def parked_here(state: Array) -> Array:
    """``state`` with the arm parked: from now on shut joints are kept where they rest."""
    here = state.copy()
    here[PARKED], here[PLACE] = 1.0, np.where(state[PHASE] == SHUT, state[ERROR], 0.0)
    return here


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
        lever = math.sqrt(J_BT[0, i] ** 2 + J_BT[1, i] ** 2 + J_BT[2, i] ** 2)
        least = law.band_least if state[PARKED, i] > 0.0 else _ARRIVED_RAD
        state[BAND, i] = min(max(law.band / max(lever, 1e-3), least), law.band_most)
        keep = math.exp(-law.dt_s / _SPEED_FILTER_S)
        state[SPEED, i] = keep * state[SPEED, i] + (1.0 - keep) * turned[i] / law.dt_s
        state[SINCE, i] += law.dt_s
        if state[PHASE, i] == FOLLOWING and not _arrived(law, state, i, out[LEFT, i]):
            continue
        if state[PHASE, i] == KEPT:
            continue
        for side in range(2):
            slope = joints.curve[i, side, 1, 1] / joints.curve[i, side, 1, 0]
            gains[side] = joints.flow_gain[i, side] * slope * speeds[i, side]
        if state[PHASE, i] == SHUT:
            spool = _watched(law, state, i, out[LEFT, i], gains)
        else:
            spool = _inched(law, state, i, out[LEFT, i], gains)
        out[VALVES, i] = max(-joints.limit, min(joints.limit, spool))
        out[Q_CMD, i], out[QD_CMD, i], out[PT1, i] = given.q_meas[i], 0.0, 0.0


@kernel
def _arrived(law: ParkingLaw, state: Array, i: int, error: float) -> bool:
    """Whether the joint law is done with joint ``i``, which then is shut."""
    state[HELD, i] = state[HELD, i] + law.dt_s if abs(error) < state[BAND, i] else 0.0
    if state[HELD, i] < 2.0 * law.shutting[i] and state[SINCE, i] < law.patience:
        return False
    _shut(state, i, error)
    state[DRIFT, i] = 0.0
    return True


@kernel
def _shut(state: Array, i: int, error: float) -> None:
    state[PHASE, i], state[SINCE, i], state[ERROR, i] = SHUT, 0.0, error


@kernel
def _watched(law: ParkingLaw, state: Array, i: int, error: float, gains: Array) -> float:
    """A shut valve: wait for the joint to rest, watch its creep, begin an inch before it leaves its band.

    Parked, it may be further off when it does not go on, or comes back by itself: an inch the other way takes
    it through its play, of which the encoder sees nothing.
    """
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
    error, band = state[ERROR, i] - state[PLACE, i], state[BAND, i]
    least = max(band, 0.5 * _LEFT_RAD) / _GOES_ON_S
    known = watched > 0.2 * _GOES_ON_S or (state[DRIFT, i] * drift > 0.0 and abs(state[DRIFT, i]) > least)
    goes_on = law.loaded[i] > 0.0 and known and error * drift > 0.0 and abs(drift) > least
    leave = band if goes_on or state[PARKED, i] == 0.0 else max(2.0 * band, _LEFT_RAD)
    ahead = error + drift * law.latest[i]
    if max(abs(ahead), abs(error)) <= leave:
        return 0.0
    sense = 1.0 if error > 0.0 else -1.0
    hasty = sense == state[SENSE, i] and since < law.rest and abs(drift) * law.rest > 2.0 * band
    state[HASTE, i] = state[HASTE, i] + 1.0 if hasty else 0.0
    if state[HASTE, i] >= _HASTES:
        state[PHASE, i], state[DRIFT, i] = KEPT, drift
        return 0.0
    return _begun(law, state, i, error, drift, sense, gains)


@kernel
def _begun(
    law: ParkingLaw, state: Array, i: int, error: float, drift: float, sense: float, gains: Array
) -> float:
    """The first spool command of an inch: of one that is watched, or of a pulse."""
    side = 0 if sense > 0.0 else 1
    state[DRIFT, i], state[PHASE, i], state[SINCE, i], state[SENSE, i] = drift, OPEN, 0.0, sense
    state[FROM, i], state[SEEN, i], state[ERROR, i] = error, 0.0, error
    opened = max(state[EDGE + side, i] - state[DOUBT + side, i], 0.0)
    state[OPENED, i], way = opened, sense * error + _beyond(state, i)
    state[FINE, i] = 1.0 if way < _FINE_RAD else 0.0
    return sense * float(opened)


@kernel
def _beyond(state: Array, i: int) -> float:
    """How far (rad) beyond its place the joint is put."""
    creeps = state[SENSE, i] * state[DRIFT, i] > _CREEPS_1_S * state[BAND, i]
    return _BEYOND * state[BAND, i] if creeps else 0.0


@kernel
def _inched(law: ParkingLaw, state: Array, i: int, error: float, gains: Array) -> float:
    """An opening valve: further until the joint moves, shut before it gets there.

    The speed rises such that half the way is left when motion is seen, or as fast as the doubt asks for.
    """
    sense, fine = state[SENSE, i], state[FINE, i] > 0.0
    side, latest = 0 if sense > 0.0 else 1, law.latest[i]
    gain, beyond = gains[side], _beyond(state, i)
    keep = math.exp(-law.dt_s / _FAST_FILTER_S)
    error -= state[PLACE, i]
    state[ERROR, i] = keep * state[ERROR, i] + (1.0 - keep) * error
    way = max(sense * state[FROM, i] + beyond, 2.0 * _LEAST_SEEN_RAD)
    gone = sense * (state[FROM, i] - state[ERROR, i])
    speed = max(sense * state[SPEED, i], 0.0)
    easy = _EASY if fine else 1.0
    rise = max(easy * way / (latest * latest), gain * state[DOUBT + side, i] / _UNSURE_S)
    if gone > (_LEAST_SEEN_RAD if fine else _SEEN_RAD):
        state[SEEN, i] = 1.0
    if fine or speed < min(max(way / (3.0 * latest), law.slowest), law.fastest):
        highest = law.deadband[i, side] + _SURE * law.spread[i, side]
        state[OPENED, i] = min(state[OPENED, i] + rise / gain * law.dt_s, highest)
    left = 0.5 * way - gone
    if not fine and state[SEEN, i] > 0.0:  # before it is seen, the encoder's noise is its speed
        left = sense * error + beyond - speed * law.shutting[i]
    if left > 0.0:
        return float(sense * state[OPENED, i])
    if state[SEEN, i] > 0.0:
        since = min(latest + math.sqrt(2.0 * max(gone, 0.0) / rise), state[SINCE, i])
        _learn(law, state, i, state[OPENED, i] - rise * since / gain)
        state[DOUBT + side, i] = max(0.5 * state[DOUBT + side, i], law.slowest / gain)
    _shut(state, i, error + state[PLACE, i])
    return 0.0


@kernel
def _learn(law: ParkingLaw, state: Array, i: int, edge: float) -> None:
    """Believe by half that joint ``i`` moves from ``edge`` on, as far as it is known at all."""
    side = 0 if state[SENSE, i] > 0.0 else 1
    middle, doubt = law.deadband[i, side], _SURE * law.spread[i, side]
    believed = state[EDGE + side, i] + 0.5 * (edge - state[EDGE + side, i])
    state[EDGE + side, i] = min(max(believed, middle - doubt, 0.0), middle + doubt)
