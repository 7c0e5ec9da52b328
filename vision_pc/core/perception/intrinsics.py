"""From pixels to rays and back: the camera calibration, undistortion and projection of points."""

import math

import cv2
import numpy as np

from foundation.compiled import kernel
from vision_pc.config.camera import CameraSettings, EyeSettings
from vision_pc.config.stereo_camera import StereoCalibration
from vision_pc.config.vision import MarkerSettings
from vision_pc.core import se3
from vision_pc.core.perception.rectification import rectified_camera
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, CameraModel, FrameObservation

_SAME = np.eye(3)  # neither turned nor scaled
_UNDISTORT_UNTIL = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-10)


def calibration(settings: CameraSettings) -> CameraCalibration:
    """The calibration that the configuration describes; of a raw camera, that of its rectified pairs.

    Raises ConfigurationError as ``rectification.geometry``.
    """
    known = settings.calibration
    if isinstance(known, StereoCalibration):
        return rectified_camera(known)
    R_CR = se3.exp_so3(np.radians(known.right_rotation_vector_deg))
    return CameraCalibration(
        settings.width_px,
        settings.height_px,
        _eye(known.left, se3.identity()),
        _eye(known.right, se3.transform(R_CR, (known.baseline_m, 0.0, 0.0))),
    )


def _eye(settings: EyeSettings, X_CE: Array) -> CameraModel:
    K = np.diag([settings.fx_px, settings.fy_px, 1.0])
    K[:2, 2] = settings.cx_px, settings.cy_px
    return CameraModel(K, np.array(settings.distortion), X_CE)


def with_offset(camera: CameraCalibration, x_px: float, y_px: float) -> CameraCalibration:
    """``camera`` with the right eye's principal point moved by an offset (right picture minus model)."""
    K = camera.right.K.copy()
    K[0, 2] += x_px
    K[1, 2] += y_px
    return camera._replace(right=camera.right._replace(K=K))


def normalised(eye: CameraModel, pixels: Array) -> Array:
    """Undistorted image coordinates x/z, y/z (n, 2) in the eye's axes of distorted ``pixels`` (n, 2)."""
    if not eye.distortion.any():
        return np.asarray((pixels - eye.K[:2, 2]) / (eye.K[0, 0], eye.K[1, 1]))
    points = np.ascontiguousarray(pixels, dtype=np.float64).reshape(-1, 1, 2)
    found = cv2.undistortPointsIter(points, eye.K, eye.distortion, _SAME, _SAME, _UNDISTORT_UNTIL)
    return np.asarray(found, dtype=np.float64).reshape(-1, 2)


def distorted(eye: CameraModel, rays: Array) -> Array:
    """Pixels (n, 2) of image coordinates x/z, y/z (n, 2) in the eye's axes; inverse of ``normalised``."""
    return np.asarray(_distorted(rays, eye.distortion, eye.K))


@kernel(nogil=True)
def _distorted(rays: Array, distortion: Array, K: Array) -> Array:
    k1, k2, p1, p2, k3 = distortion[0], distortion[1], distortion[2], distortion[3], distortion[4]
    pixels = np.empty(rays.shape)
    for i in range(rays.shape[0]):
        x, y = rays[i, 0], rays[i, 1]
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        u = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
        v = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
        pixels[i, 0], pixels[i, 1] = K[0, 0] * u + K[0, 2], K[1, 1] * v + K[1, 2]
    return pixels


def project(eye: CameraModel, points_C: Array) -> Array:
    """Pixels (n, 2) at which ``eye`` sees ``points_C`` (n, 3); NaN for points not in front of it."""
    points = se3.apply(se3.inverse(eye.X_CE), points_C)
    z = np.where(points[:, 2] > 1e-6, points[:, 2], math.nan)
    return distorted(eye, points[:, :2] / z[:, None])


_EYES_DIFFER = (0.2, 0.2, 2e-4)  # [E] focal lengths, px, and turn about the axis, rad, of the right eye
_LENS_DIFFERS = (
    1e-3,
    1.5e-4,
    1.5e-4,
    5e-4,
    3e-4,
)  # [E] k1, p1, p2 of the right eye, k2 of both, of the right


def prior_stds(settings: MarkerSettings) -> Array:
    """Standard deviations (12,) of a camera's errors before anything was seen."""
    offset, radial = settings.offset_std_px, max(settings.radial_std, 1e-6)
    baseline = settings.calibration.baseline
    return np.array([offset, offset, baseline, *_EYES_DIFFER, radial, *_LENS_DIFFERS])


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
    return with_offset(as_found(camera, previous), previous.offset.x_px, previous.offset.y_px)
