"""Drill holes with depth: the mouth lies where it was drilled, what is inside moves with the eye."""

from typing import Any

import numpy as np
import pytest

from plant_emulator.core.camera.exposures import CameraView
from plant_emulator.core.camera.stereo_camera import LEFT, StereoCamera
from plant_emulator.core.mechanics.geometry import rotation_from_vector, transform
from tests.plant_emulator.camera.camera_world import CLEAN, camera, wall_view

PLACE = (-0.45, 0.1)


def clean(**wall: Any) -> StereoCamera:
    return camera(CLEAN | {"wall": CLEAN.get("wall", {}) | wall})


def drilled(depth_m: float, broken: float = 0.0) -> StereoCamera:
    hole = {"centre_m": list(PLACE), "diameter_mm": 60.0, "grey": 0, "rim_grey": 120, "depth_m": depth_m,
            "broken": broken, "seed": 4}  # fmt: skip
    return clean(drill_holes=[hole], contrast_grey=0.0, mean_grey=120.0)


def around(eyes: StereoCamera, view: CameraView) -> tuple[np.ndarray, np.ndarray]:
    """The hole's surroundings as shares of dark, and where its middle is in them, px."""
    X_WO = eyes.scene.mounts.X_WO
    place = np.array([[*PLACE, 0.0]]) @ X_WO[:3, :3].T + X_WO[:3, 3]
    (where,), _ = eyes.project(view.X_WC, place)
    u, v = np.rint(where).astype(int)
    part = eyes.render_eye(LEFT, view, 1).astype(float)[v - 30 : v + 31, u - 30 : u + 31]
    return part, where - [u - 30, v - 30]


def aslant(eyes: StereoCamera) -> CameraView:
    straight = wall_view(eyes.scene, 1.0)
    turned = transform(rotation_from_vector(np.array([0.0, 0.3, 0.0])), np.array([-0.3, 0.0, 0.0]))
    return CameraView(straight.X_WC @ turned, straight.X_WM)


def test_the_mouth_is_where_it_was_drilled_and_as_wide() -> None:
    eyes = drilled(0.5)
    part, where = around(eyes, wall_view(eyes.scene, 1.0))
    hole = part < 90.0  # the tube's wall is at most 0.45 times 120
    v, u = np.nonzero(hole)
    assert u.mean() == pytest.approx(where[0], abs=0.15)
    assert v.mean() == pytest.approx(where[1], abs=0.15)
    assert hole.sum() == pytest.approx(np.pi / 4.0 * (0.06 * eyes.config.lens.fx_px) ** 2, rel=0.03)


def test_what_is_inside_moves_with_the_eye() -> None:
    """Seen aslant, one side of the tube's wall is lit: the grey inside is no longer alike on both sides."""
    eyes = drilled(0.5)
    part, where = around(eyes, aslant(eyes))
    v, u = np.mgrid[:61, :61]
    inside = np.hypot(u - where[0], v - where[1]) < 11.0
    left, right = inside & (u < where[0]), inside & (u > where[0])
    assert abs(float(part[left].mean() - part[right].mean())) > 2.0


def test_a_broken_rim_is_wider_here_and_there_only() -> None:
    whole, _ = around(drilled(0.5), wall_view(drilled(0.5).scene, 1.0))
    broken, _ = around(drilled(0.5, 0.2), wall_view(drilled(0.5, 0.2).scene, 1.0))
    more = (broken < 60.0).sum() / (whole < 60.0).sum()
    assert 1.01 < more < 1.44
