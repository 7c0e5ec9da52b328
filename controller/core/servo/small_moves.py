"""How a joint whose valve is shut is moved by a tenth of a milliradian: inches and nudges.

An *inch* brings a joint back by a way that its encoder sees. A *nudge* is shorter than the play before the
encoder: the valve opens until the oil feels it, and how long the joint takes to sink back tells how far it
rose.
A joint that leaks too fast for either is *kept* (``keeping``).
"""

import math

from controller.core.kinematics.rotations import Array
from controller.core.servo.parking_state import (
    AFTER,
    BAND,
    DOUBT,
    DRIFT,
    EDGE,
    ERROR,
    FINE,
    FROM,
    LOAD_AT,
    MARK,
    NUDGE,
    NUDGED,
    OPEN,
    OPENED,
    PHASE,
    PLACE,
    PUSH,
    SEEN,
    SENSE,
    SHUT,
    SINCE,
    SPEED,
    ParkingLaw,
)
from foundation.compiled import kernel

_SEEN_RAD = 9.6e-5  # two digits of a 17 bit encoder: less may be noise
_BEYOND = 0.3  # of the band: how far beyond its place a creeping joint is put
_CREEPS_1_S = 0.1  # of its band in a second: from there on a joint is put beyond its place
_SURE = 3.0  # standard deviations: further from its known deadband no edge is sought
_FINE_RAD = 3e-4  # six digits: of a shorter way, speed tells nothing, and the inch takes its time
_FAST_FILTER_S = 0.05  # of the error while a valve is open
_LEAST_SEEN_RAD = 3e-5  # by that filter: six standard deviations of its noise
_EASY = 0.2  # of way / lateness²: a joint that is accelerated so overshoots by nothing when shut half way
_UNSURE_S = 2.0  # through the doubt about an edge
_SURELY_SHUT = 0.5  # of its edge, from where a valve is opened slowly for the first time
_RISES_RAD_S2 = 1e-3  # at least: by what the lateness of a mobile valve adds then, no joint leaves its play,
_RISES_1_S2 = 20.0  # of its band: nor one with a short lever, which may leak a band in ten seconds
_AHEAD_S = 0.7  # before the opening that the oil felt, the next nudge begins
_PUSH_BAR, _LEAST_BAR = 0.15, 0.03  # of the load pressure: the first nudge's, the least of others
_MOST_BAR = 0.8  # a crane's lift rises 0.15 mrad by that, and beyond friction goes through all its play: 5 mm
_HELD_S = 15.0  # a nudge is judged when the joint has stayed for so long: oil that relaxes tells nothing
_HARDER = 1.2  # the next of one that was not: a joint may leak so fast, and sinks by a bit with each


@kernel
def shut(state: Array, i: int, error: float) -> None:
    """Tell valve ``i`` to shut at ``error`` (rad)."""
    state[PHASE, i], state[SINCE, i], state[ERROR, i] = SHUT, 0.0, error


@kernel
def inch_begun(state: Array, i: int, error: float, drift: float, sense: float, gain: float) -> float:
    """The first spool command of an inch: of one that is watched, or of a pulse."""
    side = 0 if sense > 0.0 else 1
    state[DRIFT, i], state[PHASE, i], state[SINCE, i], state[SENSE, i] = drift, OPEN, 0.0, sense
    state[FROM, i], state[SEEN, i] = error, 0.0
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
def inched(law: ParkingLaw, state: Array, i: int, error: float, gains: Array) -> float:
    """An opening valve: further until the joint moves, shut before it gets there.

    The speed rises such that half the way is left when motion is seen, or as fast as the doubt asks for.
    """
    sense, fine = state[SENSE, i], state[FINE, i] > 0.0
    side, latest = 0 if sense > 0.0 else 1, law.latest[i]
    gain, beyond = gains[side], _beyond(state, i)
    keep = math.exp(-law.dt_s / _FAST_FILTER_S)
    state[ERROR, i] = keep * state[ERROR, i] + (1.0 - keep) * error
    way = max(sense * state[FROM, i] + beyond, 2.0 * _LEAST_SEEN_RAD)
    off = state[ERROR, i] - state[PLACE, i]
    gone = sense * (state[FROM, i] - off)
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
        left = sense * (error - state[PLACE, i]) + beyond - speed * law.shutting[i]
    if left > 0.0:
        return float(sense * state[OPENED, i])
    if state[SEEN, i] > 0.0:
        since = min(latest + math.sqrt(2.0 * max(gone, 0.0) / rise), state[SINCE, i])
        _learn(law, state, i, state[OPENED, i] - rise * since / gain)
        state[DOUBT + side, i] = max(0.5 * state[DOUBT + side, i], law.slowest / gain)
    shut(state, i, error)
    return 0.0


@kernel
def _learn(law: ParkingLaw, state: Array, i: int, edge: float) -> None:
    """Believe by half that joint ``i`` moves from ``edge`` on, as far as it is known at all."""
    side = 0 if state[SENSE, i] > 0.0 else 1
    middle, doubt = law.deadband[i, side], _SURE * law.spread[i, side]
    believed = state[EDGE + side, i] + 0.5 * (edge - state[EDGE + side, i])
    state[EDGE + side, i] = min(max(believed, middle - doubt, 0.0), middle + doubt)


@kernel
def nudge_begun(law: ParkingLaw, state: Array, i: int, error: float, sense: float, load: float) -> float:
    """The first spool command of a nudge that shall raise joint ``i`` as far beyond its place as it sank.

    ``error`` (rad): by the encoder now; ``load`` (bar). The last nudge raised the joint by what it sank
    since, less what the encoder saw of that: so the push of the next one is chosen, if that held. If not, it
    is pushed harder, up to what raises it by as much as nudges ever shall.
    """
    side = 0 if sense > 0.0 else 1
    if state[NUDGE + side, i] == 0.0:
        state[NUDGE + side, i], state[PUSH + side, i] = _SURELY_SHUT * state[EDGE + side, i], _PUSH_BAR
    elif sense == state[SENSE, i]:
        band, sunk_by = state[BAND, i], sense * (error - state[PLACE, i])
        rises = _HARDER * law.oil[i] * state[PUSH + side, i]  # 0 where that is not known
        more = _HARDER if 0.0 < rises < 2.0 * band else 1.0
        if state[AFTER, i] > _HELD_S:
            sunk = sense * (error - state[MARK, i])
            rose = max(sense * state[DRIFT, i] * state[AFTER, i] - sunk, 0.0)
            wanted = min(max(2.0 * sunk_by, band), 2.0 * band)
            more = min(max(wanted / max(rose, 0.1 * band), 0.5), 2.0)
        state[PUSH + side, i] = min(max(more * state[PUSH + side, i], _LEAST_BAR), _MOST_BAR)
    state[MARK, i], state[AFTER, i], state[PHASE, i], state[SINCE, i] = error, 0.0, NUDGED, 0.0
    state[OPENED, i], state[SENSE, i], state[LOAD_AT, i] = state[NUDGE + side, i], sense, load
    return float(sense * state[OPENED, i])


@kernel
def nudged(law: ParkingLaw, state: Array, i: int, error: float, load: float, gains: Array) -> float:
    """The valve opens further, slowly, until the oil feels it; then it is shut.

    Whichever edge opens first: oil that was locked in on the far side of the piston moves the joint, too.
    """
    sense = state[SENSE, i]
    side = 0 if sense > 0.0 else 1
    rise = max(_RISES_RAD_S2, _RISES_1_S2 * state[BAND, i]) / gains[side]
    state[OPENED, i] += rise * law.dt_s
    felt = abs(load - state[LOAD_AT, i]) > state[PUSH + side, i]
    highest = law.deadband[i, side] + _SURE * law.spread[i, side]
    if not felt and state[OPENED, i] < highest and sense * (state[MARK, i] - error) < _SEEN_RAD:
        return float(sense * state[OPENED, i])
    state[NUDGE + side, i] = max(state[OPENED, i] - rise * _AHEAD_S, _SURELY_SHUT * state[EDGE + side, i])
    shut(state, i, error)
    return 0.0
