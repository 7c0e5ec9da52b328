"""DQCR in closed form minimises both of its problems; quaternion products and dual quaternions."""

import numpy as np
import scipy.optimize

from laboratory.experiments.hand_eye import scenes
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.solvers import classical
from vision_pc.core.hand_eye.solvers.classical import Forms
from vision_pc.core.hand_eye.solvers.motions import (
    all_motions,
    dual_part,
    dual_quaternions,
)


def forms(seed: int, level: float = 10.0) -> Forms:
    rng = np.random.default_rng(seed)
    pairs = scenes.measured(scenes.table_1_scene(), scenes.noise(0.01 * level, 0.02 * level), rng)
    return classical.forms(dual_quaternions(all_motions(pairs)))


def test_closed_form_minimises_both_problems() -> None:
    f = forms(3)
    X, certificate = classical.dqcr(f)
    assert certificate.holds
    g = stacks.quaternion_from_rotation(X[:3, :3])
    g_dual = dual_part(g, X[:3, 3])

    def rotation_cost(x: np.ndarray) -> float:  # type: ignore[type-arg]
        return float(x @ f.RR @ x / (x @ x))

    starts = np.random.default_rng(1).normal(size=(20, 4))
    best = min(float(scipy.optimize.minimize(rotation_cost, s).fun) for s in starts)
    assert rotation_cost(g) <= best + 1e-12
    along = np.linalg.svd(g[None])[2][1:]  # the tangent space gᵀg' = 0

    def dual_cost(y: np.ndarray) -> float:  # type: ignore[type-arg]
        d = y @ along
        return float(d @ f.RR @ d + 2.0 * d @ f.RD @ g)

    slope = scipy.optimize.approx_fprime(along @ g_dual, dual_cost, 1e-6)
    assert abs(g @ g_dual) < 1e-12
    assert np.abs(slope).max() < 1e-4 * np.abs(f.RR).max()
