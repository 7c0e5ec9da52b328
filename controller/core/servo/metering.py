"""A *metered* inch: a joint behind a poor valve is brought back by as much oil as its way needs.

Friction holds a slew against oil that is compressed by up to two milliradians of its way; the engine's
shaking lets go of that within 2 to 5 s after the valve has shut. An inch that waits for the encoder, or an
integral, has let far too much oil through by then, and the joint hunts. With the valve shut, q + c · load
pressure stays as it is while the joint relaxes (c = V / (2 β D) of a motor with chambers V, displacement D
and bulk modulus β). So it changes by what flows alone, and tells at once what an opening has passed.
"""

import math

from controller.core.kinematics.rotations import Array
from controller.core.servo.parking_state import (
    CAME,
    DOUBT,
    EASE,
    EASE_AT,
    EDGE,
    ERROR,
    FROM,
    GIVES,
    OIL,
    OIL_AT,
    OIL_FROM,
    OPEN,
    OPENED,
    OPENING,
    PARKED,
    PHASE,
    RATE,
    SENSE,
    SHUT,
    SINCE,
    SPEED,
    WAY,
    WENT,
    ParkingLaw,
)
from foundation.compiled import kernel

_FAST_FILTER_S = 0.05  # of error and oil while a valve is open
_FLOW_FILTER_S = 0.1  # of the oil's rate
_SEEN_RAD = 6e-5  # by the fast filter: more than the encoder's noise
_UNSURE_S = 1.0  # through the doubt about an edge
_RISE_RAD_S2 = 1.5e-3  # at least: a mobile valve's lateness adds less than a tenth of a milliradian
_STUCK = 0.3  # of its way: a joint that moved by less sticks, and gets twice the oil next time,
_MOST = 16.0  # times its way at most
_TOO_MUCH = 1.5  # times what was wanted: the edge is nearer than it was believed to be,
_STEP = 0.1  # by a tenth of the deadband at least,
_LOWEST = 0.5  # never by more than half of it
_SHORTEST_S = 0.05  # of an opening, for its flow
_KEEPS = 0.5  # of what it may be off: by so much a joint still presses on when its oil has been let out
_HELD = 1.4  # of what friction holds: more let out, it would come back where the load is not as learned
_MOST_LOADED = 4.0  # of what it may be off: what is let out of a loaded joint at once
_SAME_LOAD_RAD = 5e-3  # so near, the load of a loaded joint is what it was at ease
_EASES_S = 5.0  # how soon a resting joint's oil is believed to be at ease


@kernel
def metered_begun(state: Array, i: int, off: float) -> float:
    """The first spool command of an inch for joint ``i``, which is ``off`` (rad) its place."""
    sense = 1.0 if off > 0.0 else -1.0
    side = 0 if sense > 0.0 else 1
    moved = state[SENSE, i] * (state[FROM, i] - state[ERROR, i])
    if state[WAY, i] > 0.0:
        if sense != state[SENSE, i]:
            state[GIVES, i] = 1.0
        elif moved < _STUCK * state[WAY, i]:
            state[GIVES, i] = min(2.0 * state[GIVES, i], _MOST)
        else:
            state[GIVES, i] = max(0.5 * state[GIVES, i], 1.0)
    state[PHASE, i], state[SINCE, i], state[SENSE, i] = OPEN, 0.0, sense
    state[WAY, i], state[FROM, i], state[RATE, i] = abs(off), state[ERROR, i], 0.0
    state[OIL_FROM, i] = state[OIL, i]
    state[OPENED, i] = max(state[EDGE + side, i] - state[DOUBT + side, i], 0.0)
    return sense * float(state[OPENED, i])


@kernel
def let_out(law: ParkingLaw, state: Array, i: int) -> float:
    """How much oil (rad, with the sense of its flow) to let out of joint ``i``; 0: none, it is not there yet.

    Friction holds a joint that has arrived against the oil that moved it, and lets go of it later: it would
    go on by all that, and come back through its play. What is learned of the load is not wholly trusted:
    where nothing shakes, a joint rests under any that friction holds. One that sinks is not held up so.
    """
    oil, error = state[ERROR, i] - state[OIL, i], state[ERROR, i]
    sense = 1.0 if oil > state[EASE, i] else -1.0
    most = _HELD * abs(oil) + 2.0 * law.leaves
    if law.loaded[i] > 0.0:
        if not _raised_here(state, i, sense):
            return 0.0
        most = _MOST_LOADED * law.leaves
    presses, short = min(sense * (oil - state[EASE, i]), most), max(sense * error, 0.0)
    if short > law.leaves or presses - short < law.leaves:
        return 0.0
    return float(-sense * (presses - max(short, _KEEPS * law.leaves)))


@kernel
def _raised_here(state: Array, i: int, sense: float) -> bool:
    """Whether loaded joint ``i`` was raised, presses on, and is where its load at ease was learned."""
    near = state[EASE, i] != 0.0 and abs(state[WENT, i] - state[EASE_AT, i]) < _SAME_LOAD_RAD
    return bool(near and sense > 0.0 and state[CAME, i] > 0.0)


@kernel
def eased(law: ParkingLaw, state: Array, i: int, load: float) -> float:
    """The first spool command that lets oil out of shut joint ``i``; 0 while there is nothing to let out.

    From a joint that rests, what its oil is compressed by at ease is learned.
    """
    if state[PARKED, i] > 0.0:
        if abs(state[WENT, i] - state[EASE_AT, i]) > _SAME_LOAD_RAD and law.loaded[i] > 0.0:
            state[EASE, i] = law.oil[i] * load
        state[EASE, i] += (law.oil[i] * load - state[EASE, i]) * law.dt_s / _EASES_S
        state[EASE_AT, i] = state[WENT, i]
        return 0.0
    oil = let_out(law, state, i)
    if oil == 0.0:
        return 0.0
    spool = metered_begun(state, i, oil)
    state[GIVES, i] = 1.0  # oil that was let out before moved nothing, as it should
    return float(spool)


@kernel
def metered(law: ParkingLaw, state: Array, i: int, error: float, load: float, gains: Array) -> float:
    """An opening valve: further until oil flows, shut when enough has passed, or the joint gets there."""
    sense = state[SENSE, i]
    side = 0 if sense > 0.0 else 1
    late, gain, way = law.shutting[i], gains[side], state[WAY, i]
    keep = math.exp(-law.dt_s / _FAST_FILTER_S)
    state[ERROR, i] = keep * state[ERROR, i] + (1.0 - keep) * error
    before = state[OIL, i]
    state[OIL, i] = keep * before + (1.0 - keep) * (error - law.oil[i] * load)
    flow = sense * (before - state[OIL, i]) / law.dt_s
    state[RATE, i] += (flow - state[RATE, i]) * law.dt_s / _FLOW_FILTER_S
    if state[RATE, i] < max(way / (3.0 * law.latest[i]), law.slowest):
        opened = state[OPENED, i] + _rise(law, state, i, side, gain) / gain * law.dt_s
        state[OPENED, i] = min(opened, law.highest[i, side])
    passed = sense * (state[OIL_FROM, i] - state[OIL, i])
    gone = sense * (state[FROM, i] - state[ERROR, i])
    full = passed + max(state[RATE, i], 0.0) * late >= state[GIVES, i] * way
    there = gone + max(sense * state[SPEED, i], 0.0) * late >= way and gone > _SEEN_RAD
    if not full and not there:
        return float(sense * state[OPENED, i])
    state[OPENING, i] = state[SINCE, i]
    state[PHASE, i], state[SINCE, i] = SHUT, 0.0
    return 0.0


@kernel
def _rise(law: ParkingLaw, state: Array, i: int, side: int, gain: float) -> float:
    """How fast an opening valve lets its joint become faster (rad/s²)."""
    return float(max(gain * state[DOUBT + side, i] / _UNSURE_S, _RISE_RAD_S2))


@kernel
def learned(law: ParkingLaw, state: Array, i: int, gains: Array) -> None:
    """Learn, once the valve of joint ``i`` has shut, from what has passed where its edge is."""
    side = 0 if state[SENSE, i] > 0.0 else 1
    wanted = state[GIVES, i] * state[WAY, i]
    passed = state[SENSE, i] * (state[OIL_FROM, i] - state[OIL_AT, i])
    middle, gain, edge = law.deadband[i, side], gains[side], state[EDGE + side, i]
    if passed > _TOO_MUCH * wanted:
        nearer = (passed - wanted) / (gain * max(state[OPENING, i], _SHORTEST_S))
        edge -= max(nearer, _STEP * middle)
    else:
        late = _rise(law, state, i, side, gain) * law.shutting[i]
        seen = state[OPENED, i] - (law.slowest + late) / gain
        edge += 0.5 * max(seen - edge, 0.0)
    state[EDGE + side, i] = min(max(edge, _LOWEST * middle), law.highest[i, side])
    state[DOUBT + side, i] = max(0.5 * state[DOUBT + side, i], law.slowest / gain)
    state[OPENING, i] = 0.0
