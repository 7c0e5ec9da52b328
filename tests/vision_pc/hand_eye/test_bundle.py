"""Image-space adjustment: better than poses from pictures, honest, the robot's noise taken along."""

import math
from dataclasses import replace

import numpy as np
import pytest

from laboratory.experiments.hand_eye.localisation import (
    LocalisationRig,
    LocalisationSession,
    simulated_session,
)
from protocol.errors import MeasurementFailed
from tests.vision_pc.hand_eye.data import noisy_pairs
from vision_pc.core import se3
from vision_pc.core.hand_eye.solvers import bundle, methods
from vision_pc.core.hand_eye.solvers.bundle import RobotNoise

RUNS = 8


def sessions(rig: LocalisationRig) -> list[LocalisationSession]:
    return [simulated_session(rig, np.random.default_rng([40, run])) for run in range(RUNS)]


def test_corners_locate_better_than_poses_and_obey_the_covariance() -> None:
    rig = LocalisationRig(corner_px=0.3, robot_rotation_deg=0.0, robot_translation_mm=0.0)
    by_poses, by_corners, nees = [], [], []
    for session in sessions(rig):
        start = methods.solve(session.kept)
        found = bundle.adjust(session.kept, start)
        assert found.pixel_noise == pytest.approx(0.3, rel=0.35)
        by_poses.append(np.linalg.norm(start.X[:3, 3] - session.scene.X[:3, 3]))
        by_corners.append(np.linalg.norm(found.X[:3, 3] - session.scene.X[:3, 3]))
        error = se3.local(found.X, session.scene.X)
        nees.append(error @ np.linalg.solve(found.covariance, error))
    assert np.mean(by_corners) < 0.8 * np.mean(by_poses)
    assert 3.5 < np.mean(nees) < 9.5


def test_robot_noise_is_taken_along() -> None:
    rig = LocalisationRig(corner_px=0.1, robot_rotation_deg=0.1, robot_translation_mm=1.0)
    robot = RobotNoise(math.radians(0.1), 1e-3)
    with_it, without = [], []
    for session in sessions(rig):
        start = methods.solve(session.kept)
        truth = session.scene.X[:3, 3]
        with_it.append(np.linalg.norm(bundle.adjust(session.kept, start, robot).X[:3, 3] - truth))
        without.append(np.linalg.norm(bundle.adjust(session.kept, start).X[:3, 3] - truth))
    assert np.mean(with_it) < np.mean(without)


def test_exact_corners_give_the_exact_pose() -> None:
    rig = LocalisationRig(corner_px=0.0, robot_rotation_deg=0.0, robot_translation_mm=0.0)
    session = sessions(rig)[0]
    start = methods.solve(session.kept)
    nearby = replace(
        start, X=se3.retract(start.X, np.full(6, 0.01)), Z=se3.retract(start.Z, np.full(6, -0.01))
    )
    found = bundle.adjust(session.kept, nearby)
    np.testing.assert_allclose(found.X, session.scene.X, atol=1e-8)
    np.testing.assert_allclose(found.Z, session.scene.Z, atol=1e-8)
    assert np.nanmax(found.sample_rms_px) < 1e-6


def test_outliers_of_the_start_stay_out() -> None:
    session = sessions(LocalisationRig())[1]
    start = methods.solve(session.taken)
    assert (~start.inliers).sum() == 5
    found = bundle.adjust(session.taken, start, RobotNoise(1e-3, 5e-4))
    assert np.isnan(found.sample_rms_px[~start.inliers]).all()
    assert np.isfinite(found.sample_rms_px[start.inliers]).all()


def test_without_corners_there_is_nothing_to_adjust() -> None:
    pairs, _ = noisy_pairs(41)
    with pytest.raises(MeasurementFailed) as caught:
        bundle.adjust(pairs, methods.solve(pairs))
    assert caught.value.cause == "measurement.hand_eye.no_corners"


def test_a_sample_with_too_few_corners_is_named() -> None:
    session = sessions(LocalisationRig())[2]
    corners = session.kept.corners
    assert corners is not None
    pixels = corners.pixels.copy()
    pixels[3, :2] = np.nan
    blind = replace(session.kept, corners=corners._replace(pixels=pixels))
    with pytest.raises(MeasurementFailed, match=f"sample {blind.names[3]}") as caught:
        bundle.adjust(blind, methods.solve(session.kept))
    assert caught.value.cause == "measurement.hand_eye.no_corners"
