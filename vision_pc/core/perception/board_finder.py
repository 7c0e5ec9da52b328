"""The corners of a board in one picture, by one finder after another, the same for every command."""

from collections import Counter
from collections.abc import Iterable

import numpy as np

from protocol.errors import MeasurementFailed
from vision_pc.config.choices import Detector
from vision_pc.core.perception import zhang_intrinsics as zhang
from vision_pc.core.perception.april_grid import AprilGrid, Board, find_april_grid
from vision_pc.core.perception.stereo_fit import PairView
from vision_pc.core.perception.zhang_intrinsics import BoardView, Charuco, Checkerboard
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image

_OLD_PATTERN = "the pattern of before OpenCV 4.6, which begins with a marker"


def find_board(image: Image, board: Board, name: str, detector: Detector = Detector.SECTORS) -> BoardView:
    """The board's corners, in the board's order whichever way up the picture shows it.

    Where ``detector`` fails the others are tried, and of a ChArUco board the pattern that older programs
    print; ``second`` of the view tells which. Raises MeasurementFailed when all have failed.
    """
    if isinstance(board, AprilGrid):
        return find_april_grid(image, board, name)
    if isinstance(board, Charuco):
        try:
            return zhang.find_charuco(image, board, name)
        except MeasurementFailed as failure:
            try:
                found = zhang.find_charuco(image, board, name, old_pattern=True)
            except MeasurementFailed:
                raise failure from None
            return found._replace(second=_OLD_PATTERN)
    failures = []
    for one in dict.fromkeys((detector, Detector.SECTORS, Detector.FITTED)):
        try:
            view = zhang.find_checkerboard(image, board, one, name)
        except MeasurementFailed as failure:
            failures.append(failure)
        else:
            second = "" if one is detector else f"corners {one}, as {detector} failed"
            return _upright(image, view, board)._replace(second=second)
    raise failures[0]


def second_finders(views: Iterable[BoardView | PairView]) -> list[str]:
    """In how many views another finder than the first was needed, a line for each."""
    counts = Counter(view.second for view in views if view.second)
    return [f"{count} of the boards found by {second}" for second, count in counts.items()]


def _upright(image: Image, view: BoardView, board: Checkerboard) -> BoardView:
    """The view with its corners counted from the same end whichever finder began at which."""
    grid = view.pixels.reshape(board.rows, board.columns, 2)
    if (
        board.columns + board.rows
    ) % 2:  # half a turn would exchange black and white: the first square is black
        turned = _grey(image, grid[:2, :2]) > _grey(image, grid[:2, 1:3])
    else:
        turned = bool(grid[0, -1, 0] < grid[0, 0, 0])
    return view._replace(pixels=view.pixels[::-1]) if turned else view


def _grey(image: Image, corners: Array) -> float:
    x, y = np.round(corners.reshape(-1, 2).mean(axis=0)).astype(int)
    return float(image[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2].mean())
