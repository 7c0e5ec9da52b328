"""Excitation of one joint after the other: slow ramps and steps of the spool, each ended by what moves.

A state machine of the kind that runs in a PLC: nothing is known of the valve beforehand, so every ramp ends
when the joint has moved, is fast enough or has turned far enough. The other valves stay centred.
"""

import numpy as np

from controller.core.excitation.plan import (
    MOVED_RAD,
    OTHERS_RAD,
    PATIENCE_S,
    RAMP_RATE_1_S,
    REST_S,
    SEARCH_RATE_1_S,
    START_BELOW,
    STEP_S,
    STROKE_S,
    SWING_RAD_S,
    Excitation,
    ExcitationLimits,
    ExcitationPlan,
    Failure,
    Measured,
    Phase,
    Stroke,
    StrokeKind,
    sense_of,
    turned_by,
)
from controller.core.excitation.valve_seen import (
    TURNED,
    quickly_back,
    side_of,
    turning_rate,
    with_rim,
    with_slack,
    with_steeper,
)
from controller.core.kinematics.rotations import Array
from controller.core.servo.joint_control import pt1_step

_BLOCKED_S = 1.0  # [D] without motion under a valve that moved the joint before
_OSCILLATIONS = 4  # [D] reversals of the speed in one stroke
_OVER = 1.6  # [D] of the travel asked for, at which the stroke is broken off


def room_for(limits: ExcitationLimits, joint: int, q: float) -> tuple[float, Failure | None]:
    """The sense in which the joint has room for its strokes."""
    need = _OVER * float(limits.travel[joint])
    low, high = limits.joint_range[:, joint]
    if high - q >= need and q - low >= 0.5 * need:
        return 1.0, None
    if q - low >= need and high - q >= 0.5 * need:
        return -1.0, None
    return 1.0, Failure("commissioning.no_room", joint, float(max(high - q, q - low)), need)


def broken_off(limits: ExcitationLimits, stroke: Stroke, state: Excitation, seen: Measured) -> Failure | None:
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
        and turned > MOVED_RAD
        and state.swing != 0.0  # a closed valve creeps, but slowly
        and state.phase not in (Phase.TURNING, Phase.FALLING)
    )
    checks = (
        (turned < -2.0 * MOVED_RAD and backwards, "wrong_way", turned, -2.0 * MOVED_RAD),
        (abs(state.spool) > limits.spool_max, "no_motion", abs(state.spool), limits.spool_max),
        (state.stroke_s > STROKE_S, "too_slow", state.stroke_s, STROKE_S),
        (blocked, "blocked", turned, far),
        (state.reversals >= _OSCILLATIONS, "oscillates", float(state.reversals), float(_OSCILLATIONS)),
        (turned > far, "too_far", turned, far),
        (speed > limits.speed_limit[joint], "too_fast", speed, float(limits.speed_limit[joint])),
        (sense > 0.0 and angle > high, "joint_limit", angle, float(high)),
        (sense < 0.0 and angle < low, "joint_limit", angle, float(low)),
        (seen.pressure_bar > limits.pressure_bar, "pressure", seen.pressure_bar, limits.pressure_bar),
        (float(others.max()) > OTHERS_RAD, "other_joint_moved", float(others.max()), OTHERS_RAD),
    )
    for broken, cause, value, limit in checks:
        if broken:
            return Failure(f"commissioning.{cause}", joint, value, limit)
    return None


_SPEED_FILTER_S = 0.06  # [D] an encoder's last digit is 0.2 mrad/s behind it
_STILL_RAD_S = 1.0e-3  # [D]
# A joint behind a closed valve that leaks creeps steadily, which is rest as well: nothing swings.
_DRIFT_FILTER_S = 1.0  # [D]
_CREEPS_RAD_S = 1.5e-3  # [E] a wrist's, twice
_FALLEN = 0.05  # [D] of the ramp's top speed, at which a falling ramp has done its work
_STANDS_S = 0.4  # [E] longer than a swinging load stands at its turn, while oil still flows
_UP_SHARE = 0.45  # [D] of the way, on which a ramp rises
_LOW = 0.3  # [D] of a ramp's top speed (and its square, of the way): where it surely moves
_UNSURE = 3.0  # [D] times what a ramp begins below a rim that only a search has seen
# Another joint creeps behind its closed valve, quicker the more it bears: it is brought back between strokes.
_CREPT_RAD = 10e-3  # [D]
_BACK_RAD = 2e-3  # [D]
_BACK_SPEED = 0.3  # [D] of a ramp's top speed
_ENOUGH = 1.35  # [D] of the travel, at which a falling ramp is cut short: a slow valve still closes in time
_RUNS_AWAY = 1.5  # [D] times a ramp's top speed, at which a step has shown enough


def excite(
    settings: ExcitationPlan, state: Excitation, seen: Measured, dt_s: float
) -> tuple[Excitation, Failure | None]:
    """The next state, and what broke the excitation off; its ``spool`` is what to command."""
    if state.phase is Phase.ENDED:
        return state, None
    limits, stroke = settings.limits, settings.strokes[state.stroke]
    state = _observed(state, seen.q, stroke.joint, dt_s)
    if state.phase is Phase.RESTING:
        return _rest(settings, state, seen, dt_s)
    if state.phase is Phase.RETURNING:
        return _brought_back(settings, state, seen, dt_s)
    failure = broken_off(limits, stroke, state, seen)
    if failure is not None:
        return ended(state), failure
    state = state._replace(phase_s=state.phase_s + dt_s, stroke_s=state.stroke_s + dt_s)
    if stroke.kind is StrokeKind.SEARCH:
        return _search(settings, state, seen.q, dt_s), None
    if stroke.kind is StrokeKind.STEP:
        return _step(settings, state, seen.q), None
    return _ramp(settings, state, seen.q, dt_s), None


def ended(state: Excitation) -> Excitation:
    """``state`` with the valve centred for good."""
    return state._replace(phase=Phase.ENDED, spool=0.0)


def _observed(state: Excitation, q: Array, joint: int, dt_s: float) -> Excitation:
    keep = pt1_step(1.0, 0.0, _SPEED_FILTER_S, dt_s)
    speed = keep * state.speed + (1.0 - keep) * (q - state.q_before) / dt_s
    slowly = pt1_step(1.0, 0.0, _DRIFT_FILTER_S, dt_s)
    drift = slowly * state.drift + (1.0 - slowly) * (q - state.q_before) / dt_s
    still = abs(speed[joint]) < _STILL_RAD_S
    if state.phase is Phase.RESTING and abs(drift[joint]) < _CREEPS_RAD_S:
        still = still or abs(speed[joint] - drift[joint]) < _STILL_RAD_S
    swing, reversals = state.swing, state.reversals
    if abs(speed[joint]) > SWING_RAD_S and speed[joint] * swing <= 0.0:
        reversals += swing != 0.0
        swing = float(np.sign(speed[joint]))
    return state._replace(
        speed=speed,
        drift=drift,
        q_before=q,
        still_s=state.still_s + dt_s if still else 0.0,
        swing=swing,
        reversals=reversals,
    )


def _rest(
    settings: ExcitationPlan, state: Excitation, seen: Measured, dt_s: float
) -> tuple[Excitation, Failure | None]:
    q, limits, stroke = seen.q, settings.limits, settings.strokes[state.stroke]
    state = state._replace(phase_s=state.phase_s + dt_s)
    if state.phase_s > PATIENCE_S:
        speed = abs(float(state.speed[stroke.joint]))
        return ended(state), Failure("commissioning.not_at_rest", stroke.joint, speed, _STILL_RAD_S)
    if min(state.still_s, state.phase_s) < REST_S:
        return state, None
    crept = np.abs(q - state.place)
    crept[stroke.joint] = 0.0
    if crept.max() > _CREPT_RAD:
        who = int(crept.argmax())
        back = state._replace(phase=Phase.RETURNING, phase_s=0.0, spool=0.0, q_start=q, returning=who)
        return back, None
    if stroke.kind is StrokeKind.SEARCH and stroke.outward:
        away, failure = room_for(limits, stroke.joint, float(q[stroke.joint]))
        if failure is not None:
            return ended(state), failure
        state = state._replace(home=float(q[stroke.joint]), away=away)
    phase = Phase.HOLDING if stroke.kind is StrokeKind.STEP else Phase.RISING
    state = state._replace(phase=phase, phase_s=0.0, stroke_s=0.0, still_s=0.0, q_start=q, low_speed=0.0)
    state = state._replace(creep=state.speed, top_speed=0.0)
    return state._replace(spool=_first_spool(limits, state, stroke), swing=0.0, reversals=0), None


def _brought_back(
    settings: ExcitationPlan, state: Excitation, seen: Measured, dt_s: float
) -> tuple[Excitation, Failure | None]:
    """One scan of a joint's slow return to where it stood, its valve's deadband being unknown."""
    limits, joint = settings.limits, state.returning
    assert joint is not None
    state = state._replace(phase_s=state.phase_s + dt_s)
    missing = float(state.place[joint] - seen.q[joint])
    sense = float(np.sign(state.place[joint] - state.q_start[joint]))
    lost, speed = -sense * float(seen.q[joint] - state.q_start[joint]), sense * float(state.speed[joint])
    checks = (
        (lost > OTHERS_RAD, "wrong_way", lost, OTHERS_RAD),
        (abs(state.spool) > limits.spool_max, "no_motion", abs(state.spool), limits.spool_max),
        (state.phase_s > STROKE_S, "too_slow", state.phase_s, STROKE_S),
        (seen.pressure_bar > limits.pressure_bar, "pressure", seen.pressure_bar, limits.pressure_bar),
    )
    for broken, cause, value, limit in checks:
        if broken:
            return ended(state), Failure(f"commissioning.{cause}", joint, value, limit)
    if sense * missing <= _BACK_RAD:
        rest = state._replace(phase=Phase.RESTING, phase_s=0.0, still_s=0.0, spool=0.0, returning=None)
        return rest, None
    if speed > _BACK_SPEED * float(limits.top_speed[joint]):
        return state, None
    return state._replace(spool=state.spool + sense * SEARCH_RATE_1_S * dt_s), None


def _first_spool(limits: ExcitationLimits, state: Excitation, stroke: Stroke) -> float:
    """A search begins at 0, a ramp below the deadband's rim, a step as far above it as its speed wants.

    A search that has seen nothing but the first motion overshoots: the first ramp begins further below.
    """
    if stroke.kind is StrokeKind.SEARCH:
        return 0.0
    sense = sense_of(state, stroke)
    at = stroke.joint, side_of(sense)
    rim, slope = float(state.rim[at]), float(state.slope[at])
    if stroke.kind is StrokeKind.RAMP:
        return sense * max(rim - (1.0 if slope > 0.0 else _UNSURE) * START_BELOW, 0.0)
    return sense * min(rim + (stroke.speed / slope if slope > 0.0 else 0.0), limits.spool_max)


def _stroke_travel(limits: ExcitationLimits, state: Excitation, stroke: Stroke) -> float:
    """How far (rad) the stroke shall turn the joint: out by the travel, back to where it stood."""
    travel = float(limits.travel[stroke.joint])
    if stroke.outward:
        return travel
    back = abs(float(state.q_start[stroke.joint]) - state.home)
    return min(max(back, 0.3 * travel), 1.3 * travel)


def _done(state: Excitation, settings: ExcitationPlan) -> Excitation:
    following = state.stroke + 1
    phase = Phase.RESTING if following < len(settings.strokes) else Phase.ENDED
    return state._replace(stroke=following, phase=phase, phase_s=0.0, still_s=0.0, spool=0.0)


def _search(settings: ExcitationPlan, state: Excitation, q: Array, dt_s: float) -> Excitation:
    stroke = settings.strokes[state.stroke]
    sense = sense_of(state, stroke)
    if turned_by(state, stroke, q) >= MOVED_RAD:
        rim = state.rim.copy()
        rim[stroke.joint, side_of(sense)] = abs(state.spool)
        return _done(state._replace(rim=rim), settings)
    return state._replace(spool=state.spool + sense * SEARCH_RATE_1_S * dt_s)


def _ramp(settings: ExcitationPlan, state: Excitation, q: Array, dt_s: float) -> Excitation:
    limits, stroke = settings.limits, settings.strokes[state.stroke]
    sense = sense_of(state, stroke)
    speed = sense * float(state.speed[stroke.joint])
    step = sense * stroke.pace * RAMP_RATE_1_S * dt_s
    if state.phase is Phase.RISING:
        return _rising(limits, state, stroke, q, step)
    slower = speed < TURNED * state.top_speed
    if state.phase is Phase.TURNING and slower:
        state = with_slack(limits, state, stroke)
    elif state.phase is Phase.FALLING and not slower:  # a swing of the load had only looked like it
        state = state._replace(phase=Phase.TURNING)
    if state.phase is Phase.TURNING and state.top - abs(state.spool) < quickly_back(limits, state, stroke):
        step = sense * max(turning_rate(state, stroke) * dt_s, abs(step))
    spool = state.spool - step
    far = turned_by(state, stroke, q) > _ENOUGH * float(limits.travel[stroke.joint])
    stands = speed < _FALLEN * state.top_speed and state.still_s > _STANDS_S
    if far or sense * spool <= 0.0 or stands:
        return _done(state, settings)
    return state._replace(spool=spool)


def _rising(limits: ExcitationLimits, state: Excitation, stroke: Stroke, q: Array, step: float) -> Excitation:
    sense, turned = sense_of(state, stroke), turned_by(state, stroke, q)
    speed, travel = sense * float(state.speed[stroke.joint]), _stroke_travel(limits, state, stroke)
    if speed >= stroke.speed or turned >= _UP_SHARE * travel:
        state = with_rim(state, stroke, speed)
        back = sense * float(state.slack[stroke.joint])
        top = abs(state.spool)
        return state._replace(
            phase=Phase.TURNING, phase_s=0.0, top_speed=speed, top=top, spool=state.spool - back
        )
    moves = speed > _LOW * stroke.speed or turned > _LOW * _LOW * travel
    if state.low_speed == 0.0 and turned > MOVED_RAD and moves:
        state = state._replace(low_speed=speed, low=abs(state.spool))
    return state._replace(spool=state.spool + step)


def _step(settings: ExcitationPlan, state: Excitation, q: Array) -> Excitation:
    limits, stroke = settings.limits, settings.strokes[state.stroke]
    speed = sense_of(state, stroke) * float(state.speed[stroke.joint])
    state = state._replace(top_speed=max(state.top_speed, speed))
    far = turned_by(state, stroke, q) >= _stroke_travel(limits, state, stroke)
    if far or state.phase_s >= STEP_S or speed > _RUNS_AWAY * float(limits.top_speed[stroke.joint]):
        return _done(with_steeper(state, stroke), settings)
    return state
