"""Rendered marker corners against exactly projected ones."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from plant_emulator.config.camera import LensConfig
from plant_emulator.core.camera.rays import Lens
from plant_emulator.core.camera.stereo_camera import LEFT, RIGHT, StereoCamera
from tests.plant_emulator.camera.camera_world import (
    CLEAN,
    CameraView,
    Matrix,
    camera,
    clean_camera,
    random_view,
)
from tests.plant_emulator.camera.corner_oracle import project_corners, refined_corners

POSES = 200
LIMIT_PX = 0.02
_BORDER_PX = 20


def corner_errors(eyes: StereoCamera, views: list[CameraView]) -> Matrix:
    """Found minus projected corners (n, 2) px, left and right eye in turn; hidden markers are left out."""
    errors = []
    for frame_id, view in enumerate(views):
        eye = (LEFT, RIGHT)[frame_id % 2]
        picture = eyes.render_eye(eye, view, frame_id)
        projected = {key: pair[eye] for key, pair in project_corners(eyes, view.X_WC, view.X_WM).items()}
        tool = eyes.scene.config.tool_marker.marker_id
        for marker, corners in projected.items():
            if marker != tool and _near(corners, projected[tool]):
                continue
            found = _found(picture, corners)
            if found is not None:
                errors.append(found - corners)
    return np.concatenate(errors)


def _found(picture: np.ndarray, corners: Matrix) -> Matrix | None:
    height, width = picture.shape
    inside = (corners > _BORDER_PX).all() and (corners < [width - _BORDER_PX, height - _BORDER_PX]).all()
    if not inside:
        return None
    side = min(np.linalg.norm(corners[k] - corners[k - 1]) for k in range(4))
    half_window = int(min(side / 7 * 0.6, 8.0) - 1.0)  # within one cell on either side of the edge
    return refined_corners(picture, corners, half_window, half_window + 2.0) if half_window >= 3 else None


def _near(corners: Matrix, tool: Matrix) -> bool:
    """Whether the tool's plate or bracket could hide the marker, generously."""
    if np.isnan(tool).any():
        return False
    reach = 5.0 * np.linalg.norm(tool[0] - tool[2]) / np.sqrt(2.0)
    return bool(np.linalg.norm(corners.mean(axis=0) - tool.mean(axis=0)) < reach)


def rms(errors: Matrix) -> float:
    """Root mean square of all coordinates."""
    return float(np.sqrt(np.mean(errors**2)))


def random_views(eyes: StereoCamera, count: int, seed: int) -> list[CameraView]:
    """Seeded random views."""
    generator = np.random.default_rng(seed)
    return [random_view(eyes.scene, generator) for _ in range(count)]


@pytest.mark.slow("many pictures are drawn")
def test_corners_over_random_poses(record_property: Callable[[str, object], None]) -> None:
    eyes = clean_camera()
    errors = corner_errors(eyes, random_views(eyes, POSES, seed=1))
    worst = np.abs(errors).max()
    print(f"{len(errors)} corners over {POSES} poses: {rms(errors):.4f} px rms, {worst:.4f} px worst")
    record_property("corner_rms_px", rms(errors))
    assert len(errors) > 2 * POSES
    assert rms(errors) <= LIMIT_PX
    assert np.abs(errors.mean(axis=0)).max() <= LIMIT_PX / 10  # no bias in either direction


def test_corners_survive_the_point_spread() -> None:
    eyes = camera(CLEAN | {"camera": CLEAN["camera"] | {"blur_px": 0.6}})
    assert rms(corner_errors(eyes, random_views(eyes, 30, seed=2))) <= LIMIT_PX


LENSES = [
    LensConfig(fx_px=530.0, fy_px=530.0, cx_px=639.5, cy_px=359.5),
    LensConfig(fx_px=530.7, fy_px=530.5, cx_px=640.2, cy_px=358.9, k1=-0.0012, k2=0.0006, p1=1e-4, p2=-1e-4),
    LensConfig(fx_px=700.0, fy_px=690.0, cx_px=630.0, cy_px=350.0, k1=-0.17, k2=0.026, p1=0.002, p2=-0.001),
]


@pytest.mark.parametrize("config", LENSES)
def test_projection_is_opencvs(config: LensConfig) -> None:
    points = np.random.default_rng(4).uniform([-0.5, -0.3, 0.6], [0.5, 0.3, 2.0], (100, 3))
    matrix = np.array([[config.fx_px, 0.0, config.cx_px], [0.0, config.fy_px, config.cy_px], [0.0, 0.0, 1.0]])
    coefficients = np.array([config.k1, config.k2, config.p1, config.p2, config.k3])
    expected, _ = cv2.projectPoints(points, np.zeros((3, 1)), np.zeros((3, 1)), matrix, coefficients)
    assert np.allclose(Lens(config).project(points), expected[:, 0], atol=1e-9)


@pytest.mark.parametrize("config", LENSES)
def test_ray_map_inverts_the_projection(config: LensConfig) -> None:
    lens = Lens(config)
    x, y = lens.ray_map(1280, 720)
    rays = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1).astype(np.float64)
    v, u = np.mgrid[0:720, 0:1280]
    back = lens.project(rays).reshape(720, 1280, 2)
    assert np.abs(back - np.stack([u, v], axis=2)).max() < 1e-4  # float32 rays


def test_points_behind_the_camera_have_no_image() -> None:
    assert np.isnan(Lens(LENSES[0]).project(np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0]]))).all()


def test_a_lens_that_folds_the_picture_over_is_refused() -> None:
    with pytest.raises(ValueError, match="cannot be inverted"):
        Lens(LensConfig(fx_px=300.0, fy_px=300.0, cx_px=640.0, cy_px=360.0, k1=-0.4)).ray_map(1280, 720)
