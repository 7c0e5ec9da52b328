"""The right eye's offset by a board of known squares: where it should see the corners, and where it does."""

from collections.abc import Sequence

import cv2
import numpy as np

from vision_pc.core import se3
from vision_pc.core.perception import intrinsics
from vision_pc.core.perception.stereo_fit import PairView
from vision_pc.core.types import CameraCalibration, StereoOffset


def board_offset(views: Sequence[PairView], camera: CameraCalibration) -> StereoOffset | None:
    """How far the right picture is off what the left one predicts, px; None without a board.

    The board's pose comes from the left eye alone, its range from the size of the squares. ``std_*``: of the
    mean over the views, by how they differ.
    """
    found = []
    for view in views:
        rays = intrinsics.normalised(camera.left, view.left)
        _, turn, shift = cv2.solvePnP(view.points_m, rays, np.eye(3), np.zeros(5))
        points = se3.apply(se3.transform(se3.exp_so3(turn.ravel()), shift.ravel()), view.points_m)
        found.append(np.median(view.right - intrinsics.project(camera.right, points), axis=0))
    if not found:
        return None
    offsets = np.array(found)
    spread = (
        np.std(offsets, axis=0, ddof=1) / np.sqrt(len(offsets)) if len(offsets) > 1 else np.full(2, np.nan)
    )
    x, y = np.median(offsets, axis=0)
    return StereoOffset(float(x), float(y), float(spread[0]), float(spread[1]))
