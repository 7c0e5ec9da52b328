"""The node that stands where the vision PC stands: topics, services and the action, over ``ArmDrive``."""

import asyncio
from collections.abc import Callable, Coroutine
from concurrent.futures import CancelledError
from functools import partial
from typing import Any

from control_msgs.action import FollowJointTrajectory
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped, TwistStamped
from nav_msgs.msg import Path
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from longreach_ros2.drive import ArmDrive, TopicStreams
from longreach_ros2.kinematics import BASE, Array
from longreach_ros2.ros_messages import DEPTH, chain, joint_state, pose_stamped
from longreach_ros2.status import SUCCESSFUL, GoalOutcome, code_of, diagnosis, news_of
from nominal_arm.description import JOINT_NAMES
from protocol.errors import LongreachError
from protocol.faults import CommandCode
from protocol.reference_messages import State
from protocol.session_events import StateReceived

NAME = "longreach"
CONTROLLER = "arm_controller"  # as MoveIt and ros2_control name such things
_ACTION = f"{CONTROLLER}/follow_joint_trajectory"
_COMMANDS = ("enable", "disable", "stop", "reset")
_FEEDBACK_EVERY = 5  # references
_STATUS_S = 1.0
_LOOK_S = 0.02  # after a client that cancels, or has gone
_ANSWER_S = 5.0
_CANCELLED = "cancelled: the arm is stopped"


class DriveNode(Node):  # type: ignore[misc]
    """Callbacks in the executor's threads hand all work to ``loop``; states are published from there."""

    def __init__(self, loop: asyncio.AbstractEventLoop, drive: ArmDrive, hardware: str, tf: bool) -> None:
        super().__init__(NAME)
        self._loop, self._drive, self._hardware = loop, drive, hardware
        self._streams = TopicStreams(drive)
        self._news: tuple[int, ...] = ()
        self._together = ReentrantCallbackGroup()
        self._joint_states = self.create_publisher(JointState, "joint_states", DEPTH)
        self._tool_pose = self.create_publisher(PoseStamped, "~/tool_pose", DEPTH)
        self._tf = self.create_publisher(TFMessage, "/tf", DEPTH) if tf else None
        self._status = self.create_publisher(DiagnosticArray, "/diagnostics", DEPTH)
        self._listen(PoseStamped, "~/target", drive.go_to)
        self._listen(Path, "~/path", drive.go_along)
        self._listen(PoseStamped, "~/servo", self._streams.servo)
        self._listen(TwistStamped, "~/twist", self._streams.twist)
        self._listen(JointState, "~/joint_commands", self._streams.joints)
        self._listen(JointTrajectory, f"{CONTROLLER}/joint_trajectory", self._follow_unanswered)
        for name in _COMMANDS:
            serve = partial(self._commanded, CommandCode[name.upper()])
            self.create_service(Trigger, f"~/{name}", serve, callback_group=self._together)
        self._action = ActionServer(
            self,
            FollowJointTrajectory,
            _ACTION,
            self._followed,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=self._together,
        )
        self.create_timer(_STATUS_S, self._publish_status)
        drive.link.listeners.append(self._heard)

    def _listen(self, kind: type, topic: str, act: Callable[[Any], Coroutine[Any, Any, None]]) -> None:
        async def acted(message: Any) -> None:
            try:
                await act(message)
            except LongreachError as error:
                self._drive.refusals.note(topic, error)
                self.get_logger().warning(f"{topic}: {error.cause}: {error}")
                self._publish_status()

        def received(message: Any) -> None:
            asyncio.run_coroutine_threadsafe(acted(message), self._loop)

        self.create_subscription(kind, topic, received, DEPTH)

    def _commanded(self, code: CommandCode, _: Any, response: Any) -> Any:
        future = asyncio.run_coroutine_threadsafe(self._drive.command(code), self._loop)
        try:
            response.message = future.result(_ANSWER_S)
            response.success = True
        except (LongreachError, TimeoutError) as error:
            response.message = str(error) or f"no answer within {_ANSWER_S:g} s"
        if response.success and code is CommandCode.ENABLE:
            self._loop.call_soon_threadsafe(self._streams.rearm)
        return response

    async def _follow_unanswered(self, message: Any) -> None:
        await self._drive.follow(self._drive.goal_of(message))

    def _followed(self, handle: ServerGoalHandle) -> Any:
        """In a thread of the executor, which waits for the motion."""
        try:
            outcome = asyncio.run_coroutine_threadsafe(self._outcome(handle), self._loop).result()
        except CancelledError:
            outcome = GoalOutcome(code_of(""), "the node has ended: the arm is stopped")
        if outcome.cancelled:
            handle.canceled()
        elif outcome.code == SUCCESSFUL:
            handle.succeed()
        else:
            handle.abort()
        return FollowJointTrajectory.Result(error_code=outcome.code, error_string=outcome.text)

    async def _outcome(self, handle: ServerGoalHandle) -> GoalOutcome:
        task = asyncio.ensure_future(self._follow_with_feedback(handle))
        attended = False
        while not task.done():
            clients = self.count_subscribers(f"{_ACTION}/_action/feedback")
            if handle.is_cancel_requested or (attended and not clients):
                task.cancel()
            attended |= clients > 0
            await asyncio.wait([task], timeout=_LOOK_S)
        if task.cancelled():
            return GoalOutcome(SUCCESSFUL, _CANCELLED, cancelled=True)
        error = task.exception()
        if isinstance(error, LongreachError):
            return GoalOutcome(code_of(error.cause), f"{error.cause}: {error}")
        if error is not None:
            raise error
        return GoalOutcome(SUCCESSFUL, "")

    async def _follow_with_feedback(self, handle: ServerGoalHandle) -> None:
        count = 0

        def progress(q: Array, rate: Array) -> None:
            nonlocal count
            if count % _FEEDBACK_EVERY == 0:
                handle.publish_feedback(self._feedback(q, rate))
            count += 1

        await self._drive.follow(self._drive.goal_of(handle.request), progress)

    def _feedback(self, q: Array, rate: Array) -> Any:
        measured = self._drive.link.state.q_meas
        feedback = FollowJointTrajectory.Feedback(joint_names=list(JOINT_NAMES))
        feedback.desired = JointTrajectoryPoint(positions=q.tolist(), velocities=rate.tolist())
        feedback.actual = JointTrajectoryPoint(positions=list(measured))
        feedback.error = JointTrajectoryPoint(positions=(q - measured).tolist())
        return feedback

    def _heard(self, event: object) -> None:
        if isinstance(event, StateReceived):
            self._publish(event.state)
            if (news := news_of(event.state)) != self._news:
                self._news = news
                self._publish_status()

    def _publish(self, state: State) -> None:
        stamp = self._drive.time.of(self._drive.link.local_time_ns(state.time_ns))
        self._joint_states.publish(joint_state(state.q_meas, stamp))
        self._tool_pose.publish(pose_stamped(state.X_BT, BASE, stamp))
        if self._tf is not None:
            self._tf.publish(chain(self._drive.kinematics.frames(state.q_meas), stamp))

    def _publish_status(self) -> None:
        level, message, values = diagnosis(self._drive.link, self._drive.refusals)
        status = DiagnosticStatus(level=bytes([level]), name=f"{NAME}: arm", message=message)
        status.hardware_id = self._hardware
        status.values = [KeyValue(key=key, value=value) for key, value in values.items()]
        array = DiagnosticArray(status=[status])
        array.header.stamp.sec, array.header.stamp.nanosec = self._drive.time.of(self._drive.link.now_ns)
        self._status.publish(array)
