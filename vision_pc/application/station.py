"""The station: arm, eyes, controller and camera put together, what they have found out, and the programs.

Every program of the REST face is a method here that takes its settings and a report, and returns JSON.
Before an operation begins, ``refuse_now`` says whether the present state forbids it.
"""

from contextlib import AbstractAsyncContextManager
from typing import NamedTuple, Protocol

import numpy as np

from protocol.channel import LinkStatistics
from protocol.clock_offset import OffsetEstimate
from protocol.errors import LinkLost, RequestRefused
from protocol.faults import CommandCode, FaultCode, GroupState
from protocol.pose import Pose
from protocol.reference_messages import FLAG_EMERGENCY_LATCHED, Acknowledgement, State
from vision_pc.application.schemas import (
    JSON,
    MoveBody,
    approach_json,
    calibration_json,
    corrected_json,
    line_equation_json,
    look_json,
    orientation_json,
    pose_json,
    positioning_json,
    track_json,
)
from vision_pc.config.programs import (
    LineEquationSettings,
    LocalMapSettings,
    LookingAndMovingSettings,
    OrientationSettings,
    PositioningSettings,
    ProgramSettings,
    TrajectorySettings,
)
from vision_pc.core.calibration.line_equation import line_equation
from vision_pc.core.calibration.local_calibration import LocalCalibration
from vision_pc.core.calibration.local_error_model import LocalTrack, camera_in_tool, record_local_track
from vision_pc.core.calibration.orientation import adjust_orientation, orientation_error
from vision_pc.core.calibration.trajectory_matching import trajectory_matching
from vision_pc.core.ports import Arm, Eyes, Report, Watch
from vision_pc.core.positioning.corrected_positioning import look_then_move_corrected
from vision_pc.core.positioning.look_then_move import LookVerdict, judge, look_then_move
from vision_pc.core.positioning.visual_servoing import look_and_move
from vision_pc.core.se3 import Array, from_pose, transform
from vision_pc.core.types import Look
from vision_pc.shell.event_log import EventLog


class Controller(Protocol):
    """The controller as the REST face sees it; ``ReferenceLink`` implements it."""

    @property
    def connected(self) -> bool: ...
    @property
    def state(self) -> State: ...
    @property
    def state_age_ns(self) -> int: ...
    @property
    def clock_offset(self) -> OffsetEstimate | None: ...
    @property
    def authenticated(self) -> bool: ...
    @property
    def statistics(self) -> LinkStatistics: ...
    async def command(self, code: CommandCode) -> Acknowledgement: ...
    async def next_state(self) -> State: ...


class StoppableArm(Arm, Protocol):
    """An arm that can be halted after an operation ended early."""

    async def halt(self) -> None: ...


class CameraStatus(NamedTuple):
    """Whether fresh pairs come, and how; ``trouble`` is the cause when they do not."""

    connected: bool
    age_ms: float | None
    frames: int
    rate_hz: float
    dropped: int = 0
    reconnects: int = 0
    trouble: str | None = None


class Camera(Protocol):
    """The camera as the REST face sees it."""

    def status(self) -> CameraStatus: ...
    async def latest_png(self) -> bytes: ...


class LatestLook(NamedTuple):
    """The newest look of any program, with its verdict."""

    look: Look
    verdict: LookVerdict


class RememberingEyes:
    """Eyes that hand every look on to ``remember`` before the program gets it."""

    def __init__(self, eyes: Eyes, station: "Station") -> None:
        self._eyes = eyes
        self._station = station

    async def look(self, frames: int | None = None) -> Look:
        """A look, remembered."""
        look = await self._eyes.look(frames)
        self._station.remember(look)
        return look

    def watch(self, *, markers: bool, odometry: bool) -> AbstractAsyncContextManager[Watch]:
        """A watch, as it is."""
        return self._eyes.watch(markers=markers, odometry=odometry)


class Station:
    """One rig and what it has learned since the service started."""

    def __init__(
        self,
        arm: StoppableArm,
        eyes: Eyes,
        controller: Controller,
        camera: Camera,
        settings: ProgramSettings,
        log: EventLog,
    ) -> None:
        self.arm = arm
        self.eyes = RememberingEyes(eyes, self)
        self.controller = controller
        self.camera = camera
        self.settings = settings
        self.log = log
        self.calibration: LocalCalibration | None = None
        self.track: LocalTrack | None = None
        self._latest: LatestLook | None = None
        self._positioning = settings.positioning

    def remember(self, look: Look) -> None:
        """Makes ``look`` the latest one and logs it."""
        self._latest = LatestLook(look, judge(look, self._positioning))
        self.log.write("look", **self.latest_look())

    def latest_look(self) -> JSON:
        """The latest look. Raises RequestRefused (``refused.no_look_yet``)."""
        if self._latest is None:
            raise RequestRefused("refused.no_look_yet", "nothing was looked at since the service started")
        look, verdict = self._latest
        return look_json(look, verdict, orientation_error(look))

    def refuse_now(self, kind: str, method: str | None = None) -> None:
        """Raises RequestRefused or LinkLost when operation ``kind`` cannot begin in the present state."""
        state = self.controller.state
        camera = self.camera.status()
        if kind != "move" and not camera.connected:
            raise LinkLost(camera.trouble or "link.camera_silent", "no fresh pictures from the camera")
        if state.group_state is GroupState.MOVING:
            raise RequestRefused("refused.moving", f"{kind}: the arm is moving")
        if kind != "look":
            refuse_motion(kind, state)
            if not self.log.healthy:
                raise RequestRefused("refused.recording_failed", f"{kind}: events can no longer be recorded")
        if method == "calibrated" and self.calibration is None:
            why = "no local calibration yet: run trajectory-matching first"
            raise RequestRefused("refused.not_calibrated", why)
        if kind == "looking-and-moving" and self.track is None and self.calibration is None:
            why = "no camera axes yet: run local-track or trajectory-matching first"
            raise RequestRefused("refused.not_calibrated", why)
        if method == "corrected" and self.track is None:
            raise RequestRefused("refused.not_calibrated", "no local track yet: run local-track first")

    async def look(self, frames: int | None, report: Report) -> JSON:
        """A look."""
        report(0.1, "looking")
        await self.eyes.look(frames)
        return self.latest_look()

    async def adjust_orientation(self, settings: OrientationSettings, report: Report) -> JSON:
        """Orientation adjustment."""
        return orientation_json(await adjust_orientation(self.arm, self.eyes, report, settings))

    async def line_equation(self, settings: LineEquationSettings, report: Report) -> JSON:
        """Line equation, its one input, and a look at the result."""
        result = await line_equation(self.arm, self.eyes, report, settings)
        await self.eyes.look()
        return line_equation_json(result) | {"look": self.latest_look()}

    async def trajectory_matching(self, settings: TrajectorySettings, report: Report) -> JSON:
        """Trajectory matching; the calibration is kept for look-then-move."""
        self.calibration = await trajectory_matching(self.arm, self.eyes, report, settings)
        return calibration_json(self.calibration)

    async def local_track(self, settings: LocalMapSettings, report: Report) -> JSON:
        """The local track for the corrected look-then-move."""
        self.track = await record_local_track(self.arm, self.eyes, report, settings)
        return track_json(self.track)

    async def look_then_move(self, settings: PositioningSettings, method: str, report: Report) -> JSON:
        """Look-then-move with what was calibrated last."""
        self._positioning = settings
        if method == "corrected" and self.track is not None:
            track, self.track = self.track, None  # a drive that fails leaves a gap in it
            result = await look_then_move_corrected(
                self.arm, self.eyes, report, settings, self.settings.local_map, track
            )
            self.track = result.track
            return corrected_json(result)
        if self.calibration is None:
            raise RequestRefused("refused.not_calibrated", "no local calibration yet")
        return positioning_json(await look_then_move(self.arm, self.eyes, report, settings, self.calibration))

    async def looking_and_moving(
        self, settings: LookingAndMovingSettings, clearance_m: float, report: Report
    ) -> JSON:
        """Looking and moving in the axes of the local track, or else of the calibration; then a look."""
        look = await self.eyes.look()
        if self.track is not None:
            R_TC = camera_in_tool(self.track, look.X_CM[:3, 3])
        elif self.calibration is not None and self.calibration.R_TC is not None:
            R_TC = self.calibration.R_TC
        else:
            raise RequestRefused("refused.not_calibrated", "neither local track nor calibration of any mount")
        self.track = None  # the arm leaves its end, unwatched by odometry
        approach = await look_and_move(self.arm, self.eyes, report, settings, clearance_m, R_TC)
        await self.eyes.look()
        return approach_json(approach) | {"look": self.latest_look()}

    async def move(self, body: MoveBody, report: Report) -> JSON:
        """A point-to-point motion."""
        report(0.1, "moving")
        target = _target(body, (await self.arm.view()).X_BT)
        view = await self.arm.move_to(target, duration_s=body.duration_s)
        miss = 1e3 * float(np.linalg.norm(view.X_BT[:3, 3] - target[:3, 3]))
        return {"X_BT_ref": pose_json(target), "X_BT": pose_json(view.X_BT), "miss_mm": round(miss, 3)}


def refuse_motion(kind: str, state: State) -> None:
    """Raises RequestRefused when the group is in no state to move."""
    if state.flags & FLAG_EMERGENCY_LATCHED:
        raise RequestRefused("refused.emergency_latched", f"{kind}: the emergency stop is latched")
    if state.group_state is GroupState.ERROR_STOP:
        fault = "" if state.fault is FaultCode.NONE else f" ({state.fault.name.lower()})"
        raise RequestRefused("refused.error_latched", f"{kind}: a fault is latched{fault}; reset first")
    if state.group_state is GroupState.DISABLED:
        raise RequestRefused("refused.disabled", f"{kind}: the arm is disabled; enable first")
    if state.group_state is GroupState.STOPPING:
        raise RequestRefused("refused.stopping", f"{kind}: the arm is stopping")


def _target(body: MoveBody, X_BT: Array) -> Array:
    """X_BT_ref of a move request."""
    R, p = X_BT[:3, :3], X_BT[:3, 3]
    if body.X_BT is not None:
        return from_pose(Pose(body.X_BT.p_m, body.X_BT.q_wxyz))
    if body.offset_base_m is not None:
        return transform(R, p + np.array(body.offset_base_m))
    return transform(R, p + R @ np.array(body.offset_tool_m))
