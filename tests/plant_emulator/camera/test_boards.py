"""Boards before the camera: what detectors find in the pictures lies where the exact lens projects it."""

from typing import Any

import cv2
import numpy as np
import pytest
from pydantic import ValidationError

from plant_emulator.config.scene import SceneConfig
from plant_emulator.core.camera.boards import board_pose
from plant_emulator.core.camera.exposures import CameraView
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.camera.stereo_camera import LEFT, RIGHT, StereoCamera
from plant_emulator.core.mechanics.geometry import rotation_from_vector, transform
from tests.plant_emulator.camera.board_points import board_points
from tests.plant_emulator.camera.camera_world import scene_config
from vision_pc.core.perception import zhang_intrinsics as zhang
from vision_pc.core.perception.marker_edges import refine
from vision_pc.core.se3_stacks import inverse

FAR = transform(np.eye(3), np.array([0.0, 0.0, -5.0]))  # the tool marker, out of sight behind the camera


def pictured(
    board: dict[str, Any],
    turn_deg: tuple[float, float, float],
    place: tuple[float, float, float],
    eye: int = LEFT,
) -> tuple[np.ndarray, np.ndarray]:
    """One eye's picture of a board at X_CB, and the true image places (n, 2) of its points."""
    board = {"position_m": [0.1, -0.05, 0.3], "rotation_deg": [4.0, -3.0, 8.0], **board}
    plain = scene_config().model_dump()
    config = SceneConfig.model_validate(plain | {"boards": [board]})
    scene = Scene(config)
    camera = StereoCamera(config.camera, scene, seed=3)
    X_WB = scene.mounts.X_WO @ board_pose(config.boards[0])
    facing = np.diag([1.0, -1.0, -1.0])
    X_CB = transform(rotation_from_vector(np.radians(turn_deg)) @ facing, np.array(place))
    X_WC = X_WB @ inverse(X_CB)
    picture = camera.render_eye(eye, CameraView(X_WC, X_WC @ FAR), frame_id=1)
    points = board_points(config.boards[0])
    return picture, camera.project(X_WC, points @ X_WB[:3, :3].T + X_WB[:3, 3])[eye]


def rms(found: np.ndarray, true: np.ndarray) -> float:
    """Root mean square distance in px."""
    return float(np.sqrt(np.mean(np.sum((found - true) ** 2, axis=1))))


@pytest.mark.parametrize("eye", [LEFT, RIGHT])
@pytest.mark.parametrize("dictionary", ["DICT_5X5_1000", "DICT_ARUCO_ORIGINAL"])
def test_marker_582_is_recognised_and_its_corners_are_sub_pixel_true(dictionary: str, eye: int) -> None:
    picture, true = pictured(
        {"kind": "marker", "dictionary": dictionary}, (25.0, -15.0, 30.0), (-0.1, 0.05, 0.55), eye
    )
    codes = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    quads, ids, _ = cv2.aruco.ArucoDetector(codes).detectMarkers(picture)
    assert ids is not None
    rough = next(q.reshape(4, 2) for q, number in zip(quads, ids.ravel(), strict=True) if number == 582)
    corners = refine(picture, rough.astype(np.float64), lambda pixels: pixels)
    assert corners is not None
    assert rms(corners, true) < 0.05


def test_checkerboard_corners_are_sub_pixel_true() -> None:
    picture, true = pictured({"kind": "checkerboard"}, (20.0, 25.0, 10.0), (0.0, 0.0, 0.4))
    view = zhang.find_checkerboard(picture, zhang.Checkerboard(8, 6, 0.024), zhang.Detector.SECTORS, "tilted")
    found = view.pixels if rms(view.pixels, true) < 5.0 else view.pixels[::-1]
    assert rms(found, true) < 0.08


def test_charuco_corners_are_sub_pixel_true_and_numbered_as_opencv_does() -> None:
    picture, true = pictured({"kind": "charuco"}, (-20.0, 15.0, -20.0), (0.02, 0.01, 0.35))
    board = zhang.Charuco(9, 7, 0.024, 0.018, cv2.aruco.DICT_5X5_100)
    view = zhang.find_charuco(picture, board, "tilted")
    assert len(view.pixels) == 48
    order = np.round(view.points_m[:, :2] / 0.024).astype(int) - 1
    assert rms(view.pixels, true[order[:, 1] * 8 + order[:, 0]]) < 0.08


@pytest.mark.parametrize(
    ("board", "what"),
    [
        ({"kind": "marker", "dictionary": "DICT_5X5_100"}, "DICT_5X5_100 holds numbers below 100"),
        ({"kind": "charuco", "marker_m": 0.03}, "must be below square_m"),
        ({"kind": "poster"}, "does not match any of the expected tags"),
    ],
)  # fmt: skip
def test_a_board_that_cannot_be_is_refused_by_name(board: dict[str, Any], what: str) -> None:
    plain = scene_config().model_dump()
    with pytest.raises(ValidationError, match=what):
        SceneConfig.model_validate(plain | {"boards": [{"position_m": [0.0, 0.0, 0.0], **board}]})
