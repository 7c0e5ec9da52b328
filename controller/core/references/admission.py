"""Admission of references: a path that the arm can follow, or a refusal with value and limit."""

from typing import NamedTuple

import numpy as np

from controller.core.kinematics.rotations import Array
from controller.core.settings import ScanSettings
from controller.core.trajectories.path_survey import Survey, survey
from controller.core.trajectories.paths import Desired, Path, path_from
from protocol.datagram_layout import MAX_WAYPOINTS
from protocol.faults import Reason
from protocol.pose import Pose, is_usable
from protocol.reference_messages import ReferencePath, ReferencePose

QUATERNION_TOLERANCE = 1e-3  # [D]
# How much faster than its limit an explicitly timed path may be: the sampling error of its peaks.
_SPEED_TOLERANCE = 2e-3  # [D]
# From a moving state the shape of a path depends on its duration, so that is found by steps of at least
# this factor.
_STRETCH = 1.15  # [D]
_STRETCHES = 24  # [D]


class Refusal(NamedTuple):
    """Why a reference was refused: one reason, the value that offends, and the limit it breaks (SI)."""

    reason: Reason
    value: float
    limit: float


def admit(
    settings: ScanSettings, start: Desired, q_start: Array, request: ReferencePose | ReferencePath
) -> Path | Refusal:
    """The path that ``request`` asks for, from the desired motion ``start`` near joint angles ``q_start``.

    A duration of 0 is replaced, segment by segment, by the shortest one inside the limits of speed and
    acceleration.
    """
    poses: tuple[Pose, ...]
    if isinstance(request, ReferencePose):
        poses, duration, dwell = (request.X_BT_ref,), request.duration_s, 0.0
    else:
        poses, duration, dwell = request.waypoints, request.segment_s, request.dwell_s
    refusal = _form(settings, poses, duration, dwell)
    if refusal is not None:
        return refusal
    p = np.array([pose.p_m for pose in poses])
    quaternions = np.array([pose.q_wxyz for pose in poses])
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    distance = float(np.linalg.norm(p[0] - start.p))
    furthest = settings.motion.first_point_distance
    if distance > furthest:
        return Refusal(Reason.TOO_FAR, distance, furthest)
    if duration > 0.0:
        durations = np.full(len(poses), duration)
        found = _path_with_durations(settings, path_from(start, p, quaternions, durations, dwell), q_start)
    else:
        found = _shortest(settings, start, q_start, p, quaternions, dwell)
    if isinstance(found, Path) and found.duration_s > settings.motion.duration_max:
        return Refusal(Reason.BAD_DURATION, found.duration_s, settings.motion.duration_max)
    return found


def unusable(pose: Pose, index: int = 0, count: int = 1) -> Refusal | None:
    """A refusal of numbers that are no pose; ``index`` of ``count`` poses."""
    if not pose.is_usable():
        return Refusal(Reason.NOT_FINITE, float(index), float(count))
    norm = pose.quaternion_norm()
    if abs(norm - 1.0) > QUATERNION_TOLERANCE:
        return Refusal(Reason.NOT_UNIT_QUATERNION, norm, 1.0)
    return None


def _form(settings: ScanSettings, poses: tuple[Pose, ...], duration: float, dwell: float) -> Refusal | None:
    """A refusal of what no arm could do: not finite, not a rotation, too many, no such duration."""
    if not poses:
        return Refusal(Reason.EMPTY_PATH, 0.0, 1.0)
    if len(poses) > MAX_WAYPOINTS:
        return Refusal(Reason.TOO_MANY_WAYPOINTS, float(len(poses)), float(MAX_WAYPOINTS))
    for index, pose in enumerate(poses):
        refusal = unusable(pose, index, len(poses))
        if refusal is not None:
            return refusal
    if not (is_usable(duration) and is_usable(dwell)):
        return Refusal(Reason.NOT_FINITE, 0.0, 0.0)
    motion = settings.motion
    if duration != 0.0 and duration < motion.duration_min:
        return Refusal(Reason.BAD_DURATION, duration, motion.duration_min)
    for seconds in (duration, dwell):
        if seconds > motion.duration_max:
            return Refusal(Reason.BAD_DURATION, seconds, motion.duration_max)
    return Refusal(Reason.BAD_DURATION, dwell, 0.0) if dwell < 0.0 else None


def _ratios(settings: ScanSettings, found: Survey) -> Array:
    """Peaks over limits, (n, 5)."""
    ratios: Array = found.peaks / settings.motion.of_peaks()
    return ratios


def _path_with_durations(settings: ScanSettings, path: Path, q_start: Array) -> Path | Refusal:
    found = survey(settings.planning, path, q_start)
    if found.reason is not Reason.ACCEPTED:
        return Refusal(found.reason, found.value, found.limit)
    ratios = _ratios(settings, found)
    segment, kind = np.unravel_index(int(ratios.argmax()), ratios.shape)
    if ratios[segment, kind] > 1.0 + _SPEED_TOLERANCE:
        limit = float(settings.motion.of_peaks()[kind])
        return Refusal(Reason.TOO_FAST, float(found.peaks[segment, kind]), limit)
    return path


def _stretch(settings: ScanSettings, found: Survey) -> Array:
    """Factors (n,) for the durations: speeds go with 1/T, accelerations with 1/T²."""
    ratios = _ratios(settings, found)
    ratios[:, 1:4:2] = np.sqrt(ratios[:, 1:4:2])
    factors: Array = ratios.max(axis=1)
    return factors


def _shortest(
    settings: ScanSettings, start: Desired, q_start: Array, p: Array, quaternions: Array, dwell: float
) -> Path | Refusal:
    least = settings.motion.duration_min
    moving = bool(np.any(start.v) or np.any(start.a) or np.any(start.omega) or np.any(start.alpha))
    # From rest the shape does not depend on the duration: survey at 1 s a segment, then scale.
    durations = np.full(len(p), 1.0)
    if moving:
        durations[0] = _rest_duration(settings, start, p[0])
    path = path_from(start, p, quaternions, durations, dwell)
    found = survey(settings.planning, path, q_start)
    if moving and found.reason is Reason.ACCEPTED and _stretch(settings, found)[0] > 1.0 + _SPEED_TOLERANCE:
        # The other segments begin at rest: the first alone is tried until it fits, then the whole once more.
        first = _fitting(settings, start, q_start, p, quaternions, durations[0])
        if isinstance(first, Refusal):
            return first
        durations[0] = first
        path = path_from(start, p, quaternions, durations, dwell)
        found = survey(settings.planning, path, q_start)
    if found.reason is not Reason.ACCEPTED:
        return Refusal(found.reason, found.value, found.limit)
    factors = _stretch(settings, found)
    factors[0] = 1.0 if moving else factors[0]
    return path_from(start, p, quaternions, np.maximum(durations * factors, least), dwell)


def _fitting(
    settings: ScanSettings, start: Desired, q_start: Array, p: Array, quaternions: Array, tried: float
) -> float | Refusal:
    """A duration of the first segment inside the limits, tried from ``tried`` on by steps."""
    factor = 1.0
    duration = tried
    for _ in range(_STRETCHES):
        path = path_from(start, p[:1], quaternions[:1], np.array([duration]), 0.0)
        found = survey(settings.planning, path, q_start)
        if found.reason is not Reason.ACCEPTED:
            return Refusal(found.reason, found.value, found.limit)
        factor = float(_stretch(settings, found)[0])
        if factor <= 1.0 + _SPEED_TOLERANCE:
            return duration
        duration *= max(factor, _STRETCH)
    return Refusal(Reason.TOO_FAST, factor, 1.0)


def _rest_duration(settings: ScanSettings, start: Desired, goal: Array) -> float:
    """The first guess from a moving state: long enough to cover the way and to take the speed off."""
    limits = settings.motion
    way = float(np.linalg.norm(goal - start.p))
    slowing = float(np.linalg.norm(start.v)) / limits.acceleration
    turning = float(np.linalg.norm(start.omega)) / limits.turn_acceleration
    return max(1.875 * way / limits.speed, slowing, turning, limits.duration_min)
