"""Stamped messages of ROS as references of the link: frames, stamps, numbers, each refused by name."""

import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from longreach_ros2.kinematics import Array
from longreach_ros2.trajectories import refused
from protocol.reference_messages import ReferencePath, ReferencePose
from vision_pc.core.se3 import to_pose, transform

# [D] A stamp is of this machine's clock if it is at most so much older or newer than now.
OLDEST_NS, NEWEST_NS = 250_000_000, 50_000_000
_SET_NS = 1_000_000  # the system's clock was set, or has drifted as far
_NORM = 1e-3  # as clause 1.5 of the protocol
_NS = 1_000_000_000


class RosTime:
    """ROS time, which is the system's, beside the monotonic clock of the link; both in ns."""

    def __init__(self, offset_ns: int | None = None) -> None:
        """``offset_ns``: ROS time minus monotonic time; None: as the system's clock is set, to 1 ms."""
        self._fixed = offset_ns is not None
        self._offset_ns = offset_ns or 0

    @property
    def offset_ns(self) -> int:
        """ROS time minus monotonic time: the same for one instant, whenever it is asked for."""
        if not self._fixed:
            now_ns = time.time_ns() - time.monotonic_ns()
            if abs(now_ns - self._offset_ns) > _SET_NS:
                self._offset_ns = now_ns
        return self._offset_ns

    def of(self, monotonic_ns: int) -> tuple[int, int]:
        """Seconds and nanoseconds of a ROS stamp for a monotonic time."""
        return divmod(monotonic_ns + self.offset_ns, _NS)

    def measured_ns(self, stamp: Any, now_ns: int) -> int:
        """The monotonic time of ``stamp``, for which 0 is ``now_ns``.

        Raises RequestRefused (``refused.ros_stamp``) for one that is too old, or ahead: another clock's.
        """
        stamp_ns: int = stamp.sec * _NS + stamp.nanosec
        if stamp_ns == 0:
            return now_ns
        age_ns = now_ns + self.offset_ns - stamp_ns
        if not -NEWEST_NS <= age_ns <= OLDEST_NS:
            words = f"the stamp is {age_ns / _NS:.3f} s old by this machine's clock"
            raise refused("stamp", f"{words}, allowed are {-NEWEST_NS / _NS:g} s to {OLDEST_NS / _NS:g} s")
        return now_ns - max(age_ns, 0)


def pose_in_base(pose: Any, frame: str, frames: Mapping[str, Array]) -> Array:
    """X_BT (4, 4) of a ``geometry_msgs/Pose`` in ``frame``. Raises RequestRefused."""
    X_BF = _known(frame, frames)
    p, q = pose.position, pose.orientation
    numbers = np.array([p.x, p.y, p.z, q.x, q.y, q.z, q.w])
    if not np.all(np.isfinite(numbers)):
        raise refused("not_finite", f"pose {numbers.tolist()} is not all finite")
    norm = float(np.linalg.norm(numbers[3:]))
    if abs(norm - 1.0) > _NORM:
        raise refused("not_unit_quaternion", f"the quaternion's norm is {norm:g}, limit 1 within {_NORM:g}")
    return X_BF @ transform(Rotation.from_quat(numbers[3:]).as_matrix(), numbers[:3])


def twist_in_base(twist: Any, frame: str, frames: Mapping[str, Array]) -> Array:
    """(6,) m/s and rad/s of the tool in B, from a ``geometry_msgs/Twist`` along the axes of ``frame``."""
    R = _known(frame, frames)[:3, :3]
    v, w = twist.linear, twist.angular
    numbers = np.array([[v.x, v.y, v.z], [w.x, w.y, w.z]])
    if not np.all(np.isfinite(numbers)):
        raise refused("not_finite", f"twist {numbers.ravel().tolist()} is not all finite")
    return np.concatenate([R @ numbers[0], R @ numbers[1]])


def target_of(message: Any, frames: Mapping[str, Array]) -> ReferencePose:
    """The point-to-point reference that a PoseStamped asks for. Raises RequestRefused."""
    return ReferencePose(0, to_pose(pose_in_base(message.pose, message.header.frame_id, frames)), 0.0)


def path_of(message: Any, frames: Mapping[str, Array]) -> ReferencePath:
    """The reference of a ``nav_msgs/Path``: at rest at each pose, the controller choosing the pace.

    Raises RequestRefused, also for poses that are stamped with different times: a path has none.
    """
    stamps = {(one.header.stamp.sec, one.header.stamp.nanosec) for one in message.poses}
    if len(stamps) > 1:
        raise refused("timed_path", "the poses have different stamps: times on a path are not followed")
    frame = message.header.frame_id
    poses = [pose_in_base(one.pose, one.header.frame_id or frame, frames) for one in message.poses]
    return ReferencePath(0, tuple(map(to_pose, poses)), 0.0, 0.0)


def _known(frame: str, frames: Mapping[str, Array]) -> Array:
    if frame not in frames:
        words = f"frame {frame!r} is not known" if frame else "no frame is named"
        raise refused("frame", f"{words}; known are {', '.join(frames)}")
    return frames[frame]
