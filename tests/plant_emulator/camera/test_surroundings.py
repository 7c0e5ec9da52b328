"""Depth steps, bare patches and passers: where they should be, in pictures and in the eye model."""

from typing import Any

import numpy as np
import pytest

from foundation.configuration import load
from plant_emulator.config.scene import SceneConfig
from plant_emulator.core.camera.exposures import CameraView, Capture, Shot
from plant_emulator.core.camera.stereo_camera import LEFT, StereoCamera
from protocol.errors import ConfigurationError
from testbed.lockstep.true_view import TrueView
from tests.plant_emulator.camera.camera_world import CLEAN, camera, clean_camera, start_view, wall_view
from tests.plant_emulator.camera.test_stereo_camera import seen_ids
from tests.support.paths import CONFIGS

EVEN = {"lighting_gradient_per_m": [0.0, 0.0], "contrast_grey": 0.0, "mean_grey": 120.0}
IDEAL = {
    "lens": dict.fromkeys(("k1", "k2", "p1", "p2"), 0.0),
    "rectification": {"vertical_px": 0.0, "disparity_px": 0.0, "right_eye_rotation_deg": [0.0, 0.0, 0.0]},
}
SECOND_NS = 1_000_000_000
PERSON = {"start_m": [-1.5, 0.0, 0.4], "velocity_m_s": [1.0, 0.0, 0.0], "period_s": 4.0}


def clean(wall: dict[str, Any] | None = None, **scene: Any) -> StereoCamera:
    """The clean camera with more of the scene."""
    return camera(CLEAN | {"wall": CLEAN["wall"] | (wall or {})} | scene)


def taken(eyes: StereoCamera, view: CameraView, time_s: float) -> np.ndarray:
    """The left picture at a time."""
    capture = Capture(1, round(time_s * SECOND_NS), view)
    return eyes.take(Shot(1, capture.capture_ns, capture, None, (), True))[LEFT]


def column_of(eyes: StereoCamera, view: CameraView, x: float, y: float, z: float) -> tuple[float, float]:
    """Column and row in the left picture of a place in O."""
    point = (eyes.scene.mounts.X_WO @ [x, y, z, 1.0])[None, :3]
    (pixel,), _ = eyes.project(view.X_WC, point)
    return float(pixel[0]), float(pixel[1])


def test_a_blocks_face_ends_at_its_edges_and_shows_its_sides() -> None:
    block = {"centre_m": [0.6, 0.0], "size_m": [0.2, 0.3], "depth_m": 0.25}
    eyes = clean(wall=EVEN | {"blocks": [block]})
    view = wall_view(eyes.scene, 1.0)
    picture = eyes.render_eye(LEFT, view, 1)
    (edge, row), (foot, _) = (column_of(eyes, view, 0.5, 0.0, z) for z in (0.25, 0.0))
    assert foot < edge - 20  # the camera looks from the left: it sees that side
    side = picture[round(row), round(foot) + 3 : round(edge) - 2]
    assert (side == 60).all()  # half of the wall's light
    assert (picture[round(row), round(edge) + 3 : round(edge) + 60] == 120).all()
    assert (picture[round(row), round(foot) - 60 : round(foot) - 3] == 120).all()


def test_a_bare_patch_has_so_much_of_the_contrast_left() -> None:
    patch = {"centre_m": [-0.5, -0.1], "radius_m": 0.2, "contrast": 0.2}
    eyes, plain = clean(wall={"bare_patches": [patch]}), clean_camera()
    view = wall_view(eyes.scene, 1.0)
    column, row = (round(value) for value in column_of(eyes, view, -0.5, -0.1, 0.0))
    bare, rough = (e.render_eye(LEFT, view, 1).astype(float) for e in (eyes, plain))
    inside = np.s_[row - 50 : row + 50, column - 50 : column + 50]
    assert bare[inside].std() == pytest.approx(0.2 * rough[inside].std(), rel=0.1)
    assert np.array_equal(bare[:, 700:], rough[:, 700:])


def test_what_passes_is_where_its_speed_has_brought_it() -> None:
    even = PERSON | {"contrast_grey": 0.0, "mean_grey": 220.0}
    eyes = clean(wall=EVEN, passers=[even])
    view = wall_view(eyes.scene, 1.5)
    for time_s, middle in ((1.0, -0.5), (2.0, 0.5), (5.0, -0.5)):  # 5 s: it began again
        picture = taken(eyes, view, time_s).astype(float)
        (left, row), (right, _) = (column_of(eyes, view, middle + h, 0.3, 0.4) for h in (-0.25, 0.25))
        shown = (picture[round(row)] - 120.0) / 100.0
        assert (np.arange(1280) * shown).sum() / shown.sum() == pytest.approx(0.5 * (left + right), abs=0.2)
        assert shown.sum() == pytest.approx(right - left, abs=0.2)


def test_the_eye_model_sees_a_marker_when_the_picture_does() -> None:
    passer = {"start_m": [-1.0, 0.0, 0.3], "velocity_m_s": [0.5, 0.0, 0.0], "period_s": 4.0}
    eyes = clean(passers=[passer | {"size_m": [0.25, 1.0]}])
    view, model = start_view(eyes.scene), TrueView(eyes.config, eyes.scene)
    seen = []
    for time_s in (0.0, 1.0, 1.6, 2.0, 2.4, 3.5):
        found = seen_ids(taken(eyes, view, time_s))
        both = model.markers(Capture(1, round(time_s * SECOND_NS), view))
        whole = {number for number, marker in both.items() if marker.left is not None}
        # a detector may still read a marker whose rim is just touched; it never reads one that is covered
        assert whole <= found | {0}
        assert 0 in found
        seen.append(whole)
    assert {1, 2, 3} <= seen[0]
    assert min(len(s) for s in seen) <= 2


def test_the_eye_models_wall_points_lie_on_faces_and_not_in_bare_patches() -> None:
    patch = {"centre_m": [0.4, -0.3], "radius_m": 0.25, "contrast": 0.1}
    block = {"centre_m": [-0.55, -0.1], "size_m": [0.3, 0.4], "depth_m": 0.2}
    passer = {"start_m": [0.0, 0.0, 0.5], "velocity_m_s": [0.0, 0.0, 0.0], "size_m": [0.2, 3.0]}
    eyes = clean(wall={"bare_patches": [patch], "blocks": [block]}, passers=[passer])
    view = wall_view(eyes.scene, 1.5)
    rays = np.stack(np.meshgrid(np.linspace(-1.0, 1.0, 80), np.linspace(-0.6, 0.6, 50)), axis=-1).reshape(
        -1, 2
    )
    shown, model = Capture(1, 0, view), TrueView(eyes.config, eyes.scene)
    points_W = model.on_wall(shown, rays)
    X_OW = np.linalg.inv(eyes.scene.mounts.X_WO)
    points = points_W @ X_OW[:3, :3].T + X_OW[:3, 3]
    on_face = np.isclose(points[:, 2], 0.2)
    assert on_face.sum() > 50
    assert np.isclose(points[~on_face, 2], 0.0).all()
    assert (np.abs(points[on_face, :2] - [-0.55, -0.1]) <= [0.15 + 1e-9, 0.2 + 1e-9]).all()
    assert (np.linalg.norm(points[~on_face, :2] - [0.4, -0.3], axis=1) > 0.25).all()
    assert not any(hidden.any() for hidden in model.hidden(shown, points_W)[:1])
    behind = np.array(
        [[0.0, 0.0, 0.0], [-0.45, -0.1, 0.0], [0.8, 0.2, 0.0]]
    )  # of passer, of block, of nothing
    behind_W = behind @ eyes.scene.mounts.X_WO[:3, :3].T + eyes.scene.mounts.X_WO[:3, 3]
    assert model.hidden(shown, behind_W)[LEFT].tolist() == [True, True, False]


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        ({"passers": [PERSON | {"velocity_m_s": [0.0, 0.0, -0.2]}]}, "into the wall"),
        ({"wall": {"blocks": [{"centre_m": [0, 0], "size_m": [0.3, 0.3], "depth_m": 0.0}]}}, "greater than"),
        ({"wall": {"bare_patches": [{"centre_m": [0, 0], "radius_m": 3.0}]}}, "less than or equal to 2"),
    ],
)
def test_a_world_that_cannot_be_is_refused(overrides: dict[str, Any], told: str) -> None:
    with pytest.raises(ConfigurationError, match=told):
        load(SceneConfig, CONFIGS / "scene.yaml", overrides)
