"""Kalibr's AprilGrid: a board of tag36h11 with black squares where their corners meet."""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from protocol.errors import MeasurementFailed, RequestRefused
from vision_pc.core.perception.zhang_intrinsics import BoardView, PlainBoard
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image

_BORDERS = (2, 1)  # black modules around the code: Kalibr's drawing has two, other programs' one
_MODULES = 6
_LEAST_TAGS = 2
_OFF = 0.2  # [D] of a tag's side, and of the spacing, that gaps in pictures may be off
_UNTIL = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-4)


class AprilGrid(NamedTuple):
    """``columns`` × ``rows`` tags of ``tag_m`` from black edge to black edge, the gap between them
    ``spacing`` times that; the lower left one is number ``first``, the next one right of it.

    The board's axes: x right, y up, origin at the lower left corner of the lower left tag.
    """

    columns: int
    rows: int
    tag_m: float
    spacing: float
    first: int = 0

    def points_m(self, numbers: NDArray[np.int64]) -> Array:
        """The corners (n, 4, 3) of tags ``numbers`` (n,) in OpenCV's order, from the lower right one
        clockwise: Kalibr draws each tag half a turn from OpenCV's picture of it.
        """
        row, column = np.divmod(np.asarray(numbers) - self.first, self.columns)
        at = np.stack([column, row], axis=-1)[:, None] * (1.0 + self.spacing)
        corners = at + np.array([[1.0, 0.0], [0.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
        return self.tag_m * np.pad(corners, ((0, 0), (0, 0), (0, 1)))

    def all_points_m(self) -> Array:
        """The corners (4 n, 3) of all its tags, in the order of their numbers."""
        return self.points_m(self.first + np.arange(self.columns * self.rows)).reshape(-1, 3)


Board = PlainBoard | AprilGrid


def find_april_grid(image: Image, board: AprilGrid, name: str) -> BoardView:
    """The corners of the tags that one grey picture shows.

    Raises MeasurementFailed (``measurement.intrinsics.no_board``) naming the view for fewer than 2 tags, and
    RequestRefused (``refused.board.counts``, ``.spacing``) where the tags stand otherwise than it says.
    """
    book = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    for border in _BORDERS:
        settings = cv2.aruco.DetectorParameters()
        settings.markerBorderBits = border
        corners, found, _ = cv2.aruco.ArucoDetector(book, settings).detectMarkers(image)
        numbers = np.array([], dtype=np.int64) if found is None else np.asarray(found, dtype=np.int64).ravel()
        if len(numbers) >= _LEAST_TAGS:
            break
    else:
        raise MeasurementFailed(
            "measurement.intrinsics.no_board", f"view {name}: {len(numbers)} tags, {_LEAST_TAGS} are needed"
        )
    pixels = np.asarray(corners, dtype=np.float64).reshape(-1, 4, 2)
    module = np.linalg.norm(pixels - np.roll(pixels, 1, axis=1), axis=-1).min(axis=1) / (
        _MODULES + 2 * border
    )
    for quad, reach in zip(pixels, np.maximum(1, 0.5 * border * module).astype(int).tolist(), strict=True):
        refined = cv2.cornerSubPix(
            image, quad.astype(np.float32).reshape(4, 1, 2), (reach, reach), (-1, -1), _UNTIL
        )
        quad[:] = refined.reshape(4, 2)
    _require_as_shown(board, dict(zip(numbers.tolist(), pixels, strict=True)), name)
    second = "" if border == _BORDERS[0] else "tags with one black module around them"
    return BoardView(name, board.points_m(numbers).reshape(-1, 3), pixels.reshape(-1, 2), second)


def _require_as_shown(board: AprilGrid, shown: dict[int, Array], name: str) -> None:
    """Raises RequestRefused where numbers or gaps are not those of the board."""
    last = board.first + board.columns * board.rows - 1
    beyond = [number for number in sorted(shown) if not board.first <= number <= last]
    why = f"view {name} shows tag {beyond[0]}; " if beyond else f"view {name}: "
    beside = _gap(shown, 1, (0, 3), (1, 2))
    above = {step: _gap(shown, step, (3, 2), (0, 1)) for step in range(2, max(shown) + 1)}
    rows_of = min(above, key=lambda step: abs(above[step] - beside), default=board.columns)
    sure = np.isfinite(beside) and abs(above.get(rows_of, np.inf) - beside) < _OFF
    if beyond or (sure and rows_of != board.columns and board.rows > 1):
        counted = f"; rows of {rows_of} tags are seen" if sure else ""
        raise RequestRefused(
            "refused.board.counts",
            f"{why}tagCols = {board.columns} and tagRows = {board.rows} have "
            f"{board.first} to {last}{counted}",
        )
    if np.isfinite(beside) and abs(beside - board.spacing) > max(_OFF * board.spacing, 0.05):
        raise RequestRefused(
            "refused.board.spacing",
            f"{why}tagSpacing = {board.spacing:g}: gaps of {beside:.2f} tags are seen; it is the gap over "
            "tagSize, no length",
        )


def _gap(shown: dict[int, Array], step: int, ours: tuple[int, int], theirs: tuple[int, int]) -> float:
    """The median gap, in sides of a tag, between tags whose numbers differ by ``step``: infinite where there
    is no such pair in line. ``ours``: the ends of our side that face the other tag, ``theirs`` the far ends.
    """
    gaps = []
    for number, quad in shown.items():
        if number + step in shown:
            other = shown[number + step]
            away = quad[list(ours)] - quad[list(theirs)]
            between = other[list(theirs)] - quad[list(ours)]
            along = np.sum(away * between) / np.sum(away * away)
            gaps.append(float(abs(along) + np.linalg.norm(between - along * away) / np.linalg.norm(away)))
    return float(np.median(gaps)) if gaps else np.inf
