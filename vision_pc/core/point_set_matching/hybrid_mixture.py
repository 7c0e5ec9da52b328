"""Fine matching of two pose trajectories by a hybrid mixture model, solved by expectation maximisation.

Positions are Gaussian, directions von Mises-Fisher, outliers uniform (Min, Wang and Meng 2018, as used by
Mäkinen et al. 2023, refs. 30 and 31). Each model point y_m with unit directions v_ma explains a data point
x_n with unit directions n_na by x ≈ R y + t, n ≈ R v. Camera trace and kinematic trace may be associated in
time (then x_n belongs to y_n or is an outlier) or not (then every y_m competes for every x_n).
"""

import math
from typing import NamedTuple

import numpy as np

from protocol.errors import MeasurementFailed
from vision_pc.core.se3 import Array, nearest_rotation

_ITERATIONS = 100
_STOP_RELATIVE = 1e-8
_KAPPA_START, _KAPPA_CAP = 10.0, 1e5
_OUTLIERS_START = 0.1
_OUTLIERS_RANGE = (1e-3, 0.9)
_SIGMA_FLOOR_M = 1e-5


class PoseSet(NamedTuple):
    """Positions (N, 3) in metres and, per point, A unit directions (N, A, 3); A may be 0."""

    positions: Array
    directions: Array


class MixtureMatch(NamedTuple):
    """The match x ≈ R y + t, n ≈ R v, and the mixture it was found with.

    ``sigma_m``: position scatter per axis. ``outlier_share``: w. ``inlier`` (N,): probability that each
    data point is not an outlier.
    """

    R: Array
    t: Array
    sigma_m: float
    outlier_share: float
    inlier: Array
    converged: bool


def positions_only(positions: Array) -> PoseSet:
    """A pose set without directions."""
    return PoseSet(positions, np.zeros((len(positions), 0, 3)))


def full_poses(positions: Array, rotations: Array) -> PoseSet:
    """A pose set whose directions are the three columns of each of ``rotations`` (N, 3, 3)."""
    return PoseSet(positions, np.swapaxes(rotations, 1, 2).copy())


def match_trajectories(data: PoseSet, model: PoseSet, R_start: Array, *, associated: bool) -> MixtureMatch:
    """The hybrid-mixture match of ``data`` (camera) on ``model`` (kinematics), from the coarse R ``R_start``.

    Source: formulas of ``p(n|m)``, E and M step as derived for the hybrid mixture model; responsibilities are
    kept in logarithms. Raises MeasurementFailed for fewer than four points, unequal counts when
    ``associated``, or when the outliers take over (``measurement.match_lost``).
    """
    _check(data, model, associated)
    x, y = data.positions, model.positions
    R = nearest_rotation(R_start)
    t = x.mean(axis=0) - R @ y.mean(axis=0)
    variance = float(_squared_distances(x, y @ R.T + t, associated).mean()) / 3.0
    kappa = _start_concentration(data, model, R)
    share = _OUTLIERS_START
    volume = float(np.linalg.norm(np.ptp(x, axis=0))) ** 3  # a cube: a planar set has no volume of its own
    previous, converged, iterations = -math.inf, False, 0
    while not converged and iterations < _ITERATIONS:
        iterations += 1
        log_p = _log_density(data, model, R, t, variance, kappa, associated)
        p, likelihood = _responsibilities(log_p, share, volume, data.directions.shape[1], len(y), associated)
        if abs(likelihood - previous) < _STOP_RELATIVE * abs(likelihood):
            converged = True
        previous = likelihood
        R, t, variance, kappa, share = _maximise(data, model, p, variance, kappa, associated)
    inlier = p if associated else p.sum(axis=1)
    return MixtureMatch(R, t, math.sqrt(variance), share, inlier, converged)


def _check(data: PoseSet, model: PoseSet, associated: bool) -> None:
    n, m = len(data.positions), len(model.positions)
    if min(n, m) < 4:
        raise MeasurementFailed(
            "measurement.too_few_samples", f"matching: {n} and {m} points, at least 4 are wanted"
        )
    if associated and n != m:
        raise MeasurementFailed(
            "measurement.not_associated", f"matching: {n} against {m} points in time association"
        )


def _start_concentration(data: PoseSet, model: PoseSet, R: Array) -> float:
    """κ to start from: what the mean directions show under ``R``, at most 10: a far start is not lost."""
    axes = data.directions.shape[1]
    if not axes:
        return 0.0
    cosines = (data.directions.mean(axis=0) * (model.directions.mean(axis=0) @ R.T)).sum()
    return min(_concentration(float(cosines) / axes), _KAPPA_START)


def _squared_distances(x: Array, y_moved: Array, associated: bool) -> Array:
    """‖x − (R y + t)‖²: (N,) when associated, else (N, M)."""
    if associated:
        return np.asarray(((x - y_moved) ** 2).sum(axis=-1))
    squares = (x**2).sum(axis=1)[:, None] + (y_moved**2).sum(axis=1)[None, :] - 2.0 * x @ y_moved.T
    return np.asarray(np.maximum(squares, 0.0))


def _log_density(
    data: PoseSet, model: PoseSet, R: Array, t: Array, variance: float, kappa: float, associated: bool
) -> Array:
    """log p(n|m): Gaussian of the position times von Mises-Fisher of each direction; (N,) or (N, M)."""
    squared = _squared_distances(data.positions, model.positions @ R.T + t, associated)
    log_p = -1.5 * math.log(2.0 * math.pi * variance) - squared / (2.0 * variance)
    axes = data.directions.shape[1]
    if axes:
        cosines = _summed_cosines(data.directions, model.directions @ R.T, associated)
        # κ/(2π(e^κ − e^−κ)), safe for large κ
        log_c = math.log(kappa) - math.log(2.0 * math.pi) - kappa - math.log1p(-math.exp(-2.0 * kappa))
        log_p = log_p + axes * log_c + kappa * cosines
    return np.asarray(log_p)


def _summed_cosines(n: Array, v_turned: Array, associated: bool) -> Array:
    """Σ_a n_a · R v_a: (N,) when associated, else (N, M)."""
    if associated:
        return np.asarray((n * v_turned).sum(axis=(1, 2)))
    return n.reshape(len(n), -1) @ v_turned.reshape(len(v_turned), -1).T


def _responsibilities(
    log_p: Array, share: float, volume: float, axes: int, components: int, associated: bool
) -> tuple[Array, float]:
    """E step: p_mn as (N,) or (N, M), and the log-likelihood."""
    log_outlier = math.log(share) - math.log(volume) - axes * math.log(4.0 * math.pi)
    if associated:
        log_joint = math.log1p(-share) + log_p
        log_total = np.logaddexp(log_joint, log_outlier)
        return np.exp(log_joint - log_total), float(log_total.sum())
    log_joint = math.log1p(-share) - math.log(components) + log_p
    top = np.maximum(log_joint.max(axis=1), log_outlier)
    log_total = top + np.log(np.exp(log_joint - top[:, None]).sum(axis=1) + np.exp(log_outlier - top))
    return np.exp(log_joint - log_total[:, None]), float(log_total.sum())


def _maximise(
    data: PoseSet, model: PoseSet, p: Array, variance: float, kappa: float, associated: bool
) -> tuple[Array, Array, float, float, float]:
    """M step: R, t, σ², κ and w from the responsibilities ``p``."""
    x, y, n, v = data.positions, model.positions, data.directions, model.directions
    by_data, by_model = (p, p) if associated else (p.sum(axis=1), p.sum(axis=0))
    total = float(by_data.sum())
    if total < 3.0:
        raise MeasurementFailed(
            "measurement.match_lost", f"matching: only {total:.1f} points are not outliers"
        )
    x_mean, y_mean = by_data @ x / total, by_model @ y / total
    x_weighted = p[:, None] * (x - x_mean) if associated else p.T @ (x - x_mean)
    H = (y - y_mean).T @ x_weighted / variance
    axes = n.shape[1]
    if axes:
        flat = n.reshape(len(n), -1)
        n_weighted = (p[:, None] * flat if associated else p.T @ flat).reshape(v.shape)
        H = H + kappa * np.einsum("mai,maj->ij", v, n_weighted)
    R = nearest_rotation(H.T)
    t = x_mean - R @ y_mean
    squared = _squared_distances(x, y @ R.T + t, associated)
    new_variance = max(float((p * squared).sum()) / (3.0 * total), _SIGMA_FLOOR_M**2)
    if axes:
        cosines = _summed_cosines(n, v @ R.T, associated)
        kappa = _concentration(float((p * cosines).sum()) / (axes * total))
    share = min(max(1.0 - total / len(x), _OUTLIERS_RANGE[0]), _OUTLIERS_RANGE[1])
    return R, t, new_variance, kappa, share


def _concentration(mean_cosine: float) -> float:
    """κ with coth κ − 1/κ = ``mean_cosine``: a rational start and five Newton steps, capped."""
    r = min(max(mean_cosine, 1e-3), 1.0 - 1e-9)
    kappa = r * (3.0 - r * r) / (1.0 - r * r)
    for _ in range(5):
        if kappa > 300.0:  # coth κ = 1 to the last digit
            return min(1.0 / (1.0 - r), _KAPPA_CAP)
        coth = 1.0 / math.tanh(kappa)
        slope = 1.0 - coth * coth + 1.0 / (kappa * kappa)
        kappa = max(kappa - (coth - 1.0 / kappa - r) / slope, 1e-3)
    return min(kappa, _KAPPA_CAP)
