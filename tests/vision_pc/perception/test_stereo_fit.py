"""A raw stereo camera from exact corners with noise: found; too little is refused."""

from collections.abc import Callable

import numpy as np
import pytest

from protocol.errors import MeasurementFailed, RequestRefused
from tests.vision_pc.perception.test_rectification import raw_camera, seen_raw
from vision_pc.config.choices import LensModel
from vision_pc.core import se3
from vision_pc.core.perception import stereo_fit
from vision_pc.core.perception.stereo_fit import PairView
from vision_pc.core.perception.zhang_intrinsics import BoardView
from vision_pc.core.se3 import Array

SIZE = (640, 360)
TRUE = raw_camera(LensModel.BROWN_CONRADY)
CORNER_PX = 0.1
ROWS, COLUMNS = np.mgrid[0:6, 0:9]
BOARD = np.stack([COLUMNS.ravel(), ROWS.ravel(), np.zeros(54)], axis=1) * 0.03


def view_at(name: str, X: Array, rng: np.random.Generator) -> PairView | None:
    left, right = seen_raw(TRUE, se3.apply(X, BOARD))
    both = np.concatenate([left, right])
    if not ((both > 4.0) & (both < np.array(SIZE) - 4.0)).all():
        return None
    noise = rng.normal(size=(2, *left.shape)) * CORNER_PX
    return PairView(name, BOARD, left + noise[0], right + noise[1])


def anywhere(rng: np.random.Generator) -> Array:
    """A place of the board's middle before the camera, m."""
    depth = rng.uniform(0.3, 0.7)
    return np.array([rng.uniform(-0.9, 0.9) * depth, rng.uniform(-0.5, 0.5) * depth, depth])


def views_of(
    seed: int, count: int, tilt_deg: float = 40.0, place: Callable[[np.random.Generator], Array] = anywhere
) -> list[PairView]:
    rng = np.random.default_rng(seed)
    views: list[PairView] = []
    while len(views) < count:
        R = se3.exp_so3(np.radians(rng.uniform(-tilt_deg, tilt_deg, 3)))
        seen = view_at(f"{len(views):02d}", se3.transform(R, place(rng) - R @ BOARD.mean(axis=0)), rng)
        if seen is not None:
            views.append(seen)
    return views


@pytest.mark.slow("a camera is fitted")
def test_the_camera_is_found() -> None:
    found = stereo_fit.fit(views_of(1, 20), SIZE, LensModel.BROWN_CONRADY, "drawn")
    for eye, true in ((found.calibration.left, TRUE.left), (found.calibration.right, TRUE.right)):
        assert eye.fx_px == pytest.approx(true.fx_px, abs=2.0)
        np.testing.assert_allclose(eye.distortion[:2], true.distortion[:2], atol=0.02)
    np.testing.assert_allclose(found.calibration.right_position_m, TRUE.right_position_m, atol=1e-3)
    assert found.calibration.rms_px == pytest.approx(CORNER_PX * np.sqrt(2.0), rel=0.15)
    assert not found.left_out


@pytest.mark.slow("a camera is fitted")
def test_a_view_that_disagrees_is_left_out_by_name() -> None:
    views = views_of(4, 14)
    rng = np.random.default_rng(9)
    views[5] = views[5]._replace(right=views[5].right + rng.normal(size=(54, 2)) * 4.0)
    found = stereo_fit.fit(views, SIZE, LensModel.BROWN_CONRADY, "drawn")
    assert found.left_out == ("05",)
    assert len(found.names) == 13


def test_too_few_and_too_alike_views_are_refused_by_name() -> None:
    views = views_of(5, 10)
    with pytest.raises(RequestRefused, match="7 pairs show the board in both eyes, at least 8") as refused:
        stereo_fit.fit(views[:7], SIZE, LensModel.BROWN_CONRADY, "drawn")
    assert refused.value.cause == "refused.camera.too_few_views"
    again = [views[k % 3]._replace(name=f"copy {k}") for k in range(12)]
    with pytest.raises(RequestRefused, match=r"only 3 of 12 .* alike are copy 3, copy 4.*move") as refused:
        stereo_fit.fit(again, SIZE, LensModel.BROWN_CONRADY, "drawn")
    assert refused.value.cause == "refused.camera.views_alike"


def test_a_board_in_one_corner_is_refused_and_told_where_to_go() -> None:
    views = views_of(6, 30, place=lambda rng: rng.uniform([-0.95, -0.5, 1.2], [-0.7, -0.3, 1.2]))
    with pytest.raises(RequestRefused, match=r"hold it also to the .*lower right") as refused:
        stereo_fit.fit(views, SIZE, LensModel.BROWN_CONRADY, "drawn")
    assert refused.value.cause == "refused.camera.poor_coverage"


def test_boards_that_are_never_tilted_are_refused() -> None:
    with pytest.raises(RequestRefused, match="tilt the board") as refused:
        stereo_fit.fit(views_of(7, 16, tilt_deg=2.0), SIZE, LensModel.BROWN_CONRADY, "drawn")
    assert refused.value.cause == "refused.camera.no_tilt"


def test_a_fit_with_large_errors_is_no_camera() -> None:
    rng = np.random.default_rng(8)
    off = rng.normal(size=(2, 54, 2)) * 3.0
    views = [v._replace(left=v.left + off[0], right=v.right - off[1]) for v in views_of(8, 12)]
    with pytest.raises(MeasurementFailed, match="not flat, or eyes not exposed together") as refused:
        stereo_fit.fit(views, SIZE, LensModel.BROWN_CONRADY, "drawn")
    assert refused.value.cause == "measurement.camera.poor_fit"


def test_only_corners_that_both_eyes_see_are_used() -> None:
    pixels = np.arange(108.0).reshape(54, 2)
    left = BoardView("a", BOARD[:20], pixels[:20])
    right = BoardView("a", BOARD[10:], pixels[10:])
    both = stereo_fit.paired(left, right)
    np.testing.assert_array_equal(both.points_m, BOARD[10:20])
    np.testing.assert_array_equal(both.left, both.right)
    with pytest.raises(MeasurementFailed, match="view a: 2 corners"):
        stereo_fit.paired(left, BoardView("a", BOARD[18:], pixels[18:]))
