"""What breaks an excitation off: room that is wanted before it, and limits that a running stroke keeps."""

import numpy as np

from controller.core.excitation.excitation_state import (
    SWING_RAD_S,
    Excitation,
    Measured,
    Phase,
    Trouble,
    sense_of,
    turned_by,
)
from controller.core.excitation.plan import ExcitationLimits, Stroke

_BLOCKED_S = 1.0  # without motion under a valve that moved the joint before
_OSCILLATIONS = 4  # reversals of the speed in one stroke
_OVER = 1.6  # of the travel asked for, at which the stroke is broken off


def room_for(limits: ExcitationLimits, joint: int, q: float) -> tuple[float, Trouble | None]:
    """The sense in which the joint has room for its strokes."""
    need = _OVER * float(limits.travel[joint])
    low, high = limits.joint_range[:, joint]
    if high - q >= need and q - low >= 0.5 * need:
        return 1.0, None
    if q - low >= need and high - q >= 0.5 * need:
        return -1.0, None
    return 1.0, Trouble("commissioning.no_room", joint, float(max(high - q, q - low)), need)


def broken_off(limits: ExcitationLimits, stroke: Stroke, state: Excitation, seen: Measured) -> Trouble | None:
    """The first limit that the running stroke has broken; None while it is inside all of them."""
    joint, sense = stroke.joint, sense_of(state, stroke)
    turned, speed = turned_by(state, stroke, seen.q), abs(float(state.speed[joint]))
    backwards = sense * float(state.speed[joint]) < -SWING_RAD_S
    far = _OVER * float(limits.travel[joint])
    low, high = limits.joint_range[:, joint]
    angle = float(seen.q[joint])
    others = np.abs(seen.q - state.q_start - state.stroke_s * state.creep)
    others[joint] = 0.0
    blocked = (
        state.still_s > _BLOCKED_S
        and turned > limits.moved
        and state.swing != 0.0  # a closed valve creeps, but slowly
        and state.phase not in (Phase.TURNING, Phase.FALLING)
    )
    checks = (
        (turned < -2.0 * limits.moved and backwards, "wrong_way", turned, -2.0 * limits.moved),
        (abs(state.spool) > limits.spool_max, "no_motion", abs(state.spool), limits.spool_max),
        (state.stroke_s > limits.stroke_s, "too_slow", state.stroke_s, limits.stroke_s),
        (blocked, "blocked", turned, far),
        (state.reversals >= _OSCILLATIONS, "oscillates", float(state.reversals), float(_OSCILLATIONS)),
        (turned > far, "too_far", turned, far),
        (speed > limits.speed_limit[joint], "too_fast", speed, float(limits.speed_limit[joint])),
        (sense > 0.0 and angle > high, "joint_limit", angle, float(high)),
        (sense < 0.0 and angle < low, "joint_limit", angle, float(low)),
        (seen.pressure_bar > limits.pressure_bar, "pressure", seen.pressure_bar, limits.pressure_bar),
        (float(others.max()) > limits.others, "other_joint_moved", float(others.max()), limits.others),
    )
    for broken, cause, value, limit in checks:
        if broken:
            return Trouble(f"commissioning.{cause}", joint, value, limit)
    return None
