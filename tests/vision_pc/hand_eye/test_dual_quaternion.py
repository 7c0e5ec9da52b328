"""DQCR in closed form minimises both of its problems; quaternion products and dual quaternions."""

import numpy as np
import scipy.optimize

from laboratory.experiments.hand_eye import scenes
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.solvers import classical
from vision_pc.core.hand_eye.solvers.motions import (
    all_motions,
    dual_part,
    dual_quaternions,
)


def test_closed_form_minimises_both_problems() -> None:
    rng = np.random.default_rng(3)
    pairs = scenes.measured(scenes.table_1_scene(), scenes.noise(0.1, 0.2), rng)
    motions = dual_quaternions(all_motions(pairs))
    R, D = motions.rotation_rows(), motions.dual_rows()
    RR, RD = (np.einsum("mij,mik->jk", R, second) for second in (R, D))
    X, certificate = classical.dqcr(motions)
    assert certificate.holds
    g = stacks.quaternion_from_rotation(X[:3, :3])
    g_dual = dual_part(g, X[:3, 3])

    def rotation_cost(x: np.ndarray) -> float:  # type: ignore[type-arg]
        return float(x @ RR @ x / (x @ x))

    starts = np.random.default_rng(1).normal(size=(20, 4))
    best = min(float(scipy.optimize.minimize(rotation_cost, s).fun) for s in starts)
    assert rotation_cost(g) <= best + 1e-12
    along = np.linalg.svd(g[None])[2][1:]  # the tangent space gᵀg' = 0

    def dual_cost(y: np.ndarray) -> float:  # type: ignore[type-arg]
        d = y @ along
        return float(d @ RR @ d + 2.0 * d @ RD @ g)

    slope = scipy.optimize.approx_fprime(along @ g_dual, dual_cost, 1e-6)
    assert abs(g @ g_dual) < 1e-12
    assert np.abs(slope).max() < 1e-4 * np.abs(RR).max()
