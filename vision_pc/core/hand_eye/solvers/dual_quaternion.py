"""A X = X B in dual quaternions: DQCR as published, its closed form, and the joint problem.

With x_i, y_i the motions of hand and camera and g + ε g' the unknown, R_i = A(x_i) − B(y_i) and D_i =
A(x'_i) − B(y'_i):

    problem 1 (27):   min Σ ‖R_i g‖²               gᵀg = 1
    problem 2 (31):   min Σ ‖R_i g' + D_i g‖²      gᵀg' = 0, g from problem 1
    joint:            min Σ ‖R_i g‖² + ‖R_i g' + D_i g‖²   over both, gᵀg = 1, gᵀg' = 0

Source: Hua et al. 2024, section 4.2. Problem 1 is a 4×4 eigenvalue problem and problem 2 a linear
least-squares problem, so the published relaxations are tight and `closed_form` gives the same X.
"""

from typing import NamedTuple

import clarabel
import numpy as np
import scipy.optimize
import scipy.sparse

from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.solvers import sdp
from vision_pc.core.hand_eye.solvers.moment_relaxation import Polynomial, Relaxation, monomial, relaxed
from vision_pc.core.hand_eye.solvers.motions import DualQuaternions
from vision_pc.core.hand_eye.solvers.quaternion_algebra import translation_of_dual
from vision_pc.core.hand_eye.solvers.result import Certificate
from vision_pc.core.se3 import Array

_BRACKET, _WIDEST = 1e-9, 10.0  # of the second multiplier; the matrix has norm 1
_ENLARGE = (1.0, 1e-4)


class Forms(NamedTuple):
    """The quadratic forms of the joint objective over (g, g'): Σ RᵀR, Σ RᵀD and Σ DᵀD, (4, 4) each."""

    RR: Array
    RD: Array
    DD: Array

    def joint(self) -> Array:
        """The joint objective's matrix (8, 8)."""
        return np.block([[self.RR + self.DD, self.RD.T], [self.RD, self.RR]])


def forms(motions: DualQuaternions) -> Forms:
    """The quadratic forms of these motions."""
    R, D = motions.rotation_rows(), motions.dual_rows()
    return Forms(*(np.einsum("mij,mik->jk", first, second) for first, second in ((R, R), (R, D), (D, D))))


def closed_form(f: Forms) -> tuple[Array, Certificate]:
    """X (4, 4) by DQCR's two problems in closed form, and the certificate of problem 1."""
    values, vectors = np.linalg.eigh(f.RR)
    g = vectors[:, 0]
    scale = float(np.trace(f.RR)) / 4.0
    system = np.zeros((5, 5))
    system[:4, :4] = f.RR / scale
    system[:4, 4] = system[4, :4] = g
    g_dual = np.linalg.solve(system, np.append(-f.RD @ g / scale, 0.0))[:4]
    S = f.RR - values[0] * np.eye(4)
    least, largest = float(np.linalg.eigvalsh(S)[0]), float(values[-1])
    certificate = Certificate(
        "eigenvalue problem, KKT", least / largest, float(np.abs(S @ g).max()) / largest, 0.0, rank=1
    )
    return _pose(g, g_dual), certificate


class PublishedSolution(NamedTuple):
    """The outcome of both published relaxations."""

    X: Array
    rotation: Relaxation
    translation: Relaxation
    certificate: Certificate


def published(f: Forms) -> PublishedSolution:
    """X (4, 4) by DQCR as published: both problems as order-2 moment relaxations.

    Problem 1 is symmetric in g and −g, so its moment matrices have rank 2, equal at both orders; g is the
    principal eigenvector of the second moments. Problem 2 has no bound on fourth moments, so its
    certificate is that the order-1 matrix has rank 1. The dual part is scaled to the size of the motions,
    else metres or millimetres would decide the solver's accuracy. Raises MeasurementFailed when the solver
    fails.
    """
    scale = float(np.trace(f.RR)) / 4.0
    rotation, g = _relaxed_rotation(f.RR / scale)
    length = max(float(np.sqrt(np.trace(f.DD) / np.trace(f.RR))), 1e-9)
    translation, g_dual = _relaxed_translation(f.RR / scale, f.RD @ g / (scale * length), g)
    values = np.linalg.eigvalsh(f.RR) / scale
    reached = float(g @ f.RR @ g) / scale
    certificate = Certificate(
        "order-2 moment relaxations, rank and KKT",
        least_eigenvalue=float(values[0] - reached) / float(values[-1]),
        stationarity=float(np.abs(f.RR @ g / scale - reached * g).max()) / float(values[-1]),
        gap=(reached - rotation.value) / float(values[-1]),
        rank=rotation.rank_upper,
    )
    return PublishedSolution(_pose(g, g_dual * length), rotation, translation, certificate)


def _relaxed_rotation(form: Array) -> tuple[Relaxation, Array]:
    """Problem 1, (27), relaxed as published, and g (4,).

    It is solved a second time in the axes of its own first answer, the unknowns across that answer enlarged
    ten thousand times: the same problem, but the solver's few digits are then digits of what was left.
    """
    axes = np.eye(4)
    published_form: Relaxation | None = None
    for across in _ENLARGE:
        stretch = np.diag([1.0, across, across, across])
        turned = axes.T @ form @ axes
        turned = turned - (turned[0, 0] if across < 1.0 else 0.0) * np.eye(4)  # a constant on the sphere
        objective = np.zeros((5, 5))
        objective[1:, 1:] = stretch @ turned @ stretch / across**2
        unit: Polynomial = {monomial(): 1.0} | {monomial(k, k): -float(stretch[k, k] ** 2) for k in range(4)}
        solved = relaxed(objective, [unit])
        published_form = published_form or solved
        h = stretch @ np.linalg.eigh(solved.second)[1][:, -1]
        h = h / np.linalg.norm(h)
        axes = axes @ np.linalg.qr(np.column_stack([h, np.eye(4)]))[0]
    assert published_form is not None
    return published_form, axes[:, 0]


def _relaxed_translation(form: Array, linear: Array, g: Array) -> tuple[Relaxation, Array]:
    """Problem 2, (31), relaxed as published, and g' (4,): min g'ᵀ form g' + 2 linearᵀ g' with gᵀg' = 0.

    It is solved a second time around its own first answer, enlarged in the same way.
    """
    g_dual = np.zeros(4)
    published_form: Relaxation | None = None
    for unit in _ENLARGE:
        objective = np.zeros((5, 5))
        objective[1:, 1:] = form
        objective[0, 1:] = objective[1:, 0] = (linear + form @ g_dual) / unit
        orthogonal: Polynomial = {monomial(k): float(g[k]) for k in range(4)}
        orthogonal[monomial()] = float(g @ g_dual) / unit
        solved = relaxed(objective, [orthogonal])
        published_form = published_form or solved
        g_dual = g_dual + unit * solved.first
    assert published_form is not None
    return published_form, g_dual


def joint(f: Forms) -> tuple[Array, Certificate]:
    """X (4, 4) at the global optimum of the joint problem by its Shor relaxation (8×8), and the certificate.

    Raises MeasurementFailed (``measurement.hand_eye.sdp``) when the solver fails.
    """
    length = max(
        float(np.sqrt(np.trace(f.DD) / np.trace(f.RR))), 1e-9
    )  # columns of equal size: g' in these lengths
    units = np.diag([1.0] * 4 + [length] * 4)
    M = units @ f.joint() @ units
    scale = float(np.linalg.eigvalsh(M)[-1])
    M = M / scale
    A_1, A_2 = _constraints()
    A = scipy.sparse.csc_matrix(np.stack([sdp.svec(A_1), sdp.svec(A_2)], axis=1))
    solution = sdp.solved(np.array([-1.0, 0.0]), A, sdp.svec(M), [clarabel.PSDTriangleConeT(8)])
    values = np.linalg.eigvalsh(sdp.smat(solution.dual, 8))
    v, multipliers = _stationary(M, float(solution.primal[1]))
    S = M - multipliers[0] * A_1 - multipliers[1] * A_2
    certificate = Certificate(
        "Shor 8x8, KKT",
        least_eigenvalue=float(np.linalg.eigvalsh(S)[0]),
        stationarity=float(np.abs(S @ v).max()),
        gap=float(v @ M @ v - multipliers[0]),
        rank=int((values > 1e-4 * values[-1]).sum()),
    )
    return _pose(v[:4], v[4:] * length), certificate


def _constraints() -> tuple[Array, Array]:
    A_1, A_2 = np.zeros((8, 8)), np.zeros((8, 8))
    A_1[:4, :4] = np.eye(4)
    A_2[:4, 4:] = A_2[4:, :4] = 0.5 * np.eye(4)
    return A_1, A_2


# Without any noise the block of g' has no inverse: g' along g costs nothing, and is excluded by gᵀg' = 0.
_RIDGE = 1e-15


def _stationary(M: Array, multiplier: float) -> tuple[Array, tuple[float, float]]:
    """The exact stationary point (8,) and both multipliers next to the relaxation's second one.

    With g' eliminated, the first multiplier is the least eigenvalue of a 4x4 matrix and concave in the
    second one, with the slope g·g': its only root is bracketed, which Newton's steps on the KKT equations
    may leave where almost nothing is noisy.
    """

    def at(second: float) -> tuple[float, Array]:
        K = M[:4, 4:] - 0.5 * second * np.eye(4)
        across = np.linalg.solve(M[4:, 4:] + _RIDGE * np.eye(4), K.T)
        values, vectors = np.linalg.eigh(M[:4, :4] - K @ across)
        g = vectors[:, 0]
        return float(values[0]), np.concatenate([g, -across @ g])

    def slope(second: float) -> float:
        _, v = at(second)
        return float(v[:4] @ v[4:])

    width = _BRACKET
    while slope(multiplier - width) * slope(multiplier + width) > 0.0 and width < _WIDEST:
        width *= 10.0
    if width < _WIDEST:
        multiplier = float(scipy.optimize.brentq(slope, multiplier - width, multiplier + width, xtol=1e-18))
    first, v = at(multiplier)
    return v, (first, multiplier)


def _pose(g: Array, g_dual: Array) -> Array:
    return stacks.transform(stacks.rotation_from_quaternion(g), translation_of_dual(g, g_dual))
