"""One law suite for rigid transforms: at the identity, tiny, random, and near half a turn."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from vision_pc.core import se3
from vision_pc.core.se3 import Array

ANGLES = [0.0, 1e-9, 1e-7, 1e-6, 1e-3, 0.5, 2.0, 3.0, math.pi - 1e-3, math.pi - 1e-5, math.pi - 1e-8, math.pi]


def axes(count: int = 6) -> list[Array]:
    generator = np.random.default_rng(5)
    random = generator.standard_normal((count, 3))
    return [v / np.linalg.norm(v) for v in (*np.eye(3), *-np.eye(3), *random)]


@pytest.mark.parametrize("angle", ANGLES)
def test_exponential_agrees_with_scipy_and_logarithm_inverts_it(angle: float) -> None:
    for axis in axes():
        R = se3.exp_so3(angle * axis)
        np.testing.assert_allclose(R, Rotation.from_rotvec(angle * axis).as_matrix(), atol=1e-15)
        w = se3.log_so3(R)
        assert abs(np.linalg.norm(w) - angle) < 1e-7
        np.testing.assert_allclose(se3.exp_so3(w), R, atol=1e-9)
        if angle < math.pi - 1e-6:
            np.testing.assert_allclose(w, angle * axis, atol=1e-8)


@pytest.mark.parametrize("angle", ANGLES)
def test_quaternions_agree_with_scipy(angle: float) -> None:
    for axis in axes():
        R = se3.exp_so3(angle * axis)
        q = se3.quaternion_from_rotation(R)
        assert q[0] >= 0.0
        assert abs(np.linalg.norm(q) - 1.0) < 1e-15
        np.testing.assert_allclose(se3.rotation_from_quaternion(q), R, atol=1e-14)
        x, y, z, w = Rotation.from_matrix(R).as_quat()
        assert abs(abs(q @ (w, x, y, z)) - 1.0) < 1e-14


def poses(seed: int, count: int = 20) -> list[Array]:
    generator = np.random.default_rng(seed)
    return [
        se3.transform(se3.exp_so3(generator.uniform(-1.8, 1.8, 3)), generator.uniform(-3, 3, 3))
        for _ in range(count)
    ]


def test_group_laws() -> None:
    for X, Y in zip(poses(1), poses(2), strict=True):
        np.testing.assert_allclose(X @ se3.inverse(X), np.eye(4), atol=1e-14)
        np.testing.assert_allclose(se3.inverse(X @ Y), se3.inverse(Y) @ se3.inverse(X), atol=1e-13)
        points = np.random.default_rng(3).standard_normal((5, 3))
        np.testing.assert_allclose(se3.apply(X @ Y, points), se3.apply(X, se3.apply(Y, points)), atol=1e-13)


def test_retract_and_local_are_inverse() -> None:
    for X, Y in zip(poses(1), poses(2), strict=True):
        np.testing.assert_allclose(se3.retract(X, se3.local(X, Y)), Y, atol=1e-12)
        np.testing.assert_allclose(se3.interpolate(X, Y, 1.0), Y, atol=1e-12)
        np.testing.assert_allclose(se3.interpolate(X, Y, 0.0), X, atol=1e-12)
        half = se3.interpolate(X, Y, 0.5)
        R_X, R_Y, R_half = (Z[:3, :3] for Z in (X, Y, half))
        assert abs(se3.angle_between(R_X, R_half) - 0.5 * se3.angle_between(R_X, R_Y)) < 1e-9


def test_boundary_poses_come_back() -> None:
    for X in poses(4):
        np.testing.assert_allclose(se3.from_pose(se3.to_pose(X)), X, atol=1e-14)


def test_covariance_of_the_inverse_is_what_sampling_gives() -> None:
    generator = np.random.default_rng(6)
    X = poses(7)[0]
    root = generator.standard_normal((6, 6)) * 1e-4
    samples = [se3.retract(X, root @ generator.standard_normal(6)) for _ in range(20_000)]
    deltas = np.array([se3.local(se3.inverse(X), se3.inverse(Y)) for Y in samples])
    expected = se3.inverse_covariance(X, root @ root.T)
    assert np.linalg.norm(np.cov(deltas.T) - expected) < 0.05 * np.linalg.norm(expected)


@given(st.tuples(*[st.floats(-1.4, 1.4)] * 3))
def test_euler_angles_give_the_rotation_back(angles: tuple[float, float, float]) -> None:
    a, b, c = angles
    R = se3.exp_so3((a, 0, 0)) @ se3.exp_so3((0, b, 0)) @ se3.exp_so3((0, 0, c))
    np.testing.assert_allclose(se3.euler_xyz(R), angles, atol=1e-12)


def test_nearest_rotation_is_proper_and_leaves_rotations_alone() -> None:
    R = poses(8)[0][:3, :3]
    np.testing.assert_allclose(se3.nearest_rotation(2.5 * R), R, atol=1e-14)
    mirrored = se3.nearest_rotation(R @ np.diag([1.0, 1.0, -1.0]))
    assert abs(np.linalg.det(mirrored) - 1.0) < 1e-12
