"""What strokes tell of their valve: where it opens, how much it gives, how far it hangs behind; pure."""

from controller.core.excitation.plan import (
    RAMP_RATE_1_S,
    Excitation,
    ExcitationLimits,
    Phase,
    Stroke,
    sense_of,
)

# A spool with hysteresis stands still while its command turns back: that part is passed quickly.
_TURNING_1_S = 1.5  # [D] of the opening at the top, each second; at least the ramp's own rate
TURNED = 0.93  # [D] of the speed at the top, below which the spool follows again
_LAG_S = 0.1  # [E] of valve and speed filter, at most that of a servo valve
_QUICKLY = 0.5  # [D] of the opening at the top, beyond the known slack: a swing may hide that the speed falls
_LEVER = 2.0  # [D] of the way between low and top, below low: a rim further down was read off a swing


def side_of(sense: float) -> int:
    """The column of ``rim`` and ``slope``: 0 raising, 1 lowering."""
    return 0 if sense > 0.0 else 1


def with_rim(state: Excitation, stroke: Stroke, speed: float) -> Excitation:
    """``state`` at a ramp's top: the line through what the joint did at low and at present speed tells where
    the valve opens, and how much a spool beyond that gives.

    Where a load swings, either speed may be any: what an earlier ramp told stays where the line reaches far.
    """
    joint, side, spool = stroke.joint, side_of(sense_of(state, stroke)), abs(state.spool)
    if not speed > state.low_speed > 0.0 or not spool > state.low:
        return state
    rim, slope = state.rim.copy(), state.slope.copy()
    measured = (speed - state.low_speed) / (spool - state.low)
    below = state.low_speed / measured
    if slope[joint, side] > 0.0 and below > _LEVER * (spool - state.low):
        return state
    slope[joint, side], rim[joint, side] = measured, max(state.low - below, 0.0)
    return state._replace(rim=rim, slope=slope)


def _opening(state: Excitation, stroke: Stroke) -> float:
    """How far (spool) the valve is open at a ramp's top."""
    rim = float(state.rim[stroke.joint, side_of(sense_of(state, stroke))])
    return max(state.top - rim, 0.0)


def turning_rate(state: Excitation, stroke: Stroke) -> float:
    """How fast (1/s) the spool's command turns back at a ramp's top."""
    return _TURNING_1_S * _opening(state, stroke)


def quickly_back(limits: ExcitationLimits, state: Excitation, stroke: Stroke) -> float:
    """How far (spool) the command turns back quickly: further, it would pass what the ramp shall show.

    A slow triangle does so for as long as the speed does not fall: it finds the slack.
    """
    if _finds_slack(limits, stroke):
        return state.top
    return float(state.slack[stroke.joint]) + _QUICKLY * _opening(state, stroke)


def with_slack(limits: ExcitationLimits, state: Excitation, stroke: Stroke) -> Excitation:
    """``state`` on the falling ramp; after a slow triangle with what its command had to turn back before the
    speed fell.

    What the lag and the speed's fall itself took is left out, so that the next ramp's leap falls short. A
    load that swings hides that the speed falls: quick triangles tell nothing, and of the slow ones the
    shortest holds.
    """
    state = state._replace(phase=Phase.FALLING, phase_s=0.0)
    if not _finds_slack(limits, stroke):
        return state
    rate = max(turning_rate(state, stroke), stroke.pace * RAMP_RATE_1_S)
    quick = rate * _LAG_S + 2.0 * (1.0 - TURNED) * rate / _TURNING_1_S
    found = max(state.top - abs(state.spool) - quick, 0.0)
    slack = state.slack.copy()
    slack[stroke.joint] = min(found, slack[stroke.joint] or found)
    return state._replace(slack=slack)


def _finds_slack(limits: ExcitationLimits, stroke: Stroke) -> bool:
    return stroke.speed < float(limits.top_speed[stroke.joint])


def with_steeper(state: Excitation, stroke: Stroke) -> Excitation:
    """``state`` after a step that was faster than the ramps had said: the next one opens by less.

    A load that swings spoils what a ramp says, and oil that flows progressively is quicker further out.
    """
    joint, side = stroke.joint, side_of(sense_of(state, stroke))
    opened = abs(state.spool) - float(state.rim[joint, side])
    if opened <= 0.0:
        return state
    slope = state.slope.copy()
    slope[joint, side] = max(state.top_speed / opened, float(slope[joint, side]))
    return state._replace(slope=slope)
