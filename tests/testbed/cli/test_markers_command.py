"""`longreach markers` on drawn pictures: numbers, corners, small ones, pairs, and refusals."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.support.commands import ran
from vision_pc.core.perception.picture_markers import search
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image

DICTIONARY = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_1000)
_TIMES = 8


def picture(places: dict[int, tuple[float, float, float]]) -> Image:
    """Upright markers, by number (x, y of the first corner, side) px, each pixel the mean of 64 samples.

    Sides of a multiple of 0.75 px have cells of whole samples.
    """
    large = np.full((240 * _TIMES, 320 * _TIMES), 200, np.uint8)
    for number, (x, y, side) in places.items():
        size = round(_TIMES * side)
        column, row = round(_TIMES * (x + 0.5)), round(_TIMES * (y + 0.5))  # pixel centres at integers
        marker = cv2.aruco.generateImageMarker(DICTIONARY, number, size)
        large[row : row + size, column : column + size] = np.minimum(marker, 200)  # one paper, in and around
    small = cv2.resize(large, (320, 240), interpolation=cv2.INTER_AREA)
    noise = np.random.default_rng(1).normal(0.0, 2.0, small.shape)
    return np.clip(cv2.GaussianBlur(small.astype(float), (0, 0), 0.6) + noise, 0, 255).astype(np.uint8)


def corners(x: float, y: float, side: float) -> Array:
    return np.array([[x, y], [x + side, y], [x + side, y + side], [x, y + side]])


def test_corners_are_as_good_as_they_say_and_small_markers_are_kept() -> None:
    places = {3: (40.25, 30.5, 39.0), 7: (150.5, 60.25, 13.5)}
    found = search(picture(places), "DICT_4X4_1000").markers
    assert [marker.number for marker in found] == [3, 7]
    assert [marker.method for marker in found] == ["cells", "cells"]
    assert 0.0 < found[0].std_px < found[1].std_px < 0.2
    for marker in found:
        errors = marker.corners - corners(*places[marker.number])
        assert np.abs(errors).max() < 4.0 * marker.std_px
        assert marker.side_px == pytest.approx(places[marker.number][2], abs=0.5)
    assert [marker.number for marker in search(picture(places), "DICT_4X4_1000", frozenset({7})).markers] == [
        7
    ]
    too_small = search(picture({7: (150.5, 60.25, 7.5)}), "DICT_4X4_1000").markers
    assert too_small == []


@pytest.mark.parametrize("name", ["DICT_4X4_50", "DICT_5X5_100", "DICT_6X6_250", "DICT_7X7_50"])
def test_every_size_that_opencv_has_of_a_family_is_known(name: str, tmp_path: Path) -> None:
    """A book of 250 is the first quarter of one of 1000: others name the small one."""
    book = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    shown = np.full((200, 200), 255, np.uint8)
    shown[50:150, 50:150] = cv2.aruco.generateImageMarker(book, 17, 100)
    cv2.imwrite(str(tmp_path / "a.png"), shown)
    ran("markers", tmp_path / "a.png", "--dictionary", name, "--number", 17)


def test_directories_are_paired_by_name_listed_drawn_and_written(tmp_path: Path) -> None:
    left, right = tmp_path / "left", tmp_path / "right"
    for file, x in ((left / "7.png", 60.0), (left / "8.png", 60.0), (right / "8.png", 51.5)):
        file.parent.mkdir(exist_ok=True)
        cv2.imwrite(str(file), picture({3: (x, 30.0, 40.0)}))
    told = tmp_path / "markers.json"
    command = ("markers", left, "--dictionary", "DICT_4X4_1000")
    shown = ran(*command, "--right", right, "--out", tmp_path / "drawn", "--json", told).output
    assert "without a partner: 1 pictures of the left eye and 0 of the right one (7.png)" in shown
    (seen,) = json.loads(told.read_text())["pictures"]
    apart = np.array(seen["markers"][0]["corners_px"]) - seen["right_markers"][0]["corners_px"]
    np.testing.assert_allclose(apart.mean(axis=0), [8.5, 0.0], atol=0.1)
    assert len(list((tmp_path / "drawn").iterdir())) == 2
    assert "INCOMPLETE" in ran(*command, "--number", 4, status=1).output


@pytest.mark.parametrize(
    ("x", "y", "told"),
    [
        (68.5, 30.0, "the eyes are exchanged"),
        (60.0, 30.0, "it is one picture"),
        (51.5, 34.0, "no rectified pair"),
    ],
)
def test_a_pair_that_is_none_is_questioned(tmp_path: Path, x: float, y: float, told: str) -> None:
    left, right = tmp_path / "left.png", tmp_path / "right.png"
    cv2.imwrite(str(left), picture({3: (60.0, 30.0, 40.0)}))
    cv2.imwrite(str(right), picture({3: (x, y, 40.0)}))
    shown = ran("markers", left, "--right", right, "--dictionary", "DICT_4X4_1000", status=1)
    assert told in " ".join(shown.output.split())
