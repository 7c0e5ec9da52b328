"""How a joint that leaks is *held*: its valve passes what it loses, so that it need not move.

A servo valve that went through its overlap to and fro would take the joint through the backlash before its
encoder. A leak has one sense, and the opening too; a joint that stands too high sinks by itself, or turns
the sense over. Oil that a motion left in the chambers takes minutes to leak away, and what the opening has to
pass changes with it. Meanwhile the load pressure tells how the joint moves within its backlash: friction is a
spring before it slides. A joint of which it does not tell leans, once it is calm, on that side on which the
encoder sees it sink: noise would let it wander from one to the other.
"""

import math

import numpy as np

from controller.core.kinematics.rotations import Array
from controller.core.parking.jogs import shut_valve
from controller.core.parking.joint import HOLD, MOVES, Joint, ParkingLaw
from foundation.compiled import kernel
from protocol.process_image import VALVE_FULL_SCALE

FAR_RAD = 1e-3  # [D] a joint that went so far is not held, whatever its valve passes: a jog brings it back,
_NOT_AGAIN = -1e6  # and until the next motion no number of moves in a row tells that it leaks
_WORD = 1.0 / VALVE_FULL_SCALE  # of spool
_SURE = 3.0  # [D] standard deviations: further from its known deadband no edge is sought
_LEAKS_RAD_S = 1e-3  # [E] at most at first: a joint that was just shut still moves
_FILTER_S = 0.1  # [D] of a held joint's error
_ZONE_RAD = 2.4e-5  # [D] half a digit: nearer, the leak is taken for known
_LEARNS = 0.12  # [D] of the gain squared: so slowly that it does not swing through the backlash
_CALM_S = 5.0  # [D] quiet for so long, a held joint needs less gain of a slower filter, and it leans
_SOFT, _SOFT_FILTER_S = 0.25, 1.0  # [D]
_LEANS_RAD_S = 4e-6  # [M] ten times what the encoder's noise makes of that gain
_SOFT_SPRING, _LEARNS_SPRING = 0.4, 0.25  # [M] instead, of a joint whose load tells,
_EXCITED_RAD = 1e-4  # [D] and is not calm further off
_SUNK_RAD, _SUNK_S = 1e-4, 60.0  # [M] what the load tells at most, forgotten in: friction relaxes, too;
_SILENT_S = 200.0  # [M] instead, where the encoder does not tell otherwise
_HASTENS = 4.0  # [M] while the load tells that a parked joint sinks: between edges an opening does little,
_TELLS_RAD = 1.5e-5  # [E] by a tenth of a bar, and the encoder, within its backlash, does not tell otherwise
_HIGH_RAD, _HIGH_S = 1e-4, 5.0  # [D] a joint stands so much too high for so long: its valve is shut


@kernel
def start_holding(joint: Joint, drift: float, load: float) -> None:
    """From now on the joint, which leaks by ``drift`` (rad/s) under ``load`` (bar), is held."""
    leak = joint.leak
    joint.phase, joint.since, joint.creep = HOLD, 0.0, drift
    joint.jog.sense = 1.0 if joint.error > joint.place else -1.0
    leak.bias = min(max(joint.jog.sense * drift, 0.0), _LEAKS_RAD_S)
    leak.load, leak.remainder, leak.too_high, leak.highest = load, 0.0, 0.0, -_HIGH_RAD


def soft_gain(law: ParkingLaw) -> Array:
    """The gain (6,) of held joints once they are calm (1/s)."""
    return np.asarray(np.where(law.friction_spring > 0.0, _SOFT_SPRING, _SOFT) * law.holding_gain)


@kernel
def holding_spool(law: ParkingLaw, joint: Joint, i: int, error: float, load: float, gains: Array) -> float:
    """The spool command of held joint ``i``, on one side of the overlap.

    Proportional to its error, and a bias that learns the leak and where the edge is. One step of the valve's
    word is 15 µrad/s of the crane's lift, more than the balance bears: what a scan rounds off, the next ones
    make up for.
    """
    leak, springs = joint.leak, law.friction_spring[i] > 0.0
    k, learns, filter_s, lean = law.holding_gain[i], _LEARNS_SPRING if springs else _LEARNS, _FILTER_S, 0.0
    far = springs and abs(joint.error - joint.place) > _EXCITED_RAD
    if not far and (joint.watch.quiet > _CALM_S or joint.rest > MOVES):
        k, filter_s = (_SOFT_SPRING if springs else _SOFT) * k, _SOFT_FILTER_S
        lean = 0.0 if springs else _LEANS_RAD_S
    keep = math.exp(-law.dt_s / filter_s)
    joint.error = keep * joint.error + (1.0 - keep) * error
    if abs(joint.error - joint.place) > FAR_RAD:
        shut_valve(joint, error)
        joint.jog.repeats = _NOT_AGAIN
        return 0.0
    sunk = _sunk_by_load(law, joint, i, load)
    if springs and _stands_too_high(joint, law.dt_s):
        return 0.0
    sense = joint.jog.sense
    side = 0 if sense > 0.0 else 1
    gain, below = gains[side], sense * (joint.error - joint.place)
    outside = math.copysign(max(abs(below) - _ZONE_RAD, 0.0), below)
    if joint.rest > MOVES and outside >= 0.0 and sense * sunk > _TELLS_RAD:
        learns *= _HASTENS
    doubt = gain * _SURE * law.spread[i, side]
    bias = leak.bias + learns * k * k * (outside + sense * sunk) * law.dt_s
    leak.bias = min(max(bias, -doubt), doubt + law.fastest)
    opened = max(joint.valve.edge[side] + (k * (below + sense * sunk) + leak.bias - lean) / gain, 0.0)
    word = round((opened + leak.remainder) / _WORD)
    leak.remainder += opened - _WORD * word
    return float(sense * _WORD * word)


@kernel
def _sunk_by_load(law: ParkingLaw, joint: Joint, i: int, load: float) -> float:
    """How far (rad) joint ``i`` has sunk lately by its ``load`` (bar), within its backlash.

    What pushes a joint up by a hair has to push harder than what lets it down.
    """
    spring, leak = law.friction_spring[i], joint.leak
    if spring == 0.0:
        return 0.0
    most, below = _SUNK_RAD / spring, joint.error - joint.place
    contradicted = below * (leak.load - load) < 0.0 and abs(below) > _ZONE_RAD
    leak.load += (load - leak.load) * law.dt_s / (_SUNK_S if contradicted else _SILENT_S)
    leak.load = min(max(leak.load, load - most), load + most)
    return float(spring * (leak.load - load))


@kernel
def _stands_too_high(joint: Joint, dt_s: float) -> bool:
    """Whether the joint has stood too high for so long that its valve has to be shut.

    One that goes on although it is shut leaks the other way now, and is held on the other side.
    """
    leak = joint.leak
    below = joint.jog.sense * (joint.error - joint.place)
    leak.too_high = 0.0 if below > -_HIGH_RAD else leak.too_high + dt_s
    if leak.too_high < _HIGH_S:
        leak.highest = min(below, -_HIGH_RAD)
        return False
    leak.remainder = 0.0
    leak.highest = max(leak.highest, below)
    if below < leak.highest - _HIGH_RAD:
        joint.jog.sense, leak.bias, leak.too_high = -joint.jog.sense, 0.0, 0.0
    return True
