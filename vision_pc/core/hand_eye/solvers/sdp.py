"""Semidefinite programs through Clarabel: symmetric matrices as scaled triangles, failures as errors.

min qᵀx   subject to   b − A x in the cones
"""

import math
from typing import Any, NamedTuple

import clarabel
import numpy as np
import scipy.sparse

from protocol.errors import MeasurementFailed
from vision_pc.core.se3 import Array

_ACCURACY = 1e-10


class SdpSolution(NamedTuple):
    """``primal`` x and ``dual`` z of the program above, and the optimal value."""

    primal: Array
    dual: Array
    value: float


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


def solved(q: Array, A: scipy.sparse.csc_matrix, b: Array, cones: list[Any]) -> SdpSolution:
    """The optimum. Raises MeasurementFailed (``measurement.hand_eye.sdp``) when the solver does not reach it.

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
    return SdpSolution(np.array(result.x), np.array(result.z), float(result.obj_val))
