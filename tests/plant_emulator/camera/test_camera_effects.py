"""Each effect of the camera and the wall does what its name says, and no more."""

from typing import Any

import cv2
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from plant_emulator.core.camera.exposures import CameraView, motion_between
from plant_emulator.core.camera.stereo_camera import LEFT, StereoCamera
from plant_emulator.core.camera.wall.wall_texture import SIZE, wall_texture
from plant_emulator.core.mechanics.geometry import rotation_from_vector, transform
from tests.plant_emulator.camera.camera_world import (
    CLEAN,
    Matrix,
    camera,
    clean_camera,
    even_plate,
    start_view,
    wall_view,
)
from tests.plant_emulator.camera.corner_oracle import project_corners, refined_corners
from tests.plant_emulator.camera.test_stereo_camera import shift_between


def clean(**sections: dict[str, Any]) -> StereoCamera:
    """The camera without disturbances, with more keys in the scene's sections."""
    return camera(
        {name: CLEAN.get(name, {}) | keys for name, keys in ({k: {} for k in CLEAN} | sections).items()}
    )


def test_motion_carries_one_view_into_the_next() -> None:
    before = start_view(clean_camera().scene)
    turn = rotation_from_vector(np.array([0.01, -0.02, 0.005]))
    now = CameraView(*(X @ transform(turn, np.array([0.002, 0.001, -0.003])) for X in before[:2]))
    motion = motion_between(before, now, 0.02)
    for reached, expected in zip(motion.at(before, 0.02)[:2], now[:2], strict=True):
        assert np.allclose(reached, expected, atol=1e-12)
    assert np.allclose(
        motion.at(before, 0.01).X_WC[:3, 3], (before.X_WC[:3, 3] + now.X_WC[:3, 3]) / 2.0, atol=1e-12
    )


@pytest.mark.parametrize("width_px", [0.6, 1.5])
def test_the_point_spread_is_as_wide_as_configured(width_px: float) -> None:
    plate = even_plate((-0.4, 0.0), (0.3, 0.3), 220.0)
    plain = CLEAN | {"passers": [plate], "wall": CLEAN["wall"] | {"contrast_grey": 0.0, "mean_grey": 60.0}}
    eyes = camera(plain | {"camera": CLEAN["camera"] | {"blur_px": width_px}})
    view = wall_view(eyes.scene, 1.0)
    X_WO = eyes.scene.mounts.X_WO
    (corner,), _ = eyes.project(view.X_WC, (X_WO @ [[-0.55], [0.0], [0.0], [1.0]])[:3].T)
    column, row = np.rint(corner).astype(int)
    profile = eyes.render_eye(LEFT, view, 1)[row, column - 12 : column + 13]
    pixel = 1.0 / 12.0  # variance of the pixel's own width
    assert spread(profile) / np.sqrt(12.0) == pytest.approx(np.sqrt(width_px**2 + pixel), rel=0.05)


def test_a_misprinted_marker_is_as_large_as_it_was_printed() -> None:
    view = start_view(clean_camera().scene)
    sides = []
    for scale_error in (0.0, 0.03):
        eyes = clean(tool_marker={"print_scale_error": scale_error, "quiet_zone_m": 0.02})
        corners = refined_corners(
            eyes.render_eye(LEFT, view, 1), project_corners(eyes, *view)[0][LEFT], 4, 6.0
        )
        assert corners is not None
        sides.append(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1))
    np.testing.assert_allclose(sides[1] / sides[0], 1.03, atol=1e-3)


def spread(profile: np.ndarray) -> float:
    """Width in pixels of a ramp between two levels: sqrt(12) times its standard deviation."""
    slope = np.diff(profile.astype(float))
    places = np.arange(slope.size)
    mean = (slope * places).sum() / slope.sum()
    return float(np.sqrt(12.0 * (slope * (places - mean) ** 2).sum() / slope.sum()))


def relief_height(x: Matrix, y: Matrix, amplitude: float, length: float) -> Matrix:
    """The undulation as documented: half of each of two parabola waves, counted from the texture's corner."""

    def wave(turns: Matrix) -> Matrix:
        t = turns - np.floor(turns + 0.5)
        return 8.0 * t * (1.0 - 2.0 * np.abs(t))

    along, down = (x + SIZE / 2000.0) / length, (SIZE / 2000.0 - y) / length
    return amplitude * 0.5 * (wave(along) + wave(1.37 * down + 0.3))


@pytest.mark.parametrize("offset", [-0.4, 0.4])
def test_an_undulating_wall_is_a_rigid_surface(offset: float) -> None:
    """From either side, the texture lies at the projections of the points of one and the same surface."""
    eyes = clean(wall={"undulation_mm": 20.0, "undulation_length_m": 0.8})
    wall = eyes.scene.config.wall
    side = np.arange(-60, 61) / 800.0
    x, y = np.meshgrid(0.35 + side, 0.05 - side)
    z = relief_height(x, y, 0.02, 0.8)
    X_WO = eyes.scene.mounts.X_WO
    straight = wall_view(eyes.scene, 1.1)
    view = CameraView(straight.X_WC @ transform(np.eye(3), np.array([offset, 0.0, 0.0])), straight.X_WM)
    points = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1) @ X_WO[:3, :3].T + X_WO[:3, 3]
    image, _ = eyes.project(view.X_WC, points)
    texture = wall_texture(wall.texture_seed, wall.mean_grey, wall.contrast_grey)[1700:2300, 2100:2750]
    places = [SIZE / 2 - 1000.0 * y - 0.5 - 1700, SIZE / 2 + 1000.0 * x - 0.5 - 2100]
    truth = map_coordinates(cv2.GaussianBlur(texture.astype(float), (0, 0), 4.0), places, order=3)
    pixel_m = 1.1 / eyes.config.lens.fx_px
    picture = eyes.render_eye(LEFT, view, 1).astype(float)
    blurred = cv2.GaussianBlur(picture, (0, 0), 4e-3 / pixel_m)
    seen = map_coordinates(blurred, [image[:, 1].reshape(x.shape), image[:, 0].reshape(x.shape)], order=3)
    assert np.abs(shift_between(truth, seen)).max() / (800.0 * pixel_m) < 0.05
    flat, _ = eyes.project(
        view.X_WC, (points - X_WO[:3, 3]) @ X_WO[:3, :3] * [1, 1, 0] @ X_WO[:3, :3].T + X_WO[:3, 3]
    )
    assert np.abs(image - flat).max() > 0.5  # the relief moves the picture, so the above is a test


def test_exposure_scales_and_saturates() -> None:
    view = start_view(clean_camera().scene)
    plain = clean_camera().render_eye(LEFT, view, 1).astype(float)
    dim, bright = (clean(camera={"exposure_gain": gain}).render_eye(LEFT, view, 1) for gain in (0.5, 4.0))
    assert np.abs(dim - plain * 0.5).max() <= 1.0
    assert (bright[plain > 64] == 255).all()
