"""A camera that is not as calibrated: its errors are found along the legs; odometry then sees with them."""

from typing import Any

import numpy as np
import pytest

from laboratory.experiments.positioning.corrected_run import adapting
from testbed.lockstep.simulated_odometry import SimulatedFrame
from tests.support.paths import CONFIGS
from tests.testbed.lockstep.test_simulated_measurements import Stage, noisy
from vision_pc.core.perception.watch import Watcher
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraErrors, FrameObservation

USUAL = {"noise_px": 0.0133, "bias_px": 0.003, "map_px": 0.14}
OFF: dict[str, Any] = {
    "baseline_m": 0.12 * 1.004,
    "lens_difference": {"fx_px": 0.27, "fy_px": -0.2, "k1": 0.0015, "k2": 5e-4, "p1": -2e-4, "p2": 2e-4},
    "rectification": {"disparity_px": 1.5, "vertical_px": 0.4},
}
HUNG = [
    {"marker_id": 1, "misplaced_m": [0.0005, -0.0004, 0.0003]},
    {"marker_id": 2, "misplaced_m": [-0.0003, 0.0003, -0.0002]},
    {"marker_id": 3, "misplaced_m": [0.0004, 0.0002, 0.0004]},
]


def legs(stage: Stage, per_leg: int = 12) -> list[SimulatedFrame]:
    """Three legs along the camera's axes, as the local track has them."""
    corners = 0.2 * np.array([[-1.0, -1.0, -1.0], [0.0, -1.0, -1.0], [0.0, 0.0, -1.0], [0.0, 0.0, 0.0]])
    at = np.linspace(0.0, 3.0, 3 * per_leg)
    way = np.column_stack([np.interp(at, range(4), corners[:, axis]) for axis in range(3)])
    frames = [stage.exposed(stage.moved(step)) for step in way]
    return [frame._replace(capture_ns=500_000_000 * k) for k, frame in enumerate(frames)]


def watched(stage: Stage, frames: list[SimulatedFrame]) -> Watcher[SimulatedFrame]:
    watcher = Watcher(stage.sensor, markers=True, odometry=True)
    watcher.live = True
    for frame in frames:
        watcher.add(frame, np.eye(4))
    watcher.calibrate()
    return watcher


def stage(seed: int = 1, enabled: bool = True, **camera: Any) -> Stage:
    vision = adapting(CONFIGS)
    vision["markers"]["calibration"]["enabled"] = enabled
    sides = {1: [-0.2, 0.0], 2: [0.2, 0.0], 3: [0.0, 0.2]}
    plates = [
        {"side_m": 0.12, "quiet_zone_m": 0.02, "centre_m": sides[one["marker_id"]]} | one for one in HUNG
    ]
    return Stage(noisy(**USUAL), seed, vision, camera=camera, object_of_interest={"markers": plates})


@pytest.fixture(scope="module")
def along_the_legs() -> tuple[Stage, Watcher[SimulatedFrame]]:
    """A camera that is off, and the watch of its legs."""
    one = stage(**OFF)
    return one, watched(one, legs(one))


def found(watcher: Watcher[SimulatedFrame]) -> CameraErrors:
    newest = watcher.samples[-1].observation
    assert newest.errors is not None
    return newest.errors


def test_offset_baseline_and_lenses_are_told_apart_along_the_legs(
    along_the_legs: tuple[Stage, Watcher[SimulatedFrame]],
) -> None:
    errors = found(along_the_legs[1])
    truth = np.array([-1.5, 0.4, 0.004, 0.27, -0.2, 0.0, 0.0, 0.0015, -0.0002, 0.0002, 0.0, 5e-4])
    limits = np.array([0.1, 0.03, 2.5e-3, 0.08, 0.08, 1e-4, 5e-4, 2e-4, 3e-5, 1e-4, 3e-4, 2e-4])
    off = np.abs(errors.values - truth)
    assert (off < limits).all(), off / limits
    assert (off < 4.0 * np.sqrt(np.diag(errors.covariance)) + 0.1 * limits).all()


def test_a_camera_as_calibrated_is_left_as_it_is() -> None:
    one = stage()
    errors = found(watched(one, legs(one)))
    assert (np.abs(errors.values) < 4.0 * np.sqrt(np.diag(errors.covariance)) + 1e-6).all()
    assert np.abs(errors.values[:2]).max() < 0.08


def way_by_odometry(one: Stage, previous: FrameObservation | None) -> Array:
    """How far odometry is off at the end of a way of 0.55 m towards the wall and aside."""
    odometry = one.sensor.odometry(previous)
    steps = np.linspace([0.0, 0.0, 0.0], [0.25, -0.2, 0.45], 25)
    poses = [odometry.process(one.exposed(one.moved(step))) for step in steps]
    return np.asarray(poses[-1].X_C0C[:3, 3] - steps[-1])


def test_odometry_of_a_long_way_gains_what_was_found(
    along_the_legs: tuple[Stage, Watcher[SimulatedFrame]],
) -> None:
    """Beyond the legs, but for a length that look and odometry share."""
    one, watcher = along_the_legs
    observation = watcher.samples[-1].observation
    off = []
    for previous in (observation, observation._replace(errors=None)):
        error, step = way_by_odometry(one, previous), np.array([0.25, -0.2, 0.45])
        off.append(float(np.linalg.norm(error - step * float(error @ step) / float(step @ step))))
    assert off[0] < 5e-4, off
    assert off[0] < 0.3 * off[1], off


def test_later_pictures_do_not_change_what_was_found(
    along_the_legs: tuple[Stage, Watcher[SimulatedFrame]],
) -> None:
    one, watcher = along_the_legs
    before = watcher.samples[-1].observation
    late = one.exposed(one.truth)._replace(capture_ns=before.capture_ns + 600_000_000_000)
    after = one.sensor.observe(late, before)
    assert after.errors is before.errors
    assert after.offset == before.offset


@pytest.mark.parametrize("why", ["too near together", "too few", "not asked for"])
def test_legs_that_show_too_little_find_nothing(why: str) -> None:
    one = stage(enabled=why != "not asked for", **OFF)
    frames = legs(one)
    shown = {"too near together": frames[-1:] * 14, "too few": frames[::5], "not asked for": frames[::2]}
    newest = watched(one, shown[why]).samples[-1].observation
    assert newest.errors is None
