"""Why markers that a picture shows are not read: another dictionary, a mirrored picture, white on black."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import cv2
import numpy as np

from vision_pc.core.perception.picture_markers import search
from vision_pc.core.types import Image

_CONFIRMED = 3  # ways that are looked at with more care than OpenCV has by default
_WAYS: dict[str, Callable[[Image], Image]] = {
    "": lambda image: image,
    "the picture is mirrored": lambda image: np.ascontiguousarray(image[:, ::-1]),
    "the markers are inverted, white on black": lambda image: np.asarray(255 - image, dtype=np.uint8),
}


class OtherReading(NamedTuple):
    """The ``numbers`` that are read of ``dictionary`` where the picture is changed as ``how`` says."""

    dictionary: str
    how: str
    numbers: list[int]


def other_reading(image: Image, dictionary: str, dictionaries: Sequence[str]) -> OtherReading | None:
    """How most markers are read where ``dictionary`` has none in the picture as it is: by one of
    ``dictionaries``, the given one and the smallest first; None where none are.
    """
    tried: list[tuple[int, str, str]] = []
    for how, changed in _WAYS.items():
        shown = changed(image)
        others = (dictionary, *(name for name in dictionaries if name != dictionary))
        tried += [(_count(shown, other), other, how) for other in others]
    for count, other, how in sorted(tried, key=lambda one: -one[0])[:_CONFIRMED]:
        numbers = [marker.number for marker in search(_WAYS[how](image), other).markers]
        if count and 2 * len(numbers) >= count:
            return OtherReading(other, how, numbers)
    return None


def _count(image: Image, dictionary: str) -> int:
    """How many markers OpenCV's detector reads, as it comes."""
    book = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    ids = cv2.aruco.ArucoDetector(book).detectMarkers(image)[1]
    return 0 if ids is None else len(ids)
