"""How noisy camera and robot were, from the residuals: restricted maximum likelihood of variance components.

Plain sums of squares would call the noise too small (twelve unknowns were fitted) and could not tell rotation
from translation noise; the restricted likelihood (Patterson and Thompson 1971) does both.
It also tells camera from robot noise: a hand that is turned wrongly moves the target by the lever arm.
Taking both as unknown costs nothing measurable when only one is noisy; assuming the wrong one doubles
the errors.
"""

from enum import StrEnum

import numpy as np

from vision_pc.core.hand_eye import maximum_likelihood as ml
from vision_pc.core.hand_eye.maximum_likelihood import Equations, Estimate, Noise
from vision_pc.core.se3 import Array

_ROUNDS = 40
_FOR_RATIO = 6  # samples: with fewer the unknowns can fit all translations and call their noise zero
_FOR_SOURCE = 8  # samples: with fewer camera and robot noise cannot be told apart
_SETTLED = 1e-3
_NEGLIGIBLE = 1e-3  # of the residuals' total: a component below it is done
USUAL_RATIO = (1.7e-3, 1e-3)  # 0.1 degrees to 1 mm
_LEAST = 1e-9  # rad and m: exact synthetic data still need finite weights


class NoiseSource(StrEnum):
    """Whose noise the residuals show."""

    CAMERA = "camera"
    ROBOT = "robot"
    BOTH = "both"


_FIELDS = {
    NoiseSource.CAMERA: ("camera_rotation", "camera_translation"),
    NoiseSource.ROBOT: ("robot_rotation", "robot_translation"),
    NoiseSource.BOTH: Noise._fields,
}


def beginning(source: NoiseSource, rotation: float, translation: float) -> Noise:
    """Noise of that size (rad, m) from which to search; of both, when the source is both."""
    rotation, translation = max(float(rotation), _LEAST), max(float(translation), _LEAST)
    if source is NoiseSource.BOTH:
        share = 0.5**0.5
        return Noise(share * rotation, share * translation, share * rotation, share * translation)
    if source is NoiseSource.ROBOT:
        return Noise(_LEAST, _LEAST, rotation, translation)
    return Noise(rotation, translation)


def estimated(
    equations: Equations, start: Estimate, noise: Noise, source: NoiseSource
) -> tuple[Estimate, Noise]:
    """The maximum-likelihood estimate and the noise of ``source`` that the residuals themselves show.

    ``noise`` gives the size from which to search. Under 8 samples all of it is taken as the
    camera's, and under 6 the ratio of rotation to translation is kept.
    """
    samples = int((equations.weights > 0.5).sum())
    if source is NoiseSource.BOTH and (equations.tied or samples < _FOR_SOURCE):
        source = NoiseSource.CAMERA
    if samples < _FOR_RATIO:
        noise = beginning(source, *USUAL_RATIO)
    size = float(np.hypot(noise.camera_rotation, noise.robot_rotation))
    shift = float(np.hypot(noise.camera_translation, noise.robot_translation))
    noise = beginning(source, size, shift)
    estimate = start
    for _ in range(_ROUNDS):
        estimate = ml.maximize(equations, estimate.X, estimate.Z, noise, steps=2)
        shown, share = _shown_over_expected(equations, estimate, noise, _FIELDS[source])
        if samples < _FOR_RATIO:
            shown = np.full(len(shown), float(shown @ share))
        noise = noise._replace(
            **{
                name: max(float(getattr(noise, name) * np.sqrt(ratio)), _LEAST)
                for name, ratio in zip(_FIELDS[source], shown, strict=True)
            }
        )
        open_still = (share > _NEGLIGIBLE) & (np.abs(np.log(np.maximum(shown, 1e-30))) > _SETTLED)
        if not open_still.any():
            break
    return ml.maximize(equations, estimate.X, estimate.Z, noise), noise


def _shown_over_expected(
    equations: Equations, estimate: Estimate, noise: Noise, fields: tuple[str, ...]
) -> tuple[Array, Array]:
    """For each field: squared residuals over their expectation, and its share of the total expectation.

    The first is 1 when the noise is right. A share is 0 for a component that has shrunk to nothing.
    """
    W = ml.whitener(equations, estimate.X, estimate.Z, noise)
    J = ml.whitened(W, ml.jacobian(equations, estimate.X, estimate.Z, estimate.residuals))
    r = ml.whitened(W, estimate.residuals[..., None])[..., 0]
    covariance = np.linalg.inv(np.einsum("nij,nik->jk", J, J))
    ratios, expectations = [], []
    for name in fields:
        part = Noise(0.0, 0.0)._replace(**{name: getattr(noise, name)})
        V = ml.residual_covariances(equations, estimate.X, estimate.Z, part)
        K = ml.whitened(W, np.swapaxes(ml.whitened(W, V), -1, -2))
        fitted = np.sum(np.einsum("nij,nik->jk", J, K @ J) * covariance)
        expected = max(float(np.einsum("nii->", K) - fitted), 1e-12)
        ratios.append(float(np.einsum("ni,nij,nj->", r, K, r)) / expected)
        expectations.append(0.0 if getattr(noise, name) <= _LEAST else expected)
    return np.array(ratios), np.array(expectations) / max(sum(expectations), 1e-12)


def few_sample_factor(samples: int) -> float:
    """What a covariance must be multiplied by because the noise was itself estimated from few samples.

    ν/(ν − 2) of Student's distribution, ν = 3 n − 6 for each component, 6 n − 12 for both together.
    """
    degrees = (6.0 * samples - 12.0) if samples < _FOR_RATIO else (3.0 * samples - 6.0)
    return degrees / (degrees - 2.0)
