"""Shadow, glare, auto exposure, response curve and dirt: each against an answer that needs no renderer."""

import math
from typing import Any

import numpy as np
import pytest

from foundation.configuration import load
from plant_emulator.config.scene import SceneConfig
from plant_emulator.core.camera.exposures import Capture, Shot
from plant_emulator.core.camera.stereo_camera import LEFT, MOST_GAIN, RIGHT, AutoExposure, StereoCamera
from plant_emulator.core.camera.surroundings import glare_on, shadow_on
from plant_emulator.core.mechanics.geometry import rotation_from_vector, transform
from protocol.errors import ConfigurationError
from tests.plant_emulator.camera.camera_world import (
    CLEAN,
    camera,
    clean_camera,
    scene_config,
    start_view,
    wall_view,
)
from tests.support.paths import CONFIGS

EVEN = {"lighting_gradient_per_m": [0.0, 0.0], "contrast_grey": 0.0, "mean_grey": 120.0}
SECOND_NS = 1_000_000_000


def even(**scene: Any) -> StereoCamera:
    """The clean camera before an even wall, with more of the scene."""
    keys = CLEAN["camera"] | scene.pop("camera", {})
    return camera({"wall": EVEN, "camera": keys} | scene)


def at(eyes: StereoCamera, capture: Capture) -> tuple[np.ndarray, np.ndarray]:
    """The pair of a capture."""
    return eyes.take(Shot(capture.frame_id, capture.capture_ns, capture, None, (), True))


def on_wall(eyes: StereoCamera, view: Any, x: float, y: float) -> tuple[float, float]:
    """Column and row in the left picture of a place on the wall."""
    X_WO = eyes.scene.mounts.X_WO
    (pixel,), _ = eyes.project(view.X_WC, (X_WO @ [x, y, 0.0, 1.0])[None, :3])
    return float(pixel[0]), float(pixel[1])


def test_a_shadow_darkens_by_its_factor_and_its_edge_wanders() -> None:
    shadow = {"factor": 0.5, "start_m": -0.5, "speed_m_s": 0.2, "way_m": 1.0, "penumbra_m": 0.01}
    eyes = even(lighting={"shadow": shadow})
    view = wall_view(eyes.scene, 1.0)
    for time_s, edge in ((0, -0.5), (1, -0.3), (2, -0.1), (6, -0.3)):  # 6 s: begun again
        picture = at(eyes, Capture(1, time_s * SECOND_NS, view))[LEFT].astype(float)
        column, row = on_wall(eyes, view, edge, -0.25)
        profile = picture[round(row), round(column) - 40 : round(column) + 41]
        assert profile[0] == pytest.approx(60.0, abs=1.0)
        assert profile[-1] == pytest.approx(120.0, abs=1.0)
        assert round(column) - 40.5 + (120.0 - profile).sum() / 60.0 == pytest.approx(column, abs=0.2)


def test_a_shadow_lies_on_markers_and_on_what_the_tool_carries() -> None:
    shaded = even(lighting={"shadow": {"factor": 0.5, "start_m": 5.0, "speed_m_s": 0.0}})
    view = start_view(shaded.scene)
    plain = even().render_eye(LEFT, view, 1).astype(float)
    assert np.abs(shaded.render_eye(LEFT, view, 1) - 0.5 * plain).max() <= 1.0
    away = even(lighting={"shadow": {"factor": 0.5, "start_m": -5.0, "speed_m_s": 0.0}})
    assert np.array_equal(away.render_eye(LEFT, view, 1), plain.astype(np.uint8))


def test_a_tilted_plates_shadow_is_that_of_its_points() -> None:
    config = scene_config({"lighting": {"shadow": {"factor": 0.4, "direction_deg": 30.0}}}).lighting.shadow
    X_OP = transform(rotation_from_vector(np.array([0.3, -0.5, 0.2])), np.array([0.1, -0.2, 0.4]))
    a, b, c, factor = shadow_on(config, X_OP, config.edge_m(3.0))
    s, t = 0.07, 0.11  # right, down
    x, y, _, _ = X_OP @ [s, -t, 0.0, 1.0]
    way = math.cos(math.radians(30.0)) * x + math.sin(math.radians(30.0)) * y
    assert a * s + b * t + c == pytest.approx((way - config.edge_m(3.0)) / config.penumbra_m)
    assert factor == 0.4


def test_glare_lies_where_a_mirror_shows_the_lamp() -> None:
    """The ray from the eye, reflected there by the law of reflection, meets the lamp."""
    config = scene_config({"lighting": {"glare": {"strength_grey": 100.0}}}).lighting.glare
    X_OP = transform(rotation_from_vector(np.array([0.05, -0.1, 0.2])), np.array([0.1, -0.2, 0.05]))
    eye_P = np.array([0.4, -0.3, 0.9])
    right, down, _, _ = glare_on(config, X_OP, eye_P)
    place = np.array([right, -down, 0.0])
    back = (place - eye_P) * [1.0, 1.0, -1.0]
    lamp_P = (np.linalg.inv(X_OP) @ [*config.lamp_m, 1.0])[:3]
    assert np.linalg.norm(np.cross(back, lamp_P - place)) < 1e-12
    assert back @ (lamp_P - place) > 0.0
    behind = transform(rotation_from_vector(np.array([0.0, math.pi, 0.0])), np.zeros(3))
    assert not glare_on(config, behind, eye_P).any()


def test_auto_exposure_converges_as_a_first_order_lag() -> None:
    config = scene_config({"camera": {"auto_exposure": {"enabled": True}}}).camera.auto_exposure
    servo = AutoExposure(config)
    bright, dark = np.full((8, 8), 110, np.uint8), np.full((8, 8), 55, np.uint8)
    assert servo.gain(bright, 1.0, 0) == pytest.approx(1.0)
    gains = [servo.gain(dark, 1.0, round(n * 0.1 * SECOND_NS)) for n in range(1, 31)]
    expected = [2.0 ** (1.0 - math.exp(-n * 0.1 / 0.3)) for n in range(1, 31)]
    np.testing.assert_allclose(gains, expected, rtol=1e-9)
    assert servo.gain(bright, 1.0, 3 * SECOND_NS) == gains[-1]  # the other eye, or a frozen frame
    black = np.zeros((8, 8), np.uint8)
    assert servo.gain(black, 1.0, 100 * SECOND_NS) == pytest.approx(MOST_GAIN)


def test_both_eyes_pictures_are_brought_to_the_wanted_mean() -> None:
    eyes = even(camera={"auto_exposure": {"enabled": True}, "exposure_gain": 0.4})
    view = wall_view(eyes.scene, 1.0)
    for frame in range(3):
        pair = at(eyes, Capture(frame, frame * SECOND_NS, view))
        assert [float(picture.mean()) for picture in pair] == pytest.approx([110.0, 110.0], abs=1.5)


def test_a_response_curve_bends_grey_levels_and_nothing_else() -> None:
    view = start_view(clean_camera().scene)
    plain = clean_camera().render_eye(LEFT, view, 1).astype(float)
    curved = camera(CLEAN | {"camera": CLEAN["camera"] | {"response_gamma": 0.45}})
    expected = 255.0 * (plain / 255.0) ** 0.45
    found = curved.render_eye(LEFT, view, 1)
    assert np.abs(found - expected)[plain > 4.0].max() <= 0.51


def test_dirt_stays_in_one_eye_at_one_place() -> None:
    spot = {"eye": "right", "centre_px": [300.0, 500.0], "radius_px": 40.0, "transmission": 0.5}
    eyes = even(camera={"dirt": [spot | {"scatter_grey": 20.0}]})
    view = wall_view(eyes.scene, 1.0)
    plain = even()
    for moved in (0.0, 0.1):
        shifted = view._replace(X_WC=view.X_WC @ transform(np.eye(3), np.array([moved, 0.0, 0.0])))
        assert np.array_equal(*(e.render_eye(LEFT, shifted, 1) for e in (eyes, plain)))
        clean, dirty = (e.render_eye(RIGHT, shifted, 1).astype(float) for e in (plain, eyes))
        assert dirty[500, 300] == pytest.approx(0.5 * clean[500, 300] + 20.0, abs=1.0)
        share = math.exp(-0.5)
        expected = (1.0 - 0.5 * share) * clean[500, 340] + 20.0 * share
        assert dirty[500, 340] == pytest.approx(expected, abs=1.0)
        assert np.abs(dirty - clean)[:200].max() == 0.0


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        ({"lighting": {"glare": {"lamp_m": [0.0, 0.0, -1.0]}}}, "lamp_m"),
        ({"lighting": {"shadow": {"factor": 1.5}}}, "less than or equal to 1"),
        ({"camera": {"dirt": [{"eye": "middle", "centre_px": [0.0, 0.0]}]}}, "'left' or 'right'"),
    ],
)
def test_light_that_cannot_be_is_refused(overrides: dict[str, Any], told: str) -> None:
    with pytest.raises(ConfigurationError, match=told):
        load(SceneConfig, CONFIGS / "scene.yaml", overrides)
