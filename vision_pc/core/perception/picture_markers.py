"""Every marker in a picture, of any number: for people and for putting a camera into service.

What OpenCV's detector finds is refined; what it finds square but cannot read is read from a fit of its cells.
"""

from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np

from vision_pc.core.perception import marker_edges, marker_template
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image

LEAST_SIDE_PX = 8.0  # of the mean edge: a cell of a 36h11 then has 1 px
_WINDOWS = (5, 9, 13, 23, 45)  # px: one window loses markers whose border is far thinner or wider
_USUAL, _SENSITIVE = (
    7.0,
    3.0,
)  # grey levels that a border is darker by; [M] 3 loses half as many of 75° or 12 px
_GROWN_PX = 1.0  # squares of few pixels are found too small
_EDGE_STD_PX = 0.05  # corners by edge lines, noise 2, sides from 16 px on
_LONG_PX = 16.0  # shorter edges have fewer than ten profiles
_SHORT_EDGE_STD_PX = 0.15
_GRADIENT_STD_PX = 0.25  # by gradients in a small window
_ROUGH_STD_PX = 0.7  # as the detector has them


_READ_LIKE = 0.9  # correlation of a marker that OpenCV did not read with what it is said to be
_SHOWS_LIKE = (
    0.6  # the same of the cells' middles, of any marker: keys of a keyboard have 0.1, a screen's edge 0.5
)
_PLACES, _LEAST_CONTRAST = 9, 8.0  # of a side; grey levels: less than lines need, for small blurred markers
_FITTED_PX = 90.0  # of an edge
_EDGE_REACH_PX = 1.5  # to either side, at most half a cell: corners by gradients are not believed farther off
_CORRECTION = 0.6  # share of the wrong cells that a dictionary could correct


class PictureMarker(NamedTuple):
    """A marker's number, its corners (4, 2) px in ArUco's order, how they were refined (``cells``, ``edges``,
    ``gradients``, ``rough``), and their standard deviation per coordinate, px.
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


def search(
    image: Image, dictionary: str, requested: frozenset[int] = frozenset(), window_px: int = 13
) -> MarkerSearch:
    """What of ``dictionary`` is in ``image``, markers smaller than ``LEAST_SIDE_PX`` left out.

    With ``requested`` numbers only these are given, and other threshold windows than ``window_px`` are tried
    only while one of them is missing; without, all windows are tried.
    """
    book = _book(dictionary)
    markers: list[PictureMarker] = []
    read: list[tuple[int, Array]] = []
    is_grid = dictionary.startswith("DICT_APRILTAG")
    unread: list[Array] = []
    for window, darker in ((window_px, _USUAL), *((other, _SENSITIVE) for other in _WINDOWS)):
        if requested and requested <= {marker.number for marker in markers}:
            break
        quads, ids, rejected = _detector(dictionary, window, darker).detectMarkers(image)
        for number, quad in zip([] if ids is None else map(int, ids.ravel()), quads, strict=True):
            place = quad.reshape(4, 2).astype(np.float64)
            if (not requested or number in requested) and not _is_known(markers, number, place):
                read.append((number, place))
                made = refined(image, number, place, _cells(book, number), is_grid)
                markers += [] if made is None else [made]
        unread += [quad.reshape(4, 2).astype(np.float64) for quad in rejected]
    if not requested or not requested <= {marker.number for marker in markers}:
        more = _read_quads(image, unread, markers, book, requested)
        large = [marker for marker in more if marker.side_px >= LEAST_SIDE_PX]
        markers += [marker for marker in large if looks_right(image, marker, _cells(book, marker.number))]
    edgeless = {number for number, place in read if not _is_known(markers, number, place)}
    alone = [quad for quad in unread if not any(_covers(marker.corners, quad) for marker in markers)]
    return MarkerSearch(
        sorted(markers, key=lambda marker: (marker.number, *marker.corners[0])),
        sorted(edgeless),
        len(_apart(alone)),
    )


def _apart(quads: list[Array]) -> list[Array]:
    """One of each place, of a marker's size."""
    found: list[Array] = []
    for quad in quads:
        if np.linalg.norm(quad[0] - quad[1]) >= LEAST_SIDE_PX and not any(
            _covers(one, quad) for one in found
        ):
            found.append(quad)
    return found


def _read_quads(
    image: Image,
    quads: list[Array],
    markers: list[PictureMarker],
    book: cv2.aruco.Dictionary,
    requested: frozenset[int],
) -> list[PictureMarker]:
    """Markers in squares that the detector could not read, where their cells, fitted, have a number."""
    found: list[PictureMarker] = []
    for quad in quads:
        if any(_covers(marker.corners, quad) for marker in (*markers, *found)):
            continue
        for start in (quad, _grown(quad)):
            marker = _read_one(image, start, book)
            if marker is not None and (not requested or marker.number in requested):
                found.append(marker)
                break
    return found


def _read_one(image: Image, quad: Array, book: cv2.aruco.Dictionary) -> PictureMarker | None:
    """The marker about ``quad`` whose number its cells have, if they have one."""
    blank = np.full((book.markerSize + 2,) * 2, 0.5)
    blank[[0, -1]] = blank[:, [0, -1]] = 0.0
    shown = marker_template.fit(image, quad, blank, known=False)
    if shown is None:
        return None
    bits = (shown.cells[1:-1, 1:-1] > 0.5).astype(np.uint8)
    good, number, turns = book.identify(bits, _CORRECTION)
    if not good:
        return None
    fitted = marker_template.fit(image, np.roll(shown.corners, turns, axis=0), _cells(book, number))
    if fitted is None or fitted.likeness < _READ_LIKE:
        return None
    return PictureMarker(int(number), fitted.corners, "cells", fitted.std_px)


def looks_right(image: Image, marker: PictureMarker, cells: Array) -> bool:
    """Whether a marker, read by chance perhaps, looks like its ``cells`` (n, n): a fit of all of them is
    vague on other things; where there is none the grey levels in their middles must go with them.
    """
    if marker.method == "cells":
        return marker.std_px < _ROUGH_STD_PX
    rows, columns = (index.ravel() + 0.5 for index in np.indices(cells.shape))
    middles = np.column_stack([columns, rows])
    grey = _grey_at(image, marker.corners, len(cells), middles)
    return bool(np.corrcoef(grey, cells.ravel())[0, 1] >= _SHOWS_LIKE)


def _grown(quad: Array) -> Array:
    """The square with its corners moved away from its middle."""
    away = quad - quad.mean(axis=0)
    return np.asarray(quad + _GROWN_PX * away / np.linalg.norm(away, axis=1, keepdims=True))


def _covers(corners: Array, quad: Array) -> bool:
    """Whether both are about the same square."""
    side = float(np.linalg.norm(corners[0] - corners[1]))
    return bool(np.linalg.norm(corners.mean(axis=0) - quad.mean(axis=0)) < 0.5 * side)


def refined(image: Image, number: int, rough: Array, cells: Array, wide: bool) -> PictureMarker | None:
    """The marker with its corners refined; None where no edge tells them, or it looks otherwise.

    ``wide``: where ink is on both sides of them, the border is tried as two cells wide, as in AprilTag grids.
    """
    made = _refined_by(image, number, rough, cells)
    if _is_whole(image, made, cells):
        return made
    if not wide:
        return None
    padded = np.pad(cells, 1)
    by_lines = _by_edges(image, number, _near(image, _outer(rough, len(cells)), padded))
    return by_lines if by_lines is not None and _is_whole(image, by_lines, padded) else None


def _near(image: Image, corners: Array, cells: Array) -> Array:
    """Corners nearer to the marker's by all of its light, in a picture made small enough for that; as they
    are where it fails. What touches corners spoils them by a tenth of a pixel.
    """
    scale = min(1.0, _FITTED_PX / float(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).max()))
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    fitted = marker_template.fit(np.asarray(small, dtype=np.uint8), scale * (corners + 0.5) - 0.5, cells)
    return corners if fitted is None else np.asarray((fitted.corners + 0.5) / scale - 0.5)


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
    along = (np.arange(_PLACES) + 0.5) * count / _PLACES
    reach = min(0.5, _EDGE_REACH_PX * count / marker.side_px)  # cells
    inside, outside = np.full(_PLACES, reach), np.full(_PLACES, -reach)
    sides = [
        np.stack([np.concatenate([across, count - across, along, along]),
                  np.concatenate([along, along, across, count - across])], axis=-1)
        for across in (inside, outside)
    ]  # fmt: skip
    ink, paper = (_grey_at(image, marker.corners, count, places).reshape(4, _PLACES) for places in sides)
    return bool((np.median(paper - ink, axis=1) >= _LEAST_CONTRAST).all())


def _grey_at(image: Image, corners: Array, count: int, places: Array) -> Array:
    """The grey levels at ``places`` (n, 2) x, y, in cells of a marker."""
    square = np.array([[0, 0], [count, 0], [count, count], [0, count]], dtype=np.float32)
    H = cv2.getPerspectiveTransform(square, corners.astype(np.float32))
    seen = cv2.perspectiveTransform(places[None].astype(np.float32), H)[0]
    grey = cv2.remap(
        image, seen[:, 0].copy(), seen[:, 1].copy(), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(grey.ravel(), dtype=np.float64)


def _refined_by(image: Image, number: int, rough: Array, cells: Array) -> PictureMarker:
    """The marker with its corners refined by all of its ``cells``, else by edge lines, by gradients, or as
    they are.
    """
    edges = _by_edges(image, number, rough)
    for start in [rough] if edges is None else [edges.corners, rough]:
        fitted = marker_template.fit(image, start, cells)
        if fitted is not None:
            return PictureMarker(number, fitted.corners, "cells", fitted.std_px)
    if edges is not None:
        return edges
    side = float(np.linalg.norm(rough - np.roll(rough, -1, axis=0), axis=1).min())
    reach = int(np.clip(side / 6.0 - 1.0, 1.0, 3.0))  # within the border, whose cells are a sixth or less
    moved = cv2.cornerSubPix(
        image,
        rough.astype(np.float32).reshape(-1, 1, 2),
        (reach, reach),
        (-1, -1),
        (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 40, 0.005),
    ).reshape(4, 2)
    if np.abs(moved - rough).max() <= reach:
        return PictureMarker(number, moved.astype(np.float64), "gradients", _GRADIENT_STD_PX)
    return PictureMarker(number, rough, "rough", _ROUGH_STD_PX)


def drawn(image: Image, markers: list[PictureMarker]) -> Image:
    """``image`` in colour with outline, number and first corner of every marker."""
    picture = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    for marker in markers:
        outline = np.round(8.0 * marker.corners).astype(np.int32)
        colour = (60, 200, 60) if marker.method in ("cells", "edges") else (40, 160, 255)
        cv2.polylines(picture, [outline], True, colour, 1, cv2.LINE_AA, 3)
        x, y = (round(float(value)) for value in marker.corners[0])
        cv2.circle(picture, (x, y), 2, (60, 60, 255), -1)
        cv2.putText(picture, str(marker.number), (x + 4, y - 4), cv2.FONT_HERSHEY_SIMPLEX, 0.5, colour, 1)
    return np.asarray(picture, dtype=np.uint8)


def _is_known(markers: list[PictureMarker], number: int, place: Array) -> bool:
    """Whether a marker of this number was found about there already."""
    return any(marker.number == number and _covers(marker.corners, place) for marker in markers)


def _cells(book: cv2.aruco.Dictionary, number: int) -> Array:
    """Ink 0 and paper 1 of a marker, (n, n), border included."""
    return (book.generateImageMarker(number, book.markerSize + 2) > 0).astype(np.float64)


@lru_cache(maxsize=16)
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
