"""Residuals, derivatives and covariances against finite differences and the Cramér-Rao bound."""

import numpy as np
import pytest

from laboratory.experiments.hand_eye import scenes
from protocol.errors import MeasurementFailed
from tests.vision_pc.hand_eye.data import random_poses, random_scene
from vision_pc.core import se3
from vision_pc.core.hand_eye.solvers import maximum_likelihood as ml
from vision_pc.core.hand_eye.solvers import noise as noise_model
from vision_pc.core.hand_eye.solvers.maximum_likelihood import Equations, Noise
from vision_pc.core.se3 import Array

STEP = 1e-6


def disturbed(rng: np.random.Generator, X: Array) -> Array:
    return X @ random_poses(rng, len(X), 0.2, 0.05)


def test_jacobian_equals_finite_differences() -> None:
    rng = np.random.default_rng(1)
    scene = random_scene(rng, 5)
    X, Z = scene.X, scene.Z
    P = disturbed(rng, ml.predicted(scene.X_BT, X, Z))
    equations = Equations(scene.X_BT, P, np.ones(5))
    J = ml.jacobian(equations, X, Z, ml.residuals(scene.X_BT, P, X, Z))
    for k in range(J.shape[-1]):
        step = np.zeros(J.shape[-1])
        step[k] = STEP
        after = ml.residuals(scene.X_BT, P, *ml.moved(X, Z, step))
        before = ml.residuals(scene.X_BT, P, *ml.moved(X, Z, -step))
        np.testing.assert_allclose(J[..., k], (after - before) / (2.0 * STEP), atol=1e-4)


def test_covariance_is_the_bound_and_the_errors_obey_it() -> None:
    scene = scenes.table_1_scene()
    n = scenes.noise(0.1, 0.2)
    bound = scenes.bound(scene, n)
    errors, nees = [], []
    for run in range(100):
        pairs = scenes.measured(scene, n, np.random.default_rng([8, run]))
        equations = Equations(pairs.H, pairs.P, np.ones(len(pairs)))
        estimate = ml.maximize(equations, scene.X, scene.Z, n)
        covariance = ml.covariance_of_X(estimate)
        error = se3.local(estimate.X, scene.X)
        errors.append(error)
        nees.append(error @ np.linalg.solve(covariance, error))
        spread = np.degrees(np.sqrt(np.trace(covariance[3:, 3:])))
        assert spread == pytest.approx(bound.rotation_deg, rel=0.02)
    rms = np.sqrt(np.mean(np.sum(np.array(errors)[:, 3:] ** 2, axis=1)))
    assert np.degrees(rms) < 1.15 * bound.rotation_deg
    assert 5.0 < np.mean(nees) < 7.0


def test_identical_poses_leave_it_singular() -> None:
    H = np.tile(np.eye(4), (4, 1, 1))
    with pytest.raises(MeasurementFailed) as caught:
        ml.maximize(Equations(H, H + 0.0, np.ones(4)), np.eye(4), np.eye(4), Noise(1e-3, 1e-3))
    assert caught.value.cause == "measurement.hand_eye.singular"


@pytest.mark.parametrize(
    ("truth", "louder"),
    [
        (Noise(1.7e-3, 5e-4, 1e-12, 1e-12), "camera"),
        (Noise(1e-12, 1e-12, 1.7e-3, 5e-4), "robot"),
    ],
)
def test_camera_and_robot_noise_are_told_apart(truth: Noise, louder: str) -> None:
    found = []
    for run in range(5):
        rng = np.random.default_rng([10, run])
        scene = scenes.viewing_scene(rng, 25)
        pairs = scenes.measured(scene, truth, rng)
        equations = Equations(pairs.H, pairs.P, np.ones(25))
        start = ml.maximize(equations, scene.X, scene.Z, Noise(1e-3, 1e-3))
        found.append(noise_model.estimated(equations, start.X, start.Z, Noise(1e-3, 1e-3))[1])
    camera = np.median([n.camera_rotation for n in found])
    robot = np.median([n.robot_rotation for n in found])
    loud, quiet = (camera, robot) if louder == "camera" else (robot, camera)
    assert loud == pytest.approx(1.7e-3, rel=0.3)
    assert quiet < 0.4 * loud


def test_few_samples_do_not_call_their_noise_zero() -> None:
    for count in (3, 4, 5):
        rng = np.random.default_rng([11, count])
        scene = scenes.viewing_scene(rng, count, tilt_deg=45.0)
        pairs = scenes.measured(scene, Noise(1.7e-3, 1e-3), rng)
        equations = Equations(pairs.H, pairs.P, np.ones(count))
        start = ml.maximize(equations, scene.X, scene.Z, Noise(1e-3, 1e-3))
        _, n = noise_model.estimated(equations, start.X, start.Z, Noise(1e-3, 1e-3))
        assert 3e-4 < n.camera_rotation < 8e-3
        assert 2e-4 < n.camera_translation < 5e-3
    assert noise_model.few_sample_factor(3) > noise_model.few_sample_factor(12) > 1.0
