"""How sure sums of a least-squares fit's unknowns are, where blocks of its rows err together; pure functions.

Leaving out one block after the other overstates it where a block holds much of what is known: what is left of
its rows then counts (I − H)⁻¹ times, H the block's part of the projection on the columns. (I − H)^−½ is right
on average where rows err alone, and hardly less so where those of a block do not. Bell and McCaffrey, Bias
reduction in standard errors for linear regression with multi-stage samples, 2002; so is the number of degrees
of freedom, by which the spread is widened as Student's.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from vision_pc.core.se3 import Array

_LEAST_FREEDOM = 3.0  # degrees, as of which Student's spread is told
_OWN = 1e-8  # of 1 − an eigenvalue of H: a direction that one block alone tells leaves nothing


def block_spreads(columns: Array, target: Array, sums: Array, sizes: Sequence[int]) -> Array:
    """The standard deviations (p,) of ``sums`` (p, k) of the unknowns by which ``columns`` (m, k) make
    ``target`` (m,); ``sizes``: rows of each block, in order."""
    units = np.maximum(np.abs(columns).max(axis=0), 1e-12)
    basis, sizes_of, back = np.linalg.svd(columns / units, full_matrices=False)
    told = sizes_of > 1e-10 * sizes_of[0]
    basis, inverse = basis[:, told], (back[told].T / sizes_of[told]) @ basis[:, told].T
    left = target - basis @ (basis.T @ target)
    ends = np.cumsum([0, *sizes])
    weights = (sums / units) @ inverse
    blocks = [slice(first, end) for first, end in pairwise(ends)]
    spread = np.array([[w[b] @ _whitened(basis[b], left[b]) for b in blocks] for w in weights])
    freedom = np.array([_freedom(w, basis, blocks) for w in weights])
    return np.asarray(np.sqrt(np.sum(spread**2, axis=1) * freedom / (freedom - 2.0)))


def _whitened(basis: Array, values: Array) -> Array:
    """(I − B Bᵀ)^−½ ``values`` for the rows B of one block; what it alone tells is left out."""
    kept, rotation = np.linalg.eigh(np.eye(len(basis)) - basis @ basis.T)
    scale = np.where(kept > _OWN, np.maximum(kept, _OWN) ** -0.5, 0.0)
    return np.asarray(rotation @ (scale * (rotation.T @ values)))


def _freedom(weights: Array, basis: Array, blocks: Sequence[slice]) -> float:
    """Degrees of freedom of a spread if rows err alone: by its mean and its scatter (Satterthwaite)."""
    parts = np.zeros((len(blocks), len(weights)))
    for part, block in zip(parts, blocks, strict=True):
        part[block] = _whitened(basis[block], weights[block])
        part -= basis @ (basis.T @ part)
    shared = parts @ parts.T
    return max(float(np.trace(shared) ** 2 / np.sum(shared**2)), _LEAST_FREEDOM)
