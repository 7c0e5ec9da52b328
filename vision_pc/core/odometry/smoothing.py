"""Whether pictures are so noisy that their finest detail misleads, and their smoothing if so."""

import cv2
import numpy as np

from vision_pc.core.types import Image, StereoPair

SMOOTHING_PX = 1.0  # standard deviation; more loses as much detail as noise
_NOISY_BELOW = 0.8  # white noise alone gives 0.50, a textured wall 1.4 and more
_CURVATURE = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], dtype=np.float32)


def is_noisy(image: Image) -> bool:
    """Whether noise outweighs texture at the scale of a pixel.

    Averaging two by two halves white noise but leaves texture's curvature or steepens it: what becomes of
    the mean curvature (Immerkær 1996) tells the two apart whatever their strength.
    """
    fine = image.astype(np.float32)
    coarse = cv2.resize(fine, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    return bool(_curvature(coarse) < _NOISY_BELOW * _curvature(fine))


def smoothed(pair: StereoPair) -> StereoPair:
    """``pair`` with both pictures smoothed."""
    left, right = (cv2.GaussianBlur(image, (0, 0), SMOOTHING_PX) for image in (pair.left, pair.right))
    return pair._replace(left=np.asarray(left, dtype=np.uint8), right=np.asarray(right, dtype=np.uint8))


def _curvature(image: cv2.typing.MatLike) -> float:
    return float(np.abs(cv2.filter2D(image, -1, _CURVATURE)).mean())
