"""Tubes before the wall: rim and mouth stand where they should for each eye, and the truth says where."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from plant_emulator.core.camera.stereo_camera import StereoCamera
from plant_emulator.core.camera.wall.bores import hole_places
from testbed.scenarios.settings import chosen_overrides, load_settings
from tests.plant_emulator.camera.camera_world import CLEAN, camera, wall_view
from tests.support.paths import CONFIGS

PLACE, LENGTH = (-0.35, 0.08), 0.15


def racked(length_m: float = LENGTH, **more: Any) -> StereoCamera:
    tube = {"centre_m": list(PLACE), "diameter_mm": 60.0, "grey": 0, "rim_grey": 200, "side_grey": 10,
            "length_m": length_m} | more  # fmt: skip
    wall = CLEAN["wall"] | {"tubes": [tube], "contrast_grey": 0.0, "mean_grey": 120.0}
    return camera(CLEAN | {"wall": wall})


def crop(picture: np.ndarray, where: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    u, v = np.rint(where).astype(int)
    return picture[v - 40 : v + 41, u - 40 : u + 41].astype(float), where - [u - 40, v - 40]


def test_the_rim_lies_before_the_wall_in_both_eyes() -> None:
    eyes = racked()
    view = wall_view(eyes.scene, 1.0)
    X_WO = eyes.scene.mounts.X_WO
    mouth = hole_places(eyes.scene.config.wall) @ X_WO[:3, :3].T + X_WO[:3, 3]
    for picture, where in zip(
        eyes.render(view.X_WC, view.X_WM, 1), eyes.project(view.X_WC, mouth), strict=True
    ):
        part, middle = crop(picture, where[0])
        v, u = np.mgrid[:81, :81]
        ring = part > 150.0
        assert u[ring].mean() == pytest.approx(middle[0], abs=0.3)
        assert v[ring].mean() == pytest.approx(middle[1], abs=0.3)
        scale = eyes.config.lens.fx_px / (1.0 - LENGTH)
        outer = np.hypot(u - middle[0], v - middle[1])[ring].max()
        assert outer == pytest.approx(scale * 0.034, abs=0.9)
        assert np.all(part[np.hypot(u - middle[0], v - middle[1]) < 0.8 * scale * 0.03] < 20.0)


def test_the_side_reaches_from_the_rim_to_the_wall_where_it_stands() -> None:
    eyes = racked()
    view = wall_view(eyes.scene, 1.0)
    X_WO = eyes.scene.mounts.X_WO
    ends = np.array([[*PLACE, 0.0], [*PLACE, LENGTH]]) @ X_WO[:3, :3].T + X_WO[:3, 3]
    left, _ = eyes.project(view.X_WC, ends)
    picture = eyes.render(view.X_WC, view.X_WM, 1)[0]
    way = (left[0] - left[1]) / np.linalg.norm(left[0] - left[1])
    foot = left[0] + way * eyes.config.lens.fx_px * 0.034
    inside, outside = np.rint(foot - 2.0 * way).astype(int), np.rint(foot + 2.0 * way).astype(int)
    assert picture[inside[1], inside[0]] < 30
    assert picture[outside[1], outside[0]] == pytest.approx(120, abs=2)


def test_its_front_hides_what_is_behind_it_and_a_short_tube_is_all_but_a_hole() -> None:
    eyes = racked()
    hiding = eyes.scene.hiding(0.0)
    assert any(np.allclose(plate.X_parent_plate[:3, 3], [*PLACE, LENGTH]) for plate in hiding)
    flat = racked(0.006)
    view = wall_view(flat.scene, 1.0)
    X_WO = flat.scene.mounts.X_WO
    mouth = hole_places(flat.scene.config.wall) @ X_WO[:3, :3].T + X_WO[:3, 3]
    left, _ = flat.project(view.X_WC, mouth)
    dark = crop(flat.render(view.X_WC, view.X_WM, 1)[0], left[0])[0] < 60
    assert dark.sum() == pytest.approx(np.pi / 4.0 * (0.06 * 530.0) ** 2, rel=0.12)


def test_the_scenario_has_six_tubes_and_the_truth_of_each_mouth() -> None:
    settings = load_settings(Path(CONFIGS), chosen_overrides(Path(CONFIGS), "rack", 3, []))
    wall = settings.scene.wall
    assert (len(wall.tubes), len(wall.drill_holes), settings.scene.object_of_interest.markers) == (6, 0, ())
    places = hole_places(wall)
    assert np.allclose(places[:, 2], [tube.length_m for tube in wall.tubes])
    assert np.allclose(places[:, :2], [tube.centre_m for tube in wall.tubes])
