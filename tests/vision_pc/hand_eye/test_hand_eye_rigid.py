"""One law suite for the stacks of rigid motions, at the identity, tiny, random and near a half turn."""

import numpy as np
import pytest

from vision_pc.core import se3
from vision_pc.core.hand_eye import rigid
from vision_pc.core.se3 import Array


def vectors(kind: str) -> Array:
    rng = np.random.default_rng(7)
    directions = rng.normal(size=(40, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    sizes = {
        "identity": np.zeros(40),
        "tiny": np.full(40, 1e-8),
        "small": np.geomspace(1e-6, 1e-2, 40),
        "random": rng.uniform(0.1, 3.0, 40),
        "half turn": np.pi - np.geomspace(1e-9, 1e-3, 40),
    }
    return directions * sizes[kind][:, None]


KINDS = ("identity", "tiny", "small", "random", "half turn")


@pytest.mark.parametrize("kind", KINDS)
def test_logarithm_inverts_exponential(kind: str) -> None:
    v = vectors(kind)
    np.testing.assert_allclose(rigid.rotation_log(rigid.rotation_exp(v)), v, rtol=0, atol=1e-10)


@pytest.mark.parametrize("kind", KINDS)
def test_exponential_equals_the_single_one(kind: str) -> None:
    v = vectors(kind)
    singles = np.stack([se3.exp_so3(row) for row in v])
    np.testing.assert_allclose(rigid.rotation_exp(v), singles, atol=1e-13)


@pytest.mark.parametrize("kind", KINDS)
def test_quaternion_and_back(kind: str) -> None:
    R = rigid.rotation_exp(vectors(kind))
    q = rigid.quaternion(R)
    assert (q[:, 0] >= 0.0).all()
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, atol=1e-14)
    np.testing.assert_allclose(rigid.rotation_of_quaternion(q), R, atol=1e-13)
    np.testing.assert_allclose(rigid.rotation_angle(R), np.linalg.norm(vectors(kind), axis=1), atol=1e-9)


def test_exact_half_turns_about_each_axis() -> None:
    R = np.stack([np.diag([1.0, -1.0, -1.0]), np.diag([-1.0, 1.0, -1.0]), np.diag([-1.0, -1.0, 1.0])])
    np.testing.assert_allclose(rigid.rotation_angle(R), np.pi)
    np.testing.assert_allclose(rigid.rotation_exp(rigid.rotation_log(R)), R, atol=1e-12)


def test_product_matrices_multiply_quaternions() -> None:
    rng = np.random.default_rng(1)
    R, S = rigid.rotation_exp(rng.normal(size=(2, 20, 3)))
    p, q = rigid.quaternion(R), rigid.quaternion(S)
    left = (rigid.left_product_matrix(p) @ q[..., None])[..., 0]
    right = (rigid.right_product_matrix(q) @ p[..., None])[..., 0]
    np.testing.assert_allclose(left, right, atol=1e-15)
    np.testing.assert_allclose(rigid.rotation_of_quaternion(left), R @ S, atol=1e-14)


def test_dual_quaternions_hold_the_translation() -> None:
    rng = np.random.default_rng(2)
    q = rigid.quaternion(rigid.rotation_exp(rng.normal(size=(20, 3))))
    t = rng.normal(size=(20, 3))
    dual = rigid.dual_part(q, t)
    np.testing.assert_allclose(np.sum(q * dual, axis=1), 0.0, atol=1e-15)
    back = np.stack([rigid.translation_of_dual(a, b) for a, b in zip(q, dual, strict=True)])
    np.testing.assert_allclose(back, t, atol=1e-14)


def test_nearest_rotation_is_proper_even_for_a_reflection() -> None:
    rng = np.random.default_rng(3)
    M = rng.normal(size=(50, 3, 3))
    R = rigid.nearest_rotation(M)
    np.testing.assert_allclose(np.linalg.det(R), 1.0, atol=1e-12)
    np.testing.assert_allclose(R @ np.swapaxes(R, -1, -2), np.broadcast_to(np.eye(3), R.shape), atol=1e-12)
    np.testing.assert_allclose(R, np.stack([se3.nearest_rotation(m) for m in M]), atol=1e-12)


def test_mean_pose_weighs_its_poses() -> None:
    rng = np.random.default_rng(4)
    X = rigid.pose(rigid.rotation_exp(rng.normal(size=(3, 3))), rng.normal(size=(3, 3)))
    np.testing.assert_allclose(rigid.mean_pose(X, np.array([0.0, 2.0, 0.0])), X[1], atol=1e-12)
    np.testing.assert_allclose(rigid.mean_pose(X)[:3, 3], X[:, :3, 3].mean(axis=0), atol=1e-15)
