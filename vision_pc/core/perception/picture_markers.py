"""Every marker in a picture, of any number: for people and for putting a camera into service."""

from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np

from vision_pc.core.perception import marker_edges
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image

LEAST_SIDE_PX = 11.0  # of the mean edge: a 4x4 marker's cells then have 1.8 px
_WINDOWS = (7, 13, 23, 45)  # px: one window loses markers whose border is far thinner or wider
_EDGE_STD_PX = 0.05  # corners by edge lines, noise 2, sides from 16 px on
_LONG_PX = 16.0  # shorter edges have fewer than ten profiles
_SHORT_EDGE_STD_PX = 0.15
_GRADIENT_STD_PX = 0.25  # by gradients in a small window
_ROUGH_STD_PX = 0.7  # as the detector has them


class PictureMarker(NamedTuple):
    """A marker's number, its corners (4, 2) px in ArUco's order, how they were refined (``edges``,
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


def found_markers(
    image: Image, dictionary: str, wanted: frozenset[int] = frozenset(), window_px: int = 13
) -> list[PictureMarker]:
    """The markers in ``image``, by number and place, smaller ones than ``LEAST_SIDE_PX`` left out.

    With ``wanted`` numbers only these are given, and other threshold windows than ``window_px`` are tried
    only while one of them is missing; without, all windows are tried.
    """
    quads: list[tuple[int, Array]] = []
    for window in (window_px, *(other for other in _WINDOWS if other != window_px)):
        if wanted and wanted <= {number for number, _ in quads}:
            break
        corners, ids, _ = _detector(dictionary, window).detectMarkers(image)
        for number, quad in zip([] if ids is None else ids.ravel(), corners, strict=True):
            place = quad.reshape(4, 2).astype(np.float64)
            if (not wanted or int(number) in wanted) and not _is_known(quads, int(number), place):
                quads.append((int(number), place))
    markers = [refined(image, number, quad) for number, quad in quads]
    kept = [marker for marker in markers if marker.side_px >= LEAST_SIDE_PX]
    return sorted(kept, key=lambda marker: (marker.number, *marker.corners[0]))


def refined(image: Image, number: int, rough: Array) -> PictureMarker:
    """The marker with its corners refined by edge lines, else by gradients, else as they are."""
    edges = marker_edges.refine(image, rough, lambda pixels: pixels)
    if edges is not None and np.isfinite(edges).all():
        found = PictureMarker(number, edges, "edges", _EDGE_STD_PX)
        return found if found.side_px >= _LONG_PX else found._replace(std_px=_SHORT_EDGE_STD_PX)
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
        colour = (60, 200, 60) if marker.method == "edges" else (40, 160, 255)
        cv2.polylines(picture, [outline], True, colour, 1, cv2.LINE_AA, 3)
        x, y = (round(float(value)) for value in marker.corners[0])
        cv2.circle(picture, (x, y), 2, (60, 60, 255), -1)
        cv2.putText(picture, str(marker.number), (x + 4, y - 4), cv2.FONT_HERSHEY_SIMPLEX, 0.5, colour, 1)
    return np.asarray(picture, dtype=np.uint8)


def _is_known(quads: list[tuple[int, Array]], number: int, place: Array) -> bool:
    """Whether a marker of this number was found about there already."""
    side = float(np.linalg.norm(place[0] - place[1]))
    return any(
        known == number and np.linalg.norm(quad.mean(axis=0) - place.mean(axis=0)) < 0.5 * side
        for known, quad in quads
    )


@lru_cache(maxsize=16)
def _detector(dictionary: str, window: int) -> cv2.aruco.ArucoDetector:
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    parameters.adaptiveThreshWinSizeMin = parameters.adaptiveThreshWinSizeMax = window
    parameters.minMarkerPerimeterRate = 0.02  # 40 px around in a picture 2000 px wide
    parameters.perspectiveRemovePixelPerCell = 8
    return cv2.aruco.ArucoDetector(
        cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary)), parameters
    )
