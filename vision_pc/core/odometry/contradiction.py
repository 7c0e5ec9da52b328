"""How much of a picture contradicts a pose: the share of its pixels that do not go as a rigid world would.

A keyframe's picture, small, and its depths foresee where each of its pixels is seen from another place.
Dense flow (Kroeger et al. 2016) then shows what is found elsewhere, or nowhere. In a static world that is
what depths get wrong, a share of the motion that was foreseen; a thing that moves is off by its own motion.
"""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vision_pc.core.odometry.tracking import Flags
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, Image

SMALLER = 4  # [D] pictures are compared at this share of their width
_DISPARITIES, _BLOCK = 0.2, 15  # [D] at most, of the width; px of the small pictures
_LEAST_DISPARITY = 0.5  # [D] px of the small pictures
_OFF_PX = 1.5  # [M] a camera at rest and blurred pictures stay below
_OFF_SHARE = 0.3  # [M] of the motion foreseen: what coarse depths get wrong
_CONTRAST, _FAINT = 40.0, 8.0  # [D] grey levels rms: what pictures are brought to, what a blank place has
_AROUND = 15  # [D] px of a small picture
_TEXTURE, _WINDOW = 400.0, 5  # [M] squared slope, mean of a window of so many px: half of a street has it
_RIM, _NEAREST_M = 2, 0.1  # [D]
_FEWEST_PIXELS = 100  # [D]
_FINEST = 1  # [M] halvings of the small picture: with two the edges of near things are off
_TILE, _SHOWN = 8, 0.1  # [D] px; of a tile's pixels, for it to count
_LEAST_LIKENESS = 0.2  # [M] correlation of what goes as flow says
LIMIT = 0.3
"""[M] The share at which a pose is refused: of a thing over 60 % of the width 0.30 and more contradict; of a
drive, every third picture included, 0.27 at most."""


class Depths(NamedTuple):
    """A small picture (h, w) of even contrast, the points (h, w, 3) m in C that it shows, and where these are
    known in the static world (h, w).
    """

    picture: Image
    points: Array
    known: Flags


def small(image: Image) -> Image:
    """``image`` at a quarter of its size, each pixel the mean of those that it covers."""
    height, width = image.shape
    shape = (width // SMALLER, height // SMALLER)
    return np.asarray(cv2.resize(image, shape, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def disparities(left: Image, right: Image) -> Array:
    """Disparity (h, w) px of ``small`` pictures by block matching; 0 or less: unknown."""
    sixteens = max(round(_DISPARITIES * left.shape[1] / 16.0), 1)
    found = cv2.StereoBM.create(16 * sixteens, _BLOCK).compute(left, right)
    return np.asarray(found, dtype=np.float64) / 16.0


def depths(left: Image, disparity: Array, static: Flags, camera: CameraCalibration) -> Depths:
    """What the ``small`` picture ``left`` shows by its ``disparity``; ``static`` is of the whole picture."""
    focal, column, row = _pinhole(camera)
    known = (disparity > _LEAST_DISPARITY) & (small(static.astype(np.uint8)) > 0)
    usual = float(np.median(disparity[known])) if known.any() else 1.0
    base = float(np.linalg.norm(camera.right.X_CE[:3, 3]))
    depth = focal * base / np.where(known, disparity, usual)
    v, u = np.indices(disparity.shape)
    points = np.stack([(u - column) / focal * depth, (v - row) / focal * depth, depth], axis=2)
    even = _even(left)
    across, down = cv2.Sobel(even, cv2.CV_32F, 1, 0), cv2.Sobel(even, cv2.CV_32F, 0, 1)
    slope = cv2.boxFilter(across * across + down * down, -1, (_WINDOW, _WINDOW))
    return Depths(even, points.astype(np.float32), np.asarray(known & (slope > _TEXTURE)))


def contradicting(keyframe: Depths, image: Image, X_CK: Array, camera: CameraCalibration) -> float:
    """The share 0…1 of what ``keyframe`` knows, and a camera sees that has it at ``X_CK``, which its picture
    ``image`` shows elsewhere than foreseen; 0 where too little is known.
    """
    focal, column, row = _pinhole(camera)
    height, width = keyframe.known.shape
    points = keyframe.points @ X_CK[:3, :3].T.astype(np.float32) + X_CK[:3, 3].astype(np.float32)
    near = focal / np.maximum(points[..., 2], _NEAREST_M)
    x, y = points[..., 0] * near + np.float32(column), points[..., 1] * near + np.float32(row)
    seen = keyframe.known & (points[..., 2] > _NEAREST_M) & (x > _RIM) & (x < width - 1 - _RIM)
    seen &= (y > _RIM) & (y < height - 1 - _RIM)
    if int(seen.sum()) < _FEWEST_PIXELS:
        return 0.0
    v, u = np.indices((height, width), dtype=np.float32)
    bearable = np.maximum(_OFF_PX, _OFF_SHARE * SMALLER * np.hypot(x - u, y - v))
    there = np.asarray(cv2.remap(_even(small(image)), x, y, cv2.INTER_LINEAR), dtype=np.uint8)
    share = _share(keyframe.picture, there, seen, bearable)
    if share < LIMIT:
        return share
    return min(share, _share(_unshaded(keyframe.picture), _unshaded(there), seen, bearable))


def _share(picture: Image, there: Image, seen: Flags, bearable: Array) -> float:
    """The share of tiles of ``picture`` with ``seen`` (h, w) pixels most of which are nowhere in ``there``,
    or elsewhere by more than ``bearable`` (h, w) px of the whole picture.
    """
    dense = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST)
    dense.setFinestScale(_FINEST)
    flow = np.asarray(dense.calc(picture, there, None), dtype=np.float32)  # type: ignore[call-overload]
    off = SMALLER * np.hypot(flow[..., 0], flow[..., 1]) > bearable
    off = seen & (off | _unlike(picture, there, flow))
    shape = (seen.shape[1] // _TILE, seen.shape[0] // _TILE)
    shown, against = (
        np.asarray(cv2.resize(flags.astype(np.float32), shape, interpolation=cv2.INTER_AREA))
        for flags in (seen, off)
    )
    counts = shown > _SHOWN
    return float((against > 0.5 * shown)[counts].mean()) if counts.any() else 0.0


def _unlike(picture: Image, there: Image, flow: NDArray[np.float32]) -> Flags:
    """Which pixels (h, w) of ``picture`` are nowhere: what ``flow`` leads to in ``there`` is unlike them."""
    height, width = picture.shape
    column, row = (np.arange(size, dtype=np.float32) for size in (width, height))
    found = cv2.remap(there, flow[..., 0] + column, flow[..., 1] + row[:, None], cv2.INTER_LINEAR)
    one, other = picture.astype(np.float64), found.astype(np.float64)
    both = _variance(one) + _variance(other)
    return np.asarray(_variance(one - other) > (1.0 - _LEAST_LIKENESS) * both)


def _variance(values: Array) -> Array:
    """Of the pixels around each one (h, w)."""
    window = (_TILE + 1, _TILE + 1)
    return np.asarray(cv2.blur(values * values, window) - cv2.blur(values, window) ** 2)


def _pinhole(camera: CameraCalibration) -> tuple[float, float, float]:
    """Focal length and principal point (column, row) of small pictures, px; pixels' middles are whole."""
    K = camera.left.K
    column, row = ((float(K[i, 2]) + 0.5) / SMALLER - 0.5 for i in (0, 1))
    return float(K[0, 0]) / SMALLER, column, row


def _even(image: Image) -> Image:
    """``image`` as rich in contrast as any: exposures differ."""
    gain = _CONTRAST / max(float(image.std()), 1.0)
    return np.asarray(cv2.convertScaleAbs(image, alpha=gain), dtype=np.uint8)


def _unshaded(image: Image) -> Image:
    """``image`` as rich in contrast everywhere: the edge of a shadow is not taken for motion."""
    fine = image.astype(np.float32)
    fine -= cv2.blur(fine, (_AROUND, _AROUND))
    squares = np.maximum(cv2.blur(fine * fine, (_AROUND, _AROUND)), 0.0)
    fine *= _CONTRAST / (np.sqrt(squares) + _FAINT)
    return np.asarray(np.clip(fine + 128.0, 0.0, 255.0), dtype=np.uint8)
