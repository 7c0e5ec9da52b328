"""Things that are square and read as a marker by chance are none."""

import cv2
import numpy as np
import pytest

from protocol.errors import RequestRefused
from tests.support.recorded_sets import checkerboard_pictures
from vision_pc.core.perception.picture_markers import PictureMarker, looks_right, search
from vision_pc.core.types import Image

BOOK = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_1000)
EYES = ("left", "right")
CORNERS = np.array([[30.0, 30.0], [90.0, 30.0], [90.0, 90.0], [30.0, 90.0]])


def cells(number: int) -> np.ndarray:
    return (BOOK.generateImageMarker(number, 6) > 0).astype(np.float64)


def picture_of(number: int) -> Image:
    picture = np.full((120, 120), 220, dtype=np.uint8)
    picture[30:90, 30:90] = BOOK.generateImageMarker(number, 60)
    return picture


@pytest.mark.parametrize("method", ["gradients", "edges", "rough"])
def test_what_was_not_fitted_must_look_like_its_cells(method: str) -> None:
    marker = PictureMarker(37, CORNERS - 0.5, method, 0.25)
    assert looks_right(picture_of(37), marker, cells(37))
    assert not looks_right(picture_of(324), marker, cells(37))


def test_a_vague_fit_is_none() -> None:
    """Keys of a keyboard were read as 324, corners to 1.06 px."""
    vague = PictureMarker(324, CORNERS - 0.5, "cells", 1.06)
    assert not looks_right(picture_of(324), vague, cells(324))
    assert looks_right(picture_of(324), vague._replace(std_px=0.05), cells(324))


@pytest.mark.slow("many pictures of an office")
def test_pictures_of_an_office_hold_no_marker() -> None:
    """Two were found in 26 such pictures: a keyboard's keys and a screen's edge, in these."""
    try:
        office = {(eye, name): picture for eye in EYES for name, picture in checkerboard_pictures(eye)}
    except RequestRefused:
        pytest.skip("LONGREACH_DATA has no pictures of OpenCV")
    for place in (("left", "left14"), ("right", "right08")):
        assert search(office[place], "DICT_4X4_1000").markers == []
