"""How a stereo camera may differ from its calibration, and the calibration with that put in."""

import numpy as np

from vision_pc.config.vision import MarkerSettings
from vision_pc.core import se3
from vision_pc.core.perception import intrinsics
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, FrameObservation


def prior_stds(settings: MarkerSettings) -> Array:
    """Standard deviations (12,) of a camera's errors before anything was seen."""
    doubts, offset = settings.calibration, settings.offset_std_px
    focal, tangential = doubts.focal_difference_px, doubts.tangential
    radial = max(settings.radial_std, 1e-6)
    lens = [radial, doubts.radial_difference, tangential, tangential]
    lens += [doubts.quartic, doubts.quartic_difference]
    return np.array([offset, offset, doubts.baseline, focal, focal, doubts.roll_rad, *lens])


def corrected(camera: CameraCalibration, values: Array) -> CameraCalibration:
    """``camera`` with errors of these ``values`` (12,) taken into account."""
    x, y, base, fx, fy, roll, k1, more_k1, p1, p2, k2, more_k2 = (float(value) for value in values)
    K = camera.right.K.copy()
    K[0, 2] += x
    K[1, 2] += y
    K[0, 0] += fx
    K[1, 1] += fy
    X_CE = camera.right.X_CE.copy()
    X_CE[:3, 3] *= 1.0 + base
    X_CE[:3, :3] = X_CE[:3, :3] @ se3.exp_so3(np.array([0.0, 0.0, roll]))
    left = camera.left.distortion + np.array([k1, k2, 0.0, 0.0, 0.0])
    right = camera.right.distortion + np.array([k1 + more_k1, k2 + more_k2, p1, p2, 0.0])
    return camera._replace(
        left=camera.left._replace(distortion=left),
        right=camera.right._replace(K=K, distortion=right, X_CE=X_CE),
    )


def as_found(camera: CameraCalibration, previous: FrameObservation | None) -> CameraCalibration:
    """``camera`` with the errors that were found before ``previous``, but for the right eye's offset, which
    is told apart.
    """
    if previous is None or previous.errors is None:
        return camera
    return corrected(camera, np.append(np.zeros(2), previous.errors.values[2:]))


def as_believed(camera: CameraCalibration, previous: FrameObservation | None) -> CameraCalibration:
    """``camera`` with all that markers told of it until ``previous``, the right eye's offset too."""
    if previous is None or previous.offset is None:
        return camera
    return intrinsics.with_offset(as_found(camera, previous), previous.offset.x_px, previous.offset.y_px)
