"""Joint trajectories of ROS: what is followed, and what is refused with its name, value and limit."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from controller.core.kinematics.denavit_hartenberg import chain, dh_table, geometric_jacobian, tool_pose
from longreach_ros2.kinematics import TOOL, NominalKinematics, moved
from longreach_ros2.trajectories import START_RAD, JointPath, check_within, joint_path, limits_of, tolerances
from nominal_arm.description import JOINT_NAMES
from protocol.errors import RequestRefused
from testbed.exports.arm_tree import nominal_tree
from tests.longreach_ros2.messages import ARM, HOME, point, trajectory

LIMITS = limits_of(ARM)
GOAL = tuple(np.add(HOME, (0.1, 0.05, -0.05, 0.1, -0.1, 0.1)))
STILL = (0.0,) * 6


def path_of(*points: Any, **more: Any) -> JointPath:
    return joint_path(trajectory(*points, **more), HOME, LIMITS)


def refused(*points: Any, **more: Any) -> RequestRefused:
    with pytest.raises(RequestRefused) as caught:
        path_of(*points, **more)
    return caught.value


def test_frames_and_tool_are_those_of_the_controller_and_of_the_urdf() -> None:
    rng = np.random.default_rng(1)
    kinematics, table, tree = NominalKinematics(ARM), dh_table(ARM.dh), nominal_tree(ARM)
    for q in rng.uniform(LIMITS.ranges[:, 0], LIMITS.ranges[:, 1], (20, 6)):
        frames = kinematics.frames(q)
        assert np.allclose(frames[TOOL], tool_pose(table, q), atol=1e-12)
        X = np.eye(4)
        for joint, angle in zip(tree.joints, q, strict=True):
            turn = np.eye(4)
            turn[:2, :2] = [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
            X = X @ joint.X_PJ @ turn
            assert np.allclose(frames[f"{joint.name}_link"], X, atol=1e-12)


def test_the_tools_twist_is_the_jacobian_times_the_rates_and_where_it_goes() -> None:
    rng = np.random.default_rng(2)
    kinematics, table = NominalKinematics(ARM), dh_table(ARM.dh)
    for q, rate in rng.uniform(-0.5, 0.5, (10, 2, 6)) + np.array([HOME, STILL]):
        found = kinematics.moving_tool(q, rate)
        assert np.allclose(found.twist, geometric_jacobian(chain(table, q)) @ rate, atol=1e-12)
        later = kinematics.moving_tool(q + 1e-5 * rate, rate).X_BT
        assert np.allclose(moved(found.X_BT, found.twist, 1e-5), later, atol=1e-9)


def test_a_path_passes_its_points_with_their_velocities_and_rests_at_its_goal() -> None:
    middle, rate = np.add(HOME, 0.04), (0.02, 0.01, -0.01, 0.02, -0.02, 0.03)
    path = path_of(point(3.0, middle, rate), point(8.0, GOAL))
    for time_s, q, v in ((0.0, HOME, STILL), (3.0, middle, rate), (8.0, GOAL, STILL), (9.0, GOAL, STILL)):
        assert np.allclose(path.at(time_s)[0], q)
        assert np.allclose(path.at(time_s)[1], v)
    q, v = path.at(2.0)
    assert np.allclose((path.at(2.0 + 1e-6)[0] - q) / 1e-6, v, atol=1e-5)


def test_accelerations_make_the_path_smoother() -> None:
    ends = ((0.0, HOME), (8.0, GOAL))
    quintic = path_of(*(point(t, q, STILL, accelerations=[0.0] * 6) for t, q in ends))
    cubic = path_of(point(0.0, HOME), point(8.0, GOAL))
    share = np.subtract(quintic.at(0.8)[0], HOME) / np.subtract(GOAL, HOME)
    assert share == pytest.approx(10 * 0.1**3 - 15 * 0.1**4 + 6 * 0.1**5)
    share = np.subtract(cubic.at(0.8)[0], HOME) / np.subtract(GOAL, HOME)
    assert share == pytest.approx(3 * 0.1**2 - 2 * 0.1**3)


def test_joints_may_come_in_any_order() -> None:
    order = [3, 1, 0, 5, 4, 2]
    names = [JOINT_NAMES[i] for i in order]
    path = path_of(point(8.0, [GOAL[i] for i in order]), names=names)
    assert np.allclose(path.goal, GOAL)


def test_a_single_point_where_the_arm_stands_is_a_path_of_no_way() -> None:
    path = path_of(point(0.0, HOME))
    assert np.allclose(path.goal, HOME)
    assert path.duration_s < 0.1


FAR = (HOME[0] + 2 * START_RAD, *HOME[1:])
WRONG: dict[str, tuple[list[Any], dict[str, Any], str]] = {
    "points": ([], {}, "0 points"),
    "velocities": ([point(8.0, GOAL, ())], {}, "point 0 has no velocities"),
    "effort": ([point(8.0, GOAL, effort=[1.0] * 6)], {}, "point 0 has efforts"),
    "times": ([point(4.0, HOME), point(3.0, GOAL)], {}, "point 1 is at 3 s, not after 4 s"),
    "moving_end": ([point(8.0, GOAL, (0.1, *STILL[1:]))], {}, "slew at 0.1 rad/s, limit 0.001 rad/s"),
    "start": ([point(0.0, FAR), point(8.0, GOAL)], {}, "begins 20.0 mrad from where slew"),
    "joint_limit": ([point(60.0, (*GOAL[:5], 1.6))], {}, "wrist3 at 91.67 deg after 60 s, limit 90.00 deg"),
    "too_fast": ([point(1.0, (0.5, *GOAL[1:]))], {}, "limit 15.00 deg/s"),
    "not_finite": ([point(8.0, (math.nan, *GOAL[1:]))], {}, "point 0: positions [nan"),
    "joints": ([point(8.0, GOAL)], {"names": (*JOINT_NAMES[:5], "elbow")}, "missing: wrist3; unknown: elbow"),
}  # fmt: skip


@pytest.mark.parametrize("what", WRONG)
def test_what_cannot_be_followed_is_refused_by_name(what: str) -> None:
    points, more, words = WRONG[what]
    error = refused(*points, **more)
    assert error.cause == f"refused.ros_{what}"
    assert words in str(error)


def test_further_forms_of_the_same_mistakes_are_refused() -> None:
    assert refused(point(8.0, GOAL[:5])).cause == "refused.ros_points"
    assert refused(point(-1.0, HOME), point(8.0, GOAL)).cause == "refused.ros_times"
    assert refused(point(3601.0, GOAL)).cause == "refused.ros_times"
    assert refused(point(3.0, HOME), point(3.0, GOAL)).cause == "refused.ros_times"
    assert "named twice" in str(refused(point(8.0, (*GOAL, 0.0)), names=(*JOINT_NAMES, "slew")))
    assert refused(point(8.0, GOAL, (math.inf,) * 6)).cause == "refused.ros_not_finite"
    for far in ((1e308,) * 6, (-1e300,) * 6):  # finite, but not what is computed of it
        for wrong in (point(4.0, far), point(4.0, HOME, far), point(4.0, HOME, STILL, accelerations=far)):
            assert refused(wrong, point(8.0, GOAL)).cause == "refused.ros_not_finite"


def test_a_path_that_swings_out_of_range_between_its_points_is_refused() -> None:
    high = (*HOME[:5], math.radians(89.0))
    out = (*STILL[:5], 0.5)
    error = refused(point(0.0, HOME), point(20.0, high, out), point(40.0, HOME))
    assert error.cause == "refused.ros_joint_limit"
    assert "limit 90.00 deg" in str(error)


def tolerance(name: str, position: float, velocity: float = 0.0, acceleration: float = 0.0) -> Any:
    return SimpleNamespace(name=name, position=position, velocity=velocity, acceleration=acceleration)


def test_tolerances_mean_what_ros_says() -> None:
    said = [tolerance("tilt", 0.02), tolerance("slew", -1.0, -1.0, -1.0), tolerance("lift", 0.0)]
    assert tolerances(said, 0.005).tolist() == [math.inf, 0.005, 0.02, 0.005, 0.005, 0.005]


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (tolerance("elbow", 0.1), "joint 'elbow', this arm has slew"),
        (tolerance("slew", -0.5), "slew, position: tolerance -0.5, allowed are positive ones"),
        (tolerance("slew", math.nan), "slew, position: tolerance nan"),
        (tolerance("slew", 0.1, 0.1), "slew: tolerances of velocity are not judged"),
        (tolerance("slew", 0.1, 0.0, 0.1), "slew: tolerances of acceleration are not judged"),
        (tolerance("slew", 0.1, -2.0), "slew, velocity: tolerance -2"),
    ],
)
def test_a_tolerance_that_ros_does_not_allow_or_nobody_judges_is_refused(wrong: Any, words: str) -> None:
    with pytest.raises(RequestRefused, match=words):
        tolerances([wrong], 0.005)
    with pytest.raises(RequestRefused, match="joint 'lift', named twice"):
        tolerances([tolerance("lift", 0.1), tolerance("lift", 0.2)], 0.005)


def test_the_joint_that_is_off_most_by_its_own_tolerance_is_named() -> None:
    q = np.add(HOME, (0.01, 0.004, 0.0, 0.0, 0.0, 0.0))
    check_within("goal", tuple(q), np.array(HOME), np.full(6, 0.02))
    with pytest.raises(RequestRefused, match=r"lift is 4\.00 mrad off the goal, limit 1\.00 mrad") as caught:
        check_within("goal", tuple(q), np.array(HOME), np.array([0.02, 0.001, 0.02, 0.02, 0.02, 0.02]))
    assert caught.value.cause == "refused.ros_goal_tolerance"
