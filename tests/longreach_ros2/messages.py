"""Messages as ``rclpy`` hands them over, by their fields alone; ROS is not needed."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from foundation.configuration import load
from longreach_ros2.kinematics import Array
from nominal_arm.description import JOINT_NAMES, NominalArm
from tests.support.paths import CONFIGS

ARM = load(NominalArm, CONFIGS / "arm.yaml")
HOME = (0.0, 0.87, -1.31, 0.0, -0.43, 0.0)
ROS_EPOCH_NS = 1_700_000_000_000_000_000  # ROS time minus the monotonic clock's


def time_of(seconds: float) -> Any:
    whole, rest = divmod(round(seconds * 1e9), 10**9)
    return SimpleNamespace(sec=whole, nanosec=rest)


def header(frame: str = "base", stamp_s: float = 0.0) -> Any:
    return SimpleNamespace(frame_id=frame, stamp=time_of(stamp_s))


def point(t: float, q: Sequence[float], v: Sequence[float] = (0.0,) * 6, **more: Any) -> Any:
    given = {"accelerations": [], "effort": []} | more
    return SimpleNamespace(positions=list(q), velocities=list(v), time_from_start=time_of(t), **given)


def trajectory(*points: Any, names: Sequence[str] = JOINT_NAMES, stamp_s: float = 0.0) -> Any:
    return SimpleNamespace(header=header("", stamp_s), joint_names=list(names), points=list(points))


def pose(X: Array, frame: str = "base", stamp_s: float = 0.0) -> Any:
    p, q = X[:3, 3], Rotation.from_matrix(X[:3, :3]).as_quat()
    named = (dict(zip(names, values, strict=True)) for names, values in (("xyz", p), ("xyzw", q)))
    position, orientation = (SimpleNamespace(**each) for each in named)
    said = SimpleNamespace(position=position, orientation=orientation)
    return SimpleNamespace(header=header(frame, stamp_s), pose=said)


def twist(numbers: Sequence[float], frame: str = "base", stamp_s: float = 0.0) -> Any:
    v, w = (SimpleNamespace(**dict(zip("xyz", half, strict=True))) for half in np.reshape(numbers, (2, 3)))
    return SimpleNamespace(header=header(frame, stamp_s), twist=SimpleNamespace(linear=v, angular=w))


def joints(q: Sequence[float], v: Sequence[float] = (), names: Sequence[str] = JOINT_NAMES) -> Any:
    return SimpleNamespace(header=header(""), name=list(names), position=list(q), velocity=list(v))
