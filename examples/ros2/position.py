"""Positioning by vision through ROS alone: it looks, computes with standard messages and drives.

Beside `longreach-ros2 --controller … --camera`. The tool's marker and the object's three are found in both
pictures and triangulated by their CameraInfo. Four short ways tell how the base lies in the camera; then the
tool goes where its marker is before the object's middle, and looks again until it is.
"""

import functools
import threading
import time

import cv2
import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image
from std_srvs.srv import Trigger

TOOL, SIDE_M = 0, 0.12  # the tool marker's number; the object's markers' side and centres in O
OBJECT_M = {1: (-0.2, 0.0), 2: (0.2, 0.0), 3: (0.0, 0.2)}
CLEARANCE_M = 0.1  # between tool marker and object, along the camera
PICTURES, ENOUGH_M, MOST_STEPS = 8, 0.002, 12  # a servo that is settled leaves 1 to 2 mm
SHORT_M = [(-0.08, 0.0, 0.0), (0.0, 0.08, 0.0), (0.0, 0.0, 0.08), (0.0, -0.08, 0.0)]
STEP_M, SMALL_M = 0.4, 0.01  # at most, before looking again; half of what is less
MOTION_S, SETTLE_S = 60.0, 20.0  # at most, to its end and to rest there


class Positioning(Node):
    """Keeps what comes; every step waits for what it needs."""

    def __init__(self):
        super().__init__("positioning")
        self.status, self.tool, self.aim, self.spread = {}, None, None, np.zeros((3, 3))
        self.lens, self.eyes, self.pair = {}, {}, None
        self.create_subscription(DiagnosticArray, "/diagnostics", self.keep_status, 10)
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

    def keep_status(self, message):
        for status in message.status:
            if status.name == "longreach: arm":
                self.status = {one.key: one.value for one in status.values} | {"message": status.message}

    def keep_tool(self, message):
        self.tool = message

    def wait(self, what, happened, seconds=MOTION_S):
        if not self.happens(happened, seconds):
            raise TimeoutError(f"{what}: not within {seconds:g} s; the arm says {self.status}")

    def happens(self, happened, seconds):
        """Whether it does within so many seconds. Raises what the arm says when a fault has stopped it."""
        end = time.monotonic() + seconds
        while not happened():
            if self.status.get("fault", "NONE") != "NONE":
                raise RuntimeError(self.status["message"])
            if time.monotonic() > end:
                return False
            time.sleep(0.01)
        return True

    def enable(self):
        self.enabling.wait_for_service()
        answer = self.enabling.call(Trigger.Request())
        if not answer.success:
            raise RuntimeError(answer.message)

    def here(self):
        p = self.tool.pose.position
        return np.array([p.x, p.y, p.z])

    def go(self, way):
        """So far from the last target, in the base, turned as at first: steps add up, a servo's rest too."""
        if self.aim is None:
            self.aim = PoseStamped(pose=self.tool.pose)
            self.aim.header.frame_id = "base"
        p = self.aim.pose.position
        p.x, p.y, p.z = (float(at + by) for at, by in zip((p.x, p.y, p.z), way, strict=True))
        before = self.status
        self.target.publish(self.aim)
        self.wait("the target is accepted", lambda: self.answered(before))
        self.wait("the motion is done", lambda: self.status.get("motion_done") == "true")
        if not self.happens(lambda: self.status.get("settled") == "true", SETTLE_S):
            print(f"not settled within {SETTLE_S:g} s after the motion: it looks all the same", flush=True)

    def answered(self, before):
        """Whether the arm's motion is another than ``before``. Raises what it says when it refuses."""
        if self.status["refusals"] != before["refusals"]:
            raise RuntimeError(self.status["refused"])
        return self.status.get("motion", before["motion"]) != before["motion"]

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
        points = np.vstack([places[n] for n in known])
        # The tool keeps its turn, and so the camera: all pictures tell how the object is turned, not the few
        # markers of one alone, whose error reaches the middle by a lever.
        self.spread += (points - points.mean(axis=0)).T @ (model - model.mean(axis=0))
        p = points.mean(axis=0) - turn(self.spread) @ model.mean(axis=0)
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
        P, straight = [], []
        for eye, corners in (("left", left), ("right", right)):
            K, R, P_eye = (np.array(getattr(self.lens[eye], name)).reshape(3, -1) for name in "krp")
            P.append(P_eye)
            straight.append(cv2.undistortPoints(corners, K, np.array(self.lens[eye].d), R=R, P=P_eye)[:, 0].T)
        points = cv2.triangulatePoints(*P, *straight)
        return (points[:3] / points[3]).T

    def error(self):
        """How far, in the camera, the tool marker is from where it is to be."""
        tool, middle = self.look()
        return middle - tool - (0.0, 0.0, CLEARANCE_M), middle

    def directions(self):
        """R_BC: turns what the camera sees into the base, from ways that both measure."""
        start, before, at = self.here(), self.error()[1], np.zeros(3)
        ways, sights = [], []
        for way in SHORT_M:
            self.go(way - at)
            at = np.array(way)
            ways.append(self.here() - start)
            sights.append(before - self.error()[1])  # the camera is carried: what it sees goes the other way
        return turn(np.array(ways).T @ np.array(sights))


def turn(spread):
    """R that turns a's into b's best, of their sum b aᵀ (Kabsch 1976)."""
    U, _, Vt = np.linalg.svd(spread)
    return U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt


def position(node):
    """Bring the tool to the object. Raises RuntimeError when the camera does not see it there at the end."""
    node.wait("tool, lenses, status", lambda: node.tool and "motion" in node.status and len(node.lens) == 2)
    node.enable()
    R_BC = node.directions()
    for step in range(MOST_STEPS):
        error, _ = node.error()
        length = float(np.linalg.norm(error))
        print(f"step {step}: {1e3 * length:.2f} mm to go, as the camera sees it", flush=True)
        if length < ENOUGH_M:
            return
        # Friction leaves the arm short of where it comes from: whole small steps swing from side to side.
        node.go(R_BC @ error * (0.5 if length < SMALL_M else min(1.0, STEP_M / length)))
    raise RuntimeError(f"not within {1e3 * ENOUGH_M:g} mm after {MOST_STEPS} steps")


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
