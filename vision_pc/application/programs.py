"""The table of programs: API routes and bodies, lockstep's dispatcher and the page's table come from it.

A program is one row here and one coroutine; ``docs/how_to/add_a_program.md`` adds one.
"""

from typing import Any

import numpy as np

from protocol.errors import RequestRefused
from protocol.pose import Pose
from vision_pc.application.application import VisionApplication
from vision_pc.application.bodies import (
    HomeBody,
    LookBody,
    LookThenMoveSettings,
    MethodBody,
    MoveBody,
    ServoingSettings,
    SettlingBody,
    TurnSettings,
    body_of,
)
from vision_pc.application.hand_eye_programs import HAND_EYE_PROGRAMS
from vision_pc.application.program import (
    BLIND,
    MOVING,
    STANDING,
    Program,
)
from vision_pc.application.results import (
    JudgedLook,
    LineEquationResult,
    MoveResult,
    ServoingResult,
    calibration_json,
    line_equation_json,
    look_json,
    move_json,
    orientation_json,
    positioning_json,
    servoing_json,
    track_json,
)
from vision_pc.application.visit import VISIT, drive_corrected, new_track
from vision_pc.config.choices import PositioningMethod
from vision_pc.config.programs import (
    LineEquationSettings,
    LocalErrorModelSettings,
    TrajectorySettings,
)
from vision_pc.core.calibration import (
    line_equation,
    local_error_model,
    orientation,
    trajectory_matching,
)
from vision_pc.core.calibration.local_calibration import LocalCalibration
from vision_pc.core.calibration.local_error_model import LocalTrack, camera_in_tool
from vision_pc.core.calibration.orientation import OrientationResult
from vision_pc.core.ports import Report
from vision_pc.core.positioning import look_then_move, visual_servoing
from vision_pc.core.positioning.corrected_positioning import CorrectedResult
from vision_pc.core.positioning.look_then_move import PositioningResult
from vision_pc.core.se3 import Array, from_pose, transform


async def _look(application: VisionApplication, body: LookBody, report: Report) -> JudgedLook:
    report(0.1, "looking")
    await application.eyes.look(body.frames)
    judged = application.latest_look
    if judged.look.misplaced is not None:
        report(1.0, str(judged.look.misplaced))
    return judged


async def _orientation(
    application: VisionApplication, settings: TurnSettings, report: Report
) -> OrientationResult:
    _aim(application, settings.target)
    return await orientation.adjust_orientation(application.arm, application.eyes, report, settings)


async def _line_equation(
    application: VisionApplication, settings: LineEquationSettings, report: Report
) -> LineEquationResult:
    found = await line_equation.line_equation(application.arm, application.eyes, report, settings)
    await application.eyes.look()
    return LineEquationResult(found, application.latest_look)


async def _trajectory(
    application: VisionApplication, settings: TrajectorySettings, report: Report
) -> LocalCalibration:
    """The calibration is kept for look-then-move."""
    application.calibration = await trajectory_matching.trajectory_matching(
        application.arm, application.eyes, report, settings, application.settings.local_map
    )
    if application.calibration.object_stands:
        application.trust("calibration")
    return application.calibration


async def _local_track(
    application: VisionApplication, settings: LocalErrorModelSettings, report: Report
) -> LocalTrack:
    """The track is kept for the corrected look-then-move."""
    application.track = await new_track(application, settings, report)
    return application.track


async def _look_then_move(
    application: VisionApplication, settings: LookThenMoveSettings, report: Report
) -> PositioningResult | CorrectedResult:
    application.positioning = settings
    _aim(application, settings.target)
    if settings.method is PositioningMethod.CORRECTED:
        return await drive_corrected(application, settings, report)
    assert application.calibration is not None  # needed
    ended = await look_then_move.look_then_move(
        application.arm, application.eyes, report, settings, application.calibration
    )
    application.doubt(ended.contradiction)
    return ended


async def _looking_and_moving(
    application: VisionApplication, settings: ServoingSettings, report: Report
) -> ServoingResult:
    """In the camera axes of the local track, or else of the calibration."""
    arm, eyes = application.arm, application.eyes
    _aim(application, settings.target)
    look = await eyes.look()
    if application.track is not None:
        R_TC = camera_in_tool(application.track, look.X_CM[:3, 3])
    elif application.calibration is not None and application.calibration.R_TC is not None:
        R_TC = application.calibration.R_TC
    else:
        raise RequestRefused(
            "refused.not_calibrated", "neither local error model nor calibration of any mount"
        )
    application.track = None  # the arm leaves its end, unwatched by odometry
    approach = await visual_servoing.servo_to_object(arm, eyes, report, settings, settings.clearance_m, R_TC)
    await eyes.look()
    return ServoingResult(approach, application.latest_look)


async def _move(application: VisionApplication, body: MoveBody, report: Report) -> MoveResult:
    report(0.1, "moving")
    X_BT_ref = _target(body, (await application.arm.view()).X_BT)
    view = await application.arm.move_to(X_BT_ref, duration_s=body.duration_s)
    return MoveResult(X_BT_ref, view.X_BT)


async def _home(application: VisionApplication, body: HomeBody, report: Report) -> MoveResult:
    report(0.1, "moving back")
    X_BT_ref = application.controller.home
    assert X_BT_ref is not None  # needed: an enabled arm has been heard
    view = await application.arm.move_to(X_BT_ref, duration_s=body.duration_s)
    return MoveResult(X_BT_ref, view.X_BT)


def _aim(application: VisionApplication, target: str | None) -> None:
    if target is not None:
        application.camera.targets.aim(target)


def _target(body: MoveBody, X_BT: Array) -> Array:
    """X_BT_ref of a move request."""
    R, p = X_BT[:3, :3], X_BT[:3, 3]
    if body.X_BT is not None:
        return from_pose(Pose(body.X_BT.p_m, body.X_BT.q_wxyz))
    if body.offset_base_m is not None:
        return transform(R, p + np.array(body.offset_base_m))
    return transform(R, p + R @ np.array(body.offset_tool_m))


def calibration_of_the_method(
    application: VisionApplication, name: str, settings: LookThenMoveSettings
) -> None:
    """A local track, or with ``method: paper`` a local calibration."""
    if settings.method is PositioningMethod.CORRECTED:
        if application.track is None:
            raise RequestRefused(
                "refused.not_calibrated", "no local error model yet: run local calibration by odometry first"
            )
    elif application.calibration is None:
        why = "no local calibration yet: run that by trajectory matching first"
        raise RequestRefused("refused.not_calibrated", why)


def known_target(
    application: VisionApplication,
    name: str,
    settings: TurnSettings | LookThenMoveSettings | ServoingSettings,
) -> None:
    """The target that is named, if one is."""
    if settings.target is not None:
        application.camera.targets.refuse_unknown(settings.target)


def camera_axes(application: VisionApplication, name: str, settings: Any) -> None:
    """A local track or a local calibration."""
    if application.track is None and application.calibration is None:
        why = "no camera axes yet: run a local calibration first"
        raise RequestRefused("refused.not_calibrated", why)


PROGRAMS: tuple[Program[Any, Any], ...] = (
    Program(
        "look",
        "Look at tool and object with the arm at rest",
        run=_look,
        to_json=look_json,
        body=LookBody,
        needs=STANDING,
    ),
    Program(
        "orientation-adjustment",
        "Turn the tool parallel to the object (7)(8)",
        run=_orientation,
        to_json=orientation_json,
        body=body_of(TurnSettings, "form", "repetitions", "limit_deg", "target"),
        settings=lambda application: TurnSettings(**application.settings.orientation.model_dump()),
        needs=(*MOVING, known_target),
        core=orientation.adjust_orientation,
        source="Mäkinen et al. 2023, 3.1, (7)(8)",
    ),
    Program(
        "line-equation",
        "Circle, line equation, one input (10)-(16)",
        run=_line_equation,
        to_json=line_equation_json,
        body=body_of(LineEquationSettings, "radius_m", "points", "minimum"),
        settings=lambda application: application.settings.line_equation,
        core=line_equation.line_equation,
        source="Mäkinen et al. 2023, 3.2.1, (9)-(16)",
    ),
    Program(
        "trajectory-matching",
        "Local calibration by trajectory matching (17)-(19)",
        run=_trajectory,
        to_json=calibration_json,
        body=body_of(
            TrajectorySettings,
            *("segments_m", "turn_deg", "heading_deg", "placement", "method", "association"),
        ),
        settings=lambda application: application.settings.trajectory,
        core=trajectory_matching.trajectory_matching,
        source="Mäkinen et al. 2023, 3.2.2, (17)-(20), hybrid mixture model",
    ),
    Program(
        "local-track",
        "Local calibration by odometry, on three legs",
        run=_local_track,
        to_json=track_json,
        body=body_of(LocalErrorModelSettings, "leg_m"),
        settings=lambda application: application.settings.local_map,
        core=local_error_model.record_local_track,
        source="local error model (below)",
    ),
    Program(
        "look-then-move",
        "Look, then move the tool to the object (20)-(22)",
        run=_look_then_move,
        to_json=positioning_json,
        body=body_of(
            LookThenMoveSettings,
            *("clearance_m", "tolerance_mm", "corrections", "target", "inputs", "aim_mm"),
            base=MethodBody,
        ),
        settings=lambda application: LookThenMoveSettings(**application.settings.positioning.model_dump()),
        needs=(*MOVING, calibration_of_the_method, known_target),
        core=look_then_move.look_then_move,
        source="Mäkinen et al. 2023, (20)-(22); `corrected_positioning.py`: corrected positioning (below)",
    ),
    Program(
        "looking-and-moving",
        "Drive the tool to the object in closed loop, at camera rate",
        run=_looking_and_moving,
        to_json=servoing_json,
        body=body_of(
            ServoingSettings,
            *("gain", "pull_gain", "clearance_m", "settle_mm", "timeout_s", "target"),
            base=SettlingBody,
        ),
        settings=lambda application: ServoingSettings(
            clearance_m=application.settings.positioning.clearance_m,
            **application.settings.looking_and_moving.model_dump(),
        ),
        needs=(*MOVING, camera_axes, known_target),
        core=visual_servoing.servo_to_object,
        source="Mäkinen et al. 2023, section 6, names it as possible",
    ),
    Program(
        "move",
        "Move the tool point to point",
        run=_move,
        to_json=move_json,
        body=MoveBody,
        needs=BLIND,
    ),
    Program(
        "home",
        "Move the tool back to where it stood when the machine was first heard",
        run=_home,
        to_json=move_json,
        body=HomeBody,
        needs=BLIND,
    ),
    VISIT,
    *HAND_EYE_PROGRAMS,
)
