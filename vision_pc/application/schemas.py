"""What crosses the REST face: requests with their limits, and results. Every unit is in its key."""

import math
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from vision_pc.application.operations import Operation
from vision_pc.core.calibration.line_equation import LineEquation
from vision_pc.core.calibration.local_calibration import LocalCalibration
from vision_pc.core.calibration.local_error_model import LocalTrack
from vision_pc.core.calibration.orientation import OrientationResult
from vision_pc.core.positioning.corrected_positioning import CorrectedResult
from vision_pc.core.positioning.look_then_move import LookVerdict, PositioningResult, Step
from vision_pc.core.positioning.visual_servoing import Approach
from vision_pc.core.se3 import Array, to_pose
from vision_pc.core.types import Look

Metres = Annotated[float, Field(ge=-10.0, le=10.0)]
Vector = tuple[Metres, Metres, Metres]
Unit = Annotated[float, Field(ge=-1.001, le=1.001)]
JSON = dict[str, Any]


class Body(BaseModel):
    """Base of request bodies: unknown members, NaN and infinity are refused; None means as configured."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    def overrides(self) -> JSON:
        """The members that were given."""
        return self.model_dump(exclude_none=True)


class LookBody(Body):
    """A look: ``frames`` pairs with the arm at rest."""

    frames: int | None = Field(None, ge=1, le=100, examples=[10])


class OrientationBody(Body):
    """Orientation adjustment (7)(8)."""

    form: Literal["frame_true", "paper"] | None = Field(None, examples=["frame_true"])
    repetitions: int | None = Field(None, ge=1, le=5, examples=[1])
    limit_deg: float | None = Field(None, gt=0.0, le=90.0)


class LineEquationBody(Body):
    """Line equation (10)-(16): circle and one input."""

    radius_m: float | None = Field(None, ge=0.02, le=0.6, examples=[0.2])
    points: int | None = Field(None, ge=6, le=24, examples=[18])
    minimum: Literal["sample", "fit"] | None = None


class TrajectoryBody(Body):
    """Trajectory matching (17)-(19) and the match."""

    segments_m: list[Annotated[float, Field(ge=0.01, le=1.5)]] | None = Field(
        None, min_length=2, max_length=23, examples=[[0.30, 0.10, 0.05, 0.30]]
    )
    turn_deg: float | None = Field(None, ge=5.0, le=175.0)
    heading_deg: float | None = Field(None, ge=-180.0, le=180.0)
    placement: Literal["ends_here", "starts_here"] | None = None
    method: Literal["points", "paper"] | None = None
    association: Literal["time", "none"] | None = None


class LocalTrackBody(Body):
    """Three legs along the tool's axes, for the corrected look-then-move."""

    leg_m: float | None = Field(None, ge=0.05, le=0.5, examples=[0.2])


class LookThenMoveBody(Body):
    """Look-then-move (20)-(22). ``method``: by local calibration, or by local map, corrected mid-course."""

    method: Literal["calibrated", "corrected"] = "calibrated"
    inputs: int | None = Field(None, ge=1, le=10, examples=[1])
    clearance_m: float | None = Field(None, ge=0.0, le=1.0, examples=[0.1])
    tolerance_mm: float | None = Field(None, gt=0.0, le=100.0, examples=[5.0])
    aim_mm: float | None = Field(None, ge=0.0, le=100.0, description="No input below this; 0: always one")
    corrections: int | None = Field(None, ge=0, le=10, description="Drives by odometry alone; 0: one shot")

    def overrides(self) -> JSON:
        """The members that were given, as settings."""
        given = self.model_dump(exclude_none=True, exclude={"method", "tolerance_mm", "aim_mm"})
        lengths = {"tolerance_m": self.tolerance_mm, "aim_m": self.aim_mm}
        return given | {name: 1e-3 * value for name, value in lengths.items() if value is not None}


class LookingAndMovingBody(Body):
    """Looking and moving: closed loop at camera rate. Settings left out are as configured."""

    gain: float | None = Field(None, gt=0.0, le=1.0, examples=[0.5])
    pull_gain: float | None = Field(None, ge=0.0, le=1.0)
    clearance_m: float | None = Field(None, ge=0.0, le=1.0, examples=[0.1])
    settle_mm: float | None = Field(None, gt=0.0, le=50.0, examples=[1.0])
    timeout_s: float | None = Field(None, gt=0.0, le=600.0)

    def overrides(self) -> JSON:
        """The members that were given, as settings."""
        given = self.model_dump(exclude_none=True, exclude={"clearance_m", "settle_mm"})
        asked = {} if self.settle_mm is None else {"settle_m": 1e-3 * self.settle_mm, "settle_growth": 0.0}
        return given | asked


class PoseBody(Body):
    """A pose in B."""

    p_m: Vector = Field(examples=[[3.9, 0.0, 1.0]])
    q_wxyz: tuple[Unit, Unit, Unit, Unit] = Field(examples=[[0.5, -0.5, 0.5, -0.5]])

    @model_validator(mode="after")
    def _unit(self) -> "PoseBody":
        norm = math.sqrt(sum(c * c for c in self.q_wxyz))
        if abs(norm - 1.0) > 1e-3:
            raise ValueError(f"q_wxyz has norm {norm:.4f}, must be 1 within 0.001")
        return self


class MoveBody(Body):
    """A point-to-point motion: to ``X_BT``, or by an offset along the axes of base or tool (just one)."""

    X_BT: PoseBody | None = None
    offset_base_m: Vector | None = None
    offset_tool_m: Vector | None = Field(None, examples=[[0.05, 0.0, 0.0]])
    duration_s: float = Field(0.0, ge=0.0, le=60.0)

    @model_validator(mode="after")
    def _one_target(self) -> "MoveBody":
        if sum(t is not None for t in (self.X_BT, self.offset_base_m, self.offset_tool_m)) != 1:
            raise ValueError("exactly one of X_BT, offset_base_m and offset_tool_m is wanted")
        return self


_OPERATION_EXAMPLE: JSON = {
    "id": "5f0c2a9be1d4",
    "kind": "look-then-move",
    "state": "succeeded",
    "progress": 1.0,
    "note": "reached: error +0.5 +0.2 -1.0 mm, inside 5 mm",
    "notes": [[0.0, "looking"], [0.23, "look 1: error -328.8 -65.0 +552.2 mm, outside 5 mm"]],
    "request": {"method": "calibrated", "inputs": 1},
    "created_at": 1.7e9,
    "started_at": 1.7e9,
    "ended_at": 1.700000012e9,
    "result": {
        "error_mm": {"x": 0.47, "y": 0.23, "z": -0.98},
        "std_mm": {"x": 0.2, "y": 0.2, "z": 0.6},
        "tolerance_mm": 5.0,
        "verdict": "inside",
        "certain": True,
        "ended": "reached",
    },
    "problem": None,
}


class OperationView(BaseModel):
    """An operation resource. ``result`` once it has succeeded, ``problem`` (RFC 9457) once it has failed."""

    model_config = ConfigDict(json_schema_extra={"examples": [_OPERATION_EXAMPLE]})

    id: str
    kind: str
    state: Literal["queued", "running", "succeeded", "failed", "cancelled"]
    progress: float = Field(ge=0.0, le=1.0)
    note: str
    notes: list[tuple[float, str]]
    request: JSON
    created_at: float
    started_at: float | None
    ended_at: float | None
    result: JSON | None
    problem: JSON | None


def operation_view(operation: Operation) -> OperationView:
    """The resource of an operation. Times are seconds since 1970."""
    fields = {name: getattr(operation, name) for name in OperationView.model_fields}
    return OperationView.model_validate(
        fields | {"state": operation.state.value, "notes": list(operation.notes)}
    )


def pose_json(X: Array) -> JSON:
    """A pose as position and quaternion."""
    pose = to_pose(X)
    return {"p_m": list(pose.p_m), "q_wxyz": list(pose.q_wxyz)}


def xyz(values: Array, scale: float = 1e3, digits: int = 3) -> JSON:
    """Three numbers by axis, scaled (default: metres to millimetres)."""
    return {axis: round(scale * float(value), digits) for axis, value in zip("xyz", values, strict=True)}


def degrees(values: Array) -> JSON:
    """Three angles by axis in degrees."""
    return xyz(values, math.degrees(1.0), 4)


def verdict_json(verdict: LookVerdict) -> JSON:
    """Error, uncertainty, tolerance and verdict of a look."""
    return {
        "error_mm": xyz(verdict.error_m),
        "std_mm": xyz(verdict.std_m),
        "tolerance_mm": 1e3 * verdict.tolerance_m,
        "clearance_m": verdict.clearance_m,
        "verdict": "inside" if verdict.inside else "outside",
        "certain": verdict.certain,
    }


def look_json(look: Look, verdict: LookVerdict, orientation_error: Array) -> JSON:
    """A look with its verdict."""
    return verdict_json(verdict) | {
        "time_ns": look.time_ns,
        "X_CM": pose_json(look.X_CM),
        "X_CO": pose_json(look.X_CO),
        "X_BT": pose_json(look.X_BT),
        "orientation_error_deg": degrees(orientation_error),
        "frames": look.frames,
        "failed_tool": look.failed_tool,
        "failed_object": look.failed_object,
        "std_tool_mm": xyz(look.std_tool_m),
        "std_object_mm": xyz(look.std_object_m),
        "std_tool_deg": degrees(look.std_tool_rad),
        "std_object_deg": degrees(look.std_object_rad),
        "stereo_offset_px": None if look.offset is None else [look.offset.x_px, look.offset.y_px],
    }


def orientation_json(result: OrientationResult) -> JSON:
    """Euler XYZ errors before and after each input."""
    return {
        "errors_deg": [degrees(e) for e in result.errors],
        "before_deg": degrees(result.errors[0]),
        "after_deg": degrees(result.errors[-1]),
        "inputs": len(result.references),
        "tool_shift_mm": [round(1e3 * shift, 3) for shift in result.tool_shift_m],
    }


def line_equation_json(result: LineEquation) -> JSON:
    """Direction, distance and reference."""
    return {
        "p_u": [float(v) for v in result.p_u],
        "phi_deg": math.degrees(result.phi),
        "distance_mm": 1e3 * result.distance_m,
        "X_BT_ref": pose_json(result.X_BT_ref),
        "samples": result.samples,
        "seen": result.seen,
    }


def calibration_json(calibration: LocalCalibration) -> JSON:
    """Rotation, its uncertainty, and the residuals by the axes of B (Table 3)."""
    return {
        "method": calibration.method,
        "R_BC": [[float(v) for v in row] for row in calibration.R_BC],
        "R_TC": None if calibration.R_TC is None else [[float(v) for v in row] for row in calibration.R_TC],
        "rotation_std_deg": math.degrees(calibration.rotation_std()),
        "residual_mean_mm": xyz(calibration.residuals.mean_m),
        "residual_max_mm": xyz(calibration.residuals.maximum_m),
        "condition": calibration.condition,
        "scale": calibration.scale,
        "samples": calibration.samples,
        "inlier_share": calibration.inlier_share,
        "extent_mm": 1e3 * calibration.extent_m,
    }


def track_json(track: LocalTrack) -> JSON:
    """Size and extent of a local track."""
    spread = np.ptp(track.X_BT[:, :3, 3], axis=0)
    return {"samples": len(track.X_BT), "extent_mm": xyz(spread), "X_BT": pose_json(track.X_BT_now)}


def step_json(step: Step) -> JSON:
    """One input."""
    return {
        "p_lc_mm": xyz(step.p_lc),
        "X_BT_ref": pose_json(step.X_BT_ref),
        "expected_std_mm": xyz(step.expected_std_m),
    }


def positioning_json(result: PositioningResult) -> JSON:
    """All looks and steps, and the last look's verdict."""
    return verdict_json(result.final) | {
        "looks": [verdict_json(look) for look in result.looks],
        "steps": [step_json(step) for step in result.steps],
        "ended": result.ended,
    }


def approach_json(result: Approach) -> JSON:
    """How looking and moving ended."""
    return {
        "error_mm": xyz(result.error_m),
        "spread_mm": xyz(result.spread_m),
        "time_s": round(result.time_s, 3),
        "pictures": result.pictures,
        "missed": result.missed,
    }


def corrected_json(result: CorrectedResult) -> JSON:
    """As look-then-move, with the miss that odometry measured at the end."""
    return positioning_json(result.positioning) | {"measured_miss_mm": xyz(result.measured_miss_m)}
