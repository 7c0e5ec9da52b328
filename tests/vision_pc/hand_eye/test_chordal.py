"""The chordal problem: proven, global, and not fooled where local searches are."""

import clarabel
import numpy as np
import pytest
import scipy.sparse

from laboratory.experiments.hand_eye import scenes
from protocol.errors import MeasurementFailed
from tests.vision_pc.hand_eye.data import noisy_pairs, random_poses
from vision_pc.core.hand_eye.solvers import chordal
from vision_pc.core.hand_eye.solvers import maximum_likelihood as ml
from vision_pc.core.hand_eye.solvers.maximum_likelihood import Equations, Noise
from vision_pc.core.se3 import Array

NOISE = scenes.noise(0.1, 0.5)


def chordal_cost(H: Array, P: Array, X: Array, Z: Array, n: Noise) -> float:
    R_H_transposed = np.swapaxes(H[:, :3, :3], -1, -2)
    turn = X[:3, :3] @ P[:, :3, :3] - R_H_transposed @ Z[:3, :3]
    here = P[:, :3, 3] @ X[:3, :3].T + X[:3, 3]
    there = (R_H_transposed @ (Z[:3, 3] - H[:, :3, 3])[..., None])[..., 0]
    return float(
        np.sum(turn**2) / (2.0 * n.camera_rotation**2) + np.sum((here - there) ** 2) / n.camera_translation**2
    )


@pytest.mark.parametrize("seed", range(5))
def test_optimum_is_proven_and_no_other_start_finds_better(seed: int) -> None:
    pairs, _ = noisy_pairs(seed)
    X, Z, certificate = chordal.solve(chordal.problem(pairs.H, pairs.P, np.ones(len(pairs)), NOISE))
    assert certificate.holds
    assert certificate.least_eigenvalue >= -1e-9
    assert certificate.rank == 1
    best = chordal_cost(pairs.H, pairs.P, X, Z, NOISE)
    rng = np.random.default_rng(seed)
    for X_start, Z_start in zip(random_poses(rng, 10, 2.0), random_poses(rng, 10, 2.0), strict=True):
        other = ml.maximize(Equations(pairs.H, pairs.P, np.ones(len(pairs))), X_start, Z_start, NOISE)
        assert chordal_cost(pairs.H, pairs.P, other.X, other.Z, NOISE) >= best * (1.0 - 1e-9)


def test_proof_fails_at_another_stationary_point() -> None:
    """Multipliers that make a wrong rotation stationary cannot also be positive semidefinite."""
    pairs, _ = noisy_pairs(10)
    problem = chordal.problem(pairs.H, pairs.P, np.ones(len(pairs)), NOISE)
    X, Z, _ = chordal.solve(problem)
    wrong = X[:3, :3] @ np.diag([1.0, -1.0, -1.0])
    _, constraints = chordal._constraints()
    v = np.concatenate([wrong.ravel(), Z[:3, :3].ravel(), [1.0]])
    zero = np.zeros(len(constraints))
    assert not chordal._certificate(problem.M, v, zero, constraints, np.eye(19)).holds


def test_an_unsolvable_program_is_an_error() -> None:
    A = scipy.sparse.csc_matrix(np.array([[1.0], [-1.0]]))
    with pytest.raises(MeasurementFailed) as caught:  # x ≤ −1 and x ≥ 1
        chordal.sdp_solved(np.array([1.0]), A, np.array([-1.0, -1.0]), [clarabel.NonnegativeConeT(2)])
    assert caught.value.cause == "measurement.hand_eye.sdp"
