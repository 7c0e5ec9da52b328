"""Points followed from picture to picture: good features spread over a grid, and two-way Lucas-Kanade
tracking.
"""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vision_pc.config import OdometrySettings
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image

Flags = NDArray[np.bool_]

_BLOCK = 7  # px: neighbourhood whose gradients make a feature good
_STEPS = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 0.003)
_BORDER = 8  # px: a window this close to the rim has lost too much of itself


class Tracked(NamedTuple):
    """Where points went, (n, 2) px, and which of them may be believed, (n,)."""

    points: Array
    good: Flags


def features(image: Image, allowed: Flags, taken: Array, settings: OdometrySettings) -> Array:
    """New features (n, 2) px, at most one in each grid cell that holds none of ``taken`` (m, 2).

    ``allowed`` (height, width): False where nothing may be picked up. A feature's structure tensor must
    have a least eigenvalue above an absolute floor (noise on a blank wall has none) and above a share of
    the picture's best.
    """
    response = cv2.cornerMinEigenVal(image, _BLOCK, ksize=3)
    response[~allowed] = 0.0
    response[:_BORDER], response[-_BORDER:], response[:, :_BORDER], response[:, -_BORDER:] = (
        0.0,
        0.0,
        0.0,
        0.0,
    )
    floor = max(settings.minimum_eigenvalue, settings.quality * float(response.max()))
    rows = np.linspace(0, image.shape[0], settings.grid_rows + 1).astype(int)
    columns = np.linspace(0, image.shape[1], settings.grid_columns + 1).astype(int)
    occupied = grid_cells(taken, image.shape, settings)
    found = []
    for i in range(settings.grid_rows):
        for j in range(settings.grid_columns):
            if occupied[i, j]:
                continue
            cell = response[rows[i] : rows[i + 1], columns[j] : columns[j + 1]]
            _, best, _, (x, y) = cv2.minMaxLoc(cell)
            if best >= floor:
                found.append((best, columns[j] + x, rows[i] + y))
    found.sort(reverse=True)
    room = max(settings.features - len(taken), 0)
    return np.array([(x, y) for _, x, y in found[:room]], dtype=np.float64).reshape(-1, 2)


def grid_cells(points: Array, shape: tuple[int, ...], settings: OdometrySettings) -> Flags:
    """Which cells (grid_rows, grid_columns) of a picture of ``shape`` hold at least one of ``points`` (n,
    2).
    """
    cells = np.zeros((settings.grid_rows, settings.grid_columns), dtype=bool)
    if len(points):
        row = np.clip(points[:, 1] * settings.grid_rows / shape[0], 0, settings.grid_rows - 1).astype(int)
        column = np.clip(
            points[:, 0] * settings.grid_columns / shape[1], 0, settings.grid_columns - 1
        ).astype(int)
        cells[row, column] = True
    return cells


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
    before: Image, after: Image, points: Array, guess: Array, settings: OdometrySettings, two_way: bool
) -> Tracked:
    """``points`` (n, 2) of ``before`` found in ``after``, starting at ``guess`` (n, 2).

    Believed when found inside the picture and, if ``two_way``, the way back ends where it began.
    """
    if len(points) == 0:
        return Tracked(np.zeros((0, 2)), np.zeros(0, dtype=bool))
    start = np.ascontiguousarray(points, dtype=np.float32).reshape(-1, 1, 2)
    there, found = _flow(
        before, after, start, np.asarray(guess, dtype=np.float32).reshape(-1, 1, 2), settings
    )
    height, width = after.shape
    ends = there.reshape(-1, 2).astype(np.float64)
    inside = ((ends >= _BORDER) & (ends < (width - _BORDER, height - _BORDER))).all(axis=1)
    good = found & inside
    if two_way:
        back, returned = _flow(after, before, there, start.copy(), settings)
        error = np.linalg.norm((back - start).reshape(-1, 2), axis=1)
        good &= returned & (error < settings.back_error_px)
    return Tracked(ends, good)


def _flow(
    before: Image,
    after: Image,
    points: NDArray[np.float32],
    guess: NDArray[np.float32],
    settings: OdometrySettings,
) -> tuple[NDArray[np.float32], Flags]:
    window = (settings.window_px, settings.window_px)
    ends, status, _ = cv2.calcOpticalFlowPyrLK(
        before,
        after,
        points,
        guess,
        winSize=window,
        maxLevel=settings.pyramid_levels - 1,
        criteria=_STEPS,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        minEigThreshold=1e-4,
    )
    return np.asarray(ends, dtype=np.float32), np.asarray(status).ravel().astype(bool)
