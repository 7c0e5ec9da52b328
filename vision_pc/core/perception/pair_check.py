"""What pairs say of the camera that took them: rows that belong together, eyes exchanged, sharpness,
exposure.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vision_pc.core import se3
from vision_pc.core.perception import intrinsics
from vision_pc.core.perception.stereo_fit import PairView
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, Image, PointPairs, StereoOffset, StereoPair


def board_offset(views: Sequence[PairView], camera: CameraCalibration) -> StereoOffset | None:
    """How far the right picture is off what the left one predicts, px; None without a board.

    The board's pose comes from the left eye alone, its range from the size of the squares. ``std_*``: of the
    mean over the views, by how they differ.
    """
    found = []
    for view in views:
        rays = intrinsics.normalised(camera.left, view.left)
        _, turn, shift = cv2.solvePnP(view.points_m, rays, np.eye(3), np.zeros(5))
        points = se3.apply(se3.transform(se3.exp_so3(turn.ravel()), shift.ravel()), view.points_m)
        found.append(np.median(view.right - intrinsics.project(camera.right, points), axis=0))
    if not found:
        return None
    offsets = np.array(found)
    spread = (
        np.std(offsets, axis=0, ddof=1) / np.sqrt(len(offsets)) if len(offsets) > 1 else np.full(2, np.nan)
    )
    x, y = np.median(offsets, axis=0)
    return StereoOffset(float(x), float(y), float(spread[0]), float(spread[1]))


ROWS, COLUMNS = 3, 4
_FEATURES = 1500
_WINDOW = (15, 15)
_BACK_PX = 0.5
_UNIQUE = 0.8  # a match is so much better than the next best
_BAND_PX = 12.0  # about the most frequent row difference; matches beyond it are chance
_MOST_ROWS_PX = 60.0  # beyond it no camera is meant to be rectified, and matches are chance
_LEAST_IN_CELL = 8
_NORMAL = 1.4826  # standard deviation of a normal error over its median absolute one
_SATURATED, _BLACK = 250, 5


class RowReport(NamedTuple):
    """How far the right eye's rows are below the left's, px, over all matched points.

    ``spread_px`` is a robust standard deviation, ``cells_px`` (3, 4) the median by place in the picture, NaN
    where fewer than 8 points are; ``disparity_px`` the median, negative with exchanged eyes.
    """

    points: int
    median_px: float
    spread_px: float
    cells_px: Array
    disparity_px: float


class PictureReport(NamedTuple):
    """Of one eye: mean grey, shares of white and black pixels, and the width (standard deviation) of its
    edges.
    """

    mean_grey: float
    white_share: float
    black_share: float
    edge_px: float


def matched(pair: StereoPair) -> PointPairs:
    """Points of the left picture and where the right one shows them, (n, 2) px each, n may be 0."""
    orb = cv2.ORB.create(nfeatures=_FEATURES)
    found = [orb.detectAndCompute(picture, None) for picture in (pair.left, pair.right)]
    none = np.zeros((0, 2))
    if any(descriptors is None for _, descriptors in found):
        return PointPairs(none, none)
    two = cv2.BFMatcher(cv2.NORM_HAMMING).knnMatch(found[0][1], found[1][1], k=2)
    # what repeats, as squares do, fits twice
    matches = [pair[0] for pair in two if len(pair) == 2 and pair[0].distance < _UNIQUE * pair[1].distance]
    left = np.array([found[0][0][m.queryIdx].pt for m in matches], dtype=np.float32).reshape(-1, 2)
    right = np.array([found[1][0][m.trainIdx].pt for m in matches], dtype=np.float32).reshape(-1, 2)
    near = np.abs(right[:, 1] - left[:, 1]) < _MOST_ROWS_PX
    left, right = left[near], right[near]
    if not len(left):
        return PointPairs(none, none)
    fine, ok = _follow_points(pair.left, pair.right, left, right)
    back, back_ok = _follow_points(pair.right, pair.left, fine, left)
    good = ok & back_ok & (np.abs(back - left).max(axis=1) < _BACK_PX)
    return PointPairs(left[good].astype(np.float64), np.asarray(fine, dtype=np.float64)[good])


def _follow_points(
    before: Image, after: Image, points: NDArray[np.float32], guess: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Where ``points`` (n, 2) of ``before`` are in ``after``, near ``guess`` (n, 2), and which were found."""
    ends, found, _ = cv2.calcOpticalFlowPyrLK(
        before, after, points, guess.copy(), winSize=_WINDOW, maxLevel=0, flags=cv2.OPTFLOW_USE_INITIAL_FLOW
    )
    return np.asarray(ends, dtype=np.float32), np.asarray(found).ravel() > 0


def rows_of(points: Sequence[PointPairs], size: tuple[int, int]) -> RowReport | None:
    """What matched points of all pairs, pictures of ``size`` (width, height), say of the rows; None of
    none.
    """
    left = np.concatenate([np.zeros((0, 2)), *(one.left for one in points)])
    right = np.concatenate([np.zeros((0, 2)), *(one.right for one in points)])
    if not len(left):
        return None
    down = right[:, 1] - left[:, 1]
    band = np.abs(down - _densest(down)) < _BAND_PX
    left, right, down = left[band], right[band], down[band]
    median = float(np.median(down))
    inner = np.abs(down - median) < max(6.0 * _NORMAL * float(np.median(np.abs(down - median))), 1.0)
    left, right, down = left[inner], right[inner], down[inner]
    cells = np.full((ROWS, COLUMNS), np.nan)
    row = np.clip(left[:, 1] * ROWS / size[1], 0, ROWS - 1).astype(int)
    column = np.clip(left[:, 0] * COLUMNS / size[0], 0, COLUMNS - 1).astype(int)
    for i in range(ROWS):
        for j in range(COLUMNS):
            inside = (row == i) & (column == j)
            if inside.sum() >= _LEAST_IN_CELL:
                cells[i, j] = np.median(down[inside])
    median = float(np.median(down))
    spread = _NORMAL * float(np.median(np.abs(down - median)))
    return RowReport(len(down), median, spread, cells, float(np.median(left[:, 0] - right[:, 0])))


def _densest(values: Array) -> float:
    """The middle of the 4 units in which most of ``values`` (n,) lie."""
    edges = np.arange(-_MOST_ROWS_PX - 2.0, _MOST_ROWS_PX + 3.0)
    counts = np.convolve(np.histogram(values, edges)[0], np.ones(4), mode="valid")
    return float(edges[int(np.argmax(counts))] + 2.0)


def picture_report(picture: Image) -> PictureReport:
    """Brightness and sharpness of one picture; ``edge_px`` is NaN where there is no edge to measure."""
    return PictureReport(
        float(picture.mean()),
        float((picture >= _SATURATED).mean()),
        float((picture <= _BLACK).mean()),
        _edge_px(picture),
    )


def _edge_px(picture: Image) -> float:
    """Width of the strongest edges: a step of height h blurred by σ has the gradient h / (σ sqrt(2 π))."""
    smooth = cv2.GaussianBlur(picture, (3, 3), 0.5).astype(np.float32)
    across, down = (cv2.Scharr(smooth, cv2.CV_32F, *order) / 32.0 for order in ((1, 0), (0, 1)))
    gradient = np.hypot(across, down)
    window = np.ones((9, 9), dtype=np.uint8)
    height = cv2.dilate(smooth, window) - cv2.erode(smooth, window)
    strong = (gradient >= np.percentile(gradient, 99.5)) & (height > 40.0)
    if strong.sum() < 50:
        return float("nan")
    widths = height[strong] / (gradient[strong] * np.sqrt(2.0 * np.pi))
    return float(np.percentile(widths, 25.0))  # what is soft in the scene is no fault of the lens
