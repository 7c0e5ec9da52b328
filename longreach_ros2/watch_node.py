"""The node that watches: what the services show live, as topics of ROS; truth under ``/truth`` alone."""

from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState
from tf2_msgs.msg import TFMessage

from longreach_ros2.camera import EYES, PicturePublisher
from longreach_ros2.kinematics import BASE
from longreach_ros2.live_client import LiveMessage
from longreach_ros2.references import RosTime
from longreach_ros2.ros_messages import DEPTH, Stamp, joint_state, pose_stamped, posed, transforms
from nominal_arm.description import JOINT_NAMES
from protocol.pose import Pose
from vision_pc.core.se3 import to_pose

STATE, TRUTH, TRUE_FRAMES, SEEN = "/controller/state", "/plant/truth", "/tf_true", "/vision/tf"
_IMAGES = {f"/camera/{eye}/image": eye for eye in EYES}
_LENSES = {f"/camera/{eye}/calibration": eye for eye in EYES}
TOPICS = frozenset({STATE, TRUTH, TRUE_FRAMES, SEEN, *_IMAGES, *_LENSES})


class WatchNode(Node):  # type: ignore[misc]
    """Publishes what ``show`` is given. It has no subscription and no service: nothing can be commanded."""

    def __init__(self, ros_time: RosTime) -> None:
        super().__init__("longreach_watch")
        self._time = ros_time
        self._joints = self.create_publisher(JointState, "joint_states", DEPTH)
        self._tool = self.create_publisher(PoseStamped, "longreach/tool_pose", DEPTH)
        self._tree = self.create_publisher(TFMessage, "/tf", DEPTH)
        self._true_joints = self.create_publisher(JointState, "/truth/joint_states", DEPTH)
        self._true_tool = self.create_publisher(PoseStamped, "/truth/tool_pose", DEPTH)
        self._true_tree = self.create_publisher(TFMessage, "/truth/tf", DEPTH)
        self._pictures: dict[bool, PicturePublisher] = {}
        self._lenses: dict[str, Any] = {}
        self._seen: dict[str, Any] = {}

    def show(self, live: LiveMessage) -> None:
        """Publish one message of the live face."""
        topic, log_ns, message = live
        stamp = self._time.of(log_ns)
        if topic == STATE:
            self._joints.publish(joint_state(_joints(message, "q_meas"), stamp))
            self._tool.publish(pose_stamped(_state_pose(message), BASE, stamp))
        elif topic == TRUTH:
            self._true_joints.publish(joint_state(_joints(message, "q"), stamp))
            self._true_tool.publish(
                pose_stamped(to_pose(np.reshape(message.X_BT, (4, 4))), "true/base", stamp)
            )
        elif topic == TRUE_FRAMES:
            self._true_tree.publish(transforms(message.transforms, stamp))
        elif topic == SEEN:
            self._show_seen(message, stamp)
        elif topic in _LENSES:
            self._lenses[_LENSES[topic]] = message
        else:
            self._show_picture(_IMAGES[topic], message, stamp)

    def _show_seen(self, message: Any, stamp: Stamp) -> None:
        """Markers and objects found, as frames and each as a pose of its own."""
        self._tree.publish(transforms(message.transforms, stamp))
        for one in message.transforms:
            if one.child_frame_id not in self._seen:
                self._seen[one.child_frame_id] = self.create_publisher(PoseStamped, one.child_frame_id, DEPTH)
            self._seen[one.child_frame_id].publish(pose_stamped(posed(one), one.parent_frame_id, stamp))

    def _show_picture(self, eye: str, message: Any, stamp: Stamp) -> None:
        compressed = hasattr(message, "format")
        if compressed not in self._pictures:
            self._pictures[compressed] = PicturePublisher(self, compressed)
            self._pictures[compressed].lenses = self._lenses
        self._pictures[compressed].publish(eye, message, stamp)


def _joints(message: Any, what: str) -> list[float]:
    return [getattr(message, f"{what}_{name}_rad") for name in JOINT_NAMES]


def _state_pose(message: Any) -> Pose:
    x, y, z = (getattr(message, f"X_BT_p_{axis}_m") for axis in "xyz")
    a, b, c, d = (getattr(message, f"X_BT_q_{axis}") for axis in "wxyz")
    return Pose((x, y, z), (a, b, c, d))
