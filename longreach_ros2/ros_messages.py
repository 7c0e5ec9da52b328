"""Poses, frames, joints and pictures as messages of ROS."""

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any

from geometry_msgs.msg import PoseStamped, TransformStamped
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, JointState
from tf2_msgs.msg import TFMessage

from longreach_ros2.kinematics import BASE, Array
from nominal_arm.description import JOINT_NAMES
from protocol.pose import Pose
from vision_pc.core.se3 import inverse, to_pose

DEPTH = 10
PICTURES: QoSProfile = qos_profile_sensor_data
Stamp = tuple[int, int]


def joint_state(q: Sequence[float], stamp: Stamp) -> Any:
    """Angles of our six joints, rad."""
    return stamped(JointState(name=list(JOINT_NAMES), position=list(q)), BASE, stamp)


def pose_stamped(pose: Pose, frame: str, stamp: Stamp) -> Any:
    """A pose in ``frame``."""
    message = stamped(PoseStamped(), frame, stamp)
    _fill(message.pose.position, message.pose.orientation, pose)
    return message


def chain(frames: dict[str, Array], stamp: Stamp) -> Any:
    """Each of ``frames`` (X_BF by name) in the one before."""
    found = []
    for (before, X), (name, Y) in pairwise(frames.items()):
        found.append(transform(to_pose(inverse(X) @ Y), before, name, stamp))
    return TFMessage(transforms=found)


def transform(pose: Pose, frame: str, child: str, stamp: Stamp) -> Any:
    """Frame ``child`` in ``frame``."""
    message = stamped(TransformStamped(child_frame_id=child), frame, stamp)
    _fill(message.transform.translation, message.transform.rotation, pose)
    return message


def posed(given: Any) -> Pose:
    """The pose of a ``foxglove.FrameTransform``."""
    p, q = given.translation, given.rotation
    return Pose((p.x, p.y, p.z), (q.w, q.x, q.y, q.z))


def image(given: Any, stamp: Stamp) -> Any:
    """A ``foxglove.RawImage`` or ``CompressedImage`` as ROS has it."""
    if hasattr(given, "format"):
        return stamped(CompressedImage(format=given.format, data=given.data), given.frame_id, stamp)
    message = Image(height=given.height, width=given.width, encoding=given.encoding, step=given.step)
    message.data.frombytes(given.data)
    return stamped(message, given.frame_id, stamp)


def camera_info(given: Any, stamp: Stamp) -> Any:
    """A ``foxglove.CameraCalibration`` as ROS has it."""
    message = CameraInfo(height=given.height, width=given.width, distortion_model=given.distortion_model)
    message.d, message.k, message.r, message.p = list(given.D), list(given.K), list(given.R), list(given.P)
    return stamped(message, given.frame_id, stamp)


def stamped(message: Any, frame: str, stamp: Stamp) -> Any:
    """``message`` with its header."""
    message.header.frame_id = frame
    message.header.stamp.sec, message.header.stamp.nanosec = stamp
    return message


def transforms(given: Iterable[Any], stamp: Stamp) -> Any:
    """A ``foxglove.FrameTransforms`` as ROS has it."""
    return TFMessage(
        transforms=[transform(posed(one), one.parent_frame_id, one.child_frame_id, stamp) for one in given]
    )


def _fill(position: Any, orientation: Any, pose: Pose) -> None:
    position.x, position.y, position.z = pose.p_m
    orientation.w, orientation.x, orientation.y, orientation.z = pose.q_wxyz
