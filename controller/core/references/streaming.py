"""Streamed references: which one is followed, and what happens when none comes.

A reference is judged by itself (is it a pose, young enough, near enough, and can the arm go straight there?)
and then approached with bounded speed, acceleration and jerk. When no fresh one has come for a while, the arm
is slowed down; one that comes now is followed again, gently. At the silence limit the valves are centred and
the fault is latched: it takes RESET, ENABLE and a new START_STREAM to move again.
"""

import math
from typing import NamedTuple

import numpy as np

from controller.core.kinematics.denavit_hartenberg import damped_inverse
from controller.core.kinematics.rotations import Array, exponential, norm, orientation_error, product
from controller.core.references.admission import Refusal, unusable
from controller.core.servo.servo_step import ServoGains
from controller.core.settings import ScanSettings
from controller.core.trajectories.approach import ApproachTrajectory, AxisLimits, approach, twist_limit
from controller.core.trajectories.path_survey import survey_straight
from controller.core.trajectories.paths import Desired
from foundation.compiled import kernel
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
    most = twist_limit(limits).tolist()
    refusal = (
        _place(settings, stream, arrival, now_ns)
        or unusable(reference.X_BT_ref)
        or _runs_away(reference.twist_ref, most)
    )
    if refusal is not None:
        return refusal
    p, quaternion = np.empty(3), np.empty(4)
    numbers = np.array((*reference.X_BT_ref.p_m, *reference.X_BT_ref.q_wxyz, *reference.twist_ref))
    scale, age_s = reference.X_BT_ref.quaternion_norm(), (now_ns - arrival.measured_ns) * 1e-9
    distance, turn = _carried_on(numbers, scale, age_s, desired, p, quaternion)
    refusal = _near(settings, distance, turn)
    if refusal is not None:
        return refusal
    found = survey_straight(settings.planning, desired.p, desired.quaternion, (p, quaternion), q_meas)
    if found[0] is not Reason.ACCEPTED:
        return Refusal(*found)
    planned = approach(desired, p, quaternion, numbers[7:], limits)
    if planned is None:
        return Refusal(Reason.TOO_FAST, max(map(abs, reference.twist_ref)), max(most))
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


def _runs_away(twist: tuple[float, ...], most: list[float]) -> Refusal | None:
    """A refusal of a reference that itself moves faster than may be followed, or by no number."""
    if not all(map(is_usable, twist)):
        return Refusal(Reason.NOT_FINITE, 0.0, 1.0)
    ratios = [abs(speed) / limit for speed, limit in zip(twist, most, strict=True)]
    axis = ratios.index(max(ratios))
    return Refusal(Reason.TOO_FAST, abs(twist[axis]), most[axis]) if abs(twist[axis]) > most[axis] else None


@kernel
def _carried_on(
    numbers: Array, scale: float, age_s: float, desired: Desired, p: Array, quaternion: Array
) -> tuple[float, float]:
    """Fill p (3,), quaternion (4,): where the pose is that ``numbers`` with its twist (13,) ``age_s`` ago.

    ``scale``: the norm of its quaternion. Returns how far that is from ``desired``, m and rad.
    """
    moved = exponential((age_s * numbers[10], age_s * numbers[11], age_s * numbers[12]))
    there = product(moved, (numbers[3] / scale, numbers[4] / scale, numbers[5] / scale, numbers[6] / scale))
    for k in range(4):
        quaternion[k] = there[k]
    for k in range(3):
        p[k] = numbers[k] + age_s * numbers[7 + k]
    away = p[0] - desired.p[0], p[1] - desired.p[1], p[2] - desired.p[2]
    half = norm(orientation_error(quaternion, desired.quaternion))
    return norm(away), 2.0 * math.asin(min(1.0, half))


def _near(settings: ScanSettings, distance: float, turn: float) -> Refusal | None:
    """A refusal of a jump: further (m, rad) from the pose that is commanded now than a stream may ask for."""
    limits = settings.streaming
    if distance > limits.distance_m:
        return Refusal(Reason.TOO_FAR, distance, limits.distance_m)
    return Refusal(Reason.TOO_FAR, turn, limits.turn_rad) if turn > limits.turn_rad else None


def _within_joint_speeds(settings: ScanSettings, J_BT: Array) -> AxisLimits:
    """The axes' limits, slowed down so far that no joint can be too fast at this pose, whatever they do."""
    limits = settings.streaming.axes
    share = _share(settings.servo.gains, J_BT, limits.speed, settings.planning.joint_speeds)
    return limits if share >= 1.0 else limits._replace(speed=share * limits.speed)


@kernel
def _share(gains: ServoGains, J_BT: Array, speed: Array, joint_speeds: Array) -> float:
    inverse, _, _ = damped_inverse(J_BT, gains.damping_onset, gains.damping_max)
    share: float = (joint_speeds / (np.abs(inverse) @ speed)).min()
    return share
