"""`object_moves`: the object slides, the wall stays; the truth and the pictures agree."""

import numpy as np

from plant_emulator.core.camera.exposures import CameraView, Capture, Shot
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.camera.stereo_camera import LEFT, StereoCamera
from plant_emulator.core.faults.kinds import ObjectMoves
from plant_emulator.core.plant import Plant
from testbed.lockstep.true_view import TrueView
from testbed.scenarios.scenario import load_settings
from tests.support.paths import CONFIGS

SETTINGS = load_settings(CONFIGS, {})
SCENE = Scene(SETTINGS.scene)


def test_the_truth_slides_with_it_and_its_end_puts_it_back() -> None:
    plant = Plant(SETTINGS.plant, 1, SCENE.mounts)
    still = plant.truth().X_WO
    made = plant.inject(ObjectMoves(speed_mm_s=20.0, axis="y"))
    plant.advance(500_000_000)
    slid = np.linalg.inv(still) @ plant.truth().X_WO
    assert np.allclose(slid[:3, 3], [0.0, 0.01, 0.0], atol=1e-9)
    plant.clear(made.number)
    assert np.array_equal(plant.truth().X_WO, still)


def slid_view(shift_m: float) -> CameraView:
    truth = Plant(SETTINGS.plant, 1, SCENE.mounts).truth()
    X_WO = truth.X_WO.copy()
    X_WO[:3, 3] += shift_m * X_WO[:3, 0]
    return CameraView(truth.X_WC, truth.X_WM, X_WO)


def test_pictures_show_it_where_it_is_before_a_wall_that_stays() -> None:
    camera, still, slid = StereoCamera(SETTINGS.scene.camera, SCENE, 1), slid_view(0.0), slid_view(0.02)
    here, there = (camera.take_eye(LEFT, shot(view)).astype(int) for view in (still, slid))
    exact = TrueView(SETTINGS.scene.camera, SCENE)
    before, after = (exact.markers(shot(view).shown) for view in (still, slid))
    hung = [n for n, (parent, _) in SCENE.marker_corners().items() if parent == "O"]
    corners = [seen[n].left for seen in (before, after) for n in hung]
    assert all(np.linalg.norm(after[n].left - before[n].left, axis=1).min() > 5.0 for n in hung)
    rows, columns = np.nonzero(np.abs(here - there) > 40)
    low, high = np.min(corners, axis=(0, 1)) - 60.0, np.max(corners, axis=(0, 1)) + 60.0
    assert len(rows) > 1000
    assert low[1] < rows.min() <= rows.max() < high[1]
    assert low[0] < columns.min() <= columns.max() < high[0]
    assert np.mean(here == there) > 0.97  # the wall is the same


def shot(view: CameraView) -> Shot:
    return Shot(1, 5, Capture(1, 5, view), None, (), delivered=True)
