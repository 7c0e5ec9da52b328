"""The arm over the reference link: the ``Arm`` port that calibration programs drive."""

import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import AbstractAsyncContextManager

import numpy as np

from protocol.errors import LinkLost, MotionUnsettled, RequestRefused
from protocol.faults import CommandCode, GroupState
from protocol.reference_messages import (
    FLAG_SETTLED,
    FLAG_STREAMING,
    ReferencePath,
    ReferencePose,
    State,
    StreamedPose,
)
from vision_pc.application.camera_eyes import CameraEyes
from vision_pc.application.ports import StoppableArm
from vision_pc.application.reference_link import ReferenceLink
from vision_pc.config.vision import MotionSettings
from vision_pc.core.ports import ArmView, Eyes, ReferenceStream
from vision_pc.core.se3 import Array, from_pose, to_pose

_NUMBERS = 1 << 32


class ArmStream:
    """Implements ``vision_pc.core.ports.ReferenceStream``; nothing here waits."""

    def __init__(self, link: ReferenceLink, stream_id: int) -> None:
        self.stream_id = stream_id
        self._link = link
        self._sent = 0
        self._begun = False

    async def send(
        self, X_BT_ref: Array, measured_ns: int | None = None, twist_ref: Array | None = None
    ) -> None:
        """Send one reference. Raises as the port says."""
        self.check()
        self._sent = (self._sent + 1) % _NUMBERS
        twist = np.zeros(6) if twist_ref is None else np.asarray(twist_ref, dtype=float)
        a, b, c, d, e, f = twist.tolist()
        time_ns = self._link.now_ns if measured_ns is None else measured_ns
        self._link.stream(
            StreamedPose(self.stream_id, self._sent, time_ns, to_pose(X_BT_ref), (a, b, c, d, e, f))
        )

    async def view(self) -> ArmView:
        """The newest view. Raises as the port says."""
        self.check()
        return view_of(self._link.state, self._link)

    def check(self) -> None:
        """Raise RequestRefused when the stream is closed or one of its references was refused.

        A state that does not name the stream's motion was under way when the stream was opened.
        """
        refused = self._link.refusal_of(self.stream_id)
        state = self._link.state
        self._begun |= state.motion_id == self.stream_id
        if self._begun:
            refuse_broken(state)
            if not state.flags & FLAG_STREAMING or state.motion_id != self.stream_id:
                raise RequestRefused("refused.not_streaming", "the controller has ended the stream")
        if refused is not None:
            what = f"streamed reference {refused.number}"
            raise self._link.refused(what, refused.reason, refused.value, refused.limit)


def refuse_broken(state: State) -> None:
    """Raises RequestRefused when the group is not in a state in which a motion goes on."""
    fault = state.fault.name.lower()
    ended = {
        GroupState.ERROR_STOP: (f"fault_{fault}", f"the motion ended by a fault: {fault.replace('_', ' ')}"),
        GroupState.DISABLED: ("disabled", "the arm is disabled"),
        GroupState.STOPPING: ("stopped", "the motion was stopped"),
    }.get(state.group_state)
    if ended is not None:
        raise RequestRefused(f"refused.{ended[0]}", ended[1])


def view_of(state: State, link: ReferenceLink) -> ArmView:
    """A state of the link as programs see it, on our clock."""
    return ArmView(
        time_ns=link.local_time_ns(state.time_ns),
        group_state=state.group_state,
        fault=state.fault,
        severity=state.severity,
        motion_id=state.motion_id,
        motion_done=state.motion_done,
        settled=bool(state.flags & FLAG_SETTLED),
        q_meas=np.array(state.q_meas),
        q_cmd=np.array(state.q_cmd),
        X_BT=from_pose(state.X_BT),
        X_BT_cmd=from_pose(state.X_BT_cmd),
    )


_NOISE_NS = 100_000_000  # of an encoder's digits; no arm goes to and fro faster than five times a second
_CREEPS_RAD = 5e-4  # at most: friction lets go of 0.3 to 0.6 mrad, most of it before the later half
_BEGIN_STATES = 50  # states after the acknowledgement by which the motion must have begun


class LinkArm:
    """Implements ``vision_pc.core.ports.Arm``. Every motion returns at rest, or raises."""

    def __init__(self, link: ReferenceLink, settings: MotionSettings) -> None:
        self._link = link
        self._settings = settings

    async def view(self) -> ArmView:
        """The newest view. Raises LinkLost."""
        return view_of(self._link.state, self._link)

    async def move_to(self, X_BT_ref: Array, duration_s: float = 0.0) -> ArmView:
        """The view after the point-to-point motion has settled. Raises RequestRefused or LinkLost."""
        answer = await self._link.request(ReferencePose(0, to_pose(X_BT_ref), duration_s))
        return await self._finished(answer.command_id)

    async def follow(
        self, waypoints: Sequence[Array], segment_s: float = 0.0, dwell_s: float = 0.0
    ) -> ArmView:
        """The view after the path has settled. Raises RequestRefused or LinkLost."""
        poses = tuple(to_pose(X) for X in waypoints)
        answer = await self._link.request(ReferencePath(0, poses, segment_s, dwell_s))
        return await self._finished(answer.command_id)

    @contextlib.asynccontextmanager
    async def streaming(self) -> AsyncIterator[ArmStream]:
        """A context in which references are streamed; its exit returns at rest. Raises as the port says."""
        answer = await self._link.command(CommandCode.START_STREAM)
        stream = ArmStream(self._link, answer.command_id)
        try:
            yield stream
            stream.check()
            await self._link.command(CommandCode.END_STREAM)
        except BaseException:
            with contextlib.suppress(LinkLost):
                await self.stop()
            raise
        await self._finished(stream.stream_id)

    async def stop(self) -> None:
        """Stop the arm. Returns when the controller has accepted the stop. Raises LinkLost."""
        await self._link.command(CommandCode.STOP)

    async def halt(self) -> None:
        """Stops the arm, also where the newest state shows it at rest: a motion may be on its way to it."""
        if self._link.connected:
            await self.stop()

    async def _finished(self, command_id: int) -> ArmView:
        """The view once motion ``command_id`` is done, settled and has rested.

        Raises RequestRefused when it was stopped, overtaken or ended by a fault; MotionUnsettled
        (``motion.not_settled``) when it is done but keeps moving.
        """
        begun = False
        waited = 0
        done: list[State] = []
        while True:
            state = await self._link.next_state()
            refuse_broken(state)
            if state.motion_id != command_id:
                waited += 1
                if begun or waited > _BEGIN_STATES:
                    raise RequestRefused(
                        "refused.overtaken", f"motion {command_id} gave way to {state.motion_id}"
                    )
                continue
            begun = True
            if not state.motion_done:
                continue
            done.append(state)
            if state.flags & FLAG_SETTLED:
                return view_of((await self._states_at_rest(state.time_ns))[-1], self._link)
            if state.time_ns - done[0].time_ns > self._settings.settle_timeout_s * 1e9:
                rested = await self._states_at_rest(state.time_ns)
                view = view_of(self._still(rested), self._link)
                return view._replace(unrest=_to_and_fro(done[len(done) // 2 :] + rested))

    async def _states_at_rest(self, from_ns: int) -> list[State]:
        """The states while the arm rests; by the controller's clock, so that lockstep can use it too."""
        states = []
        while True:
            states.append(await self._link.next_state())
            refuse_broken(states[-1])
            if states[-1].time_ns - from_ns >= self._settings.rest_s * 1e9:
                return states

    def _still(self, states: list[State]) -> State:
        """The last of ``states``, through which no encoder moved. Raises MotionUnsettled."""
        moved_mrad = 1e3 * float(np.ptp([state.q_meas for state in states], axis=0).max())
        if moved_mrad > self._settings.still_mrad:
            raise MotionUnsettled(
                "motion.not_settled",
                f"arm still moves by {moved_mrad:.2f} mrad, limit {self._settings.still_mrad:g} mrad, "
                f"{self._settings.settle_timeout_s:g} s after its motion",
            )
        return states[-1]


def _to_and_fro(states: list[State]) -> Array:
    """How far (6,) rad each encoder went to and fro in ``states``, of when the motion had died away.

    The smaller of its farthest rise and its farthest fall, of means that leave little of its noise: a joint
    that creeps goes one way, and where it stands is known when it is looked at. One that went farther than
    joints creep may be on its way back later.
    """
    slots = np.array([(state.time_ns - states[0].time_ns) // _NOISE_NS for state in states])
    angles = np.array([state.q_meas for state in states])
    q = np.array([angles[slots == slot].mean(axis=0) for slot in np.unique(slots)])
    rise = (q - np.minimum.accumulate(q)).max(axis=0)
    fall = (np.maximum.accumulate(q) - q).max(axis=0)
    way = np.ptp(q, axis=0)
    return np.asarray(np.where(way > _CREEPS_RAD, way, np.minimum(rise, fall)))


class CarryingArm:
    """Implements ``StoppableArm``: an arm whose motions odometry watches while targets are kept.

    Without targets, or within a watch, it is the arm itself.
    ``motions``: how many were asked for.
    """

    def __init__(self, arm: StoppableArm, eyes: Eyes, camera: CameraEyes) -> None:
        self._arm = arm
        self._eyes = eyes
        self.motions = 0
        self._camera = camera

    async def view(self) -> ArmView:
        """As the arm's."""
        return await self._arm.view()

    async def move_to(self, X_BT_ref: Array, duration_s: float = 0.0) -> ArmView:
        """As the arm's, watched."""
        return await self._move_watched(lambda: self._arm.move_to(X_BT_ref, duration_s=duration_s))

    async def follow(
        self, waypoints: Sequence[Array], segment_s: float = 0.0, dwell_s: float = 0.0
    ) -> ArmView:
        """As the arm's, watched."""
        return await self._move_watched(
            lambda: self._arm.follow(waypoints, segment_s=segment_s, dwell_s=dwell_s)
        )

    def streaming(self) -> AbstractAsyncContextManager[ReferenceStream]:
        """As the arm's: whoever streams watches for himself."""
        self.motions += 1
        return self._arm.streaming()

    async def stop(self) -> None:
        """As the arm's."""
        await self._arm.stop()

    async def halt(self) -> None:
        """As the arm's."""
        await self._arm.halt()

    async def _move_watched(self, move: Callable[[], Awaitable[ArmView]]) -> ArmView:
        self.motions += 1
        if not self._camera.carries:
            return await move()
        async with self._eyes.watch(markers=False, odometry=True):
            return await move()
