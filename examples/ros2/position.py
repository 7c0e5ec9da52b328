"""Positioning by vision through ROS alone: it looks, computes with standard messages and drives.

Beside `longreach-ros2 --controller … --camera`. The tool's marker and the object's three are found in both
pictures and triangulated by their CameraInfo. Four short ways tell how the base lies in the camera; then the
tool goes where its marker is before the object's middle, and looks again until it is.
"""

import functools
import sys
import threading
import time

import cv2
import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_srvs.srv import Trigger

TOOL, SIDE_M = 0, 0.12  # the tool marker's number; the object's markers' side and centres in O
OBJECT_M = {1: (-0.2, 0.0), 2: (0.2, 0.0), 3: (0.0, 0.2)}
CLEARANCE_M = (
    float(sys.argv[1]) if len(sys.argv) > 1 else 0.1
)  # between tool marker and object, along the camera
PICTURES, ENOUGH_M, MOST_STEPS = 8, 0.0015, 6
SHORT_M = [(-0.08, 0.0, 0.0), (0.0, 0.08, 0.0), (0.0, 0.0, 0.08), (0.0, -0.08, 0.0)]
STEP_M = 0.4  # at most, before looking again


class Positioning(Node):
    """Keeps what comes; every step waits for what it needs."""

    def __init__(self):
        super().__init__("positioning")
        self.joints, self.tool, self.lens, self.eyes, self.pair = [], None, {}, {}, None
        self.create_subscription(JointState, "/joint_states", self.keep_joints, 10)
        self.create_subscription(PoseStamped, "/longreach/tool_pose", self.keep_tool, 10)
        for eye in ("left", "right"):
            for kind, name, keep in (
                (Image, "image_raw", self.keep_picture),
                (CameraInfo, "camera_info", self.keep_lens),
            ):
                took = functools.partial(keep, eye)
                self.create_subscription(kind, f"/camera/{eye}/{name}", took, qos_profile_sensor_data)
        self.target = self.create_publisher(PoseStamped, "/longreach/target", 10)
        self.enabling = self.create_client(Trigger, "/longreach/enable")
        settings = cv2.aruco.DetectorParameters()
        settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        book = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_1000)
        self.detector = cv2.aruco.ArucoDetector(book, settings)

    def keep_picture(self, eye, message):
        """Pictures of both eyes belong together by their stamps; some are lost on a busy machine."""
        stamp = (message.header.stamp.sec, message.header.stamp.nanosec)
        self.eyes = dict([*self.eyes.items(), ((eye, stamp), message)][-8:])
        pair = [self.eyes.get((each, stamp)) for each in ("left", "right")]
        if None not in pair:
            self.pair = pair

    def keep_lens(self, eye, message):
        self.lens[eye] = message

    def keep_joints(self, message):
        self.joints = [*self.joints[-99:], message.position]  # a second

    def keep_tool(self, message):
        self.tool = message

    def wait(self, happened, seconds=120.0):
        end = time.monotonic() + seconds
        while not happened():
            if time.monotonic() > end:
                raise TimeoutError(f"{happened.__name__}: not within {seconds:g} s")
            time.sleep(0.01)

    def enable(self):
        self.enabling.wait_for_service()
        answer = self.enabling.call(Trigger.Request())
        if not answer.success:
            raise RuntimeError(answer.message)

    def at_rest(self):
        return len(self.joints) == 100 and np.ptp(self.joints, axis=0).max() < 1e-3

    def here(self):
        p = self.tool.pose.position
        return np.array([p.x, p.y, p.z])

    def go(self, p):
        """To a place in the base, turned as the tool is now."""
        message = PoseStamped()
        message.header.frame_id = "base"
        message.pose.orientation = self.tool.pose.orientation
        message.pose.position.x, message.pose.position.y, message.pose.position.z = map(float, p)
        self.target.publish(message)
        time.sleep(1.0)
        self.joints = []
        self.wait(self.at_rest)

    def look(self):
        """Tool marker and object's middle in the left camera, m: means of several pairs of pictures."""
        found, self.pair = [], None
        end = time.monotonic() + 60.0
        while len(found) < PICTURES:
            if time.monotonic() > end:
                raise TimeoutError("tool and object are not seen in enough pictures")
            pair, self.pair = self.pair, None
            if pair is None:
                time.sleep(0.01)
            else:
                found += self.measured(*pair)
        return np.mean(found, axis=0)

    def measured(self, left, right):
        """[(tool, object)] of one pair, nothing where one is not seen."""
        corners = [self.markers(picture) for picture in (left, right)]
        places = {n: self.triangulated(corners[0][n], corners[1][n]) for n in corners[0] if n in corners[1]}
        known = [n for n in OBJECT_M if n in places]
        if TOOL not in places or not known:
            return []
        # x right, y up in O, as the markers hang; ArUco's corners go round from the upper left one.
        square = 0.5 * SIDE_M * np.array([(-1, 1), (1, 1), (1, -1), (-1, -1)])
        model = np.vstack([np.column_stack((square + OBJECT_M[n], np.zeros(4))) for n in known])
        _, p = rigid(model, np.vstack([places[n] for n in known]))
        return [(places[TOOL].mean(axis=0), p)]

    def markers(self, picture):
        grey = np.frombuffer(picture.data, np.uint8).reshape(picture.height, picture.width)
        corners, numbers, _ = self.detector.detectMarkers(grey)
        return (
            {}
            if numbers is None
            else dict(zip(numbers.ravel().tolist(), (c[0] for c in corners), strict=True))
        )

    def triangulated(self, left, right):
        P = [np.array(self.lens[eye].p).reshape(3, 4) for eye in ("left", "right")]
        points = cv2.triangulatePoints(P[0], P[1], left.T.astype(float), right.T.astype(float))
        return (points[:3] / points[3]).T

    def error(self):
        """How far, in the camera, the tool marker is from where it is to be."""
        tool, middle = self.look()
        return middle - tool - (0.0, 0.0, CLEARANCE_M), middle

    def directions(self):
        """R_BC: turns what the camera sees into the base, from ways that both measure."""
        start = self.here()
        _, before = self.error()
        ways, sights = [], []
        for way in SHORT_M:
            self.go(start + way)
            _, middle = self.error()
            ways.append(self.here() - start)
            sights.append(before - middle)  # the camera is carried: what it sees goes the other way
        return rigid(np.array(sights), np.array(ways), turning_alone=True)[0]


def rigid(model, points, turning_alone=False):
    """R, p with points ≈ R model + p (Kabsch 1976)."""
    a, b = (np.zeros(3), np.zeros(3)) if turning_alone else (model.mean(axis=0), points.mean(axis=0))
    U, _, Vt = np.linalg.svd((points - b).T @ (model - a))
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return R, b - R @ a


def position(node):
    """Bring the tool to the object; each step's error in mm."""
    node.wait(lambda: node.tool is not None and len(node.lens) == 2)
    node.enable()
    node.wait(node.at_rest)
    R_BC = node.directions()
    for step in range(MOST_STEPS):
        error, _ = node.error()
        length = float(np.linalg.norm(error))
        print(f"step {step}: {1e3 * length:.2f} mm to go, as the camera sees it", flush=True)
        if length < ENOUGH_M:
            return
        node.go(node.here() + R_BC @ error * min(1.0, STEP_M / length))


def main():
    rclpy.init()
    node = Positioning()

    def spin():
        try:
            rclpy.spin(node)
        except ExternalShutdownException:
            return

    thread = threading.Thread(target=spin, daemon=True)
    thread.start()
    try:
        position(node)
    finally:
        rclpy.try_shutdown()
        thread.join()


if __name__ == "__main__":
    main()
