"""Markers and boards as others print and photograph them: grids with a border of two cells, other
dictionaries, mirrored and inverted pictures, ChArUco of before OpenCV 4.6, boards that one finder misses.
"""

from pathlib import Path

import cv2
import numpy as np
import pytest

from protocol.errors import MeasurementFailed
from tests.support.commands import ran
from vision_pc.config.choices import Detector
from vision_pc.core.perception import zhang_intrinsics as zhang
from vision_pc.core.perception.board_finder import find_board, second_finders
from vision_pc.core.perception.picture_markers import search
from vision_pc.core.perception.zhang_intrinsics import Charuco, Checkerboard
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image

GRID = "DICT_APRILTAG_36h11"
CELL, TAGS = 24, 3
STEP = 13 * CELL  # a tag of ten cells, a gap of three


def grid() -> tuple[Image, dict[int, Array]]:
    """A grid of tags with a border of two cells and black squares between them, seen obliquely, and their
    outer corners (4, 2) px.
    """
    book = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, GRID))
    size = TAGS * STEP + 6 * CELL
    flat = np.full((size, size), 255, np.uint8)
    corners = {}
    for k in range(TAGS * TAGS):
        x, y = 3 * CELL + k % TAGS * STEP, 3 * CELL + k // TAGS * STEP
        flat[y : y + 10 * CELL, x : x + 10 * CELL] = 0
        tag = cv2.aruco.generateImageMarker(book, k, 8 * CELL)
        flat[y + CELL : y + 9 * CELL, x + CELL : x + 9 * CELL] = tag
        corners[k] = (
            np.array([[x, y], [x + 10 * CELL, y], [x + 10 * CELL, y + 10 * CELL], [x, y + 10 * CELL]]) - 0.5
        )
        for across in (x - 3 * CELL, x + 10 * CELL):
            for down in (y - 3 * CELL, y + 10 * CELL):
                flat[down : down + 3 * CELL, across : across + 3 * CELL] = 0
    at = np.array([[0, 0], [size, 0], [size, size], [0, size]], np.float32)
    to = np.array([[70, 40], [640, 90], [590, 560], [40, 600]], np.float32)
    H = cv2.getPerspectiveTransform(at, to)
    # drawn four times as large, then made small: edges lie where they should to a hundredth of a pixel
    large = cv2.warpPerspective(
        flat, np.diag([4.0, 4.0, 1.0]) @ H, (2800, 2600), flags=cv2.INTER_AREA, borderValue=200
    )
    seen = cv2.resize(cv2.GaussianBlur(large, (0, 0), 3.0), (700, 650), interpolation=cv2.INTER_AREA)
    moved = {
        k: cv2.perspectiveTransform(c[None].astype(np.float64), H)[0] - 0.375 for k, c in corners.items()
    }  # the middle of four small pixels
    return seen, moved


def test_corners_of_a_border_of_two_cells_are_the_outer_ones() -> None:
    image, true = grid()
    found = search(image, GRID)
    assert len(found.markers) >= 7
    for marker in found.markers:
        assert np.abs(marker.corners - true[marker.number]).max() < 4.0 * marker.std_px + 0.1, marker


def test_a_number_without_an_edge_at_its_corners_is_told_and_has_none() -> None:
    book = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, GRID))
    image = np.zeros((300, 300), np.uint8)  # black goes on beyond the border
    image[86:214, 86:214] = cv2.aruco.generateImageMarker(book, 5, 128)
    image[:40] = image[-40:] = 255
    image = cv2.GaussianBlur(image, (0, 0), 0.8)
    found = search(image, GRID)
    assert found.markers == []


def picture(dictionary: str, numbers: tuple[int, ...]) -> Image:
    book = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    image = np.full((240, 200 * len(numbers)), 255, np.uint8)
    for k, number in enumerate(numbers):
        image[60:180, 200 * k + 40 : 200 * k + 160] = cv2.aruco.generateImageMarker(book, number, 120)
    return image


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        (lambda image: image, "as DICT_4X4_50 they read 0 7 23 42"),
        (lambda image: image[:, ::-1], "as DICT_4X4_50 if the picture is mirrored they read 0 7 23 42"),
        (
            lambda image: 255 - image,
            "as DICT_4X4_50 if the markers are inverted, white on black they read 0 7 23 42",
        ),
    ],
)
def test_a_picture_without_a_wanted_marker_says_what_it_shows(
    tmp_path: Path, changed: object, told: str
) -> None:
    assert callable(changed)
    cv2.imwrite(str(tmp_path / "a.png"), changed(picture("DICT_4X4_50", (0, 7, 23, 42))))
    shown = " ".join(ran("markers", tmp_path / "a.png", status=1).output.split())
    assert told in shown
    assert "4 squares look like markers" in shown


OLD = Charuco(8, 6, 0.03, 0.022, cv2.aruco.DICT_5X5_100)


def test_charuco_of_before_4_6_is_found_and_told() -> None:
    views = []
    for old in (False, True):
        drawn = zhang.charuco_board(OLD, old).generateImage((960, 720), marginSize=40)
        views.append(find_board(cv2.GaussianBlur(drawn, (0, 0), 1.0), OLD, "v"))
    assert [len(view.points_m) for view in views] == [35, 35]
    np.testing.assert_allclose(views[0].pixels, views[1].pixels, atol=0.3)
    assert second_finders(views) == [
        "1 of the boards found by the pattern of before OpenCV 4.6, which begins with a marker"
    ]


def test_a_board_that_one_finder_misses_is_found_by_another(monkeypatch: pytest.MonkeyPatch) -> None:
    """Corners come in the same order, whichever finder began at which end."""
    board = Checkerboard(9, 6, 0.025)
    squares = np.kron(np.indices((7, 10)).sum(axis=0) % 2, np.ones((40, 40))).astype(np.uint8) * 200
    image = cv2.GaussianBlur(
        cv2.copyMakeBorder(squares, 60, 60, 60, 60, cv2.BORDER_CONSTANT, value=230), (0, 0), 0.8
    )
    image = image[::-1, ::-1].copy()
    first = find_board(image, board, "v")
    assert first.second == ""
    monkeypatch.setattr(cv2, "findChessboardCornersSB", lambda *_, **__: (False, None))
    second = find_board(image, board, "v")
    assert second.second == f"corners {Detector.FITTED}, as {Detector.SECTORS} failed"
    np.testing.assert_allclose(second.pixels, first.pixels, atol=0.5)
    monkeypatch.setattr(cv2, "findChessboardCorners", lambda *_, **__: (False, None))
    with pytest.raises(MeasurementFailed, match="no board of 9x6 corners"):
        find_board(image, board, "v")
