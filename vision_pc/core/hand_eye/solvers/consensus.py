"""Which samples agree: graduated non-convexity, and a robust guess of the noise when nobody knows it.

Truncated least squares, min Σ min(r_i², c²), reached by a sequence of problems that begins convex (Yang et
al. 2020, "Graduated non-convexity for robust spatial perception"). The threshold c needs the noise; if it
is not given, the least quantile of residuals over triples of samples gives it (Rousseeuw 1984), with no
random choice of triples.

Each problem begins with a closed form: the rotation of X from a weighted eigenvalue problem over all pairs of
samples, that of Z as a chordal mean, both translations from least squares. It has no local minima.
"""

import itertools
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from protocol.errors import MeasurementFailed
from vision_pc.config.choices import Setup
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.samples import PosePairs
from vision_pc.core.hand_eye.solvers import maximum_likelihood as ml
from vision_pc.core.hand_eye.solvers import noise as noise_model
from vision_pc.core.hand_eye.solvers.maximum_likelihood import Equations, Noise
from vision_pc.core.hand_eye.solvers.motions import Motions, dual_quaternions
from vision_pc.core.se3 import Array, nearest_rotation

LEAST_FOR_OUTLIERS = 5  # samples: with fewer, three that agree by chance outvote the others
_TRIPLES = 300
_BEST = 4
_CONCENTRATIONS = 2
_TURNS = 0.3  # [D] of what all samples turn about a second axis, that those of a hypothesis keep
_MEDIAN_NORM = 1.5382  # median length of a 3-vector of unit normals
_GROWTH = 2.0
_STEPS = 3  # of Gauss-Newton a round: the weights move on before more of them pay
_ROUNDS = 80


_RIDGE = 1e-12


class Parts(NamedTuple):
    """What the samples contribute, ready to be weighted: see ``parts``."""

    H: Array
    P: Array
    rotation_forms: Array  # (n n, 16): 4×4 each, symmetric in the samples, zero on the diagonal
    translation_rows: Array  # (n, 3, 6): [I, -R_Hᵀ] over (t_X, t_Z)
    translation_forms: Array  # (n, 36): 6×6 each, the squares of those rows


def parts(pairs: PosePairs, motions: Motions) -> Parts:
    """The weightable parts of ``pairs``; ``motions`` are those of all pairs of samples."""
    n = len(pairs)
    rows = dual_quaternions(motions).rotation_rows()
    forms = np.zeros((n, n, 4, 4))
    i, j = np.triu_indices(n, k=1)
    forms[i, j] = forms[j, i] = np.swapaxes(rows, -1, -2) @ rows
    R_H_transposed = np.swapaxes(pairs.H[:, :3, :3], -1, -2)
    rows_t = np.concatenate([np.broadcast_to(np.eye(3), (n, 3, 3)), -R_H_transposed], axis=-1)
    squares = np.swapaxes(rows_t, -1, -2) @ rows_t
    return Parts(pairs.H, pairs.P, forms.reshape(n * n, 16), rows_t, squares.reshape(n, 36))


def start_of(p: Parts, weights: Array) -> tuple[Array, Array]:
    """X and Z (..., 4, 4) for sample ``weights`` (..., n); leading dimensions are independent problems."""
    lead = weights.shape[:-1]
    pair_weights = (weights[..., :, None] * weights[..., None, :]).reshape(*lead, -1)
    form = (pair_weights @ p.rotation_forms).reshape(*lead, 4, 4)
    R_X = stacks.rotation_from_quaternion(np.linalg.eigh(form)[1][..., 0])
    turned = p.H[:, :3, :3] @ R_X[..., None, :, :] @ p.P[:, :3, :3]
    R_Z = nearest_rotation(np.sum(weights[..., None, None] * turned, axis=-3))
    rows = p.translation_rows
    right = rows[:, :, 3:] @ p.H[:, :3, 3, None] - R_X[..., None, :, :] @ p.P[:, :3, 3, None]
    normal = (weights @ p.translation_forms).reshape(*lead, 6, 6)
    normal = normal + _RIDGE * weights.sum(axis=-1)[..., None, None] * np.eye(6)
    gathered = np.sum(weights[..., None, None] * (np.swapaxes(rows, -1, -2) @ right), axis=-3)
    t = np.linalg.solve(normal, gathered)[..., 0]
    return stacks.transform(R_X, t[..., :3]), stacks.transform(R_Z, t[..., 3:])


def graduated(p: Parts, setup: Setup, noise: Noise, threshold: float) -> Array:
    """Weights (n,), 1 for the samples whose squared normalised residual stays below ``threshold`` at the
    truncated optimum, 0 for the others.
    """
    n = len(p.H)
    X, Z = _refined(p, setup, noise, np.ones(n), None)
    squares = normalised_squares(p, setup, noise, X, Z)
    worst = float(squares.max())
    if worst <= threshold:
        return np.ones(n)
    mu = threshold / (2.0 * worst - threshold)
    for _ in range(_ROUNDS):
        weights = _truncated_weights(squares, threshold, mu)
        if (weights > 0.5).sum() < 3:  # the surrogate has let go of nearly all: keep the best half
            weights = agreeing(p.H, squares, (n + 4) // 2)
        X, Z = _refined(p, setup, noise, weights, (X, Z))
        squares = normalised_squares(p, setup, noise, X, Z)
        settled = bool(((weights < 1e-9) | (weights > 1.0 - 1e-9)).all())
        if settled and ((squares <= threshold) == (weights > 0.5)).all():
            break
        mu *= _GROWTH
    return (squares <= threshold).astype(float)


def _truncated_weights(squares: Array, threshold: float, mu: float) -> Array:
    """Yang et al. 2020, eq. (14)."""
    middle = np.sqrt(threshold * mu * (mu + 1.0) / np.maximum(squares, 1e-12)) - mu
    upper, lower = (mu + 1.0) / mu * threshold, mu / (mu + 1.0) * threshold
    return np.where(squares >= upper, 0.0, np.where(squares <= lower, 1.0, np.clip(middle, 0.0, 1.0)))


def _refined(
    p: Parts, setup: Setup, noise: Noise, weights: Array, previous: tuple[Array, Array] | None
) -> tuple[Array, Array]:
    """The weighted optimum from the closed-form start, or from the previous estimate if that is better."""
    equations = Equations(p.H, p.P, weights, setup)
    start = start_of(p, weights)
    if previous is not None and ml.cost(equations, *previous, noise) < ml.cost(equations, *start, noise):
        start = previous
    estimate = ml.maximize(equations, *start, noise, steps=_STEPS)
    return estimate.X, estimate.Z


def normalised_squares(p: Parts, setup: Setup, noise: Noise, X: Array, Z: Array) -> Array:
    """Each sample's squared residual in units of the noise (n,): χ² of 6 degrees for a good one."""
    equations = Equations(p.H, p.P, np.ones(len(p.H)), setup)
    white = ml.whitened(ml.whitener(equations, X, Z, noise), ml.residuals(p.H, p.P, X, Z)[..., None])
    return np.asarray(np.sum(white[..., 0] ** 2, axis=-1))


def guessed_noise(p: Parts, setup: Setup) -> Noise:
    """The noise of a good sample as the camera's, although up to almost half of the samples may be bad.

    Raises MeasurementFailed (``measurement.hand_eye.no_solution``) when no three samples determine a pose.
    """
    n = len(p.H)
    majority = (n + 4) // 2
    weights = triple_weights(n)
    X, Z = start_of(p, weights)
    turns, shifts = misfits(p, X, Z)
    score = _quantile(turns, majority) * _quantile(shifts, majority)
    best = [_concentrated(p, setup, X[k], Z[k], majority) for k in np.argsort(score, kind="stable")[:_BEST]]
    turn, shift = min(best, key=lambda sizes: sizes[0] * sizes[1])
    if not math.isfinite(turn * shift):
        raise MeasurementFailed("measurement.hand_eye.no_solution", "no three samples determine the pose")
    small_sample = (1.0 + 5.0 / max(n - 2, 1)) / _MEDIAN_NORM
    return noise_model.starting_noise(turn * small_sample, shift * small_sample)


def second_turn(H: Array) -> float:
    """How far the hands H (n, 4, 4) turn about a second axis, rad a sample: 0 where all axes are parallel.

    Samples without it leave X free along the axis, and fit any such X.
    """
    turns = stacks.log_so3(H[:, :3, :3] @ H[0, :3, :3].T)
    return float(np.linalg.svd(turns, compute_uv=False)[1]) / math.sqrt(len(H))


def turn_like_all(H: Array, some: NDArray[Any]) -> bool:
    """Whether the hands ``H[some]`` turn about a second axis as those of all samples (n, 4, 4) do."""
    return second_turn(H[some]) >= _TURNS * second_turn(H)


def agreeing(H: Array, sizes: Array, count: int) -> Array:
    """Weights (n,), 1 for the ``count`` samples of least ``sizes``, and as many more as turn about two axes:
    where most samples share one orientation, the best alone would not."""
    order = np.argsort(sizes, kind="stable")
    while count < len(order) and not turn_like_all(H, order[:count]):
        count += 1
    weights = np.zeros(len(order))
    weights[order[:count]] = 1.0
    return weights


def triple_weights(n: int) -> Array:
    """Weights (about 300, n) of triples of samples: all, every few, or scattered ones where they are many.

    Scattered by the three-dimensional golden ratio (Roberts' R3 sequence), which needs no random numbers.
    """
    if math.comb(n, 3) <= 10 * _TRIPLES:
        every = list(itertools.combinations(range(n), 3))
        chosen = np.array(every[:: max(1, math.ceil(len(every) / _TRIPLES))])
    else:
        ratio = 1.0 / 1.2207440846057596 ** np.arange(1, 4)
        scattered = (n * np.modf(np.outer(np.arange(1, 2 * _TRIPLES), ratio))[0]).astype(np.intp)
        distinct = np.array([len(set(triple)) == 3 for triple in scattered.tolist()])
        chosen = scattered[distinct][:_TRIPLES]
    weights = np.zeros((len(chosen), n))
    np.put_along_axis(weights, chosen, 1.0, axis=-1)
    return weights


def _concentrated(p: Parts, setup: Setup, X: Array, Z: Array, majority: int) -> tuple[float, float]:
    """The quantiles of turn and shift after refitting to the ``majority`` best samples, a few times."""
    for _ in range(_CONCENTRATIONS):
        turns, shifts = misfits(p, X, Z)
        turn, shift = _quantile(turns, majority), _quantile(shifts, majority)
        noise = Noise(max(float(turn), 1e-9), max(float(shift), 1e-9))
        size = (turns / noise.camera_rotation) ** 2 + (shifts / noise.camera_translation) ** 2
        weights = agreeing(p.H, size, majority)
        X, Z = _refined(p, setup, noise, weights, (X, Z))
    turns, shifts = misfits(p, X, Z)
    return float(_quantile(turns, majority)), float(_quantile(shifts, majority))


def misfits(p: Parts, X: Array, Z: Array) -> tuple[Array, Array]:
    """Rotation (rad, chordal) and translation (m) sizes of the residuals (..., n)."""
    expected = stacks.inverse(X)[..., None, :, :] @ stacks.inverse(p.H) @ Z[..., None, :, :]
    gap = p.P - expected
    chord = np.sqrt(0.5 * np.sum(gap[..., :3, :3] ** 2, axis=(-2, -1)))
    return chord, np.linalg.norm(gap[..., :3, 3], axis=-1)


def _quantile(sizes: Array, majority: int) -> Array:
    return np.asarray(np.sort(sizes, axis=-1)[..., majority - 1])
