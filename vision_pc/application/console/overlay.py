"""What was detected, in pixels of the left eye, for a page that draws it over the picture."""

import math
from typing import Any

import numpy as np

from vision_pc.application.ports import Seen
from vision_pc.core.perception.intrinsics import distorted
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration

_AXIS_M = 0.06
_NEAREST_M = 0.05  # what is nearer than this, or behind the eye, is not drawn
_ELLIPSE_POINTS = 48
JSON = dict[str, Any]


def overlay(seen: Seen, clearance_m: float, tolerance_m: float, predicted: JSON | None) -> JSON:
    """Outlines, axes, the error as an arrow, the tolerance, the ellipse of ``predicted`` (as the API has it).

    All in px; None where not seen.
    """
    observation, camera, tool_id = seen
    X_CM, X_CO = observation.X_CM, observation.X_CO
    drawn: JSON = {
        "frame_id": observation.frame_id,
        "size": [camera.width, camera.height],
        "markers": [
            {
                "id": marker.marker_id,
                "role": "tool" if marker.marker_id == tool_id else "object",
                "corners": _rounded(marker.corners_left),
                "residual_px": round(marker.residual_px, 3),
            }
            for marker in observation.markers
        ],
        "tool": None if X_CM is None else _axes(camera, X_CM),
        "object": None if X_CO is None else _axes(camera, X_CO),
        "missing": {"tool": observation.missing_tool, "object": observation.missing_object},
        "error_mm": None,
        "aim": None,
    }
    if X_CO is not None:
        aim = X_CO[:3, 3] - np.array([0.0, 0.0, clearance_m])
        drawn["aim"] = _aim(camera, aim, tolerance_m, predicted)
        if X_CM is not None:
            drawn["error_mm"] = [round(1e3 * float(v), 2) for v in aim - X_CM[:3, 3]]
    return drawn


def _aim(camera: CameraCalibration, aim: Array, tolerance_m: float, predicted: JSON | None) -> JSON:
    """Where the tool marker's centre shall be, the square of ±tolerance around it, the told ellipse."""
    square = aim + tolerance_m * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    at = _pixels(camera, aim[None])
    ellipse = None if predicted is None else _pixels(camera, aim - _around(predicted))  # e = aim − p_CM
    return {
        "at": None if at is None else at[0],
        "square": _pixels(camera, square),
        "ellipse": ellipse,
    }


def _around(predicted: JSON) -> Array:
    """Points (n, 3) of the ellipse of the error, m."""
    ellipse, mean = predicted["ellipse_95_mm"], predicted["mean_mm"]
    t = np.linspace(0.0, 2.0 * math.pi, _ELLIPSE_POINTS, endpoint=False)
    c, s = (f(math.radians(ellipse["angle_deg"])) for f in (math.cos, math.sin))
    u, v = ellipse["major"] * np.cos(t), ellipse["minor"] * np.sin(t)
    x, y = mean["x"] + c * u - s * v, mean["y"] + s * u + c * v
    return 1e-3 * np.column_stack([x, y, np.zeros_like(t)])


def _axes(camera: CameraCalibration, X: Array) -> JSON | None:
    ends = X[:3, 3] + np.vstack([np.zeros(3), _AXIS_M * X[:3, :3].T])
    pixels = _pixels(camera, ends)
    return None if pixels is None else dict(zip(("origin", "x", "y", "z"), pixels, strict=True))


def _pixels(camera: CameraCalibration, points: Array) -> list[list[float]] | None:
    """Points (n, 3) in C as pixels of the left eye; None where one of them is not before it."""
    if points[:, 2].min() < _NEAREST_M:
        return None
    return _rounded(distorted(camera.left, points[:, :2] / points[:, 2:]))


def _rounded(pixels: Array) -> list[list[float]]:
    return [[round(float(u), 2), round(float(v), 2)] for u, v in pixels]
