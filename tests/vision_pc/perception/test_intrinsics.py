"""Projection and undistortion against OpenCV's own and against each other."""

import cv2
import numpy as np
import pytest

from vision_pc.config.vision import VisionConfig
from vision_pc.core import se3
from vision_pc.core.perception import intrinsics
from vision_pc.core.types import CameraCalibration, CameraModel

STRONG = np.array([-0.17, 0.025, 0.001, -0.0005, 0.0])


def test_configuration_becomes_a_calibration(config: VisionConfig, camera: CameraCalibration) -> None:
    assert (camera.width, camera.height) == (1280, 720)
    np.testing.assert_array_equal(camera.left.X_CE, np.eye(4))
    told = config.camera.calibration
    np.testing.assert_allclose(camera.right.X_CE[:3, 3], [told.baseline_m, 0.0, 0.0])
    turned = told.model_copy(update={"right_rotation_vector_deg": (0.0, 1.0, 0.0)})
    R_CR = intrinsics.calibration(config.camera.model_copy(update={"calibration": turned})).right.X_CE[:3, :3]
    np.testing.assert_allclose(se3.log_so3(R_CR), [0.0, np.radians(1.0), 0.0], atol=1e-12)


@pytest.mark.parametrize("distortion", [np.zeros(5), STRONG])
def test_projection_agrees_with_opencv(camera: CameraCalibration, distortion: np.ndarray) -> None:
    eye = CameraModel(
        camera.left.K, distortion, se3.transform(se3.exp_so3([0.01, 0.02, -0.01]), (0.12, 0.001, 0.0))
    )
    points = np.random.default_rng(1).uniform([-1, -0.6, 0.8], [1, 0.6, 3], (50, 3))
    X_EC = se3.inverse(eye.X_CE)
    expected, _ = cv2.projectPoints(points, se3.log_so3(X_EC[:3, :3]), X_EC[:3, 3], eye.K, distortion)
    np.testing.assert_allclose(intrinsics.project(eye, points), expected.reshape(-1, 2), atol=1e-9)


@pytest.mark.parametrize("distortion", [np.zeros(5), STRONG])
def test_undistortion_inverts_distortion(camera: CameraCalibration, distortion: np.ndarray) -> None:
    eye = CameraModel(camera.left.K, distortion, se3.identity())
    pixels = np.random.default_rng(2).uniform([0, 0], [1279, 719], (200, 2))
    np.testing.assert_allclose(
        intrinsics.distorted(eye, intrinsics.normalised(eye, pixels)), pixels, atol=1e-6
    )


def test_points_behind_the_eye_are_not_seen(camera: CameraCalibration) -> None:
    assert np.isnan(intrinsics.project(camera.left, np.array([[0.1, 0.1, -1.0], [0.0, 0.0, 0.0]]))).all()


def test_offset_moves_the_right_picture_only(camera: CameraCalibration) -> None:
    moved = intrinsics.with_offset(camera, 0.3, -0.2)
    point = np.array([[0.1, 0.2, 1.5]])
    shift = intrinsics.project(moved.right, point) - intrinsics.project(camera.right, point)
    np.testing.assert_allclose(shift, [[0.3, -0.2]], atol=1e-12)
    np.testing.assert_array_equal(moved.left.K, camera.left.K)
