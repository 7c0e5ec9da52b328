"""A plane from a larger patch: what a normal needs far away, where the surface is flat enough for it."""

import math

import cv2
import numpy as np

from vision_pc.core.se3 import Array
from vision_pc.core.targets import plane_patch
from vision_pc.core.targets.plane_patch import Mask, PlanePatch
from vision_pc.core.targets.target import TargetRefused
from vision_pc.core.types import CameraCalibration, Image, StereoPair

_TURN_WANTED = math.radians(0.4)  # 1 σ of the normal for which no larger patch is looked at
_DARK = 0.55  # of the surroundings: what is darker may be deeper
_BESIDE_PX = 9


def wider(
    pair: StereoPair, camera: CameraCalibration, plane: PlanePatch, pixel: Array, half: int, used: Mask | None
) -> PlanePatch:
    """``plane`` from a larger patch, where its normal wants it and the surface is as flat as that.

    What is as dark as the inside of a hole is left out.
    """
    if normal_std(plane) < _TURN_WANTED:
        return plane
    bright = _bright(pair.left, pixel, half)
    try:
        large = plane_patch.align(
            pair, camera, pixel, float(plane.theta[0]), half, bright if used is None else bright & used
        )
    except TargetRefused:
        return plane
    # The large patch has the small one in it: what it knows better is what the two may differ by.
    gained = max(float(plane.covariance[0, 0] - large.covariance[0, 0]), float(large.covariance[0, 0]))
    return large if abs(large.theta[0] - plane.theta[0]) < 3.0 * math.sqrt(gained) else plane


def normal_std(plane: PlanePatch) -> float:
    """How well a plane's normal is known, rad: 1 σ of the less certain of its two turns."""
    slopes = plane.covariance[1:, 1:] / float(plane.theta[0]) ** 2
    return math.sqrt(float(np.linalg.eigvalsh(slopes)[-1]))


def _bright(image: Image, pixel: Array, half: int) -> Mask:
    """Which pixels (2 half + 1, same) of a patch are no dark spot, nor beside one; all at the rim."""
    u, v = np.rint(pixel).astype(int)
    part = image[max(v - half, 0) : v + half + 1, max(u - half, 0) : u + half + 1]
    if part.shape != (2 * half + 1, 2 * half + 1):
        return np.ones((2 * half + 1, 2 * half + 1), dtype=np.bool_)
    dark = (cv2.blur(part, (5, 5)) < _DARK * np.median(part)).astype(np.uint8)
    return np.asarray(cv2.dilate(dark, np.ones((_BESIDE_PX, _BESIDE_PX), np.uint8)) == 0)
