"""What programs return, and its form at the boundaries (API, event logs): mm and degrees, units in the keys.

Only the boundaries call the ``…_json`` functions.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from vision_pc.application.ports import Seen
from vision_pc.core.calibration.line_equation import LineEquation
from vision_pc.core.calibration.local_calibration import LocalCalibration
from vision_pc.core.calibration.local_error_model import LocalTrack
from vision_pc.core.calibration.orientation import OrientationResult, orientation_error
from vision_pc.core.positioning.corrected_positioning import CorrectedResult
from vision_pc.core.positioning.expected_end import ExpectedEnd
from vision_pc.core.positioning.look_then_move import LookVerdict, PositioningResult, Step
from vision_pc.core.positioning.visual_servoing import Convergence
from vision_pc.core.se3 import Array, to_pose
from vision_pc.core.types import Contradiction, Look, MisplacedMarker

JSON = dict[str, Any]


class JudgedLook(NamedTuple):
    """A look with its verdict; a console shows the line."""

    look: Look
    verdict: LookVerdict

    def __repr__(self) -> str:
        errors = zip("xyz", 1e3 * self.verdict.error_m, 1e3 * self.verdict.std_m, strict=True)
        summary = ", ".join(f"{axis} {error:+.2f} ± {std:.2f}" for axis, error, std in errors)
        where = "inside" if self.verdict.inside else "outside"
        limit = f"±{1e3 * self.verdict.tolerance_m:g} mm in x and y"
        return f"<look of {self.look.frames} frames: {summary} mm, {where} {limit}>"


class LineEquationResult(NamedTuple):
    """The line equation, and a look after its one input."""

    equation: LineEquation
    look: JudgedLook


class ServoingResult(NamedTuple):
    """How visual servoing ended, and a look after it."""

    approach: Convergence
    look: JudgedLook


class MoveResult(NamedTuple):
    """The commanded and the reached pose of a point-to-point motion."""

    X_BT_ref: Array
    X_BT: Array

    @property
    def miss_m(self) -> float:
        """Distance between the two, m."""
        return float(np.linalg.norm(self.X_BT[:3, 3] - self.X_BT_ref[:3, 3]))


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


def look_json(judged: JudgedLook) -> JSON:
    """A look with its verdict."""
    look, verdict = judged
    return verdict_json(verdict) | {
        "time_ns": look.time_ns,
        "X_CM": pose_json(look.X_CM),
        "X_CO": pose_json(look.X_CO),
        "X_BT": pose_json(look.X_BT),
        "orientation_error_deg": degrees(orientation_error(look)),
        "frames": look.frames,
        "failed_tool": look.failed_tool,
        "failed_object": look.failed_object,
        "std_tool_mm": xyz(look.std_tool_m),
        "std_object_mm": xyz(look.std_object_m),
        "std_tool_deg": degrees(look.std_tool_rad),
        "std_object_deg": degrees(look.std_object_rad),
        "stereo_offset_px": None if look.offset is None else [look.offset.x_px, look.offset.y_px],
        "misplaced_marker": misplaced_json(look.misplaced),
        "doubt": doubt_json(look.doubt),
    }


def misplaced_json(marker: MisplacedMarker | None) -> JSON | None:
    """The marker whose place in markers.object the others contradict, by how much, and what to do."""
    if marker is None:
        return None
    off, std = ({axis: round(1e3 * float(v), 3) for axis, v in zip("xy", values, strict=True)}
                for values in (marker.off_m, marker.std_m))  # fmt: skip
    return {"id": marker.marker_id, "off_mm": off, "std_mm": std, "detail": str(marker)}


def doubt_json(doubt: Contradiction | None) -> JSON | None:
    """What was seen elsewhere than it must be, by how much, and what that may mean."""
    if doubt is None:
        return None
    return {
        "what": doubt.what,
        "shift_mm": round(1e3 * doubt.shift_m, 3),
        "turn_deg": round(math.degrees(doubt.turn_rad), 4),
        "looked_ns": doubt.time_ns,
        "detail": str(doubt),
    }


def seen_json(seen: Seen | None) -> JSON:
    """What the newest picture shows: markers by number, tool and object where they were measured, and why
    not.
    """
    if seen is None:
        return {"markers": [], "X_CM": None, "X_CO": None}
    found = seen.observation
    offset = found.offset
    return {
        "frame_id": found.frame_id,
        "markers": [
            {"id": one.marker_id, "size_mm": 1e3 * one.size, "X_CA": pose_json(one.X_CA),
             "corners_left_px": one.corners_left.round(3).tolist(),
             "both_eyes": one.corners_right is not None, "residual_px": one.residual_px}
            for one in found.markers
        ],
        "rejected": dict(found.rejected),
        "X_CM": None if found.X_CM is None else pose_json(found.X_CM),
        "X_CO": None if found.X_CO is None else pose_json(found.X_CO),
        "missing_tool": found.missing_tool,
        "missing_object": found.missing_object,
        "stereo_offset_px": None if offset is None else [offset.x_px, offset.y_px],
        "stereo_offset_std_px": None if offset is None else [offset.std_x_px, offset.std_y_px],
    }  # fmt: skip


def orientation_json(result: OrientationResult) -> JSON:
    """Euler XYZ errors before and after each input."""
    return {
        "errors_deg": [degrees(e) for e in result.errors],
        "before_deg": degrees(result.errors[0]),
        "after_deg": degrees(result.errors[-1]),
        "inputs": len(result.references),
        "tool_shift_mm": [round(1e3 * shift, 3) for shift in result.tool_shift_m],
    }


def line_equation_json(result: LineEquationResult) -> JSON:
    """Direction, distance, reference, and the look at the result."""
    line, look = result
    return {
        "p_u": [float(v) for v in line.p_u],
        "phi_deg": math.degrees(line.phi),
        "distance_mm": 1e3 * line.distance_m,
        "X_BT_ref": pose_json(line.X_BT_ref),
        "samples": line.samples,
        "seen": line.seen,
        "look": look_json(look),
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
        "expected_std_mm": xyz(step.expected.std_m),
        "expected": expected_json(step.expected),
    }


def expected_json(end: ExpectedEnd) -> JSON:
    """Mean and spread of an error not looked at yet, its 95 % ellipse, the probability to be inside."""
    major, minor, angle = end.ellipse
    return {
        "mean_mm": xyz(end.mean_m),
        "std_mm": xyz(end.std_m),
        "correlation_xy": round(end.correlation, 4),
        "freedom": round(end.freedom, 2) if math.isfinite(end.freedom) else None,
        "ellipse_95_mm": {
            "major": round(1e3 * major, 3),
            "minor": round(1e3 * minor, 3),
            "angle_deg": round(math.degrees(angle), 2),
        },
        "inside_probability": round(end.inside, 4),
    }


def positioning_json(result: PositioningResult | CorrectedResult) -> JSON:
    """All looks and steps, the last look's verdict; where odometry measured the end, what was ``expected``
    before moving and what odometry had ``seen`` before the last look.
    """
    if isinstance(result, CorrectedResult):
        return positioning_json(result.positioning) | {
            "measured_miss_mm": xyz(result.measured_residual_m),
            "expected": expected_json(result.expected),
            "seen": expected_json(result.seen),
        }
    return verdict_json(result.final) | {
        "looks": [verdict_json(look) for look in result.looks],
        "steps": [step_json(step) for step in result.steps],
        "ended": result.ended,
        "contradiction": doubt_json(result.contradiction),
    }


def servoing_json(result: ServoingResult) -> JSON:
    """How visual servoing ended, and the look after it."""
    approach, look = result
    return {
        "error_mm": xyz(approach.end.mean_m),
        "end": expected_json(approach.end),
        "limit_mm": round(1e3 * approach.limit_m, 3),
        "time_s": round(approach.time_s, 3),
        "pictures": approach.pictures,
        "missed": approach.missed,
        "look": look_json(look),
    }


def move_json(result: MoveResult) -> JSON:
    """The commanded and the reached pose, and their distance."""
    return {
        "X_BT_ref": pose_json(result.X_BT_ref),
        "X_BT": pose_json(result.X_BT),
        "miss_mm": round(1e3 * result.miss_m, 3),
    }
