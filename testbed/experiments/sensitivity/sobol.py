"""Sobol indices of groups of inputs from picked and frozen runs, for results of several numbers.

Estimators: Saltelli et al. 2010 (first order), Jansen 1999 (total); several numbers as Gamboa et al. 2014:
sums over them of covariance over sums of variance. ``scipy.stats.sobol_indices`` has the same for one number
at a time; it takes powers of two alone and no run that failed.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_RESAMPLES = 2000
_SHARE = 95.0  # of an interval, percent


class Runs(NamedTuple):
    """Results of n samples, m numbers each, NaN where a run failed.

    ``A`` (n, m), ``B`` (n, m): of independent worlds. ``AB`` (d, n, m): of A with group i taken from B.
    """

    A: Array
    B: Array
    AB: Array

    def whole(self) -> "Runs":
        """The samples all of whose runs succeeded."""
        fine = np.isfinite(self.A).all(axis=1) & np.isfinite(self.B).all(axis=1)
        fine &= np.isfinite(self.AB).all(axis=(0, 2))
        return Runs(self.A[fine], self.B[fine], self.AB[:, fine])


class SobolIndices(NamedTuple):
    """Shares (d,) of the variance: ``first`` by a group alone, ``total`` with all that it acts together with.

    ``variance``: of all m numbers together.
    """

    first: Array
    total: Array
    variance: float


class Limited(NamedTuple):
    """Indices with their 95 % intervals (2, d), and how often (d,) each group's total is the greatest."""

    indices: SobolIndices
    first_ends: Array
    total_ends: Array
    greatest: Array


def sobol(runs: Runs) -> SobolIndices:
    """The indices of runs of which none failed; NaN where nothing varies."""
    middle = np.concatenate([runs.A, runs.B]).mean(axis=0)
    A, B, AB = runs.A - middle, runs.B - middle, runs.AB - middle
    variance = float(np.concatenate([A, B]).var(axis=0).sum())
    with np.errstate(invalid="ignore", divide="ignore"):
        first = (B * (AB - A)).mean(axis=1).sum(axis=1) / variance
        total = 0.5 * ((A - AB) ** 2).mean(axis=1).sum(axis=1) / variance
    return SobolIndices(first, total, variance)


def limited(runs: Runs, seed: int) -> Limited:
    """The indices with intervals by the bootstrap over samples (percentiles), drawn by ``seed``."""
    rng = np.random.default_rng(seed)
    n = len(runs.A)
    drawn = [
        sobol(Runs(runs.A[picked], runs.B[picked], runs.AB[:, picked]))
        for picked in rng.integers(0, n, (_RESAMPLES, n))
    ]
    first, total = (np.array([getattr(one, name) for one in drawn]) for name in ("first", "total"))
    ends = (50.0 - _SHARE / 2.0, 50.0 + _SHARE / 2.0)
    first_ends, total_ends = (np.nanpercentile(some, ends, axis=0) for some in (first, total))
    counts = np.bincount(np.argmax(np.nan_to_num(total), axis=1), minlength=len(runs.AB))
    return Limited(sobol(runs), first_ends, total_ends, counts / _RESAMPLES)
