"""What the node does with the arm, in lockstep: the whole machine but ROS."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from longreach_ros2.drive import ArmDrive, JointGoal, TopicStreams
from longreach_ros2.kinematics import TOOL, Array
from longreach_ros2.references import RosTime
from longreach_ros2.status import ERROR, OFF_GOAL, OK, STALE, WARN, code_of, diagnosis, news_of
from protocol.errors import LongreachError
from protocol.faults import CommandCode, FaultCode, GroupState
from testbed.lockstep.clock import RunLog, run
from testbed.lockstep.world import World
from testbed.scenarios.scenario import chosen_overrides, load_settings
from tests.longreach_ros2.messages import ROS_EPOCH_NS, joints, point, pose, time_of, trajectory, twist
from tests.support.paths import CONFIGS
from vision_pc.application.link_arm import LinkArm
from vision_pc.core.se3 import from_pose

WAY = np.array([0.04, 0.02, -0.03, 0.05, -0.04, 0.05])
PERIOD_S = 0.03


class Driven:
    """An enabled arm in lockstep behind a ``ArmDrive``."""

    def __init__(self) -> None:
        settings = load_settings(CONFIGS, chosen_overrides(CONFIGS, None, 1, []))
        self.world = World(settings, 1, RunLog())
        self.link = self.world.link
        arm = LinkArm(self.link, settings.vision.motion)
        self.drive = ArmDrive(self.link, arm, settings.arm, self.world.clock, RosTime(ROS_EPOCH_NS))
        self.streams = TopicStreams(self.drive)
        self.world.connect()
        self.enable()
        self.home = np.array(self.link.state.q_cmd)

    def enable(self) -> None:
        run(self.drive.command(CommandCode.ENABLE))
        run(self.link.next_state())

    def pass_s(self, seconds: float) -> None:
        self.world.clock.advance_until(lambda: False, seconds)

    def goal(self, way: Array = WAY, seconds: float = 4.0, **more: Any) -> JointGoal:
        message = trajectory(point(seconds, self.home + way))
        return self.drive.goal_of(SimpleNamespace(trajectory=message, **more))

    def feed(self, act: Callable[[Any], Any], made: Callable[[int], Any], count: int) -> None:
        """``count`` messages, ``PERIOD_S`` apart, stamped with their time."""
        for number in range(count):
            message = made(number)
            message.header.stamp = time_of(1e-9 * (self.world.vision_ns + ROS_EPOCH_NS))
            run(act(message))
            self.pass_s(PERIOD_S)

    def off_mrad(self, q: Array) -> float:
        return float(1e3 * np.abs(np.array(self.link.state.q_meas) - q).max())


@pytest.fixture
def driven() -> Driven:
    return Driven()


def caught(act: Callable[[], Any]) -> LongreachError:
    with pytest.raises(LongreachError) as error:
        act()
    return error.value


@pytest.mark.slow("the arm comes to rest")
def test_a_trajectory_is_followed_to_its_goal_within_a_milliradian(driven: Driven) -> None:
    goal, off, count = driven.goal(), [], 0

    def progress(q: Array, rate: Array) -> None:
        nonlocal count
        count += 1
        off.append(driven.off_mrad(q))

    run(driven.drive.follow(goal, progress))
    assert driven.off_mrad(goal.path.goal) < 1.0
    assert max(off) < 10.0, "on the way"
    assert count == pytest.approx(4.0 / 0.02, rel=0.05)
    assert driven.link.state.group_state is GroupState.STANDBY or driven.link.state.motion_done


def test_a_refusal_of_the_controller_ends_the_trajectory_with_value_and_limit(
    driven: Driven,
) -> None:
    fast = np.array([0.5, 0.0, 0.0, 0.0, 0.0, 0.0])  # 0.25 rad/s for a joint that may: 1 m/s at the tool
    error = caught(lambda: run(driven.drive.follow(driven.goal(fast, seconds=3.5))))
    assert error.cause == "refused.too_fast"
    assert "limit" in str(error)
    driven.pass_s(2.0)
    before = np.array(driven.link.state.q_meas)
    driven.pass_s(1.0)
    assert driven.off_mrad(before) < 0.5
    assert driven.link.state.group_state is GroupState.STANDBY


@pytest.mark.slow("the arm comes to rest")
def test_tolerances_of_the_way_the_goal_and_its_time_are_judged(driven: Driven) -> None:
    near = [SimpleNamespace(name="slew", position=1e-6, velocity=0.0, acceleration=0.0)]
    error = caught(lambda: run(driven.drive.follow(driven.goal(path_tolerance=near))))
    assert (error.cause, "slew is" in str(error)) == ("refused.ros_path_tolerance", True)
    driven.pass_s(3.0)
    driven.home = np.array(driven.link.state.q_cmd)
    error = caught(lambda: run(driven.drive.follow(driven.goal(goal_tolerance=near))))
    assert error.cause == "refused.ros_goal_tolerance"
    driven.home = np.array(driven.link.state.q_cmd)
    soon = time_of(0.1)
    error = caught(lambda: run(driven.drive.follow(driven.goal(-WAY, goal_time_tolerance=soon))))
    assert "after the trajectory's end, limit 0.1 s" in str(error)


def test_joints_of_several_degrees_of_freedom_and_old_stamps_are_refused_before_anything_moves(
    driven: Driven,
) -> None:
    many = SimpleNamespace(joint_names=["floating"])
    assert caught(lambda: driven.goal(multi_dof_trajectory=many)).cause == "refused.ros_joints"
    parts = [SimpleNamespace(joint_name="slew", component=4, position=0.1)]
    assert caught(lambda: driven.goal(component_goal_tolerance=parts)).cause == "refused.ros_joints"
    error = caught(lambda: driven.goal(goal_time_tolerance=time_of(-2.0)))
    assert (error.cause, "goal_time_tolerance, s: tolerance -2" in str(error)) == (
        "refused.ros_tolerance",
        True,
    )
    assert driven.goal(goal_time_tolerance=time_of(-1.0)).extra_s == driven.goal().extra_s == np.inf
    late = trajectory(point(4.0, driven.home + WAY), stamp_s=12.0)
    assert caught(lambda: driven.drive.goal_of(late)).cause == "refused.ros_stamp"
    driven.pass_s(0.5)
    assert driven.link.state.motion_id == 0


def test_targets_and_paths_are_the_controllers_motions(driven: Driven) -> None:
    X = from_pose(driven.link.state.X_BT_cmd)
    X[1, 3] += 0.05
    run(driven.drive.go_to(pose(X)))
    driven.world.clock.advance_until(lambda: driven.link.state.motion_done, 20.0)
    driven.pass_s(2.0)
    assert from_pose(driven.link.state.X_BT)[:3, 3] == pytest.approx(X[:3, 3], abs=2e-3)
    back = np.eye(4)
    back[0, 3] = 0.03
    said = SimpleNamespace(header=pose(X).header, poses=[pose(X), pose(back, TOOL)])
    run(driven.drive.go_along(said))
    assert caught(lambda: run(driven.drive.go_to(pose(X, "map")))).cause == "refused.ros_frame"
    far = X.copy()
    far[0, 3] = 9.0
    error = caught(lambda: run(driven.drive.go_to(pose(far))))
    assert (error.cause, "limit" in str(error)) == ("refused.too_far", True)


def test_a_twist_moves_the_tool_and_its_end_is_that_of_a_silent_stream(driven: Driven) -> None:
    before = np.array(driven.link.state.X_BT_cmd.p_m)
    driven.feed(driven.streams.twist, lambda _: twist([0.0, 0.05, 0.0, 0.0, 0.0, 0.0]), 40)
    moved = np.array(driven.link.state.X_BT.p_m) - before
    assert moved[1] == pytest.approx(0.05 * 40 * PERIOD_S, abs=0.02)
    driven.pass_s(0.2)
    stopped = np.array(driven.link.state.X_BT_cmd.p_m)
    assert driven.link.state.fault is FaultCode.REFERENCE_STALE
    driven.pass_s(1.0)
    assert np.linalg.norm(driven.link.state.X_BT.p_m - stopped) < 5e-3


def test_a_topic_that_goes_on_after_a_stop_moves_nothing_until_it_pauses(driven: Driven) -> None:
    X = from_pose(driven.link.state.X_BT_cmd)

    def ahead(number: int) -> Any:
        Y = X.copy()
        Y[1, 3] += 0.002 * number
        return pose(Y)

    driven.feed(driven.streams.servo, ahead, 20)
    run(driven.drive.command(CommandCode.STOP))
    driven.pass_s(PERIOD_S)
    error = caught(lambda: driven.feed(driven.streams.servo, ahead, 5))
    assert error.cause in ("refused.stopped", "refused.not_streaming")
    driven.pass_s(0.3)
    rests = np.array(driven.link.state.X_BT_cmd.p_m)
    driven.feed(driven.streams.servo, ahead, 20)
    assert driven.link.state.X_BT_cmd.p_m == pytest.approx(tuple(rests), abs=1e-6)
    driven.pass_s(0.6)
    X = from_pose(driven.link.state.X_BT_cmd)
    driven.feed(driven.streams.servo, ahead, 20)
    assert driven.link.state.X_BT_cmd.p_m[1] > rests[1] + 0.01


@pytest.mark.slow("eight seconds of the machine")
def test_commands_of_joints_open_a_stream_again_by_enabling(driven: Driven) -> None:
    def hold(_: int) -> Any:
        return joints(driven.home)

    run(driven.drive.command(CommandCode.DISABLE))
    driven.pass_s(0.5)
    assert caught(lambda: driven.feed(driven.streams.joints, hold, 1)).cause == "refused.disabled"
    driven.feed(driven.streams.joints, hold, 3)
    driven.enable()
    driven.streams.rearm()

    def along(number: int) -> Any:
        return joints(driven.home + WAY * min(1.0, number / 60), WAY / (60 * PERIOD_S) * (number < 60))

    driven.feed(driven.streams.joints, along, 140)
    assert driven.off_mrad(driven.home + WAY) < 3.0


def test_one_topic_at_a_time_and_numbers_that_are_numbers(driven: Driven) -> None:
    X = from_pose(driven.link.state.X_BT_cmd)
    driven.feed(driven.streams.servo, lambda _: pose(X), 3)
    error = caught(lambda: driven.feed(driven.streams.twist, lambda _: twist([0.01] * 6), 1))
    assert (error.cause, "a stream of servo is open" in str(error)) == ("refused.ros_stream", True)
    driven.feed(driven.streams.servo, lambda _: pose(X), 3)
    driven.pass_s(0.6)
    bad = joints([float("nan")] * 6)
    assert (
        caught(lambda: driven.feed(driven.streams.joints, lambda _: bad, 1)).cause == "refused.ros_not_finite"
    )


def test_the_status_says_what_the_arm_is_at_and_what_was_refused_last(driven: Driven) -> None:
    refusals = driven.drive.refusals
    assert diagnosis(driven.link, refusals)[:2] == (OK, "standby")
    refusals.note("~/target", caught(lambda: run(driven.drive.go_to(pose(np.eye(4), "map")))))
    values = diagnosis(driven.link, refusals).values
    assert (values["motion"], values["motion_done"]) == ("0", "false")
    before = news_of(driven.link.state)
    driven.pass_s(0.1)
    assert news_of(driven.link.state) == before, "a state that says nothing new is not published at once"
    run(driven.drive.go_to(pose(from_pose(driven.link.state.X_BT_cmd))))
    driven.pass_s(1.0)
    gone = diagnosis(driven.link, refusals).values
    assert (gone["motion"], gone["motion_done"]) == (str(driven.link.state.motion_id), "true")
    assert news_of(driven.link.state) != before
    assert (values["refused_cause"], values["refusals"]) == ("refused.ros_frame", "1")
    assert "map" in values["refused"]
    run(driven.drive.command(CommandCode.DISABLE))
    driven.pass_s(0.5)
    assert diagnosis(driven.link, refusals).level == WARN
    run(driven.drive.command(CommandCode.EMERGENCY_STOP))
    driven.pass_s(0.1)
    assert diagnosis(driven.link, refusals)[:2] == (ERROR, "stopped by emergency stop: reset, then enable")
    driven.link.disconnect()
    assert diagnosis(driven.link, refusals).level == STALE
    assert code_of("motion.not_settled") == code_of("refused.ros_goal_tolerance") == OFF_GOAL
