"""Depths from both eyes' views of a point."""

import numpy as np

from vision_pc.core import se3
from vision_pc.core.odometry.tracking import Flags
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration

_NEAR = 0.1  # m: nearer depths are mismatches


def disparity_metres(camera: CameraCalibration) -> float:
    """Depth times disparity, px m."""
    return float(camera.right.K[0, 0] * np.linalg.norm(camera.right.X_CE[:3, 3]))


def triangulated(
    left_rays: Array, right_rays: Array, camera: CameraCalibration, least_disparity_px: float
) -> tuple[Array, Flags]:
    """Points (n, 3) in C on the left eye's rays (n, 2) where the right eye's columns (n, 2) put them, and
    which are at a sensible depth (n,): with at least this disparity.
    """
    X_RC = se3.inverse(camera.right.X_CE)
    directions = np.column_stack([left_rays, np.ones(len(left_rays))])
    a, b = directions @ X_RC[:3, :3].T, X_RC[:3, 3]
    divisor = right_rays[:, 0] * a[:, 2] - a[:, 0]
    usable = divisor < -1e-6 if b[0] < 0.0 else divisor > 1e-6
    depth = (b[0] - right_rays[:, 0] * b[2]) / np.where(usable, divisor, 1.0)
    return directions * depth[:, None], usable & (depth > _NEAR) & (
        depth * least_disparity_px < disparity_metres(camera)
    )
