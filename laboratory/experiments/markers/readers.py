"""Readers of square markers under one signature: ours, OpenCV's with every refinement, AprilTag's own."""

import importlib.util
from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np

from vision_pc.core.perception.picture_markers import found_markers
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image

REFINEMENTS = ("none", "subpix", "contour", "apriltag")
PUPIL = "pupil"
FAMILIES = {
    "DICT_APRILTAG_36h11": "tag36h11",
    "DICT_APRILTAG_16h5": "tag16h5",
    "DICT_APRILTAG_25h9": "tag25h9",
}
_ORDER = (1, 0, 3, 2)  # its corners in ours, of the same printed marker
_CENTRE = 0.5  # px: AprilTag's pixels have their centres there, also in OpenCV's refinement of that name


class MarkerReading(NamedTuple):
    """A marker that a reader tells of, its corners (4, 2) px in ArUco's order, σ per coordinate if told."""

    number: int
    corners: Array
    std_px: float = float("nan")


Reader = Callable[[Image], list[MarkerReading]]


def readers(dictionary: str) -> dict[str, Reader]:
    """Ours and OpenCV's; AprilTag's where `pupil-apriltags` is installed and has such a family."""
    made: dict[str, Reader] = {"ours": lambda image: _ours(image, dictionary)}
    for name in REFINEMENTS:
        made[name] = _opencv(dictionary, name)
    if dictionary in FAMILIES and importlib.util.find_spec("pupil_apriltags"):
        made[PUPIL] = _pupil(FAMILIES[dictionary])
    return made


def _ours(image: Image, dictionary: str) -> list[MarkerReading]:
    return [MarkerReading(one.number, one.corners, one.std_px) for one in found_markers(image, dictionary)]


def _opencv(dictionary: str, refinement: str) -> Reader:
    """OpenCV's detector as it comes, but for its refinement."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = getattr(cv2.aruco, f"CORNER_REFINE_{refinement.upper()}")
    book = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    detector = cv2.aruco.ArucoDetector(book, parameters)
    centre = _CENTRE if refinement == "apriltag" else 0.0

    def read(image: Image) -> list[MarkerReading]:
        quads, ids, _ = detector.detectMarkers(image)
        numbers = [] if ids is None else ids.ravel()
        return [
            MarkerReading(int(number), quad.reshape(4, 2).astype(np.float64) - centre)
            for number, quad in zip(numbers, quads, strict=True)
        ]

    return read


@lru_cache(
    maxsize=4
)  # a detector holds its family's tables, and its destructor ends the process now and then
def _pupil(family: str) -> Reader:
    """The AprilTag library at full resolution, one thread."""
    from pupil_apriltags import Detector

    detector = Detector(families=family, nthreads=1, quad_decimate=1.0)

    def read(image: Image) -> list[MarkerReading]:
        return [
            MarkerReading(int(one.tag_id), np.asarray(one.corners)[list(_ORDER)] - _CENTRE)
            for one in detector.detect(image)
        ]

    return read
