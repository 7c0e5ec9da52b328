"""Poses, twists and stamps of ROS as references of the link."""

import math
import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from longreach_ros2.kinematics import TOOL, NominalKinematics
from longreach_ros2.references import RosTime, path_of, pose_in_base, target_of, twist_in_base
from protocol.errors import RequestRefused
from tests.longreach_ros2.messages import ARM, HOME, ROS_EPOCH_NS, pose, time_of, twist
from vision_pc.core.se3 import from_pose

FRAMES = NominalKinematics(ARM).frames(HOME)
X_BT = FRAMES[TOOL]
NOW_NS = 5_000_000_000
CLOCK = RosTime(ROS_EPOCH_NS)


def cause(act: Any, *given: Any) -> str:
    with pytest.raises(RequestRefused) as caught:
        act(*given)
    return caught.value.cause


def test_a_pose_may_be_said_in_any_frame_of_the_arm() -> None:
    ahead = np.eye(4)
    ahead[2, 3] = 0.1
    assert np.allclose(from_pose(target_of(pose(ahead, "tool"), FRAMES).X_BT_ref), X_BT @ ahead)
    assert np.allclose(from_pose(target_of(pose(X_BT), FRAMES).X_BT_ref), X_BT)
    inside = np.linalg.inv(FRAMES["tilt_link"]) @ X_BT
    assert np.allclose(from_pose(target_of(pose(inside, "tilt_link"), FRAMES).X_BT_ref), X_BT)


def test_a_twist_turns_with_its_frame() -> None:
    v, w = np.array([0.01, 0.02, 0.03]), np.array([0.1, 0.2, 0.3])
    found = twist_in_base(twist([*v, *w], "tool").twist, "tool", FRAMES)
    assert np.allclose(found, [*(X_BT[:3, :3] @ v), *(X_BT[:3, :3] @ w)])


@pytest.mark.parametrize(("frame", "words"), [("map", "frame 'map' is not known"), ("", "no frame is named")])
def test_a_frame_that_is_not_known_is_refused_with_those_that_are(frame: str, words: str) -> None:
    with pytest.raises(RequestRefused, match=words) as caught:
        target_of(pose(X_BT, frame), FRAMES)
    assert caught.value.cause == "refused.ros_frame"
    assert "base, slew_link" in str(caught.value)
    assert cause(twist_in_base, twist([0.0] * 6).twist, frame, FRAMES) == "refused.ros_frame"


def test_numbers_that_are_none_and_quaternions_that_are_not_unit_are_refused() -> None:
    said = pose(X_BT).pose
    said.position.y = math.nan
    assert cause(pose_in_base, said, "base", FRAMES) == "refused.ros_not_finite"
    said = pose(X_BT).pose
    said.orientation.w += 0.1
    assert cause(pose_in_base, said, "base", FRAMES) == "refused.ros_not_unit_quaternion"
    assert cause(twist_in_base, twist([math.inf] * 6).twist, "base", FRAMES) == "refused.ros_not_finite"


def test_a_path_stops_at_each_pose_and_keeps_no_times() -> None:
    poses = [pose(X_BT), pose(np.eye(4), "tool"), pose(X_BT, "")]
    said = SimpleNamespace(header=pose(X_BT).header, poses=poses)
    found = path_of(said, FRAMES)
    assert len(found.waypoints) == 3
    assert np.allclose([from_pose(one) for one in found.waypoints], [X_BT] * 3)
    poses[1].header.stamp = time_of(1.0)
    assert cause(path_of, said, FRAMES) == "refused.ros_timed_path"


def test_a_stamp_is_brought_to_the_links_clock() -> None:
    assert CLOCK.measured_ns(time_of(0.0), NOW_NS) == NOW_NS
    said = (NOW_NS + ROS_EPOCH_NS) / 1e9 - 0.1
    assert CLOCK.measured_ns(time_of(said), NOW_NS) == pytest.approx(NOW_NS - 100_000_000, abs=1000)
    assert CLOCK.of(NOW_NS) == divmod(NOW_NS + ROS_EPOCH_NS, 10**9)


def test_an_instant_has_one_stamp_until_the_clock_is_set(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock, sets_ns = RosTime(), iter([0, 900_000, -900_000, 2_000_000, 2_100_000])
    monkeypatch.setattr(time, "monotonic_ns", lambda: NOW_NS)
    monkeypatch.setattr(time, "time_ns", lambda: NOW_NS + ROS_EPOCH_NS + next(sets_ns))
    first, second, third, set_anew, after = (clock.of(NOW_NS) for _ in range(5))
    assert first == second == third
    assert set_anew == after != first


@pytest.mark.parametrize("off_s", [-0.3, 0.1, 3600.0, -ROS_EPOCH_NS / 1e9])
def test_a_stamp_of_another_clock_is_refused_with_its_age(off_s: float) -> None:
    said = (NOW_NS + ROS_EPOCH_NS) / 1e9 + off_s
    with pytest.raises(RequestRefused, match=f"{-off_s:.3f} s old") as caught:
        CLOCK.measured_ns(time_of(said), NOW_NS)
    assert caught.value.cause == "refused.ros_stamp"
