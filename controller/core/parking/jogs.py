"""How a joint whose valve is shut is moved by a tenth of a milliradian: jogs and pulses.

A *jog* brings a joint back by a way that its encoder sees. A *pulse* is shorter than the backlash before the
encoder: the valve opens until the load pressure has changed, and how long the joint takes to sink back tells
how far it rose.
"""

import math

from controller.core.kinematics.rotations import Array
from controller.core.parking.joint import JOG, PULSE, SHUT, Joint, ParkingLaw
from foundation.compiled import kernel

_SEEN_RAD = 9.6e-5  # [D] two digits of a 17 bit encoder: less may be noise
_OVERTRAVEL = 0.3  # [D] of the band: how far beyond its place a creeping joint is put
_CREEPS_1_S = 0.1  # [D] of its band in a second: from there on a joint is put beyond its place
_SURE = 3.0  # [D] standard deviations: further from its known deadband no edge is sought
_FINE_RAD = 3e-4  # [D] six digits: of a shorter way, speed tells nothing, and the jog takes its time
_FAST_FILTER_S = 0.05  # [D] of the error while a valve is open
_LEAST_SEEN_RAD = 3e-5  # [E] by that filter: six standard deviations of its noise
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
    rise = max(way / (latest * latest), gain * valve.doubt[side] / _UNSURE_S)
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
