"""Intrinsics from rendered boards with known truth: each detector, what is refused, what is named."""

import cv2
import numpy as np
import pytest

from protocol.errors import MeasurementFailed, RequestRefused
from testbed.hand_eye.picture_samples import detect
from tests.support.board_pictures import BoardCamera, BoardRenderer, random_board_pose
from vision_pc.config.choices import Detector
from vision_pc.core.perception import zhang_intrinsics as zhang
from vision_pc.core.perception.zhang_intrinsics import BoardView, Charuco, Checkerboard
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image

CAMERA = BoardCamera(
    K=np.array([[440.0, 0.0, 210.0], [0.0, 441.0, 165.0], [0.0, 0.0, 1.0]]),
    distortion=np.array([-0.08, 0.03, 0.001, -0.001, 0.0]),
    width=420,
    height=320,
)
BOARD = Checkerboard(8, 6, 0.024)
CHARUCO = Charuco(7, 5, 0.030, 0.022, cv2.aruco.DICT_5X5_100)


@pytest.fixture(scope="module")
def renderer() -> BoardRenderer:
    return BoardRenderer(CAMERA)


@pytest.fixture(scope="module")
def pictures(renderer: BoardRenderer) -> list[tuple[str, Image]]:
    rng = np.random.default_rng(1)
    poses = [random_board_pose(CAMERA, BOARD, rng) for _ in range(9)]
    return [(f"v{k}", renderer.render(BOARD, X, rng)) for k, X in enumerate(poses)]


def exact_view(name: str, X_CB: Array) -> BoardView:
    """The board's corners as the camera projects them, without a picture."""
    rows, columns = np.mgrid[0 : BOARD.rows, 0 : BOARD.columns]
    points = np.stack([columns.ravel(), rows.ravel(), np.zeros(rows.size)], axis=1) * BOARD.square_m
    turn = cv2.Rodrigues(X_CB[:3, :3])[0]
    pixels = cv2.projectPoints(points, turn, X_CB[:3, 3], CAMERA.K, CAMERA.distortion)[0]
    return BoardView(name, points, np.asarray(pixels, dtype=np.float64).reshape(-1, 2))


@pytest.mark.parametrize("detector", list(Detector))
def test_rendered_camera_is_found(pictures: list[tuple[str, Image]], detector: Detector) -> None:
    views, missed = detect(pictures, BOARD, detector)
    assert missed == ()
    found = zhang.calibrate(views, CAMERA.width, CAMERA.height)
    assert found.K[0, 0] == pytest.approx(CAMERA.K[0, 0], rel=0.006)
    assert found.rms_px < (0.4 if detector is Detector.CLASSIC else 0.12)
    assert abs(found.K[0, 0] - CAMERA.K[0, 0]) < 5.0 * found.std_px[0]
    assert found.coverage.sum() == 9 * 48


def test_charuco_is_found_though_partly_hidden(renderer: BoardRenderer) -> None:
    rng = np.random.default_rng(3)
    views, counts = [], []
    for k in range(8):
        X_CB = random_board_pose(CAMERA, CHARUCO, rng)
        image = renderer.render(CHARUCO, X_CB, rng)
        corner = X_CB @ np.array([0.5 * CHARUCO.square_m, 0.5 * CHARUCO.square_m, 0.0, 1.0])
        u, v, w = CAMERA.K @ corner[:3]
        cv2.circle(image, (int(u / w), int(v / w)), 14, 128, -1)
        try:
            views.append(zhang.find_charuco(image, CHARUCO, f"c{k}"))
        except MeasurementFailed:
            continue  # so oblique and far that its markers are a few pixels
        counts.append(len(views[-1].pixels))
    assert len(views) >= 6
    assert min(counts) < 24
    found = zhang.calibrate(views, CAMERA.width, CAMERA.height)
    assert found.K[0, 0] == pytest.approx(CAMERA.K[0, 0], rel=0.02)


def test_a_picture_without_a_board_is_named() -> None:
    empty = np.full((320, 420), 120, dtype=np.uint8)
    for detector in Detector:
        with pytest.raises(MeasurementFailed, match="view blank") as caught:
            zhang.find_checkerboard(empty, BOARD, detector, "blank")
        assert caught.value.cause == "measurement.intrinsics.no_board"
    with pytest.raises(MeasurementFailed, match="view blank: 0 ChArUco corners"):
        zhang.find_charuco(empty, CHARUCO, "blank")


def test_two_views_and_parallel_boards_are_refused() -> None:
    rng = np.random.default_rng(4)
    views = [exact_view(str(k), random_board_pose(CAMERA, BOARD, rng)) for k in range(3)]
    with pytest.raises(RequestRefused, match="2 views") as refused:
        zhang.calibrate(views[:2], CAMERA.width, CAMERA.height)
    assert refused.value.cause == "refused.intrinsics.too_few_views"
    facing: list[BoardView] = []
    for k in range(4):
        X = np.eye(4)
        X[:3, 3] = (-0.08 + 0.01 * k, -0.06, 0.35 + 0.02 * k)
        view = exact_view(str(k), X)
        facing.append(view._replace(pixels=view.pixels + rng.normal(size=view.pixels.shape) * 0.1))
    with pytest.raises(MeasurementFailed, match=r"focal length") as failed:
        zhang.calibrate(facing, CAMERA.width, CAMERA.height)
    assert failed.value.cause == "measurement.intrinsics.undetermined"
