"""DQCR as published against its closed form, and certificates that fail where they must."""

import numpy as np
import pytest
import scipy.optimize

from protocol.errors import MeasurementFailed
from testbed.experiments.hand_eye import scenes
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.solvers import dual_quaternion, sdp
from vision_pc.core.hand_eye.solvers.dual_quaternion import Forms
from vision_pc.core.hand_eye.solvers.moment_relaxation import monomial, relaxed
from vision_pc.core.hand_eye.solvers.motions import all_motions, dual_quaternions
from vision_pc.core.hand_eye.solvers.quaternion_algebra import dual_part
from vision_pc.core.hand_eye.solvers.result import Certificate


def forms(seed: int, level: float = 10.0) -> Forms:
    rng = np.random.default_rng(seed)
    pairs = scenes.measured(scenes.table_1_scene(), scenes.noise(0.01 * level, 0.02 * level), rng)
    return dual_quaternion.forms(dual_quaternions(all_motions(pairs)))


@pytest.mark.parametrize("level", [0.0, 0.01, 1.0, 10.0, 100.0])
def test_published_equals_closed_form(level: float) -> None:
    f = forms(1, level)
    published = dual_quaternion.published(f)
    closed, _ = dual_quaternion.closed_form(f)
    np.testing.assert_allclose(published.X, closed, atol=1e-6)


def test_published_is_certified_by_rank() -> None:
    found = dual_quaternion.published(forms(2))
    assert (found.rotation.rank_lower, found.rotation.rank_upper) == (2, 2)  # g and −g: flat
    assert found.translation.rank_lower == 1
    assert found.rotation.purity > 1.0 - 1e-6
    assert found.certificate.holds


def test_closed_form_minimises_both_problems() -> None:
    f = forms(3)
    X, certificate = dual_quaternion.closed_form(f)
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


def test_joint_problem_is_proven_and_better_than_dqcr() -> None:
    f = forms(4)
    X, certificate = dual_quaternion.joint(f)
    assert certificate.holds
    assert certificate.least_eigenvalue >= -1e-9
    assert abs(certificate.gap) < 1e-12

    def cost(pose: np.ndarray) -> float:  # type: ignore[type-arg]
        g = stacks.quaternion_from_rotation(pose[:3, :3])
        v = np.concatenate([g, dual_part(g, pose[:3, 3])])
        return float(v @ f.joint() @ v)

    assert cost(X) < cost(dual_quaternion.closed_form(f)[0])
    rng = np.random.default_rng(2)
    for _ in range(100):  # nothing near it is better
        turn = stacks.exp_so3(rng.normal(size=3) * 1e-3)
        other = stacks.transform(turn @ X[:3, :3], X[:3, 3] + rng.normal(size=3) * 1e-3)
        assert cost(other) >= cost(X)


def test_a_certificate_can_fail() -> None:
    assert Certificate("", -1e-12, 1e-12, 0.0, 1).holds
    assert not Certificate("", -1e-6, 1e-12, 0.0, 1).holds  # a saddle or another optimum is lower
    assert not Certificate("", 0.0, 1e-3, 0.0, 1).holds  # not stationary


def test_relaxation_of_a_problem_with_a_known_answer() -> None:
    """min (x0 − 2)² + (x1 + 1)² on the unit sphere: the point of the sphere towards (2, −1, 0, 0)."""
    objective = np.zeros((5, 5))
    objective[0, 0] = 5.0
    objective[0, 1] = objective[1, 0] = -2.0
    objective[0, 2] = objective[2, 0] = 1.0
    objective[1, 1] = objective[2, 2] = 1.0
    sphere = {monomial(): 1.0} | {monomial(k, k): -1.0 for k in range(4)}
    found = relaxed(objective, [sphere])
    np.testing.assert_allclose(found.first, np.array([2.0, -1.0, 0.0, 0.0]) / np.sqrt(5.0), atol=1e-5)
    assert found.value == pytest.approx((np.sqrt(5.0) - 1.0) ** 2, abs=1e-6)
    assert found.rank_lower == found.rank_upper == 1


def test_triangles_are_an_isometry() -> None:
    rng = np.random.default_rng(5)
    A, B = rng.normal(size=(2, 6, 6))
    A, B = A + A.T, B + B.T
    assert sdp.svec(A) @ sdp.svec(B) == pytest.approx(float(np.sum(A * B)))
    np.testing.assert_allclose(sdp.smat(sdp.svec(A), 6), A, atol=1e-15)


def test_an_unsolvable_program_is_an_error() -> None:
    import clarabel
    import scipy.sparse

    A = scipy.sparse.csc_matrix(np.array([[1.0], [-1.0]]))
    with pytest.raises(MeasurementFailed) as caught:  # x ≤ −1 and x ≥ 1
        sdp.solved(np.array([1.0]), A, np.array([-1.0, -1.0]), [clarabel.NonnegativeConeT(2)])
    assert caught.value.cause == "measurement.hand_eye.sdp"
