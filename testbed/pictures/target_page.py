"""A marker or board on a page at true scale: its black cells in mm, and the page with rulers."""

import io
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline

from protocol.errors import RequestRefused
from testbed.reporting.console import out, write_json
from vision_pc.core.perception.zhang_intrinsics import Charuco, Checkerboard, charuco_board
from vision_pc.core.se3 import Array

_QUIET_SQUARES = 0.2  # [D] white around a board, in squares; detectors ask for less


class TargetShape(NamedTuple):
    """``cells`` (n, 4) mm: x, y, width, height of black rectangles; ``size_mm`` (width, height) of the whole
    target, ``quiet_mm`` the white that it needs around; ``description`` says what it is.
    """

    cells: Array
    size_mm: tuple[float, float]
    quiet_mm: float
    description: str


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
        description = f"checkerboard of {board.columns}x{board.rows} inner corners, squares of {side:g} mm"
        return TargetShape(
            _squares(columns, rows, side), (columns * side, rows * side), _QUIET_SQUARES * side, description
        )
    family = cv2.aruco.getPredefinedDictionary(board.dictionary)
    needed_markers, count = board.columns * board.rows // 2, len(family.bytesList)
    marker_mm = 1e3 * board.marker_m
    if not 0.0 < marker_mm < side:
        raise RequestRefused(
            "refused.target.board", f"markers of {marker_mm:g} mm do not fit into squares of {side:g}"
        )
    if needed_markers > count:
        raise RequestRefused(
            "refused.target.board", f"{needed_markers} markers are needed, {dictionary} has {count}"
        )
    drawn = charuco_board(board)
    cells = [_squares(board.columns, board.rows, side)]
    for number, corners in zip(np.asarray(drawn.getIds()).ravel(), drawn.getObjPoints(), strict=True):
        corner = 1e3 * np.asarray(corners, dtype=np.float64).reshape(4, 3)[0, :2]
        cells.append(_marker_cells(family, int(number), marker_mm) + np.array([*corner, 0.0, 0.0]))
    description = (
        f"ChArUco board of {board.columns}x{board.rows} squares of {side:g} mm, "
        f"{dictionary} markers of {marker_mm:g} mm"
    )
    size = (board.columns * side, board.rows * side)
    return TargetShape(np.concatenate(cells), size, _QUIET_SQUARES * side, description)


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
    ends = np.argwhere(np.diff(np.pad(white, ((0, 0), (1, 1)), constant_values=True)))
    starts, stops = ends[::2], ends[1::2, 1]
    return np.array(
        [(a * module, y * module, (b - a) * module, module) for (y, a), b in zip(starts, stops, strict=True)]
    )


PAPERS_MM = {"a4": (210.0, 297.0), "a3": (297.0, 420.0), "letter": (215.9, 279.4)}  # [S] ISO 216, ANSI Y14.1
_MARGIN_MM = 5.0  # [D] printers leave 3 to 4.2 mm white
_LEFT_MM, _BELOW_MM = 9.0, 14.0  # [D] the strips of the rulers
_RULER_MM = 100
_INCH_MM = 25.4


class Page(NamedTuple):
    """``size_mm`` (width, height) of the paper, ``corner_mm`` (x, y) the target's upper left one on it, from
    the paper's upper left corner.
    """

    size_mm: tuple[float, float]
    corner_mm: tuple[float, float]


def placed(shape: TargetShape, paper: str, size_mm: float) -> Page:
    """Where the target lies on the paper, upright or across; ``size_mm`` is what was asked for.

    Raises RequestRefused: ``refused.target.paper``, ``refused.target.does_not_fit``.
    """
    if paper not in PAPERS_MM:
        raise RequestRefused("refused.target.paper", f"{paper!r}: one of {', '.join(PAPERS_MM)} is wanted")
    needed = np.array(shape.size_mm) + 2.0 * shape.quiet_mm
    scales = []
    for size in (PAPERS_MM[paper], PAPERS_MM[paper][::-1]):
        free = np.array(size) - 2.0 * _MARGIN_MM - (_LEFT_MM, _BELOW_MM)
        scales.append(float((free / needed).min()))
        if scales[-1] >= 1.0:
            x, y = (_MARGIN_MM + _LEFT_MM, _MARGIN_MM) + 0.5 * (free - np.array(shape.size_mm))
            return Page(size, (float(x), float(y)))
    largest = np.floor(10.0 * size_mm * max(scales)) / 10.0
    raise RequestRefused(
        "refused.target.does_not_fit",
        f"{shape.description}: {needed[0]:.1f} x {needed[1]:.1f} mm with the white around; with its rulers "
        f"{paper} has room for --size-mm {largest:g} at most",
    )


def run_target(shape: TargetShape, paper: str, size_mm: float, to: Path, json_file: Path | None) -> None:
    """Write the page. Raises RequestRefused where it cannot be, OSError where the file cannot."""
    if to.suffix.lower() != ".pdf":
        raise RequestRefused("refused.target.format", f"{to}: a name that ends in .pdf is wanted")
    page = placed(shape, paper, size_mm)
    _draw(shape, page, to)
    width, height = page.size_mm
    out.print(
        f"{to}: {shape.description}, on {paper} ({width:g} x {height:g} mm)", highlight=False, soft_wrap=True
    )
    out.print(
        f"print it at 100 % (not 'fit to page'); both rulers must measure {_RULER_MM} mm, else give the "
        "measured size to what reads the pictures",
        highlight=False,
        soft_wrap=True,
    )
    written = {"description": shape.description, "target_mm": shape.size_mm, "paper": paper}
    write_json(json_file, page._asdict() | written | {"cells_mm": len(shape.cells)})


def _draw(shape: TargetShape, page: Page, to: Path) -> None:
    width, height = page.size_mm
    figure = Figure(figsize=(width / _INCH_MM, height / _INCH_MM), frameon=False)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), xlim=(0.0, width), ylim=(height, 0.0))
    axes.set_axis_off()
    _fill(axes, shape.cells + np.array([*page.corner_mm, 0.0, 0.0]))
    _fill(axes, _ruler(_MARGIN_MM + _LEFT_MM, height - _MARGIN_MM - 8.0))
    _fill(axes, _ruler(_MARGIN_MM, _MARGIN_MM)[:, [1, 0, 3, 2]])
    axes.text(
        _MARGIN_MM + _LEFT_MM, height - _MARGIN_MM, f"{shape.description}. Print at 100 %: both rulers are "
        f"{_RULER_MM} mm.", fontsize=7, va="bottom",
    )  # fmt: skip
    drawn = io.BytesIO()  # zlib has words of its own for a full disk
    figure.savefig(drawn, format="pdf", metadata={"CreationDate": None})
    to.write_bytes(drawn.getvalue())


def _ruler(x: float, y: float) -> Array:
    """A tick a millimetre from ``x`` on, downwards to ``y``, longer ones at 5 and 10."""
    lengths = [4.0 if k % 10 == 0 else 3.0 if k % 5 == 0 else 2.0 for k in range(_RULER_MM + 1)]
    ticks = [(x + k - 0.05, y, 0.1, length) for k, length in enumerate(lengths)]
    return np.array([*ticks, (x, y - 0.05, float(_RULER_MM), 0.1)])


def _fill(axes: Axes, cells: Array) -> None:
    """Fill the cells as one path, so that no viewer shows seams between neighbours."""
    corners = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0), (0.0, 0.0)])
    points = cells[:, None, :2] + corners * cells[:, None, 2:]
    codes = [Outline.MOVETO, Outline.LINETO, Outline.LINETO, Outline.LINETO, Outline.CLOSEPOLY] * len(cells)
    axes.add_patch(PathPatch(Outline(points.reshape(-1, 2), codes), facecolor="black", linewidth=0.0))
