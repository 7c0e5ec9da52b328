"""A *metered* jog: a joint behind a poor valve is brought back by as much oil as its way needs.

Friction holds a slew against oil that is compressed by up to two milliradians of its way; the engine's
shaking lets go of that within 2 to 5 s after the valve has shut. A jog that waits for the encoder, or an
integral, has let far too much oil through by then, and the joint hunts. With the valve shut, q + c · load
pressure stays as it is while the joint relaxes (c = V / (2 β D) of a motor with chambers V, displacement D
and bulk modulus β). So it changes by what flows alone, and tells at once what an opening has passed.
"""

import math

from controller.core.kinematics.rotations import Array
from controller.core.parking.joint import JOG, MOVES, SHUT, Joint, ParkingLaw
from foundation.compiled import kernel

_FAST_FILTER_S = 0.05  # [D] of error and oil while a valve is open
_FLOW_FILTER_S = 0.1  # [D] of the oil's rate
_SEEN_RAD = 6e-5  # [E] by the fast filter: more than the encoder's noise
_UNSURE_S = 1.0  # [D] through the doubt about an edge
_RISE_RAD_S2 = 1.5e-3  # [E] at least: a mobile valve's lateness adds less than a tenth of a milliradian
_STUCK = 0.3  # [D] of its travel: a joint that moved by less sticks, and gets twice the oil next time,
_MOST = 16.0  # [D] times its travel at most
_TOO_MUCH = 1.5  # [D] times what was meant: the edge is nearer than it was believed to be,
_STEP = 0.1  # [D] by a tenth of the deadband at least,
_LOWEST = 0.5  # [D] never by more than half of it
_SHORTEST_S = 0.05  # [D] of an opening, for its flow
_REMAINS = 0.5  # [D] of what it may be off: by so much a joint still presses on when its oil was released
_HELD = 1.4  # [M] of what friction holds: more released, it would come back where the load is not as learned
_MOST_LOADED = 4.0  # [D] of what it may be off: what is released from a loaded joint at once
_SAME_LOAD_RAD = 5e-3  # [E] so near, the load of a loaded joint is what it was when relaxed
_RELAXES_S = 5.0  # [D] how soon a resting joint's oil is believed to be relaxed


@kernel
def start_metered(joint: Joint, off: float) -> float:
    """The first spool command of a metered jog for a joint that is ``off`` (rad) its place."""
    sense = 1.0 if off > 0.0 else -1.0
    side, jog, oil = 0 if sense > 0.0 else 1, joint.jog, joint.oil
    moved = jog.sense * (jog.start - joint.error)
    if oil.travel > 0.0:
        if sense != jog.sense:
            oil.share = 1.0
        elif moved < _STUCK * oil.travel:
            oil.share = min(2.0 * oil.share, _MOST)
        else:
            oil.share = max(0.5 * oil.share, 1.0)
    joint.phase, joint.since, jog.sense, jog.start = JOG, 0.0, sense, joint.error
    oil.travel, oil.rate, oil.start = abs(off), 0.0, oil.error
    jog.spool = max(joint.valve.edge[side] - joint.valve.doubt[side], 0.0)
    return sense * float(jog.spool)


@kernel
def oil_to_release(law: ParkingLaw, joint: Joint, i: int) -> float:
    """How much oil (rad, with the sense of its flow) to release from joint ``i``; 0: none yet.

    Friction holds a joint that has arrived against the oil that moved it, and lets go of it later: it would
    go on by all that, and come back through its backlash. What is learned of the load is not wholly trusted:
    where nothing shakes, a joint rests under any that friction holds. One that sinks is not held up so.
    """
    compressed, error = joint.error - joint.oil.error, joint.error
    sense = 1.0 if compressed > joint.oil.relaxed else -1.0
    most = _HELD * abs(compressed) + 2.0 * law.settled
    if law.loaded[i] > 0.0:
        if not _was_raised_here(joint, sense):
            return 0.0
        most = _MOST_LOADED * law.settled
    presses, short = min(sense * (compressed - joint.oil.relaxed), most), max(sense * error, 0.0)
    if short > law.settled or presses - short < law.settled:
        return 0.0
    return float(-sense * (presses - max(short, _REMAINS * law.settled)))


@kernel
def _was_raised_here(joint: Joint, sense: float) -> bool:
    """Whether a loaded joint was raised, presses on, and is where its relaxed load was learned."""
    near = joint.oil.relaxed != 0.0 and abs(joint.side.angle - joint.oil.relaxed_at) < _SAME_LOAD_RAD
    return bool(near and sense > 0.0 and joint.side.sense > 0.0)


@kernel
def decompression_spool(law: ParkingLaw, joint: Joint, i: int, load: float) -> float:
    """The first spool command that releases oil from shut joint ``i``; 0 while there is nothing to release.

    From a joint that rests, what its oil is compressed by when relaxed is learned.
    """
    oil, spring = joint.oil, law.oil_spring[i]
    if joint.rest > MOVES:
        if abs(joint.side.angle - oil.relaxed_at) > _SAME_LOAD_RAD and law.loaded[i] > 0.0:
            oil.relaxed = spring * load
        oil.relaxed += (spring * load - oil.relaxed) * law.dt_s / _RELAXES_S
        oil.relaxed_at = joint.side.angle
        return 0.0
    release = oil_to_release(law, joint, i)
    if release == 0.0:
        return 0.0
    spool = start_metered(joint, release)
    oil.share = 1.0  # oil that was released before moved nothing, as it should
    return float(spool)


@kernel
def metered_spool(law: ParkingLaw, joint: Joint, i: int, error: float, load: float, gains: Array) -> float:
    """The spool command of a metered jog: open until enough oil has passed, or the joint gets there."""
    jog, oil, sense = joint.jog, joint.oil, joint.jog.sense
    side = 0 if sense > 0.0 else 1
    late, gain = law.shutting[i], gains[side]
    keep = math.exp(-law.dt_s / _FAST_FILTER_S)
    joint.error = keep * joint.error + (1.0 - keep) * error
    before = oil.error
    oil.error = keep * before + (1.0 - keep) * (error - law.oil_spring[i] * load)
    flow = sense * (before - oil.error) / law.dt_s
    oil.rate += (flow - oil.rate) * law.dt_s / _FLOW_FILTER_S
    if oil.rate < max(oil.travel / (3.0 * law.latest[i]), law.slowest):
        opened = jog.spool + _rise(joint, side, gain) / gain * law.dt_s
        jog.spool = min(opened, law.surely_open[i, side])
    passed = sense * (oil.start - oil.error)
    gone = sense * (jog.start - joint.error)
    full = passed + max(oil.rate, 0.0) * late >= oil.share * oil.travel
    there = gone + max(sense * joint.speed, 0.0) * late >= oil.travel and gone > _SEEN_RAD
    if not full and not there:
        return float(sense * jog.spool)
    oil.opened = joint.since
    joint.phase, joint.since = SHUT, 0.0
    return 0.0


@kernel
def _rise(joint: Joint, side: int, gain: float) -> float:
    """How fast an opening valve lets its joint become faster (rad/s²)."""
    return float(max(gain * joint.valve.doubt[side] / _UNSURE_S, _RISE_RAD_S2))


@kernel
def learn_from_metered(law: ParkingLaw, joint: Joint, i: int, gains: Array) -> None:
    """Learn, once the valve of joint ``i`` has shut, from the oil that has passed where its edge is."""
    side, oil, valve = 0 if joint.jog.sense > 0.0 else 1, joint.oil, joint.valve
    meant = oil.share * oil.travel
    passed = joint.jog.sense * (oil.start - oil.end)
    middle, gain, edge = law.deadband[i, side], gains[side], valve.edge[side]
    if passed > _TOO_MUCH * meant:
        nearer = (passed - meant) / (gain * max(oil.opened, _SHORTEST_S))
        edge -= max(nearer, _STEP * middle)
    else:
        late = _rise(joint, side, gain) * law.shutting[i]
        seen = joint.jog.spool - (law.slowest + late) / gain
        edge += 0.5 * max(seen - edge, 0.0)
    valve.edge[side] = min(max(edge, _LOWEST * middle), law.surely_open[i, side])
    valve.doubt[side] = max(0.5 * valve.doubt[side], law.slowest / gain)
    oil.opened = 0.0
