"""The eye model: exact where pictures are, wrong by what was measured in them, and failing as they do."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from foundation.configuration import merged
from plant_emulator.core.camera.exposures import CameraView, Capture
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.camera.stereo_camera import StereoCamera
from plant_emulator.core.plant import Plant
from plant_emulator.core.truth import PlantTruth
from protocol.errors import ConfigurationError, MeasurementFailed
from testbed.lockstep.simulated_measurements import (
    CornerNoise,
    EyeModelConfig,
    SimulatedFrame,
    SimulatedSensor,
    load_eye_model,
)
from testbed.lockstep.simulated_odometry import TrackingNoise
from testbed.lockstep.true_view import TrueView
from testbed.scenarios.scenario import Settings, load_settings
from tests.plant_emulator.camera.corner_oracle import project_corners
from tests.support.paths import CONFIGS
from vision_pc.core.perception.look import combine
from vision_pc.core.perception.watch import Watcher
from vision_pc.core.se3 import Array, angle_between, inverse, transform
from vision_pc.core.types import Look

NOMINAL: dict[str, Any] = {
    "camera": {
        "baseline_m": 0.12,
        "lens": {"fx_px": 530.0, "fy_px": 530.0, "cx_px": 639.5, "cy_px": 359.5}
        | dict.fromkeys(("k1", "k2", "p1", "p2", "k3"), 0.0),
        "rectification": {"vertical_px": 0.0, "disparity_px": 0.0, "right_eye_rotation_deg": [0.0, 0.0, 0.0]},
    },
    "tool_marker": {"print_scale_error": 0.0},
}
QUIET = EyeModelConfig(
    corners=CornerNoise(noise_px=0.0, bias_px=0.0, missed_share=0.0),
    tracking=TrackingNoise(noise_px=0.0, map_px=0.0, points=200, lost_share=0.0),
)


class Stage:
    """A model sight before a plant that stands still, and what it is shown."""

    def __init__(
        self, model: EyeModelConfig, seed: int = 1, vision: dict[str, Any] | None = None, **scene: Any
    ) -> None:
        as_drawn = [
            {name: getattr(marker, name) for name in ("marker_id", "side_m", "quiet_zone_m", "centre_m")}
            for marker in settings().scene.object_of_interest.markers
        ]
        world = merged(NOMINAL, {"object_of_interest": {"markers": as_drawn}})
        self.settings: Settings = load_settings(
            CONFIGS, {"scene": merged(world, scene), "vision": vision or {}}
        )
        mounts = Scene(self.settings.scene).mounts
        self.truth: PlantTruth = Plant(self.settings.plant, 1, mounts).truth()
        self.sensor = SimulatedSensor(self.settings, model, seed)
        self.exposures = 0

    def exposed(self, truth: PlantTruth) -> SimulatedFrame:
        self.exposures += 1
        return SimulatedFrame(shown(truth.X_WC, truth.X_WM), truth.time_ns, self.exposures)

    def look(self, frames: int = 4) -> Look:
        observations, previous = [], None
        for _ in range(frames):
            previous = self.sensor.observe(self.exposed(self.truth), previous)
            observations.append(previous)
        return combine(observations, np.eye(4), 0, self.settings.vision.look)

    def moved(self, step_C: Any) -> PlantTruth:
        """The truth with camera and tool moved by ``step_C`` (3,) along the camera's axes."""
        shift = transform(np.eye(3), self.truth.X_WC[:3, :3] @ np.asarray(step_C))
        return self.truth._replace(X_WC=shift @ self.truth.X_WC, X_WM=shift @ self.truth.X_WM)


def shown(X_WC: Array, X_WM: Array) -> Capture:
    """What a camera at rest shows."""
    return Capture(1, 0, CameraView(X_WC, X_WM))


def settings() -> Settings:
    return load_settings(CONFIGS, {})


def noisy(**changes: float) -> EyeModelConfig:
    corners = {"noise_px": 0.03, "bias_px": 0.02, "missed_share": 0.0}
    tracking = {"noise_px": 0.1, "map_px": 0.1, "points": 200, "lost_share": 0.0}
    for name, value in changes.items():
        (corners if name in corners else tracking)[name] = value
    return EyeModelConfig(corners=CornerNoise(**corners), tracking=TrackingNoise(**tracking))  # type: ignore[arg-type]


def test_the_view_is_the_renderers_own() -> None:
    """Exact corners agree with the rendering camera's, wherever the tool does not hide a marker."""
    config = settings()
    scene = Scene(config.scene)
    truth = Plant(config.plant, 1, scene.mounts).truth()
    camera = StereoCamera(config.scene.camera, scene, 1)
    exact = project_corners(camera, truth.X_WC, truth.X_WM)
    seen = TrueView(config.scene.camera, scene).markers(shown(truth.X_WC, truth.X_WM))
    assert seen.keys() == exact.keys()
    compared = 0
    for number, marker in seen.items():
        for pixels, true in zip(marker, exact[number], strict=True):
            if pixels is not None:
                assert np.allclose(pixels, true)
                compared += 1
    assert compared >= 6


def test_what_the_tool_hides_and_what_is_out_of_view_is_not_seen() -> None:
    stage = Stage(QUIET)
    view = TrueView(stage.settings.scene.camera, Scene(stage.settings.scene))
    X_WO, X_WC = stage.truth.X_WO, stage.truth.X_WC
    behind = transform(X_WO[:3, :3], (X_WO @ [-0.2, 0.0, 0.0, 1.0])[:3])  # the middle of marker 1
    towards = X_WC[:3, 3] - behind[:3, 3]
    before = transform(X_WO[:3, :3], behind[:3, 3] + 0.3 * towards)
    seen = view.markers(shown(X_WC, before))
    assert seen[1].left is None
    assert seen[2].left is not None
    away = stage.moved([3.0, 0.0, 0.0])
    assert all(view.markers(shown(away.X_WC, stage.truth.X_WM))[k].left is None for k in (1, 2, 3))


def test_without_noise_and_with_the_camera_that_vision_believes_in_a_look_is_exact() -> None:
    stage = Stage(QUIET)
    look = stage.look()
    for X, true in ((look.X_CM, stage.truth.X_WM), (look.X_CO, stage.truth.X_WO)):
        exact = inverse(stage.truth.X_WC) @ true
        assert np.allclose(X[:3, 3], exact[:3, 3], atol=1e-6)
        assert angle_between(X[:3, :3], exact[:3, :3]) < 1e-5


def test_a_longer_baseline_shortens_the_odometrys_way_in_proportion() -> None:
    """What is wrong with the camera shows by itself: the model draws noise, not geometry."""
    for baseline_m, scale in ((0.12, 1.0), (0.12 * 1.006, 1.0 / 1.006)):
        stage = Stage(QUIET, camera={"baseline_m": baseline_m})
        odometry = stage.sensor.odometry(None)  # no marker has told it of an offset
        steps = np.linspace([0.0, 0.0, 0.0], [0.15, 0.1, 0.1], 12)
        poses = [odometry.process(stage.exposed(stage.moved(step))) for step in steps]
        went = np.linalg.norm(poses[-1].X_C0C[:3, 3])
        assert went == pytest.approx(scale * np.linalg.norm(steps[-1]), rel=4e-4)


def test_noise_is_as_large_as_told_and_bias_stays_at_its_place() -> None:
    biased = Stage(noisy(noise_px=0.0))
    first, again = (biased.sensor.observe(biased.exposed(biased.truth), None) for _ in range(2))
    assert first.X_CO is not None
    assert np.array_equal(first.X_CO, again.X_CO), "the same place in the picture has the same bias"
    stage = Stage(noisy(bias_px=0.0))
    errors = []
    for _ in range(40):
        seen = stage.sensor.observe(stage.exposed(stage.truth), None)
        marker = next(m for m in seen.markers if m.marker_id == 1)
        errors.append(marker.corners_left)
    assert np.std(errors, axis=0).mean() == pytest.approx(0.03, rel=0.2)


def test_the_same_seed_is_the_same_noise_and_another_is_not() -> None:
    looks = [Stage(noisy(), seed).look() for seed in (1, 1, 2)]
    assert np.array_equal(looks[0].X_CO, looks[1].X_CO)
    assert not np.array_equal(looks[0].X_CO, looks[2].X_CO)


def test_failures_end_in_their_causes_and_never_in_numbers() -> None:
    with pytest.raises(MeasurementFailed) as unseen:
        Stage(noisy(missed_share=1.0)).look()
    assert unseen.value.cause == "measurement.tool_not_seen"
    stage = Stage(noisy(lost_share=1.0))
    watcher = Watcher(stage.sensor, markers=False, odometry=True)
    watcher.live = True
    for _ in range(5):
        watcher.add(stage.exposed(stage.truth), np.eye(4))
    assert [sample.X_C0C for sample in watcher.samples] == [None] * 5
    with pytest.raises(MeasurementFailed) as lost:
        watcher.require()
    assert lost.value.cause == "measurement.odometry_lost"


def test_the_shipped_parameters_load_and_a_wrong_file_is_refused(tmp_path: Path) -> None:
    usual, harder = load_eye_model(CONFIGS), load_eye_model(CONFIGS, "harder")
    assert harder.corners.noise_px > usual.corners.noise_px > 0.0
    assert harder.tracking.noise_px > usual.tracking.noise_px > 0.0
    text = (CONFIGS / "eye_model.yaml").read_text(encoding="utf-8")
    (tmp_path / "eye_model.yaml").write_text(
        text.replace("missed_share: 0", "missed_share: 7", 1), encoding="utf-8"
    )
    with pytest.raises(ConfigurationError, match="missed_share"):
        load_eye_model(tmp_path)


def test_odometry_is_lost_behind_what_passes_and_finds_its_keyframe_again() -> None:
    board = {
        "start_m": [-8.0, 0.0, 0.3],
        "velocity_m_s": [8.0, 0.0, 0.0],
        "period_s": 5.0,
        "size_m": [4.0, 4.0],
    }
    stage = Stage(QUIET, passers=[board])
    odometry = stage.sensor.odometry(None)
    outcomes = []
    for second in (0, 1, 2):  # away, in the middle, gone
        seen = stage.exposed(stage.truth)
        passed = seen._replace(shown=seen.shown._replace(capture_ns=second * 1_000_000_000))
        outcomes.append((odometry.process(passed) is not None, odometry.last_loss))
    assert outcomes == [(True, None), (False, "too_few_points"), (True, None)]
