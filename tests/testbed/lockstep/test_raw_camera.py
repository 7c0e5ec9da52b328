"""The loop takes raw pairs of two lenses: with their file it sees as well as with rectified ones."""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from foundation.configuration import merged
from plant_emulator.config.camera import CameraConfig
from protocol.errors import ConfigurationError
from testbed.lockstep.clock import RunLog, run
from testbed.lockstep.simulated_measurements import camera_eyes, load_eye_model, simulated_sight
from testbed.lockstep.world import World
from testbed.scenarios.scenario import Settings, chosen_overrides, load_settings
from tests.support.paths import CONFIGS
from vision_pc.config.camera_files.reading import write_calibration
from vision_pc.config.stereo_camera import StereoCalibration
from vision_pc.core import se3
from vision_pc.core.perception.rectification import geometry


def told_exactly(camera: CameraConfig) -> StereoCalibration:
    """The file that a perfect calibration of the plant's camera would give."""
    eyes = [
        {
            "lens": "brown-conrady",
            **{name: getattr(lens, name) for name in ("fx_px", "fy_px", "cx_px", "cy_px")},
            "distortion": (lens.k1, lens.k2, lens.p1, lens.p2, lens.k3),
        }
        for lens in (camera.lens, camera.lens_difference.added_to(camera.lens))
    ]
    return StereoCalibration.model_validate(
        {
            "format": "longreach-camera/1",
            "width_px": camera.width_px,
            "height_px": camera.height_px,
            "left": eyes[0],
            "right": eyes[1],
            "right_position_m": (camera.baseline_m, 0.0, 0.0),
            "right_rotation_vector_deg": camera.rectification.right_eye_rotation_deg,
        }
    )


@pytest.fixture(scope="module")
def raw(tmp_path_factory: pytest.TempPathFactory) -> Settings:
    """The scenario ``raw_camera`` with its calibration file."""
    overrides: dict[str, Any] = chosen_overrides(CONFIGS, "raw_camera", 1, [])
    exact = told_exactly(load_settings(CONFIGS, overrides).scene.camera)
    path: Path = tmp_path_factory.mktemp("camera") / "camera.yaml"
    write_calibration(path, exact)
    return load_settings(CONFIGS, merged(overrides, {"vision": {"camera": {"calibration": str(path)}}}))


def test_a_look_through_raw_eyes_is_as_good_as_through_rectified_ones(raw: Settings) -> None:
    world = World(raw, 1, RunLog())
    world.connect()
    look = run(camera_eyes(world).look(3))
    truth = world.plant.truth()
    told = raw.vision.camera.calibration
    X_WC = truth.X_WC @ se3.transform(geometry(told).R_left.T, np.zeros(3))
    errors = [
        se3.local(se3.inverse(X_WC) @ world.camera.renderer.scene.mounts.X_WO, look.X_CO),
        se3.local(se3.inverse(X_WC) @ truth.X_WM, look.X_CM),
    ]
    for error in errors:
        assert np.linalg.norm(error[:3]) < 0.003, errors
        assert np.degrees(np.linalg.norm(error[3:])) < 0.3, errors
    assert abs(look.offset.y_px) < 0.15


def test_eyes_without_pictures_take_no_raw_pairs(raw: Settings) -> None:
    model = load_eye_model(CONFIGS, "usual")
    with pytest.raises(ConfigurationError, match="these eyes take no raw pairs") as refused:
        partial(simulated_sight, model=model, seed=1)(World(raw, 1, RunLog()))
    assert refused.value.cause == "configuration.raw_camera"
