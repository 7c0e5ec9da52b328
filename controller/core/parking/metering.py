"""A *metered* jog: a joint behind a poor valve is brought back by as much oil as its way needs.

Friction holds a slew against oil that is compressed by up to two milliradians of its way; the engine's
shaking lets go of that within 2 to 5 s after the valve has shut. A jog that waits for the encoder, or an
integral, has let far too much oil through by then, and the joint hunts. With the valve shut, q + c · load
pressure stays as it is while the joint relaxes (c = V / (2 β D) of a motor with chambers V, displacement D
and bulk modulus β). So it changes by what flows alone, and tells at once what an opening has passed.
"""

import math

from controller.core.kinematics.rotations import Array
from controller.core.parking.joint import JOG, SHUT, Joint, ParkingLaw
from foundation.compiled import kernel

_FAST_FILTER_S = 0.05  # [D] of error and oil while a valve is open
_FLOW_FILTER_S = 0.1  # [D] of the oil's rate
_SEEN_RAD = 6e-5  # [E] by the fast filter: more than the encoder's noise
_UNSURE_S = 1.0  # [D] through the doubt about an edge
_RISE_RAD_S2 = 1.5e-3  # [E] at least: a mobile valve's lateness adds less than a tenth of a milliradian


@kernel
def start_metered(joint: Joint, off: float) -> float:
    """The first spool command of a metered jog for a joint that is ``off`` (rad) its place."""
    sense = 1.0 if off > 0.0 else -1.0
    side, jog, oil = 0 if sense > 0.0 else 1, joint.jog, joint.oil
    joint.phase, joint.since, jog.sense, jog.start = JOG, 0.0, sense, joint.error
    oil.travel, oil.rate, oil.start = abs(off), 0.0, oil.error
    jog.spool = max(joint.valve.edge[side] - joint.valve.doubt[side], 0.0)
    return sense * float(jog.spool)


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
        rise = max(gain * joint.valve.doubt[side] / _UNSURE_S, _RISE_RAD_S2)
        jog.spool = min(jog.spool + rise / gain * law.dt_s, law.surely_open[i, side])
    passed = sense * (oil.start - oil.error)
    gone = sense * (jog.start - joint.error)
    full = passed + max(oil.rate, 0.0) * late >= oil.travel
    there = gone + max(sense * joint.speed, 0.0) * late >= oil.travel and gone > _SEEN_RAD
    if not full and not there:
        return float(sense * jog.spool)
    joint.phase, joint.since = SHUT, 0.0
    return 0.0
