"""Watches and looks at the emulated camera's own pictures, whose lens, mount and prints the vision side
does not know.
"""

from typing import NamedTuple

import numpy as np
import pytest

from foundation.configuration import load
from plant_emulator.config.scene import SceneConfig
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.camera.stereo_camera import StereoCamera
from protocol.errors import MeasurementFailed
from tests.vision_pc.conftest import VISION_YAML
from vision_pc.config.camera import EyeSettings, PinholePair
from vision_pc.config.vision import VisionConfig
from vision_pc.core import se3
from vision_pc.core.perception import intrinsics, look
from vision_pc.core.perception.watch import AT_REST, Watcher
from vision_pc.core.pixel_sensor import PixelSensor
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, FrameObservation, StereoPair

X_BT_START = se3.transform(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), (3.89355, 0.0, 1.00825))


class Shot(NamedTuple):
    """A pair and the truth at its capture."""

    pair: StereoPair
    X_BT: Array
    X_WC: Array
    X_CM: Array
    X_CO: Array


class World:
    """The shipped scene, its markers where they are meant to hang; its camera goes wherever a test wants."""

    def __init__(self) -> None:
        shipped = VISION_YAML.with_name("scene.yaml")
        meant = {"misplaced_m": [0.0, 0.0, 0.0]}
        markers = [m.model_dump() | meant for m in load(SceneConfig, shipped).object_of_interest.markers]
        self.config = load(SceneConfig, shipped, {"object_of_interest": {"markers": markers}})
        self.scene = Scene(self.config)
        self.camera = StereoCamera(self.config.camera, self.scene, seed=1)

    def shot(self, offset_T: tuple[float, float, float], frame_id: int, turn_deg: float = 0.0) -> Shot:
        """What is seen with the tool ``offset_T`` (in T, metres) from the start pose, rolled by
        ``turn_deg``.
        """
        mounts = self.scene.mounts
        X_BT = X_BT_START @ se3.transform(se3.exp_so3(np.radians([0.0, 0.0, turn_deg])), offset_T)
        X_WT = mounts.X_WB @ X_BT
        X_WC, X_WM = X_WT @ mounts.X_TC, X_WT @ mounts.X_TM
        left, right = self.camera.render(X_WC, X_WM, frame_id)
        X_CW = se3.inverse(X_WC)
        return Shot(
            StereoPair(left, right, 100 * frame_id, frame_id), X_BT, X_WC, X_CW @ X_WM, X_CW @ mounts.X_WO
        )

    def true_lens(self, config: VisionConfig) -> CameraCalibration:
        """The calibration that the vision side would have if it had been told the truth."""
        lens = self.config.camera.lens
        eye = EyeSettings(
            fx_px=lens.fx_px,
            fy_px=lens.fy_px,
            cx_px=lens.cx_px,
            cy_px=lens.cy_px,
            distortion=(lens.k1, lens.k2, lens.p1, lens.p2, lens.k3),
        )
        told = PinholePair(left=eye, right=eye, baseline_m=self.config.camera.baseline_m)
        return intrinsics.calibration(config.camera.model_copy(update={"calibration": told}))


@pytest.fixture(scope="module")
def world() -> World:
    return World()


@pytest.fixture(scope="module")
def path(world: World) -> list[Shot]:
    """0.6 m in three legs."""
    legs = [(0.1, 0, 0), (0.2, 0, 0), (0.2, 0.1, 0), (0.2, 0.2, 0), (0.2, 0.2, 0.1), (0.2, 0.2, 0.2)]
    return [world.shot((0.0, 0.0, 0.0), 1), *(world.shot(leg, k + 2) for k, leg in enumerate(legs))]


def goal_error(shot: Shot, seen: FrameObservation) -> Array:
    """Error of what is asked of the eyes: from tool to object, in the camera's axes."""
    return (seen.X_CO - seen.X_CM)[:3, 3] - (shot.X_CO - shot.X_CM)[:3, 3]


def test_told_the_true_lens_the_eyes_see_the_truth(
    world: World, config: VisionConfig, path: list[Shot]
) -> None:
    camera = world.true_lens(config)
    seen: FrameObservation | None = None
    for shot in path:
        seen = look.observe(shot.pair, camera, config.markers, seen)
        error = goal_error(shot, seen)
        assert np.abs(error[:2]).max() < 0.3e-3
        assert abs(error[2]) < 1.2e-3  # prints are wrong by up to 0.08 %
        assert np.degrees(se3.angle_between(seen.X_CO[:3, :3], shot.X_CO[:3, :3])) < 0.1
    rectification = world.config.camera.rectification
    assert abs(seen.offset.x_px + rectification.disparity_px) < 0.08
    assert abs(seen.offset.y_px - rectification.vertical_px) < 0.05


def test_watch_follows_the_camera_and_leaves_the_tool_out(
    camera: CameraCalibration, config: VisionConfig, path: list[Shot]
) -> None:
    watcher = Watcher(PixelSensor(config), markers=False, odometry=True)
    for shot in path:
        watcher.add(shot.pair, shot.X_BT)
    assert [sample.time_ns for sample in watcher.samples] == [shot.pair.capture_ns for shot in path]
    for sample, shot in zip(watcher.samples, path, strict=True):
        np.testing.assert_array_equal(sample.X_BT, shot.X_BT)
        assert (sample.X_CM, sample.X_CO) == (None, None)
        true = se3.inverse(path[0].X_WC) @ shot.X_WC
        assert np.linalg.norm(sample.X_C0C[:3, 3] - true[:3, 3]) < 1.0e-3
        assert np.degrees(se3.angle_between(sample.X_C0C[:3, :3], true[:3, :3])) < 0.05
    health = watcher.health
    assert health[:4] == (len(path), 0, 0, 0)  # of which odometry, tool, object missed
    assert health.median_inliers > 100
    assert health.last_loss is None
    assert abs(health.offset.x_px + 0.3) < 0.1
    watcher.require()


def test_watch_that_missed_everything_fails_with_the_cause(
    camera: CameraCalibration, config: VisionConfig, path: list[Shot]
) -> None:
    dark = np.zeros_like(path[0].pair.left)
    blind = path[0].pair._replace(left=dark, right=dark)
    for wants, cause in (
        ({"markers": False, "odometry": True}, "measurement.odometry_lost"),
        ({"markers": True, "odometry": False}, "measurement.tool_not_seen"),
    ):
        watcher = Watcher(PixelSensor(config), **wants)
        with pytest.raises(MeasurementFailed) as failed:
            watcher.require()
        assert failed.value.cause == "measurement.no_frames"
        for _ in range(2):
            watcher.add(blind, path[0].X_BT)
        watcher.measure()
        assert all(sample[2:5] == (None, None, None) for sample in watcher.samples)
        with pytest.raises(MeasurementFailed) as failed:
            watcher.require()
        assert failed.value.cause == cause
        assert watcher.health.frames == 2
    assert watcher.health.tool_missed == 2


def test_watch_survives_a_dark_frame(
    camera: CameraCalibration, config: VisionConfig, path: list[Shot]
) -> None:
    watcher = Watcher(PixelSensor(config), markers=True, odometry=True)
    dark = np.zeros_like(path[0].pair.left)
    for k, shot in enumerate(path[:4]):
        watcher.add(shot.pair._replace(left=dark, right=dark) if k == 2 else shot.pair, shot.X_BT)
    missing = [sample.X_C0C is None for sample in watcher.samples]
    assert missing == [False, False, True, False]
    health = watcher.health
    assert (health.odometry_lost, health.tool_missed, health.object_missed) == (1, 1, 1)
    assert health.last_loss == "too_dark"
    watcher.require()


def test_of_a_standing_arm_the_newest_pairs_are_measured_when_it_goes_on_or_at_once_when_live(
    config: VisionConfig, path: list[Shot]
) -> None:
    creeps = 0.9e-3 / 20
    for live, times in ((False, [0, *range(22 - AT_REST, 22)]), (True, [*range(22)])):
        watcher = Watcher(PixelSensor(config), markers=True, odometry=False)
        watcher.live = live
        for k in range(21):
            watcher.add(path[0].pair._replace(capture_ns=k), se3.transform(np.eye(3), (creeps * k, 0.0, 0.0)))
        assert watcher.count == (21 if live else 1)
        watcher.add(path[0].pair._replace(capture_ns=21), se3.transform(np.eye(3), (1.1e-3, 0.0, 0.0)))
        assert [sample.time_ns for sample in watcher.samples] == times
