"""What the node does with the arm, over the reference link: no ROS, and no waiting but by the clock."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from longreach_ros2.kinematics import TOOL, Array, NominalKinematics, Twisted, moved
from longreach_ros2.references import RosTime, path_of, pose_in_base, target_of, twist_in_base
from longreach_ros2.status import Refusals
from longreach_ros2.trajectories import (
    JointPath,
    Limits,
    check_within,
    joint_order,
    joint_path,
    limits_of,
    refused,
    tolerance,
    tolerances,
)
from nominal_arm.description import NominalArm
from protocol.errors import LongreachError
from protocol.faults import CommandCode
from vision_pc.application.link_arm import ArmStream, LinkArm
from vision_pc.application.ports import Clock
from vision_pc.application.reference_link import ReferenceLink
from vision_pc.core.se3 import from_pose

PERIOD_S = 0.02  # [D] between the references of a trajectory
PAUSE_NS = 500_000_000  # [D] of a topic, after which its next message may open a stream
GOAL_RAD = 0.005  # [D] of each joint, where a goal names no tolerance
_STATES = 3  # after the last reference, before END_STREAM: in the same scan the latter would overtake it
_NS = 1e-9

Progress = Callable[[Array, Array], None]


class JointGoal(NamedTuple):
    """A checked trajectory: its path, how far joints may be off it and its goal (6,) rad, extra time (s)."""

    path: JointPath
    on_the_way: Array
    at_the_goal: Array
    extra_s: float


class ArmDrive:
    """Carries out what ROS asks of the arm behind ``link``."""

    def __init__(
        self, link: ReferenceLink, arm: LinkArm, nominal: NominalArm, clock: Clock, ros_time: RosTime
    ) -> None:
        self.link = link
        self.time = ros_time
        self.kinematics = NominalKinematics(nominal)
        self.refusals = Refusals()
        self._arm, self._clock = arm, clock
        self._limits: Limits = limits_of(nominal)

    def frames(self) -> dict[str, Array]:
        """X_BF of every frame at the encoders. Raises LinkLost."""
        return self.kinematics.frames(self.link.state.q_meas)

    async def command(self, code: CommandCode) -> str:
        """The reason of the controller's answer. Raises RequestRefused or LinkLost."""
        return (await self.link.command(code)).reason.name

    async def go_to(self, message: Any) -> None:
        """Begin to go to a PoseStamped. Raises RequestRefused or LinkLost."""
        self.time.measured_ns(message.header.stamp, self.link.now_ns)
        await self.link.request(target_of(message, self.frames()))

    async def go_along(self, message: Any) -> None:
        """Begin to go along a Path. Raises RequestRefused or LinkLost."""
        self.time.measured_ns(message.header.stamp, self.link.now_ns)
        await self.link.request(path_of(message, self.frames()))

    def goal_of(self, message: Any) -> JointGoal:
        """The checked goal of a FollowJointTrajectory or JointTrajectory. Raises RequestRefused, LinkLost."""
        trajectory = getattr(message, "trajectory", message)
        self.time.measured_ns(trajectory.header.stamp, self.link.now_ns)
        for name in ("multi_dof_trajectory", "component_path_tolerance", "component_goal_tolerance"):
            content = getattr(message, name, ())
            if getattr(content, "joint_names", content):
                raise refused("joints", f"{name}: the arm has no joint of several degrees of freedom")
        path = joint_path(trajectory, self.link.state.q_cmd, self._limits)
        on_the_way = tolerances(getattr(message, "path_tolerance", ()), np.inf)
        at_the_goal = tolerances(getattr(message, "goal_tolerance", ()), GOAL_RAD)
        extra = getattr(message, "goal_time_tolerance", None)
        extra_s = extra.sec + _NS * extra.nanosec if extra else 0.0
        return JointGoal(path, on_the_way, at_the_goal, tolerance("goal_time_tolerance, s", extra_s, np.inf))

    async def follow(self, goal: JointGoal, progress: Progress | None = None) -> None:
        """Follow a trajectory to rest at its goal; ``progress`` gets desired angles and rates now and then.

        Raises RequestRefused or LinkLost, with the arm stopped; a cancelled one stops it too.
        """
        async with self._arm.streaming() as stream:
            await self._stream(stream, goal, progress)
            ended_ns = self.link.now_ns
        late_s = _NS * (self.link.now_ns - ended_ns)
        if late_s > goal.extra_s:
            words = f"at rest {late_s:.2f} s after the trajectory's end, limit {goal.extra_s:g} s"
            raise refused("goal_tolerance", words)
        check_within("goal", self.link.state.q_meas, goal.path.goal, goal.at_the_goal)

    async def _stream(self, stream: ArmStream, goal: JointGoal, progress: Progress | None) -> None:
        start_ns = self.link.now_ns
        while True:
            now_ns = self.link.now_ns
            time_s = _NS * (now_ns - start_ns)
            q, rate = goal.path.at(time_s)
            reference = self.kinematics.moving_tool(q, rate)
            await stream.send(reference.X_BT, now_ns, reference.twist)
            check_within("path", self.link.state.q_meas, q, goal.on_the_way)
            if progress is not None:
                progress(q, rate)
            if time_s >= goal.path.duration_s:
                break
            number = int(time_s / PERIOD_S) + 1
            await self._clock.until(lambda: False, number * PERIOD_S - _NS * (self.link.now_ns - start_ns))
        for _ in range(_STATES):
            await self.link.next_state()


class TopicStreams:
    """Streams that topics feed: one reference a message, none of our own, so that silence is silence.

    A stream is opened by the first message after a pause of its topic: one that goes on after a stop, a fault
    or a refusal moves nothing.
    """

    def __init__(self, drive: ArmDrive) -> None:
        self._drive = drive
        self._stream: ArmStream | None = None
        self._topic = ""
        self._heard_ns: dict[str, int] = {}
        self._last: tuple[Twisted, int] | None = None

    async def servo(self, message: Any) -> None:
        """A PoseStamped: a pose to be at. Raises RequestRefused or LinkLost."""
        await self._feed("servo", message, self._standing)

    async def twist(self, message: Any) -> None:
        """A TwistStamped: how to move. Raises RequestRefused or LinkLost."""
        await self._feed("twist", message, self._moving)

    async def joints(self, message: Any) -> None:
        """A JointState: angles to be at, with or without rates. Raises RequestRefused or LinkLost."""
        await self._feed("joint_commands", message, self._jointed)

    def rearm(self) -> None:
        """Let commands of joints open a stream without a pause: ros2_control never makes one."""
        if self._topic != "joint_commands":
            self._heard_ns.pop("joint_commands", None)

    async def _feed(self, topic: str, message: Any, made: Callable[[Any, int], Twisted]) -> None:
        now_ns = self._drive.link.now_ns
        paused = self._silent(topic, now_ns)
        self._heard_ns[topic] = now_ns
        if not paused and self._topic != topic:
            return  # why its stream ended was said; this message goes on as if it had not
        if self._topic not in ("", topic) and not self._silent(self._topic, now_ns):
            raise refused("stream", f"{topic}: a stream of {self._topic} is open")
        try:
            measured_ns = self._drive.time.measured_ns(message.header.stamp, now_ns)
            if paused:
                self._topic, self._stream, self._last = topic, None, None
            self._last = made(message, measured_ns), measured_ns
            if paused:
                answer = await self._drive.link.command(CommandCode.START_STREAM)
                self._stream = ArmStream(self._drive.link, answer.command_id)
            if self._stream is not None:  # else it is being opened: then the newest is sent
                newest, measured_ns = self._last
                await self._stream.send(newest.X_BT, measured_ns, newest.twist)
        except LongreachError:
            self._topic, self._stream = "", None
            raise

    def _silent(self, topic: str, now_ns: int) -> bool:
        heard_ns = self._heard_ns.get(topic)
        return heard_ns is None or now_ns - heard_ns > PAUSE_NS

    def _standing(self, message: Any, measured_ns: int) -> Twisted:
        X_BT = pose_in_base(message.pose, message.header.frame_id, self._drive.frames())
        return Twisted(X_BT, np.zeros(6))

    def _moving(self, message: Any, measured_ns: int) -> Twisted:
        """From where the twist before has led, at first from where the arm is commanded to be."""
        if self._last is None:
            X_BT = from_pose(self._drive.link.state.X_BT_cmd)
        else:
            (before, then), at_ns = self._last
            X_BT = moved(before, then, _NS * max(0, measured_ns - at_ns))
        frames = self._drive.frames() | {TOOL: X_BT}
        return Twisted(X_BT, twist_in_base(message.twist, message.header.frame_id, frames))

    def _jointed(self, message: Any, measured_ns: int) -> Twisted:
        order = joint_order(message.name)
        if len(message.position) != len(order):
            raise refused("points", f"{len(message.position)} positions for {len(order)} joints")
        q = np.asarray(message.position, dtype=np.float64)[order]
        given = np.asarray(message.velocity, dtype=np.float64)
        rate = given[order] if len(given) == len(order) else np.zeros(len(order))
        if not (np.all(np.isfinite(q)) and np.all(np.isfinite(rate))):
            raise refused("not_finite", f"joints {q.tolist()} at {rate.tolist()} are not all finite")
        return self._drive.kinematics.moving_tool(q, rate)
