"""Maximum likelihood for H X P = Z where all samples share errors of the arm and of the camera.

Each shared error is one more unknown with a prior, known by how it moves the hand and the target's image in
each sample. What the samples can tell of it is estimated, what they cannot tell stays in the covariance of X:
a turned last joint is a turned camera, a turned first joint a turned target, and their priors decide.

Beside them each sample has noise of its own: the camera's, by the covariance of its measurement, and the
joints' play, each times one factor that the residuals show (restricted likelihood, with a prior around 1).
"""

from typing import NamedTuple

import numpy as np

from protocol.errors import MeasurementFailed
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.solvers import maximum_likelihood as ml
from vision_pc.core.hand_eye.solvers.maximum_likelihood import Equations
from vision_pc.core.hand_eye.solvers.noise import shown_and_expected
from vision_pc.core.se3 import Array

_STEPS = 30
_ROUNDS = 100
_SETTLED = 1e-4  # of a noise factor's logarithm
_CONVERGED = 1e-10  # squared length of a step in units of standard deviations
_PRIOR_DEGREES = 10.0  # of freedom, that the noise is as said


class Doubts(NamedTuple):
    """What the samples' errors may be; eye in hand.

    ``hand``, ``camera`` (n, 6, k): how one standard deviation of each shared error moves the hand as reported
    (hand's axes) and the target as measured (camera axes). ``play`` (n, 6, j): what moves the hand anew in
    each sample; ``seen`` (n, 6, 6): covariance of the target's measured pose. All as [δp; δθ]. Errors of the
    hand stand in the order of the arm's chain: each one moves what follows it.
    """

    hand: Array
    camera: Array
    play: Array
    seen: Array


class SharedFit(NamedTuple):
    """X, Z (4, 4); ``errors`` (k,) in standard deviations; the poses ``H``, ``P`` (n, 4, 4) without them.

    ``covariance`` (12 + k, 12 + k) of X, Z and the errors; ``by_noise`` (6, 6): of X, were the errors exactly
    as found. ``factors``: of camera noise and of play.
    """

    X: Array
    Z: Array
    errors: Array
    H: Array
    P: Array
    covariance: Array
    by_noise: Array
    factors: tuple[float, float]


def fit(H: Array, P: Array, weights: Array, doubts: Doubts, X: Array, Z: Array) -> SharedFit:
    """The most likely X, Z and shared errors from ``X``, ``Z`` (4, 4), by samples whose weight (n,) is not 0.

    Raises MeasurementFailed (``measurement.hand_eye.singular``) when the samples leave X undetermined.
    """
    used = weights > 0.5
    kept = Doubts(*(part[used] for part in doubts))
    try:
        X, Z, errors, factors, covariance, by_noise = _fit_shared(H[used], P[used], kept, X, Z)
    except np.linalg.LinAlgError as error:
        raise MeasurementFailed(
            "measurement.hand_eye.singular",
            "the samples leave X undetermined: information matrix is singular",
        ) from error
    true_H, true_P, _ = _without(H, P, doubts, errors)
    camera, play = (float(value) for value in factors)
    return SharedFit(X, Z, errors, true_H, true_P, covariance, by_noise, (camera, play))


def _fit_shared(
    H: Array, P: Array, doubts: Doubts, X: Array, Z: Array
) -> tuple[Array, Array, Array, Array, Array, Array]:
    k = doubts.hand.shape[-1]
    errors: Array = np.zeros(k)
    factors: Array = np.ones(2)
    prior = np.diag(np.concatenate([np.zeros(12), np.ones(k)]))
    for _ in range(_STEPS):
        linear = _linearised(H, P, doubts, X, Z, errors)
        factors = _factors(linear, factors, prior)
        slope, residual = _white(linear, factors)
        information = slope.T @ slope + prior
        gradient = slope.T @ residual + np.concatenate([np.zeros(12), errors])
        step = np.linalg.solve(information, gradient)
        X, Z = ml.moved(X, Z, -step[:12])
        errors = errors - step[12:]
        if float(step @ information @ step) < _CONVERGED:
            break
    by_noise = np.asarray(np.linalg.inv((slope.T @ slope)[:12, :12]))[:6, :6]
    return X, Z, errors, factors, np.asarray(np.linalg.inv(information)), by_noise


def _without(H: Array, P: Array, doubts: Doubts, errors: Array) -> tuple[Array, Array, Array]:
    """The poses (n, 4, 4) with shared ``errors`` taken off, and how each moves the hand there (n, 6, k)."""
    moved, slope = _along_the_chain(doubts.hand, errors)
    seen = doubts.camera @ errors
    true_P = stacks.transform(stacks.exp_so3(-seen[:, 3:]) @ P[:, :3, :3], P[:, :3, 3] - seen[:, :3])
    return H @ moved, true_P, slope


def _along_the_chain(hand: Array, errors: Array) -> tuple[Array, Array]:
    """The hand's motion (n, 4, 4) by all ``errors`` one after the other, and its slope by each (n, 6, k).

    The product of screws, not the screw of the sum: so a turned first joint remains exactly a turned base.
    """
    moved, slope = np.tile(np.eye(4), (len(hand), 1, 1)), np.zeros_like(hand)
    for k in reversed(range(len(errors))):
        v, w = hand[:, :3, k], hand[:, 3:, k]
        back = np.swapaxes(moved[:, :3, :3], -1, -2)
        shift = v - (stacks.hat(moved[:, :3, 3]) @ w[..., None])[..., 0]
        slope[:, :3, k], slope[:, 3:, k] = (back @ shift[..., None])[..., 0], (back @ w[..., None])[..., 0]
        moved = _screw(errors[k] * v, errors[k] * w) @ moved
    return moved, slope


def _screw(v: Array, w: Array) -> Array:
    """The motions (n, 4, 4) of small screws, shift ``v`` and turn ``w`` (n, 3)."""
    S = stacks.hat(w)
    shift = v[..., None] + 0.5 * S @ v[..., None] + S @ S @ v[..., None] / 6.0
    return stacks.transform(stacks.exp_so3(w), shift[..., 0])


class _LinearisedErrors(NamedTuple):
    """Residuals (n, 6) and their slope (n, 6, 12 + k) at ``errors`` (k,).

    ``units`` (2, n, 6, 6): covariances of camera noise and of play with their factors 1.
    """

    residuals: Array
    slope: Array
    errors: Array
    units: Array


def _linearised(H: Array, P: Array, doubts: Doubts, X: Array, Z: Array, errors: Array) -> _LinearisedErrors:
    true_H, true_P, by_error = _without(H, P, doubts, errors)
    equations = Equations(true_H, true_P, np.ones(len(H)))
    r = ml.residuals(true_H, true_P, X, Z)
    turn = np.kron(np.eye(2), X[:3, :3].T)  # from the hand's axes to the camera's
    of_hand = ml.robot_levers(equations, X, Z) @ turn
    moved = of_hand @ doubts.play
    units = np.stack([doubts.seen, moved @ np.swapaxes(moved, -1, -2)])
    slope = np.concatenate([ml.jacobian(equations, X, Z, r), of_hand @ by_error - doubts.camera], axis=2)
    return _LinearisedErrors(r, slope, errors, units)


def _white(linear: _LinearisedErrors, factors: Array) -> tuple[Array, Array]:
    """Slope (6 n, 12 + k) and residuals (6 n,) in units of the noise."""
    V = np.tensordot(factors**2, linear.units, axes=1)
    W = np.linalg.inv(np.linalg.cholesky(V))
    white = (W @ linear.residuals[..., None]).reshape(-1)
    return (W @ linear.slope).reshape(len(white), -1), white


def _factors(linear: _LinearisedErrors, factors: Array, prior: Array) -> Array:
    """The two noise factors (2,) that the residuals show, unknowns and shared errors being fitted."""
    # as if no shared error had been taken off yet
    residuals = linear.residuals - linear.slope[..., 12:] @ linear.errors
    for _ in range(_ROUNDS):
        shown, expected = shown_and_expected(residuals, linear.slope, linear.units, factors, prior)
        new = np.sqrt((_PRIOR_DEGREES + factors**2 * shown) / (_PRIOR_DEGREES + expected))
        settled = bool((np.abs(np.log(new / factors)) < _SETTLED).all())
        factors = new
        if settled:
            break
    return factors
