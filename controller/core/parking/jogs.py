"""How a joint whose valve is shut is moved by a tenth of a milliradian: jogs and pulses.

A *jog* brings a joint back by a way that its encoder sees. A *pulse* is shorter than the backlash before the
encoder: the valve opens until the load pressure has changed, and how long the joint takes to sink back tells
how far it rose. A joint that leaks too fast for either is *held* (``leak``).
"""

import math

import numpy as np

from controller.core.kinematics.rotations import Array
from controller.core.parking.joint import HOLD, JOG, MOVES, PULSE, SHUT, Joint, ParkingLaw
from foundation.compiled import kernel
from protocol.process_image import VALVE_FULL_SCALE

_SEEN_RAD = 9.6e-5  # [D] two digits of a 17 bit encoder: less may be noise
_OVERTRAVEL = 0.3  # [D] of the band: how far beyond its place a creeping joint is put
_CREEPS_1_S = 0.1  # [D] of its band in a second: from there on a joint is put beyond its place
_SURE = 3.0  # [D] standard deviations: further from its known deadband no edge is sought
_FINE_RAD = 3e-4  # [D] six digits: of a shorter way, speed tells nothing, and the jog takes its time
_FAST_FILTER_S = 0.05  # [D] of the error while a valve is open
_LEAST_SEEN_RAD = 3e-5  # [E] by that filter: six standard deviations of its noise
_EASY = 0.2  # [D] of way / lateness²: a joint that is accelerated so overshoots by nothing when shut half way
_UNSURE_S = 2.0  # [D] through the doubt about an edge
_SURELY_SHUT = 0.5  # [D] of its edge, from where a valve is opened slowly for the first time
_RISES_RAD_S2 = 1e-3  # [E] at least: what a late mobile valve adds takes no joint out of its backlash,
_RISES_1_S2 = 20.0  # [M] of its band: nor one with a short lever, which may leak a band in ten seconds
_AHEAD_S = 0.7  # [D] before the opening that the load answered to, the next pulse begins
_PUSH_BAR, _LEAST_BAR = 0.15, 0.03  # [D] of the load pressure: the first pulse's, the least of others
_MOST_BAR = 0.8  # [M] a crane's lift rises 0.15 mrad by that; beyond, it crosses all its backlash: 5 mm
_JUDGED_S = 15.0  # [M] a pulse is judged when the joint has stayed so long: relaxing oil tells nothing
_HARDER = 1.2  # [D] the next of one that was not: a joint may leak so fast, and sinks by a bit with each


@kernel
def shut_valve(joint: Joint, error: float) -> None:
    """Tell the joint's valve to shut at ``error`` (rad)."""
    joint.phase, joint.since, joint.error = SHUT, 0.0, error


@kernel
def start_jog(joint: Joint, off: float, drift: float, sense: float) -> float:
    """The first spool command of a jog for a joint that is ``off`` (rad) and creeps by ``drift`` (rad/s)."""
    side, jog = 0 if sense > 0.0 else 1, joint.jog
    joint.creep, joint.phase, joint.since, jog.sense = drift, JOG, 0.0, sense
    jog.start, jog.seen = off, 0
    jog.spool = max(joint.valve.edge[side] - joint.valve.doubt[side], 0.0)
    jog.fine = 1 if sense * off + _overtravel(joint) < _FINE_RAD else 0
    return sense * float(jog.spool)


@kernel
def _overtravel(joint: Joint) -> float:
    """How far (rad) beyond its place the joint is put."""
    creeps = joint.jog.sense * joint.creep > _CREEPS_1_S * joint.band
    return _OVERTRAVEL * joint.band if creeps else 0.0


@kernel
def jog_spool(law: ParkingLaw, joint: Joint, i: int, error: float, gains: Array) -> float:
    """The spool command of a jog: further open until the joint moves, shut before it gets there.

    The speed rises such that half the way is left when motion is seen, or as fast as the doubt asks for.
    """
    jog, valve, sense = joint.jog, joint.valve, joint.jog.sense
    side, latest = 0 if sense > 0.0 else 1, law.latest[i]
    gain, beyond = gains[side], _overtravel(joint)
    keep = math.exp(-law.dt_s / _FAST_FILTER_S)
    joint.error = keep * joint.error + (1.0 - keep) * error
    way = max(sense * jog.start + beyond, 2.0 * _LEAST_SEEN_RAD)
    gone = sense * (jog.start - (joint.error - joint.place))
    speed = max(sense * joint.speed, 0.0)
    easy = _EASY if jog.fine else 1.0
    rise = max(easy * way / (latest * latest), gain * valve.doubt[side] / _UNSURE_S)
    if gone > (_LEAST_SEEN_RAD if jog.fine else _SEEN_RAD):
        jog.seen = 1
    if jog.fine or speed < min(max(way / (3.0 * latest), law.slowest), law.fastest):
        highest = law.deadband[i, side] + _SURE * law.spread[i, side]
        jog.spool = min(jog.spool + rise / gain * law.dt_s, highest)
    remaining = 0.5 * way - gone
    if not jog.fine and jog.seen:  # before it is seen, the encoder's noise is its speed
        remaining = sense * (error - joint.place) + beyond - speed * law.shutting[i]
    if remaining > 0.0:
        return float(sense * jog.spool)
    if jog.seen:
        since = min(latest + math.sqrt(2.0 * max(gone, 0.0) / rise), joint.since)
        _learn_edge(law, joint, i, jog.spool - rise * since / gain)
        valve.doubt[side] = max(0.5 * valve.doubt[side], law.slowest / gain)
    shut_valve(joint, error)
    return 0.0


@kernel
def _learn_edge(law: ParkingLaw, joint: Joint, i: int, edge: float) -> None:
    """Believe by half that joint ``i`` moves from ``edge`` on, as far as it is known at all."""
    side = 0 if joint.jog.sense > 0.0 else 1
    middle, doubt = law.deadband[i, side], _SURE * law.spread[i, side]
    believed = joint.valve.edge[side] + 0.5 * (edge - joint.valve.edge[side])
    joint.valve.edge[side] = min(max(believed, middle - doubt, 0.0), middle + doubt)


@kernel
def start_pulse(law: ParkingLaw, joint: Joint, i: int, error: float, sense: float, load: float) -> float:
    """The first spool command of a pulse that shall raise joint ``i`` as far beyond its place as it sank.

    ``error`` (rad): by the encoder now; ``load`` (bar). The last pulse raised the joint by what it sank
    since, less what the encoder saw of that: so the push of the next one is chosen, if that lasted. If not,
    it is pushed harder, up to what raises it by as much as pulses ever shall.
    """
    side, pulse = 0 if sense > 0.0 else 1, joint.pulse
    if pulse.spool[side] == 0.0:
        pulse.spool[side], pulse.push[side] = _SURELY_SHUT * joint.valve.edge[side], _PUSH_BAR
    elif sense == joint.jog.sense:
        band, sunk_by = joint.band, sense * (error - joint.place)
        rises = _HARDER * law.oil_spring[i] * pulse.push[side]  # 0 where that is not known
        more = _HARDER if 0.0 < rises < 2.0 * band else 1.0
        if pulse.since > _JUDGED_S:
            sunk = sense * (error - pulse.error)
            rose = max(sense * joint.creep * pulse.since - sunk, 0.0)
            travel = min(max(2.0 * sunk_by, band), 2.0 * band)
            more = min(max(travel / max(rose, 0.1 * band), 0.5), 2.0)
        pulse.push[side] = min(max(more * pulse.push[side], _LEAST_BAR), _MOST_BAR)
    pulse.error, pulse.since, pulse.load = error, 0.0, load
    joint.phase, joint.since, joint.jog.sense, joint.jog.spool = PULSE, 0.0, sense, pulse.spool[side]
    return float(sense * joint.jog.spool)


@kernel
def pulse_spool(law: ParkingLaw, joint: Joint, i: int, error: float, load: float, gains: Array) -> float:
    """The spool command of a pulse: slowly further open until the load pressure answers, then shut.

    Whichever edge opens first: oil that was locked in on the far side of the piston moves the joint, too.
    """
    jog, pulse, sense = joint.jog, joint.pulse, joint.jog.sense
    side = 0 if sense > 0.0 else 1
    rise = max(_RISES_RAD_S2, _RISES_1_S2 * joint.band) / gains[side]
    jog.spool += rise * law.dt_s
    answered = abs(load - pulse.load) > pulse.push[side]
    highest = law.deadband[i, side] + _SURE * law.spread[i, side]
    if not answered and jog.spool < highest and sense * (pulse.error - error) < _SEEN_RAD:
        return float(sense * jog.spool)
    pulse.spool[side] = max(jog.spool - rise * _AHEAD_S, _SURELY_SHUT * joint.valve.edge[side])
    shut_valve(joint, error)
    return 0.0


FAR_RAD = 1e-3  # [D] a joint that went so far is not held, whatever its valve passes: a jog brings it back,
_NOT_AGAIN = -1e6  # and until the next motion no number of moves in a row tells that it leaks
_WORD = 1.0 / VALVE_FULL_SCALE  # of spool
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
