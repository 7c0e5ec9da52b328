"""How noisy camera and robot were, from the residuals: restricted maximum likelihood of variance components.

Plain sums of squares would call the noise too small (twelve unknowns were fitted) and could not tell rotation
from translation noise; the restricted likelihood (Patterson and Thompson 1971) does both.
It also tells camera from robot noise: a hand that is turned wrongly moves the target by the lever arm.
Taking both as unknown costs nothing measurable when only one is noisy; assuming the wrong one doubles
the errors.
"""

import math
from typing import NamedTuple

import numpy as np

from vision_pc.core.hand_eye.solvers import maximum_likelihood as ml
from vision_pc.core.hand_eye.solvers.maximum_likelihood import Equations, Estimate, Noise
from vision_pc.core.se3 import Array

_ROUNDS = 40
_LINEARISATIONS = 2
_STEPS = 4  # of Gauss-Newton before each
_FOR_RATIO = 5  # samples: with fewer the unknowns can fit all translations and call their noise zero
_FOR_SOURCE = 8  # samples: with fewer only the prior tells camera from robot noise
_SETTLED = 1e-3
_NEGLIGIBLE = 1e-3  # of the residuals' total: a component below it is done
_RATIO_STD = math.log(30.0) / 2.0  # of log(camera over robot noise): within a factor of 30 for 95 %
USUAL_RATIO = (1.7e-3, 1e-3)  # 0.1 degrees to 1 mm
_LEAST = 1e-9  # rad and m: exact synthetic data still need finite weights


def starting_noise(rotation: float, translation: float, both: bool = False) -> Noise:
    """Noise of that size (rad, m) from which to search: the camera's, or of camera and robot alike."""
    rotation, translation = max(float(rotation), _LEAST), max(float(translation), _LEAST)
    if not both:
        return Noise(rotation, translation)
    share = 0.5**0.5
    return Noise(share * rotation, share * translation, share * rotation, share * translation)


def estimated(equations: Equations, X: Array, Z: Array, noise: Noise) -> tuple[Estimate, Noise]:
    """The maximum-likelihood estimate from X, Z (4, 4), and the noise of camera and robot that its residuals
    show.

    ``noise`` gives the size from which to search. Under 5 samples all of it is taken as the camera's, and the
    ratio of rotation to translation is kept.
    """
    samples = int((equations.weights > 0.5).sum())
    both = samples >= _FOR_RATIO
    size, shift = USUAL_RATIO
    if samples >= _FOR_RATIO:
        size = float(np.hypot(noise.camera_rotation, noise.robot_rotation))
        shift = float(np.hypot(noise.camera_translation, noise.robot_translation))
    noise, fields = starting_noise(size, shift, both), Noise._fields if both else Noise._fields[:2]
    for _ in range(_LINEARISATIONS):
        estimate = ml.maximize(equations, X, Z, noise, steps=_STEPS)
        X, Z = estimate.X, estimate.Z
        noise = _noise_explaining(_linearised(equations, estimate, fields), noise, samples < _FOR_RATIO)
    return ml.maximize(equations, X, Z, noise), noise


class _LinearisedNoise(NamedTuple):
    """The samples that count, linear about an estimate: residuals (n, 6), their slope (n, 6, k), and the

    covariances (c, n, 6, 6) that unit variances of ``fields`` give them. The estimate's own motion is a
    linear regression here, which costs next to nothing beside exponentials and logarithms.
    """

    residuals: Array
    slope: Array
    units: Array
    fields: tuple[str, ...]


def _linearised(equations: Equations, estimate: Estimate, fields: tuple[str, ...]) -> _LinearisedNoise:
    used = equations.weights > 0.5
    kept = equations._replace(H=equations.H[used], P=equations.P[used], weights=equations.weights[used])
    r = estimate.residuals[used]
    nothing = Noise(0.0, 0.0)
    units = [
        ml.residual_covariances(kept, estimate.X, estimate.Z, nothing._replace(**{name: 1.0}))
        for name in fields
    ]
    return _LinearisedNoise(r, ml.jacobian(kept, estimate.X, estimate.Z, r), np.stack(units), fields)


def _noise_explaining(linear: _LinearisedNoise, noise: Noise, keep_ratio: bool) -> Noise:
    """The noise whose every component explains the residuals: each is scaled by what they show of it."""
    sizes = np.array([getattr(noise, name) for name in linear.fields])
    for _ in range(_ROUNDS):
        squares, expected = shown_and_expected(linear.residuals, linear.slope, linear.units, sizes)
        living = np.where(sizes <= _LEAST, 0.0, expected)
        share = living / max(float(living.sum()), 1e-12)
        if keep_ratio:
            shown = np.full(len(sizes), float((squares / expected) @ share))
        else:
            shown = _with_prior(squares, expected, sizes)
        sizes = np.maximum(sizes * np.sqrt(shown), _LEAST)
        counts = (share > _NEGLIGIBLE) if len(sizes) < len(Noise._fields) else (sizes > _LEAST)
        if not (counts & (np.abs(np.log(np.maximum(shown, 1e-30))) > _SETTLED)).any():
            break
    return noise._replace(**dict(zip(linear.fields, sizes.tolist(), strict=True)))


def _with_prior(squares: Array, expected: Array, sizes: Array) -> Array:
    """What each component is to be multiplied by (its square): squares over expectation, with the prior.

    Where both sides are unknown, the logarithm of camera over robot noise is normal around 0: its slope
    counts as squares for the smaller side and as expectation for the larger one. Without it the restricted
    likelihood, which is nearly flat along that ratio, often lets one side vanish.
    """
    if len(sizes) < len(Noise._fields):
        return np.asarray(squares / expected)
    camera_over_robot = np.log(sizes[:2] / sizes[2:]) / _RATIO_STD**2
    slope = np.concatenate([-camera_over_robot, camera_over_robot])
    damping = 1.0 / _RATIO_STD**2
    return np.asarray(
        (squares + np.maximum(slope, 0.0) + damping) / (expected + np.maximum(-slope, 0.0) + damping)
    )


def shown_and_expected(
    residuals: Array, slope: Array, units: Array, sizes: Array, prior: Array | float = 0.0
) -> tuple[Array, Array]:
    """For each of c components of noise the squared residuals that it is to explain, and how much that should
    be: they are equal when its ``sizes`` (c,) are right.

    ``residuals`` (n, 6) with their ``slope`` (n, 6, k) by what is fitted to them, of which the information
    ``prior`` (k, k) was there before; ``units`` (c, n, 6, 6): covariances of components of size 1.
    """
    parts = sizes[:, None, None, None] ** 2 * units
    W = np.linalg.inv(np.linalg.cholesky(parts.sum(axis=0)))
    K = W @ parts @ np.swapaxes(W, -1, -2)
    J = (W @ slope).reshape(-1, slope.shape[-1])
    r = (W @ residuals[..., None]).reshape(-1)
    covariance = ml.covariance(J.T @ J + prior)
    r = r - J @ (covariance @ (J.T @ r))

    def across(columns: Array) -> Array:
        """columnsᵀ K columns for each component, (c, k, k)."""
        turned = K @ columns.reshape(*K.shape[1:3], -1)
        return np.asarray(columns.T @ turned.reshape(len(K), len(columns), -1))

    fitted = np.sum(across(J) * covariance, axis=(-2, -1))
    expected = np.maximum(np.trace(K, axis1=-2, axis2=-1).sum(axis=-1) - fitted, 1e-12)
    return across(r[:, None])[:, 0, 0], expected


def few_sample_notes(samples: int) -> list[str]:
    """What to say of noise that few samples cannot split into camera and robot; nothing from 8 on."""
    if samples < _FOR_RATIO:
        return [
            f"{samples} samples are too few to tell camera from robot noise: all is taken as the camera's"
        ]
    hardly = f"{samples} samples hardly tell camera from robot noise: their split is mostly the prior's"
    return [hardly] if samples < _FOR_SOURCE else []


def few_sample_factor(samples: int) -> float:
    """What a covariance must be multiplied by because the noise was itself estimated from few samples.

    ν/(ν − 2) of Student's distribution, ν = 3 n − 6 for each component, 6 n − 12 for both together.
    """
    degrees = (6.0 * samples - 12.0) if samples < _FOR_RATIO else (3.0 * samples - 6.0)
    return degrees / (degrees - 2.0)
