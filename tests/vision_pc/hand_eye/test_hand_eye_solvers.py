"""All solvers through their one entrance: exact, order-free, guarded, and different from each other."""

from typing import Any

import cv2
import numpy as np
import pytest

from laboratory.experiments.hand_eye import scenes
from protocol.errors import MeasurementFailed
from tests.vision_pc.hand_eye.data import exact_pairs, noisy_pairs, random_poses, random_scene
from vision_pc.config.choices import Method, Setup
from vision_pc.core import se3
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.samples import pose_pairs
from vision_pc.core.hand_eye.solvers import methods
from vision_pc.core.hand_eye.solvers.classical import dqcr
from vision_pc.core.hand_eye.solvers.motions import Motions, dual_quaternions


@pytest.mark.parametrize("setup", list(Setup))
@pytest.mark.parametrize("method", list(Method))
def test_exact_samples_give_the_exact_pose(method: Method, setup: Setup) -> None:
    scene = random_scene(np.random.default_rng(11))
    result = methods.solve(exact_pairs(scene, setup), method)
    np.testing.assert_allclose(result.X, scene.X, atol=1e-9)
    np.testing.assert_allclose(result.Z, scene.Z, atol=1e-9)
    assert result.setup is setup
    assert result.observability.cause is None


@pytest.mark.parametrize("method", list(Method))
def test_order_of_samples_changes_nothing(method: Method) -> None:
    pairs, _ = noisy_pairs(3, 12)
    names = tuple(str(k) for k in range(12))
    hand, camera = pairs.X_BT, pairs.P
    one = methods.solve(pose_pairs(hand, camera, names=names), method)
    shuffle = np.random.default_rng(5).permutation(12)
    other = methods.solve(
        pose_pairs(hand[shuffle], camera[shuffle], names=tuple(names[k] for k in shuffle)), method
    )
    assert np.array_equal(one.X, other.X)
    assert np.array_equal(one.Z, other.Z)
    assert np.array_equal(one.residuals[shuffle], other.residuals)
    assert other.names == tuple(names[k] for k in shuffle)


def test_residuals_are_in_the_callers_order_and_in_the_camera() -> None:
    scene = random_scene(np.random.default_rng(12))
    P = scene.P()
    P[4, :3, 3] += (0.0, 0.0, 0.03)
    result = methods.solve(pose_pairs(scene.X_BT, P), Method.ROBUST)
    assert not result.inliers[4]
    assert result.inliers.sum() == 11
    np.testing.assert_allclose(result.residuals[4, :3], (0.0, 0.0, 0.03), atol=1e-6)
    np.testing.assert_allclose(np.delete(result.residuals, 4, axis=0), 0.0, atol=1e-6)


def test_tsai_survives_rotations_that_opencv_drops() -> None:
    rng = np.random.default_rng(16)
    scene = scenes.small_rotation_scene(rng, 15)
    R, _ = cv2.calibrateHandEye(
        scene.X_BT[:, :3, :3], scene.X_BT[:, :3, 3], scene.P()[:, :3, :3], scene.P()[:, :3, 3],
        method=cv2.CALIB_HAND_EYE_TSAI,
    )  # fmt: skip
    assert se3.angle_between(np.asarray(R), scene.X[:3, :3]) > np.radians(
        1.0
    )  # OpenCV's silent failure, still there
    result = methods.solve(exact_pairs(scene), Method.TSAI)
    np.testing.assert_allclose(result.X, scene.X, atol=1e-8)
    assert any("15 degrees" in note for note in result.notes)


@pytest.mark.parametrize(
    ("returned", "cause"),
    [
        (np.full((3, 3), np.nan), "measurement.hand_eye.no_solution"),
        (np.diag([1.0, 1.0, -1.0]), "measurement.hand_eye.left_handed"),
    ],
)
def test_an_improper_answer_of_opencv_is_an_error(
    monkeypatch: pytest.MonkeyPatch, returned: Any, cause: str
) -> None:
    monkeypatch.setattr(cv2, "calibrateHandEye", lambda *_, **__: (returned, np.zeros((3, 1))))
    pairs, _ = noisy_pairs(5)
    with pytest.raises(MeasurementFailed, match="park") as caught:
        methods.solve(pairs, Method.PARK)
    assert caught.value.cause == cause


def test_opencv_giving_up_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise cv2.error("determinant(R) is null")

    monkeypatch.setattr(cv2, "calibrateHandEye", refuse)
    with pytest.raises(MeasurementFailed, match="gave up") as caught:
        methods.solve(noisy_pairs(5)[0], Method.ANDREFF)
    assert caught.value.cause == "measurement.hand_eye.no_solution"


def test_signs_agree_near_a_half_turn() -> None:
    """Motions of almost 180°, where noise decides each quaternion's sign (opencv issue 24871)."""
    rng = np.random.default_rng(17)
    axes = rng.normal(size=(30, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    angles = np.concatenate([rng.uniform(0.5, 2.0, 15), np.pi + rng.normal(size=15) * 0.002])
    X = random_poses(rng, 1)[0]
    A = stacks.transform(stacks.exp_so3(axes * angles[:, None]), rng.normal(size=(30, 3)))
    B = stacks.inverse(X) @ A @ X
    B = stacks.transform(stacks.exp_so3(rng.normal(size=(30, 3)) * 0.003) @ B[:, :3, :3], B[:, :3, 3])
    dual = dual_quaternions(Motions(A, B))
    g = stacks.quaternion_from_rotation(X[:3, :3])
    mismatch = np.linalg.norm(dual.rotation_rows() @ g, axis=-1)
    assert mismatch.max() < 0.02  # a wrong sign gives 2
    assert se3.angle_between(dqcr(dual)[0][:3, :3], X[:3, :3]) < 0.01
