"""A *jog* moves a joint behind a shut valve by a tenth of a milliradian, with as much oil as its way needs.

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
def start_jog(law: ParkingLaw, joint: Joint, i: int, way: float) -> float:
    """The first spool command of a jog that takes joint ``i`` on by ``way`` (rad, with its sign)."""
    joint.sense, joint.travel = (1.0 if way > 0.0 else -1.0), abs(way)
    joint.phase, joint.since, joint.rate = JOG, 0.0, 0.0
    joint.start, joint.oil_start = joint.error, joint.oil
    joint.spool = law.early[i, 0 if way > 0.0 else 1]
    return float(joint.sense * joint.spool)


@kernel
def jog_spool(law: ParkingLaw, joint: Joint, i: int, seen: tuple[float, float, float], gains: Array) -> float:
    """The spool command of a jog: further open until oil flows, shut when enough of it has passed.

    ``seen``: error (rad), load (bar), speed (rad/s) of joint ``i`` now. ``gains`` (2,): joint speed (rad/s)
    per spool beyond the edge, raising and lowering. A joint that gets there before its oil is shut, too.
    """
    error, load, speed = seen
    sense, late = joint.sense, law.shutting[i]
    side = 0 if sense > 0.0 else 1
    keep, before = math.exp(-law.dt_s / _FAST_FILTER_S), joint.oil
    joint.error = keep * joint.error + (1.0 - keep) * error
    joint.oil = keep * before + (1.0 - keep) * (error - law.oil_spring[i] * load)
    flow = sense * (before - joint.oil) / law.dt_s
    joint.rate += (flow - joint.rate) * law.dt_s / _FLOW_FILTER_S
    if joint.rate < max(joint.travel / (3.0 * law.latest[i]), law.slowest):
        rise = max(law.doubt[i, side] / _UNSURE_S, _RISE_RAD_S2 / gains[side])
        joint.spool = min(joint.spool + rise * law.dt_s, law.surely_open[i, side])
    passed = sense * (joint.oil_start - joint.oil)
    gone = sense * (joint.start - joint.error)
    full = passed + max(joint.rate, 0.0) * late >= joint.travel
    there = gone + max(sense * speed, 0.0) * late >= joint.travel and gone > _SEEN_RAD
    if not full and not there:
        return float(sense * joint.spool)
    joint.phase, joint.since, joint.rate = SHUT, 0.0, 0.0
    return 0.0
