"""Where a drive is expected to end, told before it is looked at: mean, spread, 95 % ellipse, probability.

The error in x and y is Student's t, because the spread is itself estimated from a few drives; with infinite
freedom it is normal.
"""

import math
from functools import cache, lru_cache
from typing import NamedTuple

import numpy as np
from scipy.special import fdtri, gammaincinv, ndtr

from vision_pc.core.se3 import Array

_NODES = 96  # of Gauss-Legendre over ±8 σ: exact to 1e-9
_REACH = 8.0
_SCALES = 64  # equally probable sizes of the spread that stand for Student's t
_ALIKE = 200.0  # freedom from which Student's t is taken for normal


class ExpectedEnd(NamedTuple):
    """The error p_CO − p_CM − [0, 0, b] (3,) m, camera axes, that is expected after a drive.

    ``covariance`` (3, 3) m² about ``mean_m`` (3,); ``freedom`` of Student's t, more than 2, infinite where
    normal. ``inside``: probability that |e_x| and |e_y| end within the tolerance.
    """

    mean_m: Array
    covariance: Array
    freedom: float
    inside: float

    @property
    def std_m(self) -> Array:
        """Standard deviations (3,) along the camera's axes."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def correlation(self) -> float:
        """Of x and y."""
        return float(self.covariance[0, 1] / math.sqrt(self.covariance[0, 0] * self.covariance[1, 1]))

    @property
    def ellipse(self) -> tuple[float, float, float]:
        """Half axes (m, the longer first) of the 95 % ellipse in x and y, and the longer one's angle from x
        towards y (rad).
        """
        squares, axes = np.linalg.eigh(self.covariance[:2, :2])
        minor, major = np.sqrt(ellipse_level(self.freedom) * np.maximum(squares, 0.0)).tolist()
        return major, minor, math.atan2(axes[1, 1], axes[0, 1]) % math.pi


def expected_end(
    mean_m: Array, covariance: Array, tolerance_m: float, freedom: float = math.inf
) -> ExpectedEnd:
    """What is told of a drive whose error has this mean (3,) m and covariance (3, 3) m²."""
    inside = probability_inside(mean_m[:2], covariance[:2, :2], tolerance_m, freedom)
    return ExpectedEnd(mean_m, covariance, freedom, inside)


def ellipse_level(freedom: float, share: float = 0.95) -> float:
    """Squared distance, by the whole covariance, that ``share`` of all ends in x and y stay inside."""
    if freedom > _ALIKE:
        return float(_chi_square(share, 2.0))
    return 2.0 * float(fdtri(2.0, freedom, share)) * (freedom - 2.0) / freedom


def probability_inside(mean: Array, covariance: Array, limit: float, freedom: float = math.inf) -> float:
    """Probability that both of two errors with ``mean`` (2,), ``covariance`` (2, 2) are within ±``limit``."""
    share = float(np.mean([_normal(mean, covariance * size, limit) for size in _sizes(freedom)]))
    return min(share, 1.0)  # the nodes' sum may pass it by a rounding


@lru_cache(maxsize=64)
def _sizes(freedom: float) -> tuple[float, ...]:
    """Equally probable variances, relative to the whole, of the normals that make up Student's t."""
    if freedom > _ALIKE:
        return (1.0,)
    middles = (np.arange(_SCALES) + 0.5) / _SCALES
    return tuple(((freedom - 2.0) / _chi_square(middles, freedom)).tolist())


def _chi_square(share: float | Array, freedom: float) -> Array:
    """The quantile of χ² below which ``share`` lies; importing scipy.stats for it takes half a second."""
    return np.asarray(2.0 * gammaincinv(0.5 * freedom, share))


@cache
def _gauss_legendre() -> tuple[Array, Array]:
    """Nodes (n,) in −1…1 and their weights, which take 10 ms to find."""
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    return nodes, weights


def _normal(mean: Array, covariance: Array, limit: float) -> float:
    """The same of a normal: over x, of how probable y is given x."""
    std = math.sqrt(covariance[0, 0])
    low, high = max(-limit, mean[0] - _REACH * std), min(limit, mean[0] + _REACH * std)
    if low >= high:
        return 0.0
    nodes, weights = _gauss_legendre()
    x = 0.5 * (high + low) + 0.5 * (high - low) * nodes
    density = np.exp(-0.5 * ((x - mean[0]) / std) ** 2) / (std * math.sqrt(2.0 * math.pi))
    slope = covariance[0, 1] / covariance[0, 0]
    left = math.sqrt(max(covariance[1, 1] - slope * covariance[0, 1], 1e-18))
    y = mean[1] + slope * (x - mean[0])
    given = ndtr((limit - y) / left) - ndtr((-limit - y) / left)
    return float(0.5 * (high - low) * (weights * density) @ given)
