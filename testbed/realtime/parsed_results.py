"""Results of programs read from the API's JSON, once, into the types that the programs return."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from protocol.errors import LinkLost
from protocol.pose import Pose
from vision_pc.application.results import JSON, JudgedLook
from vision_pc.core.calibration.local_calibration import LocalCalibration, ResidualTable
from vision_pc.core.calibration.orientation import OrientationResult
from vision_pc.core.positioning.expected_end import ExpectedEnd
from vision_pc.core.positioning.look_then_move import Ended, LookVerdict, PositioningResult, Step
from vision_pc.core.se3 import Array, from_pose
from vision_pc.core.types import Look, StereoOffset


def look_of(told: JSON) -> JudgedLook:
    """A look with its verdict. The API tells standard deviations alone: each is taken for independent.

    What one frame's noise was, and how sure the offset of the eyes is, it does not tell: NaN. Raises LinkLost
    for a look that was made while no controller was connected: it does not say where the arm stood.
    """
    if told["X_BT"] is None:
        raise LinkLost("link.not_connected", "look: no controller was connected: arm unknown")
    told_offset, unknown = told["stereo_offset_px"], np.full((6, 6), math.nan)
    offset = None
    if told_offset is not None:
        x_px, y_px = told_offset
        offset = StereoOffset(x_px, y_px, math.nan, math.nan)
    look = Look(
        time_ns=int(told["time_ns"]),
        X_CM=_pose(told["X_CM"]),
        X_CO=_pose(told["X_CO"]),
        X_BT=_pose(told["X_BT"]),
        frames=told["frames"],
        failed_tool=told["failed_tool"],
        failed_object=told["failed_object"],
        cov_CM=_spread(told["std_tool_mm"], told["std_tool_deg"]),
        cov_CO=_spread(told["std_object_mm"], told["std_object_deg"]),
        frame_cov_CM=unknown,
        frame_cov_CO=unknown,
        offset=offset,
    )
    return JudgedLook(look, _verdict(told))


def _spread(std_mm: JSON, std_deg: JSON) -> Array:
    return np.diag(np.concatenate((_metres(std_mm), np.radians(_xyz(std_deg)))) ** 2)


def orientation_of(told: JSON) -> OrientationResult:
    """The errors of an orientation adjustment; the API does not report its references."""
    shifts = tuple(1e-3 * shift for shift in told["tool_shift_mm"])
    return OrientationResult(tuple(np.radians(_xyz(e)) for e in told["errors_deg"]), (), shifts)


def calibration_of(told: JSON) -> LocalCalibration:
    """A local calibration. The API reports the largest standard deviation: taken about every axis here."""
    return LocalCalibration(
        R_BC=np.array(told["R_BC"]),
        R_TC=None if told["R_TC"] is None else np.array(told["R_TC"]),
        covariance=math.radians(told["rotation_std_deg"]) ** 2 * np.eye(3),
        residuals=ResidualTable(_metres(told["residual_mean_mm"]), _metres(told["residual_max_mm"])),
        condition=told["condition"],
        method=told["method"],
        samples=told["samples"],
        inlier_share=told["inlier_share"],
        extent_m=1e-3 * told["extent_mm"],
        scale=told["scale"],
    )


def positioning_of(told: JSON) -> PositioningResult:
    """Looks and steps of a look-then-move."""
    steps = tuple(
        Step(_metres(s["p_lc_mm"]), _pose(s["X_BT_ref"]), _expected(s["expected"])) for s in told["steps"]
    )
    return PositioningResult(tuple(_verdict(look) for look in told["looks"]), steps, Ended(told["ended"]))


RESULT_OF: dict[str, Callable[[JSON], Any]] = {
    "look": look_of,
    "orientation-adjustment": orientation_of,
    "trajectory-matching": calibration_of,
    "look-then-move": positioning_of,
    "visit": lambda told: positioning_of(told["targets"][-1]),
}
"""By program; what is not here stays JSON."""


def _expected(told: JSON) -> ExpectedEnd:
    """The API tells the correlation of x and y alone: z is taken for independent."""
    std = _metres(told["std_mm"])
    covariance = np.diag(std**2)
    covariance[0, 1] = covariance[1, 0] = told["correlation_xy"] * std[0] * std[1]
    freedom = math.inf if told["freedom"] is None else float(told["freedom"])
    return ExpectedEnd(_metres(told["mean_mm"]), covariance, freedom, float(told["inside_probability"]))


def _verdict(told: JSON) -> LookVerdict:
    return LookVerdict(
        _metres(told["error_mm"]),
        _metres(told["std_mm"]),
        1e-3 * told["tolerance_mm"],
        told["clearance_m"],
        told["verdict"] == "inside",
        told["certain"],
    )


def _pose(told: JSON) -> Array:
    x, y, z = told["p_m"]
    w, i, j, k = told["q_wxyz"]
    return from_pose(Pose((x, y, z), (w, i, j, k)))


def _xyz(told: JSON) -> Array:
    return np.array([told[axis] for axis in "xyz"])


def _metres(told: JSON) -> Array:
    return 1e-3 * _xyz(told)
