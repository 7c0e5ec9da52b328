"""Quaternions, rotation vectors and their rates against scipy and finite differences."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from controller.core.kinematics.rotations import (
    angular_motion,
    exponential,
    orientation_error,
    quaternion_from_matrix,
    quaternion_product,
    rows,
    vector_from_quaternion,
    vector_rates,
)


def _wxyz(rotation: Rotation) -> np.ndarray:
    x, y, z, w = rotation.as_quat()
    return np.array([w, x, y, z])


@pytest.fixture
def rotations() -> list[Rotation]:
    rng = np.random.default_rng(5)
    turns = [Rotation.from_quat(q) for q in rng.normal(size=(200, 4))]
    near_pi = [Rotation.from_rotvec((math.pi - 1e-9) * axis) for axis in np.eye(3)]
    return [*turns, *near_pi, Rotation.identity(), Rotation.from_rotvec([1e-8, -2e-8, 0.0])]


def test_matrix_and_quaternion_equal_scipy(rotations) -> None:
    for rotation in rotations:
        R = rotation.as_matrix()
        q = quaternion_from_matrix(R)
        assert q[0] >= 0.0
        assert abs(np.dot(q, _wxyz(rotation))) == pytest.approx(1.0, abs=1e-14)
        assert np.array(rows(q)) == pytest.approx(R, abs=1e-14)


def test_product_equals_scipy(rotations) -> None:
    for a, b in zip(rotations, reversed(rotations), strict=True):
        product = quaternion_product(_wxyz(a), _wxyz(b))
        assert np.array(rows(product)) == pytest.approx((a * b).as_matrix(), abs=1e-14)


def test_exponential_and_logarithm_equal_scipy(rotations) -> None:
    for rotation in rotations:
        q = _wxyz(rotation)
        theta = vector_from_quaternion(q)
        assert theta == pytest.approx(vector_from_quaternion(-q), abs=1e-15)
        assert np.linalg.norm(theta) <= math.pi + 1e-12
        back = np.array(rows(exponential(theta)))
        assert back == pytest.approx(rotation.as_matrix(), abs=1e-12)


def test_orientation_error_is_sine_of_half_the_angle_along_the_axis() -> None:
    rng = np.random.default_rng(6)
    for angle in (1e-6, 0.1, 1.0, 3.0):
        actual = Rotation.random(rng=rng)
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        desired = Rotation.from_rotvec(angle * axis) * actual
        error = orientation_error(_wxyz(desired), _wxyz(actual))
        assert error == pytest.approx(math.sin(angle / 2) * axis, abs=1e-12)


def test_orientation_error_ignores_the_sign_of_either_quaternion() -> None:
    rng = np.random.default_rng(7)
    for _ in range(100):
        desired, actual = _wxyz(Rotation.random(rng=rng)), _wxyz(Rotation.random(rng=rng))
        want = orientation_error(desired, actual)
        for one, other in ((-desired, actual), (desired, -actual), (-desired, -actual)):
            assert orientation_error(one, other) == pytest.approx(want, abs=1e-15)


@pytest.mark.parametrize("size", [1e-9, 0.0199, 0.0201, 0.5, 2.0, 3.1])
def test_angular_motion_equals_finite_differences(size: float) -> None:
    rng = np.random.default_rng(8)
    theta = rng.normal(size=3)
    theta *= size / np.linalg.norm(theta)
    rate, bend = rng.normal(size=3), rng.normal(size=3)
    start = Rotation.random(rng=rng)

    def attitude(t: float) -> Rotation:
        return Rotation.from_rotvec(theta + rate * t + 0.5 * bend * t * t) * start

    h = 1e-4
    before, now, after = attitude(-h), attitude(0.0), attitude(h)
    late, early = (after * now.inv()).as_rotvec() / h, (now * before.inv()).as_rotvec() / h
    omega, alpha = angular_motion(theta, rate, bend)
    assert omega == pytest.approx((late + early) / 2, abs=1e-6)
    assert alpha == pytest.approx((late - early) / h, abs=1e-4)


@pytest.mark.parametrize("size", [0.0, 1e-9, 0.0199, 0.0201, 1.0, 3.14])
def test_vector_rates_undo_angular_motion(size: float) -> None:
    rng = np.random.default_rng(9)
    axis = rng.normal(size=3)
    theta = axis * size / np.linalg.norm(axis)
    rate, bend = rng.normal(size=3), rng.normal(size=3)
    found_rate, found_bend = vector_rates(theta, *angular_motion(theta, rate, bend))
    assert found_rate == pytest.approx(rate, abs=1e-9)
    assert found_bend == pytest.approx(bend, abs=1e-9)
