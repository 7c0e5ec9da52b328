"""`longreach target`: the page read back by another reader, and by OpenCV in what a printer makes of it."""

import json
import re
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.support.commands import ran
from vision_pc.config.choices import Detector
from vision_pc.core.perception.picture_markers import search
from vision_pc.core.perception.zhang_intrinsics import (
    Charuco,
    Checkerboard,
    charuco_board,
    find_charuco,
    find_checkerboard,
)
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image

_POINT_MM = 25.4 / 72.0
_PER_MM = 8  # px
_NUMBER = re.compile(rb"-?\d*\.?\d+")


def page_of(pdf: Path) -> tuple[Array, list[Array]]:
    """The page's size in mm, and its filled rectangles (n, 4) x, y, width, height from the upper left."""
    data = pdf.read_bytes()
    box = re.search(rb"/MediaBox \[([^\]]*)\]", data)
    size = np.array([float(number) for number in box[1].split()[2:]])
    paths = []
    for stream in re.findall(rb"stream\r?\n(.*?)\r?\nendstream", data, re.DOTALL):
        try:
            text = zlib.decompress(stream)
        except zlib.error:
            continue
        if not text.startswith(b"/DeviceRGB"):  # a letter of the text
            continue
        points: list[tuple[float, float]] = []
        for line in text.split(b"\n"):
            if line.endswith((b" m", b" l")) and len(numbers := _NUMBER.findall(line)) == 2:
                points.append((float(numbers[0]), float(numbers[1])))
            elif line in (b"f", b"f*", b"B", b"n", b"W n") or line.endswith(b" re"):
                if line.startswith(b"f") and points:
                    paths.append(np.array(points).reshape(-1, 4, 2))
                points = []
    rectangles = []
    for path in paths:
        low, high = path.min(axis=1), path.max(axis=1)
        corner = np.column_stack([low[:, 0], size[1] - high[:, 1]])
        rectangles.append(np.hstack([corner, high - low]) * _POINT_MM)
    return size * _POINT_MM, rectangles


def raster(size: Array, rectangles: list[Array]) -> Image:
    """The page with ``_PER_MM`` pixels a mm, each the mean of 16 samples."""
    image = np.full(np.round(4 * _PER_MM * size[::-1]).astype(int), 255, np.uint8)
    for x, y, width, height in np.round(4 * _PER_MM * np.concatenate(rectangles)).astype(int):
        image[y : y + height, x : x + width] = 0
    small = cv2.resize(image, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.uint8)


@pytest.mark.parametrize("dictionary", ["DICT_5X5_1000", "DICT_APRILTAG_36h11", "DICT_ARUCO_ORIGINAL"])
def test_a_marker_has_its_side_and_its_modules_and_is_found(tmp_path: Path, dictionary: str) -> None:
    to, told = tmp_path / "page.pdf", tmp_path / "told.json"
    words = ["--marker", "582", "--dictionary", dictionary, "--size-mm", "56", "--json", str(told)]
    ran("target", *words, "--out", to)
    size, (cells, *rulers) = page_of(to)
    np.testing.assert_allclose(size, [210.0, 297.0], atol=0.05)
    assert len(rulers) == 2
    corner = np.array(json.loads(told.read_text())["corner_mm"])
    family = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    modules = family.markerSize + 2
    expected = cv2.aruco.generateImageMarker(family, 582, modules) == 0
    black = np.zeros_like(expected)
    for x, y, width, height in (cells - [*corner, 0.0, 0.0]) * modules / 56.0:
        np.testing.assert_allclose([x, y, width, height], np.round([x, y, width, height]), atol=0.005)
        assert height == pytest.approx(1.0, abs=0.005)
        black[round(y), round(x) : round(x + width)] = True
    assert (black == expected).all()
    seen = search(raster(size, [cells, *rulers]), dictionary).markers
    assert [marker.number for marker in seen] == [582]
    where = (seen[0].corners + 0.5) / _PER_MM
    square = corner + 56.0 * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    np.testing.assert_allclose(where, square, atol=0.05)


@pytest.mark.slow("boards are drawn and found")
def test_boards_have_their_squares_and_are_found(tmp_path: Path) -> None:
    ran("target", "--board", "9x6", "--size-mm", "25", "--out", tmp_path / "a.pdf")
    size, drawn = page_of(tmp_path / "a.pdf")
    np.testing.assert_allclose(size, [297.0, 210.0], atol=0.05)  # turned across
    view = find_checkerboard(raster(size, drawn), Checkerboard(9, 6, 0.025), Detector.SECTORS, "a")
    apart = np.linalg.norm(view.pixels[0] - view.pixels[-1]) / _PER_MM
    assert apart == pytest.approx(25.0 * np.hypot(8, 5), abs=0.05)
    words = ["--board", "6x8", "--charuco", "--size-mm", "24", "--marker-mm", "18", "--paper", "letter"]
    ran("target", *words, "--out", tmp_path / "b.pdf")
    size, drawn = page_of(tmp_path / "b.pdf")
    np.testing.assert_allclose(size, [215.9, 279.4], atol=0.05)
    board = Charuco(6, 8, 0.024, 0.018, cv2.aruco.DICT_5X5_1000)
    found = find_charuco(raster(size, drawn), board, "b")
    assert len(found.pixels) == len(charuco_board(board).getChessboardCorners())
    first = found.pixels - 1e3 * _PER_MM * found.points_m[:, :2]
    np.testing.assert_allclose(
        first, np.broadcast_to(first.mean(axis=0), first.shape), atol=0.4
    )  # px of 0.125 mm


def test_rulers_are_100_mm_and_clear_of_the_target(tmp_path: Path) -> None:
    ran("target", "--board", "9x6", "--size-mm", "25.1", "--out", tmp_path / "a.pdf")
    _, (cells, below, left) = page_of(tmp_path / "a.pdf")
    for ruler, axis in ((below, 0), (left, 1)):
        ticks = np.sort(ruler[:-1, axis] + 0.5 * ruler[:-1, 2 + axis])
        np.testing.assert_allclose(ticks - ticks[0], np.arange(101.0), atol=0.01)
    assert cells[:, 0].min() > (left[:, 0] + left[:, 2]).max() + 5.0
    assert (cells[:, 1] + cells[:, 3]).max() < below[:, 1].min() - 5.0
