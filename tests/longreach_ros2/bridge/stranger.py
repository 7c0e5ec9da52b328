"""A node of somebody else: it knows standard messages and the names of topics, and nothing of ours.

Runs in the environment of ``make ros-peers``. Reads one JSON line a step from stdin, answers each with one.
"""

import json
import sys
import threading
import time
from functools import partial

import rclpy
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointTolerance
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TwistStamped
from nav_msgs.msg import Path
from rclpy.action import ActionClient
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_srvs.srv import SetBool, Trigger
from tf2_msgs.msg import TFMessage
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

NAMES = ("slew", "lift", "tilt", "wrist1", "wrist2", "wrist3")
PATIENCE_S = 30.0
TICK_S = 0.1
HEARD = {kind.__name__: kind for kind in (Image, CameraInfo, PoseStamped, TFMessage)}


class Stranger(Node):
    """Every method is a step; what it returns is its answer."""

    def __init__(self):
        super().__init__("stranger")
        self.newest, self.ages_ms, self.tree = {}, [], {}
        self.create_subscription(JointState, "/joint_states", self.heard_joints, 10)
        for kind, topic in ((PoseStamped, "/longreach/tool_pose"), (DiagnosticArray, "/diagnostics")):
            self.create_subscription(kind, topic, partial(self.newest.__setitem__, topic), 10)
        self.create_subscription(TFMessage, "/tf", self.heard_tree, 100)
        self.client = None
        self.topics = {
            name: self.create_publisher(kind, name, 10)
            for name, kind in (
                ("/longreach/target", PoseStamped),
                ("/longreach/servo", PoseStamped),
                ("/longreach/twist", TwistStamped),
                ("/longreach/path", Path),
                ("/longreach/joint_commands", JointState),
                ("/arm_controller/joint_trajectory", JointTrajectory),
            )
        }
        self.goal, self.ticks = None, 0
        self.create_timer(TICK_S, self.tick)

    def now_ns(self):
        """ROS time: the machine's, or that of /clock with use_sim_time."""
        return self.get_clock().now().nanoseconds

    def tick(self):
        self.ticks += 1

    def passed(self):
        """ROS time (s) and how often a timer of ``TICK_S`` has come."""
        return [1e-9 * self.now_ns(), self.ticks]

    def pause(self, paused):
        client = self.create_client(SetBool, "/longreach/pause")
        assert client.wait_for_service(PATIENCE_S)
        return finished(client.call_async(SetBool.Request(data=paused))).success

    def heard_joints(self, message):
        stamp = message.header.stamp
        self.ages_ms.append(1e-6 * (self.now_ns() - stamp.sec * 10**9 - stamp.nanosec))
        self.newest["/joint_states"] = message

    def heard_tree(self, message):
        self.tree.update({one.child_frame_id: one for one in message.transforms})

    def wait(self, topic="/joint_states", within_s=PATIENCE_S):
        """Whether something new comes by ``topic``."""
        self.newest.pop(topic, None)
        return until(lambda: topic in self.newest, within_s)

    def joints(self):
        self.wait()
        return list(self.newest["/joint_states"].position)

    def tool(self):
        self.wait("/longreach/tool_pose")
        p, q = (pose := self.newest["/longreach/tool_pose"].pose).position, pose.orientation
        return [p.x, p.y, p.z, q.x, q.y, q.z, q.w]

    def status(self):
        self.wait("/diagnostics")
        (status,) = self.newest["/diagnostics"].status
        said = {one.key: one.value for one in status.values}
        return said | {"level": status.level[0], "message": status.message}

    def frames(self):
        self.wait()
        until(lambda: "tool" in self.tree, PATIENCE_S)
        return {name: one.header.frame_id for name, one in self.tree.items()}

    def ages(self):
        found, self.ages_ms = sorted(self.ages_ms), []
        return found

    def hear(self, kind, topic):
        """What comes by ``topic``, asked for as pictures are, as JSON has it; none: nothing came."""
        took = partial(self.newest.__setitem__, topic)
        self.create_subscription(HEARD[kind], topic, took, qos_profile_sensor_data)
        return self.heard(topic)

    def heard(self, topic):
        """The newest of a topic that is heard."""
        if not until(lambda: topic in self.newest, PATIENCE_S):
            return None
        message = self.newest[topic]
        if isinstance(message, TFMessage):
            return {one.child_frame_id: one.header.frame_id for one in message.transforms}
        said = {"frame": message.header.frame_id, "stamp_s": message.header.stamp.sec}
        if isinstance(message, PoseStamped):
            p = message.pose.position
            return said | {"p": [p.x, p.y, p.z]}
        said |= {"width": message.width, "height": message.height}
        if isinstance(message, CameraInfo):
            return said | {"k": list(message.k), "p": list(message.p)}
        levels = len(set(message.data))
        return said | {"encoding": message.encoding, "bytes": len(message.data), "levels": levels}

    def service(self, name):
        client = self.create_client(Trigger, f"/longreach/{name}")
        assert client.wait_for_service(PATIENCE_S), name
        answer = finished(client.call_async(Trigger.Request()))
        return [answer.success, answer.message]

    def trajectory(self, points, names=NAMES, stamp_s=0.0):
        message = JointTrajectory(joint_names=list(names))
        message.header.stamp.sec = int(stamp_s)
        for point in points:
            one = JointTrajectoryPoint(positions=point["q"], velocities=point.get("v", []))
            one.time_from_start.sec = int(point["t"] // 1)
            one.time_from_start.nanosec = round(point["t"] % 1 * 1e9)
            message.points.append(one)
        return message

    def send(self, tolerance=0.0, **trajectory):
        """Send a goal; it runs on return."""
        action = "/arm_controller/follow_joint_trajectory"
        self.client = self.client or ActionClient(self, FollowJointTrajectory, action)
        assert self.client.wait_for_server(PATIENCE_S)
        goal = FollowJointTrajectory.Goal(trajectory=self.trajectory(**trajectory))
        goal.goal_tolerance = [JointTolerance(name=name, position=tolerance) for name in NAMES if tolerance]
        self.goal = finished(self.client.send_goal_async(goal))
        return self.goal.accepted

    def forget(self):
        """Be no client of the action any more."""
        if self.client is not None:
            self.client.destroy()
            self.client = None

    def result(self):
        answer = finished(self.goal.get_result_async(), 120.0)
        return [answer.status, answer.result.error_code, answer.result.error_string]

    def follow(self, **goal):
        self.send(**goal)
        return self.result()

    def cancel(self):
        finished(self.goal.cancel_goal_async())
        return self.result()

    def start(self, step, **given):
        """A step beside the others, whose answer nobody waits for."""
        threading.Thread(target=getattr(self, step), kwargs=given, daemon=True).start()

    def publish(self, topic, count=1, period_s=0.02, frame="base", **numbers):
        """The same message ``count`` times; each stamped now unless ``stamp_s`` is said."""
        publisher = self.topics[topic]
        until(lambda: publisher.get_subscription_count() > 0, PATIENCE_S)
        for _ in range(count):
            publisher.publish(self.message(publisher.msg_type, frame, numbers))
            time.sleep(period_s)
        return True

    def message(self, kind, frame, numbers):
        if kind is JointTrajectory:
            return self.trajectory(**numbers)
        message = kind()
        if kind is Path:
            message.poses = [self.message(PoseStamped, frame, {"pose": pose}) for pose in numbers["poses"]]
            for one in message.poses:
                one.header.stamp.sec = one.header.stamp.nanosec = 0
        elif kind is PoseStamped:
            p, q = message.pose.position, message.pose.orientation
            p.x, p.y, p.z, q.x, q.y, q.z, q.w = map(float, numbers["pose"])
        elif kind is TwistStamped:
            v, w = message.twist.linear, message.twist.angular
            v.x, v.y, v.z, w.x, w.y, w.z = map(float, numbers["twist"])
        else:
            message.name, message.position, message.velocity = list(NAMES), numbers["q"], numbers["v"]
        message.header.frame_id = frame
        now_ns = round(1e9 * numbers["stamp_s"]) if "stamp_s" in numbers else self.now_ns()
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(now_ns, 10**9)
        return message


def until(happened, within_s):
    end_s = time.monotonic() + within_s
    while not happened():
        if time.monotonic() > end_s:
            return False
        time.sleep(0.005)
    return True


def finished(future, within_s=PATIENCE_S):
    assert until(future.done, within_s), "no answer"
    return future.result()


def main():
    rclpy.init()
    stranger = Stranger()
    executor = SingleThreadedExecutor()
    executor.add_node(stranger)

    def spin():
        try:
            executor.spin()
        except ExternalShutdownException:
            return

    threading.Thread(target=spin, daemon=True).start()
    for line in sys.stdin:
        step, given = json.loads(line)
        print(json.dumps(getattr(stranger, step)(**given)), flush=True)
    rclpy.try_shutdown()


main()
