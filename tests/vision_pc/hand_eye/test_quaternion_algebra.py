"""Products of quaternions as matrices, and dual quaternions."""

import numpy as np

from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.solvers.quaternion_algebra import (
    dual_part,
    left_product_matrix,
    right_product_matrix,
    translation_of_dual,
)


def test_product_matrices_multiply_quaternions() -> None:
    rng = np.random.default_rng(1)
    R, S = stacks.exp_so3(rng.normal(size=(2, 20, 3)))
    p, q = stacks.quaternion_from_rotation(R), stacks.quaternion_from_rotation(S)
    left = (left_product_matrix(p) @ q[..., None])[..., 0]
    right = (right_product_matrix(q) @ p[..., None])[..., 0]
    np.testing.assert_allclose(left, right, atol=1e-15)
    np.testing.assert_allclose(stacks.rotation_from_quaternion(left), R @ S, atol=1e-14)


def test_dual_quaternions_hold_the_translation() -> None:
    rng = np.random.default_rng(2)
    q = stacks.quaternion_from_rotation(stacks.exp_so3(rng.normal(size=(20, 3))))
    t = rng.normal(size=(20, 3))
    dual = dual_part(q, t)
    np.testing.assert_allclose(np.sum(q * dual, axis=1), 0.0, atol=1e-15)
    back = np.stack([translation_of_dual(a, b) for a, b in zip(q, dual, strict=True)])
    np.testing.assert_allclose(back, t, atol=1e-14)
