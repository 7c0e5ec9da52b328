"""Knob, switch and key hole of a control cabinet, in the camera: found by its drawing, ranged in stereo.

1. The drawing is found in the left picture by its features (SIFT) and a robust homography.
2. Its pose from there tells where each target is in both pictures, to a few pixels.
3. Around each target the drawing, bent accordingly, is aligned with either picture by itself, to a few
   hundredths of a pixel (enhanced correlation, Evangelidis and Psarakis 2008: brightness does not matter).
4. The two lines of sight meet at the target.
"""

import math
from typing import Any, NamedTuple

import cv2
import numpy as np

from protocol.errors import MeasurementFailed
from vision_pc.core import se3
from vision_pc.core.perception import intrinsics
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, CameraModel, Image, StereoPair

_FEATURES = 1500
_COARSENESS = 0.75  # of the picture in which features are sought: a few pixels are enough there
_TEXELS_A_PIXEL = 2.0  # of the drawing, about: 0.5 mm against 1.1 mm at 0.6 m
_LIKENESS = 0.75  # of the best to the second best match
_RANSAC_PX = 3.0
_LEAST_MATCHES = 10
_SMOOTHING = 0.8  # px that pictures are blurred by, so that neither is sharper than the other
_WINDOW_M = 0.032  # half a side of the patch around a target
_UNTIL = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-5)
_CORRELATION = 0.8
_MISPLACED_M = 0.003
_ROW_GAP_PX = 1.0  # between the two lines of sight, at most


class Target(NamedTuple):
    """A named point of the drawing, metres from its middle (x right, y up)."""

    name: str
    x_m: float
    y_m: float


class Drawing(NamedTuple):
    """A cabinet's front as its maker drew it: grey ``picture``, texels of ``texel_m``, the targets on it."""

    picture: Image
    texel_m: float
    targets: tuple[Target, ...]


class Located(NamedTuple):
    """A target in the camera, p_C (3,); ``gap_px`` between the two lines of sight; the poorer correlation."""

    name: str
    p_C: Array
    gap_px: float
    correlation: float


class CabinetLocator:
    """Finds the targets of one cabinet. Holds the features of its drawing, which take a while to make."""

    def __init__(self, drawing: Drawing) -> None:
        self._drawing = drawing
        self._sift = cv2.SIFT.create(_FEATURES)
        points, self._descriptors = self._features(drawing.picture, _COARSENESS / _TEXELS_A_PIXEL)
        self._places = _metres(drawing, points)

    def locate(self, pair: StereoPair, camera: CameraCalibration) -> tuple[Located, ...]:
        """All targets of the drawing in C; ``camera`` with the right eye's offset taken into account.

        Raises MeasurementFailed: ``measurement.hand_eye.cabinet_not_seen`` when the drawing is not found in
        the left picture, ``.target_not_seen`` naming the target that is hidden, out of either picture, or
        misplaced.
        """
        drawing = self._drawing
        X_CA = self._front_pose(pair.left, camera.left)
        found = tuple(_locate_target(pair, drawing, target, X_CA, camera) for target in drawing.targets)
        _refuse_strangers(found, drawing)
        return found

    def _features(self, image: Image, scale: float) -> tuple[Array, Any]:
        """Places (n, 2) px in ``image`` of its features, found at ``scale`` of its size, with descriptors."""
        small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        points, descriptors = self._sift.detectAndCompute(small, None)
        return (np.array([p.pt for p in points]).reshape(-1, 2) + 0.5) / scale - 0.5, descriptors

    def _front_pose(self, image: Image, eye: CameraModel) -> Array:
        """The front in the camera X_CA (4, 4), z towards the viewer, good to a few pixels."""
        seen, descriptors = self._features(image, _COARSENESS)
        known = self._descriptors
        blank = known is None or descriptors is None
        matches = [] if blank else cv2.BFMatcher().knnMatch(known, descriptors, k=2)
        good = [m[0] for m in matches if len(m) == 2 and m[0].distance < _LIKENESS * m[1].distance]
        places, pixels = self._places[[m.queryIdx for m in good]], seen[[m.trainIdx for m in good]]
        fitting = len(good)
        if fitting >= _LEAST_MATCHES:
            _, flags = cv2.findHomography(places, pixels, cv2.RANSAC, _RANSAC_PX)
            inliers = np.zeros(fitting, bool) if flags is None else flags.ravel() > 0
            fitting = int(inliers.sum())
            X_CA = _planar_pose(places[inliers], pixels[inliers], eye) if fitting >= _LEAST_MATCHES else None
            if X_CA is not None:
                return X_CA
        raise MeasurementFailed(
            "measurement.hand_eye.cabinet_not_seen",
            f"{fitting} features of the cabinet's drawing found, {_LEAST_MATCHES} are wanted",
        )


def _planar_pose(places: Array, pixels: Array, eye: CameraModel) -> Array | None:
    """X_CA (4, 4) of the front A with ``places`` (n, 2) m at ``pixels`` (n, 2); None without a solution."""
    front = np.c_[places, np.zeros(len(places))]
    rays = intrinsics.normalised(eye, pixels)
    found, turn, shift = cv2.solvePnP(front, rays, np.eye(3), np.zeros(5), flags=cv2.SOLVEPNP_IPPE)
    return se3.transform(se3.exp_so3(np.ravel(turn)), np.ravel(shift)) if found else None


def _metres(drawing: Drawing, texels: Array) -> Array:
    """Places on the front (n, 2), x right and y up, of texels (n, 2) column and row."""
    rows, columns = drawing.picture.shape
    centred = texels - 0.5 * np.array([columns, rows]) + 0.5
    return np.asarray(centred * [drawing.texel_m, -drawing.texel_m])


def _refuse_strangers(found: tuple[Located, ...], drawing: Drawing) -> None:
    """Raise when a target is not as far from the others as on the drawing: something like it was aligned."""
    drawn = np.array([[t.x_m, t.y_m] for t in drawing.targets])
    seen = np.array([t.p_C for t in found])
    off = np.abs(_distances(seen) - _distances(drawn))
    worst = int(np.argmax(off.sum(axis=0)))
    if off.max() > _MISPLACED_M:
        raise MeasurementFailed(
            "measurement.hand_eye.target_not_seen",
            f"{found[worst].name}: {1e3 * off.max():.1f} mm nearer to or farther from another target than on "
            f"the drawing, limit {1e3 * _MISPLACED_M:g} mm",
        )


def _distances(points: Array) -> Array:
    return np.asarray(np.linalg.norm(points[:, None] - points[None], axis=-1))


def _locate_target(
    pair: StereoPair, drawing: Drawing, target: Target, X_CA: Array, camera: CameraCalibration
) -> Located:
    rays, correlations = [], []
    for image, eye in ((pair.left, camera.left), (pair.right, camera.right)):
        pixel, correlation = _aligned(image, drawing, target, X_CA, eye)
        rays.append(np.append(intrinsics.normalised(eye, pixel[None])[0], 1.0))
        correlations.append(correlation)
    p_C, apart = _meeting(rays[0], rays[1], camera.right.X_CE)
    gap_px = apart / float(p_C[2]) * float(camera.left.K[1, 1])
    if gap_px > _ROW_GAP_PX:
        raise MeasurementFailed(
            "measurement.hand_eye.target_not_seen",
            f"{target.name}: the two lines of sight pass at {gap_px:.2f} px, limit {_ROW_GAP_PX:g} px",
        )
    return Located(target.name, p_C, gap_px, min(correlations))


def _aligned(
    image: Image, drawing: Drawing, target: Target, X_CA: Array, eye: CameraModel
) -> tuple[Array, float]:
    """The target's pixel (2,) in one picture, and how well the drawing correlates there."""
    grid = np.array([[x, y] for y in (-1.0, 0.0, 1.0) for x in (-1.0, 0.0, 1.0)]) * _WINDOW_M
    places = grid + np.array([target.x_m, target.y_m])
    pixels = intrinsics.project(eye, se3.apply(X_CA, np.c_[places, np.zeros(9)]))
    height, width = image.shape
    low, high = np.floor(pixels.min(axis=0)), np.ceil(pixels.max(axis=0))
    if not (np.isfinite(pixels).all() and (low >= 0).all() and (high < [width, height]).all()):
        raise MeasurementFailed("measurement.hand_eye.target_not_seen", f"{target.name}: out of the picture")
    rows, columns = drawing.picture.shape
    texels = places * [1.0, -1.0] / drawing.texel_m + 0.5 * np.array([columns, rows]) - 0.5
    bend, _ = cv2.findHomography(texels, pixels - low)
    size = tuple(int(v) + 1 for v in high - low)
    # Blurred first as far as the picture is coarser, so that the warp does not alias.
    finer = math.sqrt(abs(float(np.linalg.det(bend[:2, :2]))))
    blurred = cv2.GaussianBlur(drawing.picture, (0, 0), max(0.45 / max(finer, 1e-3), 0.3))
    drawn = cv2.GaussianBlur(cv2.warpPerspective(blurred, bend, size), (0, 0), _SMOOTHING)
    seen = image[int(low[1]) : int(high[1]) + 1, int(low[0]) : int(high[0]) + 1]
    middle = pixels[4] - low
    inside = np.zeros(drawn.shape, dtype=np.uint8)
    cv2.fillConvexPoly(inside, np.round((pixels - low)[[0, 2, 8, 6]]).astype(np.int32), 255)
    still = np.eye(2, 3, dtype=np.float32)
    try:
        correlation, warp = cv2.findTransformECC(
            drawn, cv2.GaussianBlur(seen, (0, 0), _SMOOTHING), still, cv2.MOTION_AFFINE, _UNTIL, inside, 1
        )
    except cv2.error:
        correlation, warp = 0.0, still
    if correlation < _CORRELATION:
        raise MeasurementFailed(
            "measurement.hand_eye.target_not_seen",
            f"{target.name}: the drawing correlates by {correlation:.2f}, {_CORRELATION:g} is wanted",
        )
    return np.asarray(warp @ np.append(middle, 1.0) + low, dtype=np.float64), float(correlation)


def _meeting(left: Array, right: Array, X_CR: Array) -> tuple[Array, float]:
    """The point (3,) halfway between two lines of sight from C and R, and how far they pass each other, m."""
    d, p = X_CR[:3, :3] @ right, X_CR[:3, 3]
    A = np.stack([left, -d], axis=1)
    s, t = np.linalg.lstsq(A, p, rcond=None)[0]
    a, b = s * left, p + t * d
    return np.asarray(0.5 * (a + b)), float(np.linalg.norm(a - b))
