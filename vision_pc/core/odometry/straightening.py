"""What rectification left in the rows: the right eye's rows and its turn about the line of sight, from points
that both eyes see.

Disparities say nothing of themselves, but rows must agree: what they miss by is known after one pair.
"""

import numpy as np

from vision_pc.core import se3
from vision_pc.core.odometry.keyframes.triangulation import triangulated
from vision_pc.core.perception import intrinsics
from vision_pc.core.types import CameraCalibration, PointPairs

_FEWEST = 25
_ROUNDS = 5
_HUBER_PX = 0.2


def straightened(camera: CameraCalibration, seen: PointPairs) -> CameraCalibration:
    """``camera`` with the right eye lowered and turned so that the rows of ``seen`` agree; as it is where
    fewer than 25 points tell.
    """
    rays = [
        intrinsics.normalised(eye, pixels)
        for eye, pixels in ((camera.left, seen.left), (camera.right, seen.right))
    ]
    points, good = triangulated(rays[0], rays[1], camera, 0.0)
    if int(good.sum()) < _FEWEST:
        return camera
    expected = intrinsics.project(camera.right, points[good])
    lower = seen.right[good, 1] - expected[:, 1]
    design = np.column_stack([np.ones(len(lower)), expected[:, 0] - camera.right.K[0, 2]])
    weights = np.ones(len(lower))
    for _ in range(_ROUNDS):
        root = np.sqrt(weights)[:, None]
        (rows_px, slope), *_ = np.linalg.lstsq(root * design, root[:, 0] * lower, rcond=None)
        missed = np.abs(lower - design @ (rows_px, slope))
        weights = np.minimum(1.0, _HUBER_PX / np.maximum(missed, 1e-9))
    turned = camera.right.X_CE @ se3.transform(se3.exp_so3([0.0, 0.0, -slope]), np.zeros(3))
    lowered = intrinsics.with_offset(camera, 0.0, float(rows_px))
    return lowered._replace(right=lowered.right._replace(X_CE=turned))
