"""Odometry measured with the look's own ruler: the object's markers, seen while the legs are driven.

What a drive must do is told in the look's lengths, what it did in odometry's. Two lenses that differ, a
baseline or an offset that is off make the two disagree, by up to a hundredth in one direction and not in
another. The object stands still: a camera that moved by t sees it at o − (I + E) t, in axes that do not turn,
and E is found by least squares. Common errors of lens, baseline and prints drop out: the look has them too.
How large E may be is learnt from E itself (empirical Bayes), so that noise alone changes nothing.
"""

from typing import NamedTuple

import numpy as np

from vision_pc.config.programs import RulerSettings
from vision_pc.core.se3 import Array

_ROUNDS = 5  # of reweighting
_HUBER = 2.0
_LEAST_M = 0.1  # how far the legs must lead away while the object is seen
_LEAST_SAMPLES = 12
_MAD = 1.4826


class Ruler(NamedTuple):
    """(I + ``E``) times odometry's displacement, in camera axes, is the look's; ``covariances`` (3, 3, 3) of
    the rows of E. ``carried``: share of E that may be otherwise elsewhere on the way.
    """

    E: Array
    covariances: Array
    carried: float

    def measured(self, X_KC: Array) -> Array:
        """Poses (n, 4, 4) by odometry with their positions in the look's lengths."""
        corrected = X_KC.copy()
        corrected[:, :3, 3] += X_KC[:, :3, 3] @ self.E.T
        return corrected

    def covariance(self, d: Array) -> Array:
        """Covariance (3, 3) m² of a displacement ``d`` (3,) in camera axes that was so measured."""
        found = np.diag([float(d @ row @ d) for row in self.covariances])
        elsewhere = self.carried * self.E @ d
        return np.asarray(found + np.outer(elsewhere, elsewhere))


SHARED = Ruler(np.zeros((3, 3)), np.zeros((3, 3, 3)), 0.0)
"""Of odometry that sees with the look's own camera, its errors found: their lengths are alike."""


def fitted_ruler(X_KC: Array, p_CO: Array, settings: RulerSettings) -> Ruler | None:
    """The ruler from poses (n, 4, 4) by odometry and where the camera saw the object there, (n, 3), NaN where
    it did not. None where it was seen too seldom, or in too small a space, to tell.
    """
    seen = np.isfinite(p_CO).all(axis=1)
    t, R = X_KC[seen, :3, 3], X_KC[seen, :3, :3]
    if np.count_nonzero(seen) < _LEAST_SAMPLES or np.ptp(t, axis=0).max() < _LEAST_M:
        return None
    o = t + np.einsum("nij,nj->ni", R, p_CO[seen])  # by odometry the object would wander by −E t
    design = np.column_stack([-(t - t.mean(axis=0)), np.ones(len(t))])
    rows, precisions = np.empty((3, 3)), np.empty((3, 3, 3))
    for axis in range(3):
        rows[axis], precisions[axis] = _row(design, o[:, axis], settings)
    strength = float(np.einsum("ai,aij,aj->", rows, precisions, rows))
    spread2 = max(settings.spread**2, (strength - 9.0) / float(np.trace(precisions.sum(axis=0))))
    covariances = np.asarray(np.linalg.inv(precisions + np.eye(3) / spread2), dtype=np.float64)
    E = np.einsum("aij,ajk,ak->ai", covariances, precisions, rows)
    return Ruler(E, covariances, settings.carried)


def _row(design: Array, values: Array, settings: RulerSettings) -> tuple[Array, Array]:
    """One row of E (3,) and its precision (3, 3), without a prior; pictures follow one another, so that all
    together are worth ``independent`` ones.
    """
    weights = np.ones(len(values))
    ridge = np.diag([1e-6, 1e-6, 1e-6, 0.0])
    for _ in range(_ROUNDS):
        normal = design.T @ (design * weights[:, None]) + ridge
        theta = np.linalg.solve(normal, design.T @ (weights * values))
        misfit = values - design @ theta
        std = max(_MAD * float(np.median(np.abs(misfit))), settings.noise_m)
        weights = 1.0 / np.maximum(1.0, np.abs(misfit) / (_HUBER * std))
    worth = min(1.0, settings.independent / len(values)) / std**2
    whole = normal * worth
    rest = whole[:3, :3] - np.outer(whole[:3, 3], whole[3, :3]) / whole[3, 3]
    return np.asarray(theta[:3], dtype=np.float64), np.asarray(rest, dtype=np.float64)
