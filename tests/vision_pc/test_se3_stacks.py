"""Stacks of rigid transforms: one law suite with single ones, tiny, random and near a half turn."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vision_pc.core import se3
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.se3 import Array, nearest_rotation


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
def test_stacks_are_the_single_forms(kind: str) -> None:
    """Whatever the angle, both forms give the same to rounding, and their limits are the same numbers."""
    v = vectors(kind)
    R = stacks.exp_so3(v)
    np.testing.assert_allclose(R, np.stack([se3.exp_so3(row) for row in v]), rtol=0, atol=1e-15)
    np.testing.assert_allclose(stacks.log_so3(R), np.stack([se3.log_so3(X) for X in R]), rtol=0, atol=1e-11)
    quaternions = np.stack([se3.quaternion_from_rotation(X) for X in R])
    np.testing.assert_allclose(stacks.quaternion_from_rotation(R), quaternions, rtol=0, atol=1e-15)


@pytest.mark.parametrize("form", ["single", "stack"])
@pytest.mark.parametrize("limit", [se3.SMALL_ANGLE, math.acos(se3.HALF_TURN_COSINE)])
def test_nothing_jumps_where_a_limit_changes_the_formula(form: str, limit: float) -> None:
    axis = np.array([0.36, -0.48, 0.8])
    for angle in limit + min(limit, math.pi - limit) * np.array([-1e-1, -1e-6, 0.0, 1e-6, 1e-1]):
        w = angle * axis
        expected = Rotation.from_rotvec(w).as_matrix()
        if form == "single":
            R, back = se3.exp_so3(w), se3.log_so3(expected)
        else:
            R, back = stacks.exp_so3(w[None])[0], stacks.log_so3(expected[None])[0]
        np.testing.assert_allclose(R, expected, rtol=0, atol=2e-15)
        np.testing.assert_allclose(back, w, rtol=0, atol=1e-11)


def test_exact_half_turns_about_each_axis() -> None:
    R = np.stack([np.diag([1.0, -1.0, -1.0]), np.diag([-1.0, 1.0, -1.0]), np.diag([-1.0, -1.0, 1.0])])
    np.testing.assert_allclose(stacks.angle(R), np.pi)
    np.testing.assert_allclose(stacks.exp_so3(stacks.log_so3(R)), R, atol=1e-12)


def test_nearest_rotation_is_proper_even_for_a_reflection() -> None:
    rng = np.random.default_rng(3)
    M = rng.normal(size=(50, 3, 3))
    R = nearest_rotation(M)
    np.testing.assert_allclose(np.linalg.det(R), 1.0, atol=1e-12)
    np.testing.assert_allclose(R @ np.swapaxes(R, -1, -2), np.broadcast_to(np.eye(3), R.shape), atol=1e-12)
    np.testing.assert_allclose(R, np.stack([se3.nearest_rotation(m) for m in M]), atol=1e-12)


def test_mean_pose_weighs_its_poses() -> None:
    rng = np.random.default_rng(4)
    X = stacks.transform(stacks.exp_so3(rng.normal(size=(3, 3))), rng.normal(size=(3, 3)))
    np.testing.assert_allclose(stacks.mean_pose(X, np.array([0.0, 2.0, 0.0])), X[1], atol=1e-12)
    np.testing.assert_allclose(stacks.mean_pose(X)[:3, 3], X[:, :3, 3].mean(axis=0), atol=1e-15)
