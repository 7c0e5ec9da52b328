"""Which pixels belong to what the camera carries along: the tool, its marker and its bracket."""

import cv2
import numpy as np

from vision_pc.config.vision import ToolMarkerSettings
from vision_pc.core import se3
from vision_pc.core.odometry.tracking import Flags
from vision_pc.core.perception import intrinsics
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, CameraModel

_RIM_PX = 12  # a tracking window that touches the tool is disturbed by it
_NEAREST = 0.05  # m: what is nearer to the lens is cut off


def static_pixels(X_CM: Array, tool: ToolMarkerSettings, camera: CameraCalibration) -> tuple[Flags, Flags]:
    """For the left and the right eye, (height, width): True where the static world may be seen.

    ``X_CM`` the tool marker in the camera; what it carries is configured as rectangles in its plane.
    """
    left, right = (
        _static(eye, X_CM, tool, (camera.height, camera.width)) for eye in (camera.left, camera.right)
    )
    return left, right


def _static(eye: CameraModel, X_CM: Array, tool: ToolMarkerSettings, shape: tuple[int, int]) -> Flags:
    moving = np.zeros(shape, dtype=np.uint8)
    X_EM = se3.inverse(eye.X_CE) @ X_CM
    for x0, y0, x1, y1 in tool.carried_m:
        corners = np.array([[x0, y0, 0.0], [x1, y0, 0.0], [x1, y1, 0.0], [x0, y1, 0.0]])
        outline = _in_front(se3.apply(X_EM, corners))
        if len(outline) < 3:
            continue
        pixels = intrinsics.distorted(eye, outline[:, :2] / outline[:, 2:])
        pixels = np.clip(pixels, -16_000, 16_000)  # fillPoly counts in 16 bits
        cv2.fillPoly(moving, [np.rint(pixels).astype(np.int32)], 255)
    size = 2 * _RIM_PX + 1
    return np.asarray(cv2.dilate(moving, np.ones((size, size), np.uint8)) == 0)


def _in_front(polygon: Array) -> Array:
    """``polygon`` (n, 3), clipped to what lies farther than the nearest visible plane."""
    kept = []
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if a[2] >= _NEAREST:
            kept.append(a)
        if (a[2] - _NEAREST) * (b[2] - _NEAREST) < 0.0:
            kept.append(a + (b - a) * (_NEAREST - a[2]) / (b[2] - a[2]))
    return np.array(kept).reshape(-1, 3)
