"""Order-2 moment relaxation of a quadratic problem in four unknowns under quadratic equations (Lasserre).

Every monomial up to degree 4 becomes one variable y_α; the moment matrix of all monomials up to degree 2
(15×15) is positive semidefinite; each equation h = 0 is multiplied by all monomials that keep the degree at
4 (the localising matrix must vanish). Hua et al. 2024, eq. (17) to (24); solved by Clarabel instead of
their SeDuMi.

The equations force null vectors on the moment matrix, which then has no interior and makes solvers stall.
Eliminating the equations and those null vectors gives the same problem in a form that can be solved.
"""

import functools
import itertools
from typing import NamedTuple

import clarabel
import numpy as np
import scipy.sparse

from vision_pc.core.hand_eye.solvers import sdp
from vision_pc.core.se3 import Array

_UNKNOWNS = 4
_DEGREE = 4
_RANK_TOLERANCE = 1e-4  # of the largest eigenvalue: an interior-point solver leaves the rest near 1e-8

Exponents = tuple[int, ...]
Polynomial = dict[Exponents, float]


class Relaxation(NamedTuple):
    """``value`` is the lower bound; ``first`` (4,), ``second`` (4, 4) are the moments of degree 1 and 2;

    ``rank_lower``, ``rank_upper`` are the ranks of the moment matrices of order 1 and 2 (equal: flat, hence
    exact); ``purity`` is the share of the largest eigenvalue in ``second``.
    """

    value: float
    first: Array
    second: Array
    rank_lower: int
    rank_upper: int
    purity: float


def monomial(*variables: int) -> Exponents:
    """The exponents of the product of these variables (0…3)."""
    return tuple(variables.count(k) for k in range(_UNKNOWNS))


def relaxed(objective: Array, equations: list[Polynomial]) -> Relaxation:
    """The order-2 relaxation, (17) to (24), of min [1, x]ᵀ ``objective`` [1, x] (5, 5), ``equations`` = 0.

    Raises MeasurementFailed (``measurement.hand_eye.sdp``) when the solver fails.
    """
    index, basis = _structure()
    q = np.zeros(len(index))
    for i, j in itertools.product(range(5), repeat=2):
        q[index[_times(basis[i], basis[j])]] += objective[i, j]
    rows = [{index[monomial()]: 1.0}]
    for equation in equations:
        degree = max(sum(alpha) for alpha in equation)
        rows += [
            {index[_times(alpha, beta)]: c for alpha, c in equation.items()}
            for beta in index
            if sum(beta) + degree <= _DEGREE
        ]
    zero = np.zeros((len(rows), len(index)))
    for k, row in enumerate(rows):
        for column, coefficient in row.items():
            zero[k, column] = coefficient
    fixed = np.linalg.lstsq(zero, np.eye(len(rows))[0], rcond=1e-12)[0]
    free = _kernel(zero)
    complement = _complement(basis, equations)
    cone = np.einsum("ij,aik,kl->ajl", complement, _moment_matrices(), complement, optimize=True)
    A = scipy.sparse.csc_matrix(-np.stack([sdp.svec(S) for S in np.tensordot(free.T, cone, axes=1)], axis=1))
    b = sdp.svec(np.tensordot(fixed, cone, axes=1))
    cones = [clarabel.PSDTriangleConeT(complement.shape[1])]
    solution = sdp.solved(free.T @ q, A, b, cones)
    moments = np.tensordot(fixed + free @ solution.primal, _moment_matrices(), axes=1)
    second = moments[1:5, 1:5]
    eigenvalues = np.linalg.eigvalsh(second)
    return Relaxation(
        solution.value + float(q @ fixed),
        moments[0, 1:5],
        second,
        _rank(moments[:5, :5]),
        _rank(moments),
        float(eigenvalues[-1] / eigenvalues.sum()),
    )


def _rank(moments: Array) -> int:
    eigenvalues = np.linalg.eigvalsh(moments)
    return int((eigenvalues > _RANK_TOLERANCE * eigenvalues[-1]).sum())


def _times(alpha: Exponents, beta: Exponents) -> Exponents:
    return tuple(a + b for a, b in zip(alpha, beta, strict=True))


def _complement(basis: list[Exponents], equations: list[Polynomial]) -> Array:
    """An orthonormal basis (15, r) of what is orthogonal to the null vectors that the equations force."""
    position = {alpha: k for k, alpha in enumerate(basis)}
    null = []
    for equation in equations:
        degree = max(sum(alpha) for alpha in equation)
        for beta in basis:
            if sum(beta) + degree <= _DEGREE // 2:
                vector = np.zeros(len(basis))
                for alpha, coefficient in equation.items():
                    vector[position[_times(alpha, beta)]] = coefficient
                null.append(vector)
    return _kernel(np.stack(null))


def _kernel(rows: Array) -> Array:
    """An orthonormal basis (n, r) of the vectors that ``rows`` (m, n) send to zero."""
    _, sizes, Vt = np.linalg.svd(rows, full_matrices=True)
    return np.asarray(Vt[int((sizes > 1e-12).sum()) :].T)


@functools.cache
def _structure() -> tuple[dict[Exponents, int], list[Exponents]]:
    """The index of every monomial up to degree 4 (70) and the basis of those up to degree 2 (15)."""
    by_degree = [
        [monomial(*combo) for combo in itertools.combinations_with_replacement(range(_UNKNOWNS), degree)]
        for degree in range(_DEGREE + 1)
    ]
    index = {alpha: k for k, alpha in enumerate(itertools.chain(*by_degree))}
    return index, list(itertools.chain(*by_degree[:3]))


@functools.cache
def _moment_matrices() -> Array:
    """Where each monomial stands in the moment matrix (70, 15, 15), as zeros and ones."""
    index, basis = _structure()
    matrices = np.zeros((len(index), len(basis), len(basis)))
    for (i, first), (j, second) in itertools.product(enumerate(basis), repeat=2):
        matrices[index[_times(first, second)], i, j] = 1.0
    return matrices
