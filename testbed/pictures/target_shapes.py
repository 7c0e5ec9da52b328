"""Black cells of markers and boards in mm, as they must be printed: x right, y down, from the upper left."""

from typing import NamedTuple

import cv2
import numpy as np

from protocol.errors import RequestRefused
from vision_pc.core.perception.zhang_intrinsics import Charuco, Checkerboard, charuco_board
from vision_pc.core.se3 import Array

_QUIET_SQUARES = 0.2  # [D] white around a board, in squares; detectors ask for less


class TargetShape(NamedTuple):
    """``cells`` (n, 4) mm: x, y, width, height of black rectangles; ``size_mm`` (width, height) of the whole
    target, ``quiet_mm`` the white that it needs around; ``told`` says what it is.
    """

    cells: Array
    size_mm: tuple[float, float]
    quiet_mm: float
    told: str


def marker_shape(dictionary: str, number: int, side_mm: float) -> TargetShape:
    """Marker ``number``, black border to black border ``side_mm``.

    Raises RequestRefused: ``refused.target.dictionary``, ``refused.target.number``.
    """
    family = cv2.aruco.getPredefinedDictionary(dictionary_number(dictionary))
    count = len(family.bytesList)
    if not 0 <= number < count:
        raise RequestRefused(
            "refused.target.number", f"{dictionary} has markers 0 to {count - 1}, not {number}"
        )
    cells = _marker_cells(family, number, side_mm)
    quiet = side_mm / (family.markerSize + 2)
    return TargetShape(cells, (side_mm, side_mm), quiet, f"{dictionary} marker {number}, side {side_mm:g} mm")


def board_shape(board: Checkerboard | Charuco, dictionary: str = "") -> TargetShape:
    """The board, whose squares have ``square_m``; a checkerboard's first square is black.

    Raises RequestRefused ``refused.target.board`` for markers that do not fit into their squares and for more
    squares than the dictionary has markers for.
    """
    side = 1e3 * board.square_m
    if isinstance(board, Checkerboard):
        columns, rows = board.columns + 1, board.rows + 1
        told = f"checkerboard of {board.columns}x{board.rows} inner corners, squares of {side:g} mm"
        return TargetShape(
            _squares(columns, rows, side), (columns * side, rows * side), _QUIET_SQUARES * side, told
        )
    family = cv2.aruco.getPredefinedDictionary(board.dictionary)
    wanted, count = board.columns * board.rows // 2, len(family.bytesList)
    marker_mm = 1e3 * board.marker_m
    if not 0.0 < marker_mm < side:
        raise RequestRefused(
            "refused.target.board", f"markers of {marker_mm:g} mm do not fit into squares of {side:g}"
        )
    if wanted > count:
        raise RequestRefused("refused.target.board", f"{wanted} markers are needed, {dictionary} has {count}")
    drawn = charuco_board(board)
    cells = [_squares(board.columns, board.rows, side)]
    for number, corners in zip(np.asarray(drawn.getIds()).ravel(), drawn.getObjPoints(), strict=True):
        corner = 1e3 * np.asarray(corners, dtype=np.float64).reshape(4, 3)[0, :2]
        cells.append(_marker_cells(family, int(number), marker_mm) + np.array([*corner, 0.0, 0.0]))
    told = (
        f"ChArUco board of {board.columns}x{board.rows} squares of {side:g} mm, "
        f"{dictionary} markers of {marker_mm:g} mm"
    )
    size = (board.columns * side, board.rows * side)
    return TargetShape(np.concatenate(cells), size, _QUIET_SQUARES * side, told)


def dictionary_number(name: str) -> int:
    """OpenCV's number of the dictionary. Raises RequestRefused (``refused.target.dictionary``)."""
    value = getattr(cv2.aruco, name, None)
    if not name.startswith("DICT_") or not isinstance(value, int):
        raise RequestRefused(
            "refused.target.dictionary",
            f"OpenCV has no dictionary {name!r}; DICT_5X5_1000, DICT_APRILTAG_36h11 are two of its names",
        )
    return value


def _squares(columns: int, rows: int, side: float) -> Array:
    return np.array(
        [(x * side, y * side, side, side) for y in range(rows) for x in range(columns) if (x + y) % 2 == 0]
    )


def _marker_cells(family: cv2.aruco.Dictionary, number: int, side: float) -> Array:
    """Runs of black modules, row by row."""
    modules = family.markerSize + 2
    white = np.asarray(family.generateImageMarker(number, modules)) > 0
    module = side / modules
    runs = []
    for y, row in enumerate(white):
        edges = np.flatnonzero(np.diff(np.concatenate([[1], row.astype(int), [1]])))
        runs += [(a * module, y * module, (b - a) * module, module) for a, b in edges.reshape(-1, 2)]
    return np.array(runs)
