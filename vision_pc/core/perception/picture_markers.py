"""Every marker in a picture, of any number: for people and for putting a camera into service.

What OpenCV's detector finds is refined; what it finds square but cannot read is read from a fit of its cells.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vision_pc.core.perception import marker_edges, marker_template
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image

LEAST_SIDE_PX = 8.0  # of the mean edge: a cell of a 36h11 then has 1 px
_WINDOWS = (5, 9, 13, 23, 45)  # px: one window loses markers whose border is far thinner or wider
_USUAL = 13, 7.0  # px, and grey levels of a darker border
_SENSITIVE = 3.0  # [M] loses half as many of 75° or 12 px
_GROWN = (1.0, 1.08, 1.16)  # [D] times a square of few pixels, which is found too small
_SAME_PX = 1.0  # [D] of all corners: the square of another window
_EDGE_STD_PX = 0.05  # corners by edge lines, noise 2, sides from 16 px on
_LONG_PX = 16.0  # shorter edges have fewer than ten profiles
_SHORT_EDGE_STD_PX = 0.15
_MOST_BLUR = 0.7  # [D] cells, of a square that was not read: of others nothing tells the cells apart
_UNREAD_PX = 0.3  # [D]
_VAGUE_PX = 0.7  # [D] σ of a fit of another thing
_UNLIKE = (
    0.1 / 36
)  # a cell: what a marker that OpenCV did not read may lack to the correlation with its number
_SHOWS_LIKE = 0.6  # [M] of the cells' middles, of any: keys of a keyboard have 0.1, a screen's edge 0.5
_PLACES, _LEAST_CONTRAST = 9, 8.0  # of a side; grey levels: less than lines need, for small blurred markers
_EDGE_REACH_PX = 1.5  # [D] to either side, at most half a cell
_GREEN = (60, 200, 60)
_CORRECTION = 0.6  # share of the wrong cells that a dictionary could correct


class PictureMarker(NamedTuple):
    """A marker's number, its corners (4, 2) px in ArUco's order, how they were refined (``cells``,
    ``edges``), and their standard deviation per coordinate, px.
    """

    number: int
    corners: Array
    method: str
    std_px: float

    @property
    def side_px(self) -> float:
        """Mean length of the four edges."""
        return float(np.linalg.norm(self.corners - np.roll(self.corners, -1, axis=0), axis=1).mean())


class MarkerSearch(NamedTuple):
    """``markers`` by number and place; ``edgeless``: numbers that were read where no edge between ink and
    paper tells the corners; ``squares``: how many further squares could not be read.
    """

    markers: list[PictureMarker]
    edgeless: list[int]
    squares: int


def search(image: Image, dictionary: str, requested: frozenset[int] = frozenset()) -> MarkerSearch:
    """What of ``dictionary`` is in ``image``, markers smaller than ``LEAST_SIDE_PX`` left out.

    With ``requested`` numbers only these are given, and the search ends when all of them are there: more
    than the usual threshold is tried only while one is missing. Without, all are tried.
    """
    markers: list[PictureMarker] = []
    read: list[tuple[int, Array]] = []
    unread: list[Array] = []
    is_grid = dictionary.startswith("DICT_APRILTAG")
    usual = (_USUAL,) if requested else ()
    for window, darker in (*usual, *((other, _SENSITIVE) for other in _WINDOWS)):
        quads, ids, rejected = _detector(dictionary, window, darker).detectMarkers(image)
        for number, quad in zip([] if ids is None else map(int, ids.ravel()), quads, strict=True):
            place = quad.reshape(4, 2).astype(np.float64)
            if (not requested or number in requested) and not _is_known(markers, number, place):
                read.append((number, place))
                made = refined(image, number, place, _cells(dictionary, number), is_grid)
                markers += [] if made is None else [made]
        if requested and requested <= {marker.number for marker in markers}:
            break
        unread += [quad.reshape(4, 2).astype(np.float64) for quad in rejected]
    else:
        markers += _read_quads(image, unread, markers, dictionary, requested)
    edgeless = {number for number, place in read if not _is_known(markers, number, place)}
    alone = _elsewhere(unread, markers)
    alone = alone[np.linalg.norm(alone[:, 0] - alone[:, 1], axis=1) >= LEAST_SIDE_PX]
    return MarkerSearch(
        sorted(markers, key=lambda marker: (marker.number, *marker.corners[0])),
        sorted(edgeless),
        len(_first_of_each(alone, _are_about)),
    )


def _elsewhere(quads: list[Array], markers: list[PictureMarker]) -> Array:
    """The squares (n, 4, 2) that are about the place of no marker."""
    left = np.array(quads).reshape(-1, 4, 2)
    for marker in markers:
        left = left[~_are_about(marker.corners, left)]
    return left


def _first_of_each(quads: Array, alike: Callable[[Array, Array], NDArray[np.bool_]]) -> list[Array]:
    """The first of the squares (n, 4, 2) and of those that are not ``alike`` one before."""
    found = []
    while len(quads):
        found.append(quads[0])
        quads = quads[~alike(quads[0], quads)]
    return found


def _are_about(corners: Array, quads: Array) -> NDArray[np.bool_]:
    """Which of ``quads`` (n, 4, 2) have their middle within half a side of that of ``corners``."""
    off = np.linalg.norm(quads.mean(axis=-2) - corners.mean(axis=0), axis=-1)
    return np.asarray(off < 0.5 * np.linalg.norm(corners[0] - corners[1]))


def _are_same(corners: Array, quads: Array) -> NDArray[np.bool_]:
    return np.asarray(np.abs(quads - corners).max(axis=(-1, -2)) < _SAME_PX)


def _read_quads(
    image: Image,
    quads: list[Array],
    markers: list[PictureMarker],
    dictionary: str,
    requested: frozenset[int],
) -> list[PictureMarker]:
    """Markers in squares that the detector could not read, where the cells of one fit: the likest first."""
    book, found = _book(dictionary), list[PictureMarker]()
    free = _first_of_each(_elsewhere(quads, markers), _are_same)
    tried = [quad.mean(axis=0) + grown * (quad - quad.mean(axis=0)) for quad in free for grown in _GROWN]
    count, cells = _patterns(dictionary).shape
    chance = float(
        np.sqrt(1.0 - count ** (-2.0 / (cells - 1)))
    )  # what the likest of so many has of any square
    for likeness, number, quad in sorted(_likest(image, tried, dictionary), key=lambda one: -one[0]):
        wanted = likeness >= chance and (not requested or number in requested)
        if not wanted or any(_are_about(marker.corners, quad) for marker in found):
            continue
        fitted = marker_template.fit(image, quad, _cells(dictionary, number))
        allowed = _CORRECTION * book.maxCorrectionBits
        if fitted is None or fitted.likeness < 1.0 - _UNLIKE * cells or fitted.wrong_cells > allowed:
            continue
        marker = PictureMarker(number, fitted.corners, "cells", fitted.std_px)
        sharp = fitted.blur_px < _MOST_BLUR * marker.side_px / (book.markerSize + 2)
        if marker.side_px >= LEAST_SIDE_PX and fitted.std_px < _UNREAD_PX and sharp:
            found.append(marker)
    return found


def _likest(image: Image, quads: list[Array], dictionary: str) -> list[tuple[float, int, Array]]:
    """Of each square: the correlation of its cells' middles with the likest marker's, that number, and the
    square as this marker is turned.
    """
    patterns = _patterns(dictionary)
    count = round(patterns.shape[1] ** 0.5) + 2
    grey = marker_template.grey_at(image, np.array(quads).reshape(-1, 4, 2), _middles(count, 1))
    grey -= grey.mean(axis=1, keepdims=True)
    grey /= np.maximum(np.linalg.norm(grey, axis=1, keepdims=True), 1.0)
    alike = grey.astype(np.float32) @ patterns.T
    best = alike.argmax(axis=1)
    return [
        (float(each[k]), int(k) // 4, np.roll(quad, k % 4, axis=0))
        for each, k, quad in zip(alike, best, quads, strict=True)
    ]


def _middles(count: int, rim: int) -> Array:
    """The middles of the cells within a border of ``rim``, row by row, in a square of side 1 about 0."""
    return (np.indices((count - 2 * rim,) * 2).reshape(2, -1)[::-1].T + rim + 0.5) / count - 0.5


@lru_cache(maxsize=32)
def _patterns(dictionary: str) -> Array:
    """The inner cells of every marker in its four turns (4 n, cells), each of mean 0 and length 1."""
    inner = [_cells(dictionary, k)[1:-1, 1:-1] for k in range(len(_book(dictionary).bytesList))]
    made = np.array([np.rot90(cells, turns).ravel() for cells in inner for turns in range(4)])
    made -= made.mean(axis=1, keepdims=True)
    return np.asarray(made / np.maximum(np.linalg.norm(made, axis=1, keepdims=True), 1e-9), np.float32)


def looks_right(image: Image, marker: PictureMarker, cells: Array) -> bool:
    """Whether a marker, read by chance perhaps, looks like its ``cells`` (n, n): a fit of all of them is
    vague on other things; where there is none the grey levels in their middles must go with them.
    """
    if marker.method == "cells":
        return marker.std_px < _VAGUE_PX
    grey = marker_template.grey_at(image, marker.corners[None], _middles(len(cells), 0))[0]
    return bool(np.corrcoef(grey, cells.ravel())[0, 1] >= _SHOWS_LIKE)


def refined(image: Image, number: int, rough: Array, cells: Array, wide: bool) -> PictureMarker | None:
    """The marker with its corners refined by all of its ``cells``, else by edge lines; None where neither
    tells them, or it looks otherwise.

    ``wide``: where ink is on both sides of them, the border is tried as two cells wide, as in AprilTag grids.
    """
    for beyond in range(1 + wide):
        quad, shown = (_outer(rough, len(cells)), np.pad(cells, 1)) if beyond else (rough, cells)
        fitted = marker_template.fit(image, quad, shown)
        if fitted is None or beyond:  # what touches corners spoils a fit by a tenth of a pixel
            made = _by_edges(image, number, quad if fitted is None else fitted.corners)
        else:
            made = PictureMarker(number, fitted.corners, "cells", fitted.std_px)
        if made is not None and _is_whole(image, made, shown):
            return made
    return None


def _is_whole(image: Image, marker: PictureMarker, cells: Array) -> bool:
    """Whether it is large enough, has an edge on all sides, and looks like its ``cells``."""
    large = marker.side_px >= LEAST_SIDE_PX
    return large and _has_edges(image, marker, len(cells)) and looks_right(image, marker, cells)


def _by_edges(image: Image, number: int, rough: Array) -> PictureMarker | None:
    """The marker with the corners where the lines along its edges meet; None where there are none."""
    edges = marker_edges.refine(image, rough, lambda pixels: pixels)
    if edges is None or not np.isfinite(edges).all():
        return None
    found = PictureMarker(number, edges, "edges", _EDGE_STD_PX)
    return found if found.side_px >= _LONG_PX else found._replace(std_px=_SHORT_EDGE_STD_PX)


def _outer(corners: Array, count: int) -> Array:
    """Corners (4, 2) one cell farther out, of a marker of ``count`` cells a side."""
    square = np.array([[0, 0], [count, 0], [count, count], [0, count]], dtype=np.float32)
    H = cv2.getPerspectiveTransform(square, corners.astype(np.float32))
    beyond = square + np.sign(square - 0.5 * count)
    return np.asarray(cv2.perspectiveTransform(beyond[None], H)[0], dtype=np.float64)


def _has_edges(image: Image, marker: PictureMarker, count: int) -> bool:
    """Whether each side has ink just within it that is darker than the paper just beyond."""
    along = (np.arange(_PLACES) + 0.5) / _PLACES - 0.5
    reach = min(0.5 / count, _EDGE_REACH_PX / marker.side_px)
    inside, outside = np.full(_PLACES, 0.5 - reach), np.full(_PLACES, 0.5 + reach)
    sides = [
        np.column_stack(
            [np.concatenate([-off, off, along, along]), np.concatenate([along, along, -off, off])]
        )
        for off in (inside, outside)
    ]
    grey = marker_template.grey_at(image, marker.corners[None], np.concatenate(sides))
    ink, paper = grey.reshape(2, 4, _PLACES)
    return bool((np.median(paper - ink, axis=1) >= _LEAST_CONTRAST).all())


def drawn(image: Image, markers: list[PictureMarker]) -> Image:
    """``image`` in colour with outline, number and first corner of every marker."""
    picture = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    for marker in markers:
        outline = np.round(8.0 * marker.corners).astype(np.int32)
        cv2.polylines(picture, [outline], True, _GREEN, 1, cv2.LINE_AA, 3)
        x, y = (round(float(value)) for value in marker.corners[0])
        cv2.circle(picture, (x, y), 2, (60, 60, 255), -1)
        cv2.putText(picture, str(marker.number), (x + 4, y - 4), cv2.FONT_HERSHEY_SIMPLEX, 0.5, _GREEN, 1)
    return np.asarray(picture, dtype=np.uint8)


def _is_known(markers: list[PictureMarker], number: int, place: Array) -> bool:
    """Whether a marker of this number was found about there already."""
    return any(marker.number == number and bool(_are_about(marker.corners, place)) for marker in markers)


def _cells(dictionary: str, number: int) -> Array:
    """Ink 0 and paper 1 of a marker, (n, n), border included."""
    return marker_edges.cells_of(dictionary, number).astype(np.float64)


@lru_cache(maxsize=32)
def _book(dictionary: str) -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))


@lru_cache(maxsize=16)
def _detector(dictionary: str, window: int, darker: float) -> cv2.aruco.ArucoDetector:
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    parameters.adaptiveThreshWinSizeMin = parameters.adaptiveThreshWinSizeMax = window
    parameters.adaptiveThreshConstant = darker
    parameters.minMarkerPerimeterRate = 0.02  # 40 px around in a picture 2000 px wide
    parameters.perspectiveRemovePixelPerCell = 8
    return cv2.aruco.ArucoDetector(_book(dictionary), parameters)
