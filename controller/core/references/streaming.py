"""Streamed references: which one is followed, and what happens when none comes.

A reference is judged by itself (is it a pose, young enough, near enough, and can the arm go straight there?)
and then approached with bounded speed, acceleration and jerk. When no fresh one has come for a while, the arm
is slowed down; one that comes now is followed again, gently. At the silence limit the valves are centred and
the fault is latched: it takes RESET, ENABLE and a new START_STREAM to move again.
"""

import math
from typing import NamedTuple

import numpy as np

from controller.core.kinematics.jacobian import damped_inverse
from controller.core.kinematics.rotations import (
    Array,
    orientation_error,
    quaternion_from_vector,
    quaternion_product,
)
from controller.core.references.admission import Refusal, unusable
from controller.core.settings import ScanSettings
from controller.core.trajectories.approach import ApproachTrajectory, AxisLimits, approach, twist_limit
from controller.core.trajectories.path_survey import survey
from controller.core.trajectories.paths import Desired, at_rest, path_from
from protocol.channel import is_newer
from protocol.faults import Reason
from protocol.pose import is_usable
from protocol.session_events import StreamedPoseReceived

_AT_REST = np.zeros(6)


class Goal(NamedTuple):
    """The newest accepted reference: p (3,), unit quaternion (4,), the axes' limits on the way there."""

    p: Array
    quaternion: Array
    limits: AxisLimits


class OpenStream(NamedTuple):
    """An open stream. ``stream_id``: command id of its START_STREAM.

    ``attended``: whether the session that opened it goes on. ``fresh_ns``: when the newest accepted reference
    left the client, before the first one when the stream was opened; controller's clock. ``number`` and
    ``goal``: of that reference.
    """

    stream_id: int
    attended: bool
    fresh_ns: int
    number: int = 0
    goal: Goal | None = None


def follow(
    settings: ScanSettings,
    stream: OpenStream,
    desired: Desired,
    q_meas: Array,
    J_BT: Array,
    arrival: StreamedPoseReceived,
    now_ns: int,
) -> tuple[OpenStream, ApproachTrajectory] | Refusal:
    """The stream with this reference as its newest, and the way there from ``desired``, or why not.

    ``q_meas`` (6,), ``J_BT`` (6, 6): joint angles and Jacobian of the arm as it stands.
    """
    reference = arrival.message
    limits = _within_joint_speeds(settings, J_BT)
    twist = np.array(reference.twist_ref)
    refusal = (
        _place(settings, stream, arrival, now_ns)
        or unusable(reference.X_BT_ref)
        or _runs_away(twist, twist_limit(limits))
    )
    if refusal is not None:
        return refusal
    moved = (now_ns - arrival.measured_ns) * 1e-9 * twist
    quaternion = np.array(reference.X_BT_ref.q_wxyz) / reference.X_BT_ref.quaternion_norm()
    quaternion = quaternion_product(quaternion_from_vector(moved[3:]), quaternion)
    p = np.array(reference.X_BT_ref.p_m) + moved[:3]
    refusal = _near(settings, desired, p, quaternion)
    if refusal is not None:
        return refusal
    straight = path_from(at_rest(desired.p, desired.quaternion), p[None], quaternion[None], np.ones(1), 0.0)
    found = survey(settings.planning, straight, q_meas)
    if found.reason is not Reason.ACCEPTED:
        return Refusal(found.reason, found.value, found.limit)
    planned = approach(desired, p, quaternion, twist, limits)
    if planned is None:
        return Refusal(Reason.TOO_FAST, float(np.abs(twist).max()), float(twist_limit(limits).max()))
    goal = Goal(p, quaternion, limits)
    fresh_ns = max(stream.fresh_ns, arrival.left_ns)
    return stream._replace(fresh_ns=fresh_ns, number=reference.number, goal=goal), planned


def last_approach(stream: OpenStream, desired: Desired) -> ApproachTrajectory | None:
    """The way from ``desired`` to rest at the newest reference; None when there was none."""
    if stream.goal is None:
        return None
    return approach(desired, stream.goal.p, stream.goal.quaternion, _AT_REST, stream.goal.limits)


def silence(settings: ScanSettings, stream: OpenStream, now_ns: int) -> tuple[float, float]:
    """How long no fresh reference has come (s), and the limit at which the valves are centred."""
    limit = settings.streaming.first_s if stream.goal is None else settings.streaming.close_s
    return (now_ns - stream.fresh_ns) * 1e-9, limit


def update_fade(
    settings: ScanSettings, fade: float, stream: OpenStream | None, now_ns: int, dt_s: float
) -> float:
    """``fade`` after a scan: towards 1 (standing still) while a stream is silent, else to 0 (full pace)."""
    limits = settings.streaming
    waits = stream is not None and stream.goal is not None
    if waits and stream is not None and silence(settings, stream, now_ns)[0] > limits.slow_s:
        return min(fade + dt_s / limits.ramp_s, 1.0)
    return max(fade - dt_s / limits.recovery_s, 0.0)


def pace(fade: float) -> float:
    """Rate of time along the way, and share of the valve commands: 1 − 3x² + 2x³, smooth at both ends."""
    return 1.0 - 3.0 * fade**2 + 2.0 * fade**3


def at_pace(desired: Desired, rate: float) -> Desired:
    """``desired`` with its velocities at ``rate``; accelerations are left, the servo does not use them."""
    return desired if rate == 1.0 else desired._replace(v=rate * desired.v, omega=rate * desired.omega)


def _place(
    settings: ScanSettings, stream: OpenStream, arrival: StreamedPoseReceived, now_ns: int
) -> Refusal | None:
    """A refusal of a reference that is not the next one of this stream, or rests on something old."""
    reference = arrival.message
    if reference.stream_id != stream.stream_id or not stream.attended:
        return Refusal(Reason.NOT_STREAMING, float(reference.stream_id), float(stream.stream_id))
    if stream.goal is not None and not is_newer(reference.number, stream.number):
        return Refusal(Reason.OVERTAKEN, float(reference.number), float(stream.number))
    age_s = (now_ns - arrival.measured_ns) * 1e-9
    if age_s > settings.streaming.max_age_s:
        return Refusal(Reason.STALE, age_s, settings.streaming.max_age_s)
    return None


def _runs_away(twist: Array, most: Array) -> Refusal | None:
    """A refusal of a reference that itself moves faster than may be followed, or by no number."""
    if not all(map(is_usable, twist.tolist())):
        return Refusal(Reason.NOT_FINITE, 0.0, 1.0)
    axis = int((np.abs(twist) / most).argmax())
    if abs(twist[axis]) > most[axis]:
        return Refusal(Reason.TOO_FAST, abs(float(twist[axis])), float(most[axis]))
    return None


def _near(settings: ScanSettings, desired: Desired, p: Array, quaternion: Array) -> Refusal | None:
    """A refusal of a jump: further from the pose that is commanded now than a stream may ask for."""
    limits = settings.streaming
    distance = float(np.linalg.norm(p - desired.p))
    if distance > limits.distance_m:
        return Refusal(Reason.TOO_FAR, distance, limits.distance_m)
    turn = 2.0 * math.asin(min(1.0, float(np.linalg.norm(orientation_error(quaternion, desired.quaternion)))))
    return Refusal(Reason.TOO_FAR, turn, limits.turn_rad) if turn > limits.turn_rad else None


def _within_joint_speeds(settings: ScanSettings, J_BT: Array) -> AxisLimits:
    """The axes' limits, slowed down so far that no joint can be too fast at this pose, whatever they do."""
    limits, gains = settings.streaming.axes, settings.servo_gains
    inverse, _, _ = damped_inverse(J_BT, gains.damping_onset, gains.damping_max)
    share = float((settings.planning.joint_speeds / (np.abs(inverse) @ limits.speed)).min())
    return limits if share >= 1.0 else limits._replace(speed=share * limits.speed)
