"""Points followed from picture to picture: good features spread over a grid, and Lucas-Kanade
tracking.
"""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vision_pc.core.odometry.limits import GRID_COLUMNS, GRID_ROWS
from vision_pc.core.se3 import Array
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


Flags = NDArray[np.bool_]

_BLOCK = 7  # px: neighbourhood whose gradients make a feature good
_QUALITY = 0.01  # [D] relative to the best feature of the picture
_LEAST_EIGENVALUE = 1e-5  # [M] absolute floor; a smoothed wall at a fifth of the contrast has 4e-5
_WINDOW_PX = 21  # [D] of Lucas-Kanade, for new points
_HALVED_WINDOW_PX = 15  # [M] the same for known points, in pictures of half the size
_LEVELS = 4  # [D] of the pyramid
_BACK_ERROR_PX = 0.5  # [D] forward-backward tracking
_STEPS = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 0.003)
_COARSE_STEPS = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 10, 0.03)
_SAME_LIGHT = 0.02
_BORDER = 8  # px: a window this close to the rim has lost too much of itself


class TrackedPoints(NamedTuple):
    """Where points went, (n, 2) px, and which of them may be believed, (n,)."""

    points: Array
    good: Flags


def features(image: Image, allowed: Flags, taken: Array, most: int) -> Array:
    """New features (n, 2) px, at most one in each grid cell that holds none of ``taken`` (m, 2);
    ``most`` with those.

    ``allowed`` (height, width): False where nothing may be picked up. A feature's structure tensor must
    have a least eigenvalue above an absolute floor (noise on a blank wall has none) and above a share of
    the picture's best.
    """
    response = cv2.cornerMinEigenVal(image, _BLOCK, ksize=3)
    response[~allowed] = 0.0
    inner = np.zeros_like(allowed)
    inner[_BORDER:-_BORDER, _BORDER:-_BORDER] = True
    response[~inner] = 0.0
    floor = max(_LEAST_EIGENVALUE, _QUALITY * float(response.max()))
    rows = np.linspace(0, image.shape[0], GRID_ROWS + 1).astype(int)
    columns = np.linspace(0, image.shape[1], GRID_COLUMNS + 1).astype(int)
    occupied = grid_cells(taken, image.shape)
    found = []
    for i in range(GRID_ROWS):
        for j in range(GRID_COLUMNS):
            if occupied[i, j]:
                continue
            cell = response[rows[i] : rows[i + 1], columns[j] : columns[j + 1]]
            _, best, _, (x, y) = cv2.minMaxLoc(cell)
            if best >= floor:
                found.append((best, columns[j] + x, rows[i] + y))
    found.sort(reverse=True)
    room = max(most - len(taken), 0)
    return np.array([(x, y) for _, x, y in found[:room]], dtype=np.float64).reshape(-1, 2)


def grid_cells(points: Array, shape: tuple[int, ...]) -> Flags:
    """Which cells (rows, columns) of a picture of ``shape`` hold at least one of ``points`` (n,
    2).
    """
    cells = np.zeros((GRID_ROWS, GRID_COLUMNS), dtype=bool)
    if len(points):
        row = np.clip(points[:, 1] * GRID_ROWS / shape[0], 0, GRID_ROWS - 1).astype(int)
        column = np.clip(points[:, 0] * GRID_COLUMNS / shape[1], 0, GRID_COLUMNS - 1).astype(int)
        cells[row, column] = True
    return cells


def alike(image: Image, other: Image) -> Image:
    """``image`` as bright as ``other`` is: exposures differ from picture to picture, and flow is followed by
    grey levels.
    """
    gain = (cv2.mean(other)[0] + 1.0) / (cv2.mean(image)[0] + 1.0)
    if abs(gain - 1.0) < _SAME_LIGHT:
        return image
    return np.asarray(cv2.convertScaleAbs(image, alpha=gain), dtype=np.uint8)


def inside(pixels: Array, static: Flags) -> Flags:
    """Which of ``pixels`` (n, 2) lie in the picture, where ``static`` (height, width) is True; NaN does
    not.
    """
    height, width = static.shape
    finite = np.isfinite(pixels).all(axis=1)
    column, row = np.where(finite, pixels[:, 0], -1.0), np.where(finite, pixels[:, 1], -1.0)
    within = (column >= 0) & (column < width - 1) & (row >= 0) & (row < height - 1)
    return np.asarray(
        within & static[np.where(within, row, 0).astype(int), np.where(within, column, 0).astype(int)]
    )


def track(
    before: Image,
    after: Image,
    points: Array,
    guess: Array,
    window_px: int = _WINDOW_PX,
    levels: int = _LEVELS,
) -> TrackedPoints:
    """``points`` (n, 2) of ``before`` found in ``after``, starting at ``guess`` (n, 2).

    Believed when found inside the picture and the way back ends where it began.
    """
    if len(points) == 0:
        return TrackedPoints(np.zeros((0, 2)), np.zeros(0, dtype=bool))
    start = _as_flow(points)
    there, found = _flow(before, after, start, _as_flow(guess), window_px, levels, _STEPS)
    back, returned = _flow(after, before, there, start.copy(), window_px, levels, _STEPS)
    error = np.linalg.norm((back - start).reshape(-1, 2), axis=1)
    return TrackedPoints(
        there.reshape(-1, 2).astype(np.float64),
        found & _within(there, after) & returned & (error < _BACK_ERROR_PX),
    )


def halved(image: Image) -> Image:
    """``image`` at half its width and height, each pixel the mean of four; an odd last row or column is left
    out.
    """
    height, width = image.shape[0] // 2, image.shape[1] // 2
    whole = image[: 2 * height, : 2 * width]
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def track_halved(before: Image, after: Image, points: Array, guess: Array) -> TrackedPoints:
    """``points`` (n, 2) px of a whole picture found in another to within about a pixel, from both ``halved``.

    Starts at ``guess`` (n, 2) px of the whole picture. One way only: for who matches patches afterwards.
    """
    if len(points) == 0:
        return TrackedPoints(np.zeros((0, 2)), np.zeros(0, dtype=bool))
    # a pixel's middle is at whole numbers: that of four pixels lies half a pixel from their first
    start, there = _as_flow(0.5 * points - 0.25), _as_flow(0.5 * guess - 0.25)
    there, found = _flow(before, after, start, there, _HALVED_WINDOW_PX, _LEVELS, _COARSE_STEPS)
    return TrackedPoints(2.0 * there.reshape(-1, 2).astype(np.float64) + 0.5, found & _within(there, after))


def _as_flow(points: Array) -> NDArray[np.float32]:
    return np.ascontiguousarray(points, dtype=np.float32).reshape(-1, 1, 2)


def _within(points: NDArray[np.float32], image: Image) -> Flags:
    """Which of ``points`` (n, 1, 2) keep off the rim of ``image``."""
    height, width = image.shape
    ends = points.reshape(-1, 2)
    return np.asarray(((ends >= _BORDER) & (ends < (width - _BORDER, height - _BORDER))).all(axis=1))


def _flow(
    before: Image,
    after: Image,
    points: NDArray[np.float32],
    guess: NDArray[np.float32],
    window_px: int,
    levels: int,
    steps: tuple[int, int, float],
) -> tuple[NDArray[np.float32], Flags]:
    window = (window_px, window_px)
    ends, status, _ = cv2.calcOpticalFlowPyrLK(
        before,
        after,
        points,
        guess,
        winSize=window,
        maxLevel=levels - 1,
        criteria=steps,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        minEigThreshold=1e-4,
    )
    return np.asarray(ends, dtype=np.float32), np.asarray(status).ravel().astype(bool)
