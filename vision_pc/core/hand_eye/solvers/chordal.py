"""The global optimum of H X P = Z in the chordal distance, with a certificate.

    min  Σ κ‖R_X R_P − R_Hᵀ R_Z‖² + τ‖R_X t_P + t_X − R_Hᵀ (t_Z − t_H)‖²   over R_X, R_Z in SO(3), t_X, t_Z

Translations are eliminated, which leaves a quadratic form in v = (vec R_X, vec R_Z, 1), 19 numbers, under
quadratic constraints (orthonormal rows and columns, handedness). Its Lagrangian dual is a semidefinite
program with one 19×19 cone; where the dual is tight, its multipliers prove that a stationary point is the
global optimum: S = M − Σ λ_k A_k is positive semidefinite and S v = 0.
"""

import functools
import math
from typing import Any, NamedTuple

import clarabel
import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from protocol.errors import MeasurementFailed
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.solvers.maximum_likelihood import Noise
from vision_pc.core.hand_eye.solvers.result import Certificate
from vision_pc.core.se3 import Array, nearest_rotation

Indices = NDArray[np.int64]

_SIZE = 19
_ONE = 18  # the homogenising entry
_NEWTON_STEPS = 12


class ChordalProblem(NamedTuple):
    """``M`` (19, 19) over v = (vec R_X, vec R_Z, 1), of unit trace; ``recover`` (6, 19) gives (t_X, t_Z)."""

    M: Array
    recover: Array


def problem(H: Array, P: Array, weights: Array, noise: Noise) -> ChordalProblem:
    """The quadratic form of the samples ``H``, ``P`` (n, 4, 4) with ``weights`` (n,).

    A chordal distance of two rotations is √2 times their angle, hence κ = 1/(2σ²).
    """
    n = len(H)
    R_H_transposed = np.swapaxes(H[:, :3, :3], -1, -2)
    eye = np.eye(3)
    C = np.zeros((n, 9, _SIZE))
    C[:, :, :9] = np.einsum("ab,ndc->nacbd", eye, P[:, :3, :3]).reshape(n, 9, 9)
    C[:, :, 9:18] = -np.einsum("nab,cd->nacbd", R_H_transposed, eye).reshape(n, 9, 9)
    D = np.zeros((n, 3, _SIZE))
    D[:, :, :9] = np.einsum("ab,nd->nabd", eye, P[:, :3, 3]).reshape(n, 3, 9)
    D[:, :, _ONE] = (R_H_transposed @ H[:, :3, 3, None])[..., 0]
    E = np.concatenate([np.broadcast_to(eye, (n, 3, 3)), -R_H_transposed], axis=-1)
    rotation = float(np.hypot(noise.camera_rotation, noise.robot_rotation))
    translation = float(np.hypot(noise.camera_translation, noise.robot_translation))
    kappa, tau = weights / (2.0 * rotation**2), weights / translation**2
    EE = np.einsum("n,nij,nik->jk", tau, E, E)
    ED = np.einsum("n,nij,nik->jk", tau, E, D)
    recover = -np.linalg.pinv(EE, rcond=1e-12) @ ED
    M = np.einsum("n,nij,nik->jk", kappa, C, C) + np.einsum("n,nij,nik->jk", tau, D, D) + ED.T @ recover
    M = 0.5 * (M + M.T)
    return ChordalProblem(M / np.trace(M), recover)


def solve(chordal: ChordalProblem) -> tuple[Array, Array, Certificate]:
    """X, Z (4, 4) at the global optimum, and the certificate that it is one.

    Raises MeasurementFailed (``measurement.hand_eye.sdp``) when the semidefinite program cannot be solved.
    """
    svec_constraints, constraints = _constraints()
    b = svec(chordal.M)
    q = np.zeros(len(constraints))
    q[-1] = -1.0  # maximise the multiplier of v_18² = 1: the lower bound
    multipliers, dual = sdp_solved(q, svec_constraints, b, [clarabel.PSDTriangleConeT(_SIZE)])
    moments = smat(dual, _SIZE)
    R_X, R_Z = _rounded(moments)
    R_X, R_Z = _polished(chordal.M, R_X, R_Z)
    v = _stack_rotations(R_X, R_Z)
    certificate = _certificate(chordal.M, v, multipliers, constraints, moments)
    t = chordal.recover @ v
    return stacks.transform(R_X, t[:3]), stacks.transform(R_Z, t[3:]), certificate


def _stack_rotations(R_X: Array, R_Z: Array) -> Array:
    return np.concatenate([R_X.reshape(9), R_Z.reshape(9), [1.0]])


def _rounded(moments: Array) -> tuple[Array, Array]:
    values, vectors = np.linalg.eigh(moments)
    v = vectors[:, -1] * np.sqrt(values[-1])
    if abs(v[_ONE]) < 1e-6:
        raise MeasurementFailed(
            "measurement.hand_eye.sdp", "the semidefinite relaxation has no usable first moment"
        )
    v = v / v[_ONE]
    return nearest_rotation(v[:9].reshape(3, 3)), nearest_rotation(v[9:18].reshape(3, 3))


def _polished(M: Array, R_X: Array, R_Z: Array) -> tuple[Array, Array]:
    """The stationary point next to R_X, R_Z, by Newton on SO(3)² with the exact second derivative."""
    generators = stacks.hat(np.eye(3))
    for _ in range(_NEWTON_STEPS):
        v = _stack_rotations(R_X, R_Z)
        J = np.zeros((_SIZE, 6))
        J[:9, :3] = (generators @ R_X).reshape(3, 9).T
        J[9:18, 3:] = (generators @ R_Z).reshape(3, 9).T
        slope = M @ v
        gradient = J.T @ slope
        hessian = J.T @ M @ J
        for block, R in ((0, R_X), (3, R_Z)):
            N = (
                R @ slope[3 * block : 3 * block + 9].reshape(3, 3).T
            )  # Σ slope·(a b + b a) R / 2 for generators a, b
            hessian[block : block + 3, block : block + 3] += 0.5 * (N + N.T) - np.trace(N) * np.eye(3)
        step = np.asarray(-np.linalg.solve(hessian, gradient), dtype=np.float64)
        R_X, R_Z = stacks.exp_so3(step[:3]) @ R_X, stacks.exp_so3(step[3:]) @ R_Z
        if np.abs(step).max() < 1e-14:
            break
    return R_X, R_Z


def _certificate(M: Array, v: Array, multipliers: Array, constraints: Array, moments: Array) -> Certificate:
    """The KKT conditions at v, with the multipliers nearest to the solver's that make v stationary."""
    S = M - np.tensordot(multipliers, constraints, axes=1)
    correction = np.linalg.lstsq((constraints @ v).T, S @ v, rcond=1e-12)[0]
    S = S - np.tensordot(correction, constraints, axes=1)
    scale = float(np.linalg.eigvalsh(M)[-1])
    eigenvalues = np.linalg.eigvalsh(moments)
    bound = float(multipliers[-1] + correction[-1])
    return Certificate(
        kind="chordal SDP 19x19, KKT",
        least_eigenvalue=float(np.linalg.eigvalsh(S)[0]) / scale,
        stationarity=float(np.abs(S @ v).max()) / scale,
        gap=(float(v @ M @ v) - bound) / scale,
        rank=int((eigenvalues > 1e-4 * eigenvalues[-1]).sum()),
    )


@functools.cache
def _constraints() -> tuple[scipy.sparse.csc_matrix, Array]:
    """The constraints vᵀ A_k v = 0, but for the last, v_18² = 1: svec A_k (190, m) and A_k (m, 19, 19)."""
    matrices: list[Array] = []
    for base in (0, 9):
        at = base + np.arange(9).reshape(3, 3)
        matrices += [_orthonormal(at[i], at[j], i == j) for i in range(3) for j in range(i, 3)]
        matrices += [_orthonormal(at[:, i], at[:, j], i == j) for i in range(3) for j in range(i, 3)]
        matrices += [_handed(at, i, a) for i in range(3) for a in range(3)]
    last = np.zeros((_SIZE, _SIZE))
    last[_ONE, _ONE] = 1.0
    matrices.append(last)
    stack = np.stack(matrices)
    return scipy.sparse.csc_matrix(np.stack([svec(A) for A in stack], axis=1)), stack


def _orthonormal(first: Indices, second: Indices, same: bool) -> Array:
    A = np.zeros((_SIZE, _SIZE))
    A[first, second] += 0.5
    A[second, first] += 0.5
    A[_ONE, _ONE] -= 1.0 if same else 0.0
    return A


def _handed(at: Indices, column: int, axis: int) -> Array:
    """column_i × column_j = column_k, component ``axis``, for the cyclic triple that ends in ``column``."""
    i, j = at[:, (column + 1) % 3], at[:, (column + 2) % 3]
    a, b = (axis + 1) % 3, (axis + 2) % 3
    A = np.zeros((_SIZE, _SIZE))
    for first, second, sign in ((i[a], j[b], 0.5), (i[b], j[a], -0.5), (at[axis, column], _ONE, -0.5)):
        A[first, second] += sign
        A[second, first] += sign
    return A


_ACCURACY = 1e-10


def svec(S: Array) -> Array:
    """The upper triangle of a symmetric matrix, column by column, off-diagonals times √2 (an isometry)."""
    j, i = np.tril_indices(len(S))
    return np.asarray(np.where(i == j, 1.0, math.sqrt(2.0)) * S[i, j])


def smat(s: Array, size: int) -> Array:
    """The symmetric matrix of a scaled triangle; inverse of ``svec``."""
    j, i = np.tril_indices(size)
    S = np.zeros((size, size))
    S[i, j] = s * np.where(i == j, 1.0, math.sqrt(0.5))
    S[j, i] = S[i, j]
    return S


def sdp_solved(q: Array, A: scipy.sparse.csc_matrix, b: Array, cones: list[Any]) -> tuple[Array, Array]:
    """The primal x and the dual z at the optimum. Raises MeasurementFailed (``measurement.hand_eye.sdp``)
    when the solver does not reach it.

    One thread, so that reruns are bit-identical; no dynamic regularisation, which costs four digits here.
    """
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = _ACCURACY
    settings.max_threads = 1
    settings.dynamic_regularization_enable = False
    P = scipy.sparse.csc_matrix((len(q), len(q)))
    try:
        result = clarabel.DefaultSolver(P, q, A, b, cones, settings).solve()
    except BaseException as error:  # a panic of its Rust code is not an Exception
        if type(error).__name__ != "PanicException":
            raise
        raise MeasurementFailed(
            "measurement.hand_eye.sdp", f"the semidefinite solver broke: {error}"
        ) from error
    status = str(result.status)
    if status not in ("Solved", "AlmostSolved"):
        raise MeasurementFailed("measurement.hand_eye.sdp", f"the semidefinite program ended as {status}")
    return np.array(result.x), np.array(result.z)
