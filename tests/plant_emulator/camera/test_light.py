"""Shadow and response curve: each against an answer that needs no renderer."""

import math
from typing import Any

import numpy as np
import pytest

from foundation.configuration import load
from plant_emulator.config.scene import SceneConfig
from plant_emulator.core.camera.exposures import Capture, Shot
from plant_emulator.core.camera.stereo_camera import LEFT, StereoCamera
from plant_emulator.core.camera.surroundings import shadow_on
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


def test_a_response_curve_bends_grey_levels_and_nothing_else() -> None:
    view = start_view(clean_camera().scene)
    plain = clean_camera().render_eye(LEFT, view, 1).astype(float)
    curved = camera(CLEAN | {"camera": CLEAN["camera"] | {"response_gamma": 0.45}})
    expected = 255.0 * (plain / 255.0) ** 0.45
    found = curved.render_eye(LEFT, view, 1)
    assert np.abs(found - expected)[plain > 4.0].max() <= 0.51


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        ({"lighting": {"shadow": {"factor": 1.5}}}, "less than or equal to 1"),
    ],
)
def test_light_that_cannot_be_is_refused(overrides: dict[str, Any], told: str) -> None:
    with pytest.raises(ConfigurationError, match=told):
        load(SceneConfig, CONFIGS / "scene.yaml", overrides)
