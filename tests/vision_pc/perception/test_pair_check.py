"""What is wrong with a pair is measured: rows by place, exchanged eyes, blur, exposure."""

import cv2
import numpy as np
import pytest

from vision_pc.core.perception import pair_check
from vision_pc.core.types import Image, StereoPair

SIZE = (480, 270)


def textured(seed: int = 1) -> Image:
    grey = np.random.default_rng(seed).uniform(0.0, 255.0, (SIZE[1] + 80, SIZE[0] + 80)).astype(np.float32)
    smooth = cv2.GaussianBlur(grey, (0, 0), 1.3)
    return np.asarray(np.clip(128.0 + 3.0 * (smooth - 128.0), 0.0, 255.0), dtype=np.uint8)


def pair_with(down: float, disparity: float = 12.0, turn_deg: float = 0.0) -> StereoPair:
    """A wall at one distance; the right eye's rows ``down`` px lower, its picture turned about the middle."""
    wall = textured()
    middle = (SIZE[0] / 2.0 + 40.0, SIZE[1] / 2.0 + 40.0)
    turn = cv2.getRotationMatrix2D(middle, -turn_deg, 1.0)
    turn[:, 2] += (-disparity, down)
    right = cv2.warpAffine(wall, turn, wall.shape[::-1], flags=cv2.INTER_CUBIC)
    crop = np.s_[40 : 40 + SIZE[1], 40 : 40 + SIZE[0]]
    return StereoPair(np.ascontiguousarray(wall[crop]), np.ascontiguousarray(right[crop]), 0, 0)


@pytest.mark.parametrize("down", [0.0, 0.4, -3.0, 9.5])
def test_rows_that_are_off_are_measured(down: float) -> None:
    report = pair_check.rows_of([pair_check.matched(pair_with(down))], SIZE)
    assert report.points > 200
    assert report.median_px == pytest.approx(down, abs=0.06)
    assert report.spread_px < 0.15
    assert report.disparity_px == pytest.approx(12.0, abs=0.1)


def test_a_turned_eye_shows_by_place_and_in_the_spread() -> None:
    report = pair_check.rows_of([pair_check.matched(pair_with(0.0, turn_deg=0.8))], SIZE)
    slope = np.radians(0.8) * SIZE[0] * 0.75
    across = report.cells_px[:, -1] - report.cells_px[:, 0]
    np.testing.assert_allclose(across, slope, atol=1.2)  # points are not evenly spread in a cell
    assert report.spread_px > 1.0


def test_exchanged_eyes_have_negative_disparities() -> None:
    pair = pair_with(0.0)
    report = pair_check.rows_of([pair_check.matched(pair._replace(left=pair.right, right=pair.left))], SIZE)
    assert report.disparity_px == pytest.approx(-12.0, abs=0.1)


def test_nothing_to_see_is_nothing_and_no_number() -> None:
    even: Image = np.full(SIZE[::-1], 90, dtype=np.uint8)
    assert pair_check.rows_of([pair_check.matched(StereoPair(even, even, 0, 0))], SIZE) is None
    assert np.isnan(pair_check.picture_report(even).edge_px)


@pytest.mark.parametrize("blur", [0.8, 1.5, 3.0])
def test_blur_is_the_width_of_edges(blur: float) -> None:
    squares = np.kron((np.indices((10, 16)).sum(axis=0) % 2), np.ones((27, 30))).astype(np.float32)
    blurred = cv2.GaussianBlur(60.0 + 120.0 * squares, (0, 0), blur)
    found = pair_check.picture_report(np.asarray(blurred, dtype=np.uint8)).edge_px
    assert found == pytest.approx(np.hypot(blur, 0.8), rel=0.3)  # the measuring gradient is as wide


def test_exposure_counts_white_and_black() -> None:
    picture: Image = np.full((100, 100), 100, dtype=np.uint8)
    picture[:10], picture[90:] = 255, 0
    report = pair_check.picture_report(picture)
    assert (report.white_share, report.black_share) == (0.1, 0.1)
    assert report.mean_grey == pytest.approx(0.8 * 100 + 0.1 * 255)
