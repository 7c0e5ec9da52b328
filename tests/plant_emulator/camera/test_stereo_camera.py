"""What the rendered pictures must be besides sharp: reproducible, consistent, occluding, detectable."""

from functools import cache

import cv2
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from plant_emulator.core.camera.stereo_camera import LEFT, RIGHT, StereoCamera
from plant_emulator.core.camera.wall.wall_texture import SIZE, wall_texture
from tests.plant_emulator.camera.camera_world import (
    CameraView,
    camera,
    clean_camera,
    shipped_camera,
    start_view,
    wall_view,
)

DETECTOR = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_1000))
Grey = np.ndarray


def seen_ids(picture: Grey) -> set[int]:
    """Ids of the markers that OpenCV detects."""
    _, ids, _ = DETECTOR.detectMarkers(picture)
    return set() if ids is None else {int(i) for i in ids.ravel()}


def rendered(eyes: StereoCamera, view: CameraView, frame_id: int = 1) -> tuple[Grey, Grey]:
    """A stereo pair of ``view``."""
    return eyes.render(view.X_WC, view.X_WM, frame_id)


def test_same_seed_and_frame_give_the_same_picture() -> None:
    view = start_view(shipped_camera().scene)
    first = rendered(shipped_camera(), view, 7)
    rendered(shipped_camera(), view, 8)
    again, fresh = rendered(shipped_camera(), view, 7), rendered(camera(), view, 7)
    for k in (LEFT, RIGHT):
        assert np.array_equal(first[k], again[k])
        assert np.array_equal(first[k], fresh[k])


def test_noise_has_the_configured_strength_and_no_memory() -> None:
    eyes = camera({"camera": {"vignetting": 0.0}})
    view = start_view(eyes.scene)
    quiet = camera({"camera": {"vignetting": 0.0, "noise_grey": 0.0}})
    still = rendered(quiet, view)[LEFT].astype(np.float64)
    noise = [rendered(eyes, view, frame)[LEFT] - still for frame in (1, 2)]
    noise.append(rendered(eyes, view, 1)[RIGHT] - rendered(quiet, view)[RIGHT].astype(np.float64))
    for one in noise:
        assert one.mean() == pytest.approx(0.0, abs=0.02)
        assert one.std() == pytest.approx(np.hypot(2.0, 1.0 / np.sqrt(12.0)), rel=0.02)
    for other in noise[1:]:
        assert abs(np.corrcoef(noise[0].ravel(), other.ravel())[0, 1]) < 0.01
    rows = noise[0]
    assert abs(np.corrcoef(rows[:-1].ravel(), rows[1:].ravel())[0, 1]) < 0.01


@pytest.mark.parametrize("distance", [0.5, 0.9, 1.7, 3.2])
def test_the_wall_lies_where_its_texture_says_at_every_mip_level(distance: float) -> None:
    """A patch looked up through the projection matches the texture itself, to a fiftieth of a pixel."""
    eyes = clean_camera()
    wall = eyes.scene.config.wall
    side = np.arange(-80, 81) / 800.0
    x, y = np.meshgrid(0.42 + side, 0.05 - side)
    X_WO, view = eyes.scene.mounts.X_WO, wall_view(eyes.scene, distance)
    points = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1) @ X_WO[:3, :3].T + X_WO[:3, 3]
    image, _ = eyes.project(view.X_WC, points)
    coarse = 2.0 * distance  # millimetres: a blur that is the same on the wall for both
    top, left = 1700, 2200
    texture = the_texture(wall.texture_seed, wall.mean_grey, wall.contrast_grey)[top:2300, left:2750]
    truth = map_coordinates(
        cv2.GaussianBlur(texture.astype(np.float64), (0, 0), 2.0 * coarse),
        [SIZE / 2 - 1000.0 * y - 0.5 - top, SIZE / 2 + 1000.0 * x - 0.5 - left],
        order=3,
    )
    pixel_m = distance / eyes.config.lens.fx_px
    blurred = cv2.GaussianBlur(
        rendered(eyes, view)[LEFT].astype(np.float64), (0, 0), 2.0 * coarse * 1e-3 / pixel_m
    )
    seen = map_coordinates(blurred, [image[:, 1].reshape(x.shape), image[:, 0].reshape(x.shape)], order=3)
    shift_px = shift_between(truth, seen) / (800.0 * pixel_m)
    assert np.abs(shift_px).max() < 0.02


@cache
def the_texture(seed: int, mean_grey: float, contrast_grey: float) -> Grey:
    """The finest level of the wall's texture."""
    return wall_texture(seed, mean_grey, contrast_grey)


def shift_between(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Shift (x, y) in samples of ``after`` against ``before``, by least squares on the gradient."""
    inner = (slice(20, -20), slice(20, -20))
    gradients = [np.gradient(before, axis=axis)[inner].ravel() for axis in (1, 0)]
    system = np.stack([-gradients[0], -gradients[1], np.ones(gradients[0].size)], axis=1)
    solution = np.linalg.lstsq(system, (after - before)[inner].ravel(), rcond=None)[0]
    return np.asarray(solution[:2])


def test_rays_beside_the_wall_see_the_sky() -> None:
    eyes = clean_camera()
    view = wall_view(eyes.scene, 1.0, (0.0, 75.0, 0.0))
    picture = rendered(eyes, view)[LEFT]
    assert picture[:, 0].std() == 0.0 or picture[:, -1].std() == 0.0


def test_vignetting_darkens_the_corners_by_the_configured_share() -> None:
    bright = {"mean_grey": 120.0, "contrast_grey": 0.0, "lighting_gradient_per_m": [0.0, 0.0]}
    eyes = camera({"camera": {"vignetting": 0.3, "noise_grey": 0.0}, "wall": bright})
    picture = rendered(eyes, wall_view(eyes.scene, 1.0, (0.0, 0.0, 0.0)))[LEFT].astype(float)
    centre = eyes.eyes[LEFT].lens.centre
    corner_share = 1.0 - 0.3 * (centre @ centre) / (640.0**2 + 360.0**2)
    assert picture[0, 0] == pytest.approx(120.0 * corner_share, abs=1.0)


def test_lighting_changes_along_the_wall() -> None:
    flat = {"mean_grey": 100.0, "contrast_grey": 0.0, "lighting_gradient_per_m": [0.2, 0.0]}
    eyes = camera({"camera": {"vignetting": 0.0, "noise_grey": 0.0}, "wall": flat})
    view = wall_view(eyes.scene, 1.0)
    picture = rendered(eyes, view)[LEFT].astype(float)
    X_WO = eyes.scene.mounts.X_WO
    for x in (-0.8, 0.8):
        (where,), _ = eyes.project(view.X_WC, np.array([[x, -0.3, 0.0]]) @ X_WO[:3, :3].T + X_WO[:3, 3])
        column, row = np.rint(where).astype(int)
        assert picture[row, column] == pytest.approx(100.0 * (1.0 + 0.2 * x), abs=1.0)
