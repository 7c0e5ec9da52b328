"""Normal equations of poses and points: summed by whom they concern, and solved, points eliminated."""

from typing import NamedTuple

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from vision_pc.core.se3 import Array


class Blocks(NamedTuple):
    """Normal equations: poses H (k, 6, 6) b (k, 6), points V (m, 3, 3) c (m, 3), mixed W (k, m, 6, 3)."""

    H: Array
    b: Array
    V: Array
    c: Array
    W: Array


def summation(group: NDArray[np.int64], groups: int) -> scipy.sparse.csr_array:
    """The matrix that sums rows by their ``group`` (n,)."""
    ones, rows = np.ones(len(group)), np.arange(len(group))
    return scipy.sparse.csr_array((ones, (group, rows)), shape=(groups, len(group)))


def summed(summation: scipy.sparse.csr_array, values: Array) -> Array:
    """Blocks ``values`` (n, ...) summed by group (groups, ...)."""
    return np.asarray(summation @ values.reshape(len(values), -1)).reshape(-1, *values.shape[1:])


def _damped(blocks: Array, damping: float) -> Array:
    """Blocks (n, d, d), their diagonals raised by a share; one where nothing is known: they are solved."""
    eye = np.eye(blocks.shape[1])
    diagonal = np.einsum("nij,ij->nij", blocks, eye)
    return np.asarray(blocks + damping * diagonal + (eye != 0.0) * (diagonal == 0.0))


def step(blocks: Blocks, damping: float) -> tuple[Array, Array]:
    """Moves of the free poses (k, 6) and of the points (m, 3): points eliminated, then put back.

    What no view tells of stays where it is.
    """
    free, count = blocks.W.shape[:2]
    V, H = _damped(blocks.V, damping), _damped(blocks.H, damping)
    eliminated = blocks.W @ np.linalg.inv(V)  # (k, m, 6, 3)
    flat = eliminated.transpose(0, 2, 1, 3).reshape(6 * free, 3 * count)
    mixed = blocks.W.transpose(0, 2, 1, 3).reshape(6 * free, 3 * count)
    S = -flat @ mixed.T
    for k in range(free):
        S[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] += H[k]
    poses = np.linalg.solve(S, blocks.b.ravel() - flat @ blocks.c.ravel())
    points = np.linalg.solve(V, (blocks.c.ravel() - mixed.T @ poses).reshape(count, 3, 1))[..., 0]
    return np.asarray(poses.reshape(free, 6)), np.asarray(points)
