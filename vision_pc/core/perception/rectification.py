"""Pairs as a stereo camera takes them become pairs whose rows belong together: maps computed once, then
applied.

The rectified left eye is C from there on: its axes are the left eye's turned a little, and its pinhole is
the same for both eyes. Bouguet's method as in cv2.stereoRectify; every pixel of the result comes from within
the raw picture.
"""

from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from protocol.errors import ConfigurationError, FrameRefused
from vision_pc.config.choices import LensModel
from vision_pc.config.stereo_camera import RawEye, StereoCalibration
from vision_pc.core import se3
from vision_pc.core.buffers import BufferPool
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, CameraModel, Image, StereoPair

_WIDEST = np.radians(88.0)  # from the axis: no pinhole picture shows more
_LEAST_FOCAL = 0.5  # of a fisheye's: a pinhole picture of all of it would have its middle in a few pixels
_ANGLES = 2000
_UNTIL = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)


class RawLens(NamedTuple):
    """A lens for OpenCV: ``K`` (3, 3), coefficients, and whether they are of the fisheye model."""

    K: Array
    distortion: Array
    fisheye: bool

    def undistorted(self, pixels: Array) -> Array:
        """Image coordinates x/z, y/z (n, 2) of raw ``pixels`` (n, 2)."""
        points = np.ascontiguousarray(pixels, dtype=np.float64).reshape(-1, 1, 2)
        if self.fisheye:
            found = cv2.fisheye.undistortPoints(points, self.K, self.distortion, criteria=_UNTIL)
        else:
            same = np.eye(3)
            found = cv2.undistortPointsIter(points, self.K, self.distortion, same, same, _UNTIL)
        return np.asarray(found, dtype=np.float64).reshape(-1, 2)

    def project(self, points: Array) -> Array:
        """Raw pixels (n, 2) of ``points`` (n, 3) in the eye's own axes."""
        where = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 1, 3)
        if self.fisheye:
            seen = cv2.fisheye.projectPoints(where, np.zeros(3), np.zeros(3), self.K, self.distortion)[0]
        else:
            seen = cv2.projectPoints(where, np.zeros(3), np.zeros(3), self.K, self.distortion)[0]
        return np.asarray(seen, dtype=np.float64).reshape(-1, 2)


class RectifiedGeometry(NamedTuple):
    """How raw eyes are turned: ``R_left`` and ``R_right`` (3, 3) take directions from each raw eye's axes to
    the rectified ones; ``K`` (3, 3) is both rectified eyes' pinhole, ``baseline`` in metres.
    """

    left: RawLens
    right: RawLens
    R_left: Array
    R_right: Array
    K: Array
    baseline: float


def raw_lens(eye: RawEye) -> RawLens:
    """``eye`` for OpenCV."""
    K = np.array([[eye.fx_px, 0.0, eye.cx_px], [0.0, eye.fy_px, eye.cy_px], [0.0, 0.0, 1.0]])
    return RawLens(K, np.array(eye.distortion), eye.lens is LensModel.FISHEYE)


def right_eye(calibration: StereoCalibration) -> Array:
    """X_LR (4, 4): the raw right eye in the raw left one."""
    R_LR = se3.exp_so3(np.radians(calibration.right_rotation_vector_deg))
    return se3.transform(R_LR, calibration.right_position_m)


@lru_cache(maxsize=4)
def geometry(calibration: StereoCalibration) -> RectifiedGeometry:
    """The rectified axes and pinhole of a raw camera.

    Raises ConfigurationError (``configuration.lens_folds``) for a lens that cannot be inverted within its
    picture.
    """
    left, right = raw_lens(calibration.left), raw_lens(calibration.right)
    size = (calibration.width_px, calibration.height_px)
    for name, lens in (("left", left), ("right", right)):
        _refuse_folds(calibration, name, lens)
    X_RL = se3.inverse(right_eye(calibration))
    if left.fisheye:
        R_left, R_right, P, *_ = cv2.fisheye.stereoRectify(
            left.K, left.distortion, right.K, right.distortion, size, X_RL[:3, :3], X_RL[:3, 3],
            flags=cv2.CALIB_ZERO_DISPARITY, newImageSize=size, balance=0.0, fov_scale=1.0,
        )  # fmt: skip
    else:
        R_left, R_right, P, *_ = cv2.stereoRectify(
            left.K, left.distortion, right.K, right.distortion, size, X_RL[:3, :3], X_RL[:3, 3],
            flags=cv2.CALIB_ZERO_DISPARITY, alpha=0.0, newImageSize=size,
        )  # fmt: skip
    baseline = float(np.linalg.norm(calibration.right_position_m))
    K = np.array(P, dtype=np.float64)[:3, :3]
    if left.fisheye:
        K[[0, 1], [0, 1]] = max(K[0, 0], _LEAST_FOCAL * left.K[0, 0])
    return RectifiedGeometry(left, right, np.asarray(R_left), np.asarray(R_right), K, baseline)


def _refuse_folds(calibration: StereoCalibration, name: str, lens: RawLens) -> None:
    """The distorted radius must grow with the angle from the axis until it is beyond the farthest corner.

    A fisheye's corners may lie farther out than any pinhole picture shows: then as far as that.
    """
    size = np.array([calibration.width_px, calibration.height_px])
    focal, centre = lens.K[[0, 1], [0, 1]], lens.K[:2, 2]
    corner = float(np.linalg.norm(np.maximum(centre, size - centre) / focal))
    angles = np.linspace(0.0, _WIDEST, _ANGLES)
    radii = _radii(lens, angles)
    folds = np.flatnonzero(~(np.diff(radii) > 0.0))
    reached = float(radii[folds[0]] if folds.size else radii[-1])
    if reached < corner and (folds.size or not lens.fisheye):
        raise ConfigurationError(
            "configuration.lens_folds",
            f"{calibration.source or 'camera.calibration'}: {name}.distortion = {lens.distortion.tolist()}: "
            f"the lens folds over inside a picture of {calibration.width_px}x{calibration.height_px} px; "
            "likely coefficients of another lens model, or in another order",
        )


def _radii(lens: RawLens, angles: Array) -> Array:
    """Distorted radii (n,) in image coordinates of rays at ``angles`` (n,) from the axis; no tangential
    part.
    """
    if lens.fisheye:
        powers = [angles ** (2 * k + 3) * value for k, value in enumerate(lens.distortion)]
        return np.asarray(angles + sum(powers))
    k1, k2, _, _, k3, k4, k5, k6 = np.append(lens.distortion, np.zeros(3))[:8]
    radius = np.tan(angles)
    r2 = radius**2
    return np.asarray(
        radius * (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    )


def rectified_camera(calibration: StereoCalibration) -> CameraCalibration:
    """What is believed of the rectified pairs. Raises as ``geometry``."""
    found = geometry(calibration)
    eyes = [
        CameraModel(found.K.copy(), np.zeros(5), se3.transform(np.eye(3), (x, 0.0, 0.0)))
        for x in (0.0, found.baseline)
    ]
    return CameraCalibration(calibration.width_px, calibration.height_px, *eyes)


class Rectifier:
    """Rectifies pairs of one camera; bilinear, by fixed-point maps of a 32nd of a pixel."""

    def __init__(self, calibration: StereoCalibration) -> None:
        """Compute the maps. Raises as ``geometry``."""
        found = geometry(calibration)
        self._size = (calibration.width_px, calibration.height_px)
        self._name = calibration.source or "camera.calibration"
        self._pool = BufferPool()
        self._left = _maps(found.left, found.R_left, found.K, self._size)
        self._right = _maps(found.right, found.R_right, found.K, self._size)

    def __call__(self, pair: StereoPair) -> StereoPair:
        """``pair`` rectified. Raises FrameRefused (``frame.wrong_size``) for pictures of another size."""
        for picture in (pair.left, pair.right):
            refuse_size(picture, self._size, self._name)
        both = self._pool.take(2 * pair.left.size).reshape(2, *pair.left.shape)
        for raw, maps, into in zip((pair.left, pair.right), (self._left, self._right), both, strict=True):
            cv2.remap(raw, *maps, cv2.INTER_LINEAR, dst=into)
        return pair._replace(left=both[0], right=both[1])


def refuse_size(picture: Image, expected: tuple[int, int], whose: str) -> None:
    """Raises FrameRefused (``frame.wrong_size``) for a picture that is not ``expected`` (width, height)."""
    height, width = picture.shape[:2]
    if (width, height) != expected:
        raise FrameRefused(
            "frame.wrong_size",
            f"pictures of {width}x{height} px an eye came, {expected[0]}x{expected[1]} are wanted ({whose})",
        )


def _maps(
    lens: RawLens, R: Array, K: Array, size: tuple[int, int]
) -> tuple[NDArray[np.int16], NDArray[np.uint16]]:
    make = cv2.fisheye.initUndistortRectifyMap if lens.fisheye else cv2.initUndistortRectifyMap
    coarse, fine = make(lens.K, lens.distortion, R, K, size, cv2.CV_16SC2)
    return np.asarray(coarse, dtype=np.int16), np.asarray(fine, dtype=np.uint16)
