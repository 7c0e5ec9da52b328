"""Where a taught patch is in a picture: drawn as the eye would see it, and searched for.

Where nobody knows how far it is and how it is turned, a picture half as fine is searched in steps of size and
turn. Places that look alike there are looked at in the fine picture; what looks alike there too is refused.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from vision_pc.core import se3
from vision_pc.core.perception import intrinsics
from vision_pc.core.se3 import Array
from vision_pc.core.targets.target import TargetRefused, Taught, frame_on
from vision_pc.core.types import CameraModel, Image

_LEAST = 0.6  # correlation below which it was not found
MARGIN = 0.1  # by which the best place must beat every other
APART = 0.5  # of its half width between places that are different ones
_SCALES = (0.72, 0.85, 1.0, 1.18, 1.39)  # of its size in the picture, where nobody knows how far it is
_ROLLS_DEG = (-20.0, -10.0, 0.0, 10.0, 20.0)
_COARSE = 2  # a picture half as fine is searched first; places that look alike there are looked at finely:
_FINER_SCALES, _FINER_ROLLS_DEG = (0.92, 1.0, 1.09), (-5.0, 0.0, 5.0)
_FINE_REACH_PX, _MOST_RIVALS = 8, 8
TEXTURE_MARGIN = 0.3  # by which fine texture agrees less at a place that is another one
_BLOCK_PX, _BLOCK_REACH_PX = 15, 2  # of it, and by how much each may lie elsewhere


class Place(NamedTuple):
    """Where a taught patch lies: its middle (2,) px of the left eye, its turn from the camera's x, rad."""

    pixel: Array
    turn: float


class _Tried(NamedTuple):
    """A place (2,) px that looks like what was taught: its correlation, at which size and turn (rad).

    ``texture``: how well fine texture agrees there.
    """

    pixel: Array
    score: float
    scale: float
    roll: float
    texture: float = 0.0


def find(image: Image, eye: CameraModel, taught: Taught, expected: Array, reach_px: int | None) -> Place:
    """Where ``taught`` is in a left picture: within ``reach_px`` of ``expected`` (4, 4), None: anywhere.

    Raises TargetRefused: ``target.not_found``, ``target.ambiguous``.
    """
    half = len(taught.grey) // 2
    level = frame_on(expected[:3, 3], expected[:3, 2])
    turn = math.atan2(*(float(expected[:3, 0] @ level[:3, k]) for k in (1, 0)))
    if reach_px is not None:
        pixel = intrinsics.project(eye, expected[None, :3, 3])[0]
        found = places_like(image, drawn_as_seen(eye, taught, expected, half), (pixel, reach_px), half)
        return Place(_only(found, half), turn)
    small = cv2.resize(image, None, fx=1.0 / _COARSE, fy=1.0 / _COARSE, interpolation=cv2.INTER_AREA)
    tried = list[_Tried]()
    for scale in _SCALES:
        for roll in np.radians(_ROLLS_DEG):
            drawn = drawn_as_seen(eye, taught, turned(expected, float(roll)), half, scale / _COARSE)
            for place, score in places_like(np.asarray(small), drawn, None, len(drawn) // 2):
                tried.append(_Tried(place * _COARSE + 0.5 * (_COARSE - 1), score, scale, float(roll)))
    tried.sort(key=lambda each: -each.score)
    if len(_rivals(tried, half)) > 1:
        tried = _of_its_texture([_finely(image, eye, taught, expected, one) for one in _rivals(tried, half)])
    best = _only([(each.pixel, each.score) for each in tried], half)
    return Place(best, turn + next(each.roll for each in tried if each.pixel is best))


def _rivals(tried: Sequence[_Tried], half: int) -> list[_Tried]:
    """The best of ``tried``, which are sorted, and the best at each other place that is about as good."""
    kept = list[_Tried]()
    for one in tried:
        if one.score < tried[0].score - MARGIN or len(kept) == _MOST_RIVALS:
            break
        if all(np.linalg.norm(one.pixel - other.pixel) > APART * half for other in kept):
            kept.append(one)
    return kept


def _finely(image: Image, eye: CameraModel, taught: Taught, expected: Array, found: _Tried) -> _Tried:
    """A place that was found in the coarse picture, looked at in the fine one, in finer sizes and turns."""
    best = found._replace(score=0.0)
    for scale in found.scale * np.array(_FINER_SCALES):
        for roll in found.roll + np.radians(_FINER_ROLLS_DEG):
            X = turned(expected, float(roll))
            drawn = drawn_as_seen(eye, taught, X, len(taught.grey) // 2, float(scale))
            for place, score in places_like(image, drawn, (found.pixel, _FINE_REACH_PX), len(drawn) // 2)[:1]:
                if score > best.score:
                    texture = texture_alike(image, drawn, place)
                    best = _Tried(place, score, float(scale), float(roll), texture)
    return best


def _of_its_texture(tried: list[_Tried]) -> list[_Tried]:
    """Those whose fine texture agrees about as well as that of any, best correlation first."""
    limit = max(each.texture for each in tried) - TEXTURE_MARGIN
    return sorted((each for each in tried if each.texture > limit), key=lambda each: -each.score)


def texture_alike(image: Image, drawn: Image, place: Array) -> float:
    """How well the fine texture at ``place`` (2,) px agrees with ``drawn``: the median over blocks, each
    within a few px of its place.

    The edge of a shade looks alike wherever it goes; what it falls on does not.
    """
    side, (u, v) = len(drawn) // 2, np.rint(place).astype(int)
    top, left = max(v - side - _BLOCK_REACH_PX, 0), max(u - side - _BLOCK_REACH_PX, 0)
    seen = _without_slow(image[top : v + side + 1 + _BLOCK_REACH_PX, left : u + side + 1 + _BLOCK_REACH_PX])
    wanted, alike = _without_slow(drawn), list[float]()
    for row in range(0, len(drawn) - _BLOCK_PX + 1, _BLOCK_PX):
        for column in range(0, len(drawn) - _BLOCK_PX + 1, _BLOCK_PX):
            y, x = v - side + row - top, u - side + column - left  # of the block in what is seen
            about = seen[
                max(y - _BLOCK_REACH_PX, 0) : y + _BLOCK_PX + _BLOCK_REACH_PX,
                max(x - _BLOCK_REACH_PX, 0) : x + _BLOCK_PX + _BLOCK_REACH_PX,
            ]
            block = wanted[row : row + _BLOCK_PX, column : column + _BLOCK_PX]
            if min(about.shape) >= _BLOCK_PX:
                alike.append(float(cv2.matchTemplate(about, block, cv2.TM_CCOEFF_NORMED).max()))
    return float(np.median(alike)) if alike else 0.0


def _without_slow(part: Image) -> Array:
    grey = part.astype(np.float32)
    return np.asarray(cv2.GaussianBlur(grey, (0, 0), 1.0) - cv2.GaussianBlur(grey, (0, 0), 4.0))


def drawn_as_seen(eye: CameraModel, taught: Taught, X: Array, half: int, scale: float = 1.0) -> Image:
    """The taught patch as the eye sees it at ``X``, (m, m), ``scale`` times as fine."""
    u, v = intrinsics.project(eye, X[None, :3, 3])[0]
    side = max(int(half * scale * float(taught.texel_m * eye.K[0, 0] / X[2, 3]) * 0.8), 6)
    offsets = np.arange(-side, side + 1) / (scale if scale > 0.0 else 1.0)
    columns, rows = np.meshgrid(u + offsets, v + offsets)
    rays = intrinsics.normalised(eye, np.column_stack([columns.ravel(), rows.ravel()]))
    directions = np.column_stack([rays, np.ones(len(rays))])
    n = X[:3, 2]
    on = ((n @ X[:3, 3]) / (directions @ n))[:, None] * directions - X[:3, 3]
    x, y = (on @ X[:3, 0] / taught.texel_m + half, -(on @ X[:3, 1]) / taught.texel_m + half)
    shape = columns.shape
    grey = taught.grey.astype(np.float32)
    picture = cv2.remap(
        grey, x.reshape(shape).astype(np.float32), y.reshape(shape).astype(np.float32), cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )  # fmt: skip
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8)


def places_like(
    image: Image, drawn: Image, about: tuple[Array, int] | None, half: int
) -> list[tuple[Array, float]]:
    """Places (2,) px that look like ``drawn``, best first, and their correlations."""
    left = top = 0
    side = len(drawn) // 2
    part = image
    if about is not None:
        (u, v), reach = np.rint(about[0]).astype(int), about[1] + side
        left, top = max(u - reach, 0), max(v - reach, 0)
        part = image[top : max(v + reach + 1, 0), left : max(u + reach + 1, 0)]
    if min(part.shape) < len(drawn) + 2:
        return []
    scores = cv2.matchTemplate(cv2.GaussianBlur(part, (5, 5), 0.8), drawn, cv2.TM_CCOEFF_NORMED)
    size = 2 * max(int(APART * half), 2) + 1
    peaks = (scores >= cv2.dilate(scores, np.ones((size, size), np.uint8))) & (scores > 0.4)
    rows, columns = np.nonzero(peaks)
    order = np.argsort(-scores[rows, columns], kind="stable")[:20]
    return [
        (np.array([columns[k] + left + side, rows[k] + top + side], dtype=np.float64),
         float(scores[rows[k], columns[k]]))
        for k in order
    ]  # fmt: skip


def _only(found: list[tuple[Array, float]], half: int) -> Array:
    if not found or found[0][1] < _LEAST:
        score = found[0][1] if found else 0.0
        raise TargetRefused("target.not_found", f"target: correlation {score:.2f}, {_LEAST} is wanted")
    best, score = found[0]
    for place, other in found[1:]:
        if other > score - MARGIN and np.linalg.norm(place - best) > APART * half:
            raise TargetRefused(
                "target.ambiguous", f"target: the place at ({place[0]:.0f}, {place[1]:.0f}) px looks as alike"
            )
    return best


def turned(X: Array, angle: float) -> Array:
    """``X`` (4, 4) turned about its z by ``angle``, rad."""
    return np.asarray(X @ se3.transform(se3.exp_so3(np.array([0.0, 0.0, angle])), np.zeros(3)))
