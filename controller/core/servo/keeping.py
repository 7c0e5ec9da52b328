"""How a joint that leaks is *kept*: its valve passes what it loses, so that it need not move.

A servo valve that went through its overlap to and fro would take the joint through the play before its
encoder. A leak has one sense, and the opening too; a joint that stands too high sinks by itself, or turns
the sense over. Oil that a motion left in the chambers takes minutes to leak away, and what the opening has to
pass changes with it. Meanwhile the load pressure tells how the joint moves within its play: friction is a
spring before it slides. One of which it does not tell (``felt`` is 0) leans, once it is calm, on that flank
on which the encoder sees it sink: noise would let it wander from one to the other.
"""

import math

import numpy as np

from controller.core.kinematics.rotations import Array
from controller.core.servo.parking_state import (
    BIAS,
    DRIFT,
    EDGE,
    ERROR,
    FELT,
    HASTE,
    KEPT,
    MARK,
    OWED,
    PARKED,
    PHASE,
    PLACE,
    QUIET,
    SENSE,
    SINCE,
    ParkingLaw,
)
from controller.core.servo.small_moves import shut
from foundation.compiled import kernel
from protocol.process_image import VALVE_FULL_SCALE

_WORD = 1.0 / VALVE_FULL_SCALE  # of spool
_SURE = 3.0  # standard deviations: further from its known deadband no edge is sought
_LEAKS_RAD_S = 1e-3  # at most at first: a joint that was just shut still moves
_FILTER_S = 0.1  # of a kept joint's error
_ZONE_RAD = 2.4e-5  # half a digit: nearer, the leak is taken for known
_LEARNS = 0.12  # of the gain squared: so slowly that it does not swing through the play
_CALM_S = 5.0  # quiet for so long, a kept joint needs little: less gain of a slower filter, and it leans
_SOFT, _SOFT_FILTER_S, _LEANS_RAD_S = 0.25, 1.0, 4e-6  # ten times what the encoder's noise makes of that gain
_SOFT_FELT, _LEARNS_FELT = 0.4, 0.25  # instead, of a joint whose way is felt within its play,
_EXCITED_RAD = 1e-4  # and is not calm further off
_FELT_RAD, _FELT_S = 1e-4, 60.0  # what that way is limited to, and forgotten in: friction relaxes, too;
_SILENT_S = 200.0  # instead, where the encoder does not tell otherwise
_HASTENS = 4.0  # while its load tells that a parked joint sinks: between a spool's edges openings do little,
_TELLS_RAD = 1.5e-5  # by a tenth of a bar, and the encoder, within its play, does not tell otherwise
_HIGH_RAD, _STUBBORN_S = 1e-4, 5.0  # a joint stands so much too high for so long: its valve is shut
FAR_RAD = 1e-3  # a joint that went so far is not kept, whatever its valve passes: an inch brings it back,
_NOT_AGAIN = -1e6  # and until the next motion no number of inches in a row tells that it leaks


@kernel
def kept_begun(state: Array, i: int, drift: float, load: float) -> None:
    """From now on joint ``i``, which leaks by ``drift`` (rad/s) under ``load`` (bar), is kept."""
    state[PHASE, i], state[SINCE, i], state[DRIFT, i] = KEPT, 0.0, drift
    state[SENSE, i] = 1.0 if state[ERROR, i] > state[PLACE, i] else -1.0
    state[BIAS, i] = min(max(state[SENSE, i] * drift, 0.0), _LEAKS_RAD_S)
    state[FELT, i], state[OWED, i], state[MARK, i] = load, 0.0, -_HIGH_RAD


def calm_gain(law: ParkingLaw) -> Array:
    """The gain (6,) of kept joints once they are calm (1/s)."""
    return np.asarray(np.where(law.felt > 0.0, _SOFT_FELT, _SOFT) * law.keeping)


@kernel
def kept(law: ParkingLaw, state: Array, i: int, error: float, load: float, gains: Array) -> float:
    """The spool command of kept joint ``i``, on one side of the overlap.

    Proportional to what is left, and a bias that learns the leak and where the edge is. One step of the
    valve's word is 15 µrad/s of the crane's lift, more than the balance bears: what a scan rounds off, the
    next ones make up for.
    """
    feels = law.felt[i] > 0.0
    k, learns, filter_s, lean = law.keeping[i], _LEARNS_FELT if feels else _LEARNS, _FILTER_S, 0.0
    far = feels and abs(state[ERROR, i] - state[PLACE, i]) > _EXCITED_RAD
    if not far and (state[QUIET, i] > _CALM_S or state[PARKED, i] > 0.0):
        k, filter_s = (_SOFT_FELT if feels else _SOFT) * k, _SOFT_FILTER_S
        lean = 0.0 if feels else _LEANS_RAD_S
    keep = math.exp(-law.dt_s / filter_s)
    state[ERROR, i] = keep * state[ERROR, i] + (1.0 - keep) * error
    if abs(state[ERROR, i] - state[PLACE, i]) > FAR_RAD:
        shut(state, i, error)
        state[HASTE, i] = _NOT_AGAIN
        return 0.0
    sunk = _felt(law, state, i, load)
    if feels and _stubborn(state, i):
        return 0.0
    sense = state[SENSE, i]
    side = 0 if sense > 0.0 else 1
    gain, below = gains[side], sense * (state[ERROR, i] - state[PLACE, i])
    outside = math.copysign(max(abs(below) - _ZONE_RAD, 0.0), below)
    if state[PARKED, i] > 0.0 and outside >= 0.0 and sense * sunk > _TELLS_RAD:
        learns *= _HASTENS
    doubt = gain * _SURE * law.spread[i, side]
    bias = state[BIAS, i] + learns * k * k * (outside + sense * sunk) * law.dt_s
    state[BIAS, i] = min(max(bias, -doubt), doubt + law.fastest)
    opened = max(state[EDGE + side, i] + (k * (below + sense * sunk) + state[BIAS, i] - lean) / gain, 0.0)
    word = round((opened + state[OWED, i]) / _WORD)
    state[OWED, i] += opened - _WORD * word
    return float(sense * _WORD * word)


@kernel
def _felt(law: ParkingLaw, state: Array, i: int, load: float) -> float:
    """How far (rad) joint ``i`` has sunk lately by its ``load`` (bar), within the play before its encoder.

    What pushes a joint up by a hair has to push harder than what lets it down.
    """
    if law.felt[i] == 0.0:
        return 0.0
    most = _FELT_RAD / law.felt[i]
    below = state[ERROR, i] - state[PLACE, i]
    contradicted = below * (state[FELT, i] - load) < 0.0 and abs(below) > _ZONE_RAD
    state[FELT, i] += (load - state[FELT, i]) * law.dt_s / (_FELT_S if contradicted else _SILENT_S)
    state[FELT, i] = min(max(state[FELT, i], load - most), load + most)
    return float(law.felt[i] * (state[FELT, i] - load))


@kernel
def _stubborn(state: Array, i: int) -> bool:
    """Whether joint ``i`` has stood too high for so long that its valve has to be shut.

    One that goes on although it is shut leaks the other way now, and is kept on the other side.
    """
    below = state[SENSE, i] * (state[ERROR, i] - state[PLACE, i])
    if below > -_HIGH_RAD:
        state[SINCE, i] = 0.0
    if state[SINCE, i] < _STUBBORN_S:
        state[MARK, i] = min(below, -_HIGH_RAD)
        return False
    state[OWED, i] = 0.0
    state[MARK, i] = max(state[MARK, i], below)
    if below < state[MARK, i] - _HIGH_RAD:
        state[SENSE, i], state[BIAS, i], state[SINCE, i] = -state[SENSE, i], 0.0, 0.0
    return True
