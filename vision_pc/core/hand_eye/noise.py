"""How noisy camera or robot were, from the residuals: restricted maximum likelihood of variance components.

Plain sums of squares would call the noise too small (twelve unknowns were fitted) and could not tell rotation
from translation noise; the restricted likelihood does both (Patterson and Thompson 1971; multiplicative
updates).
"""

from enum import StrEnum

import numpy as np

from vision_pc.core.hand_eye import maximum_likelihood as ml
from vision_pc.core.hand_eye.maximum_likelihood import Equations, Estimate, Noise
from vision_pc.core.se3 import Array

_ROUNDS = 30
_SETTLED = 1e-3
LEAST = Noise(1e-9, 1e-9, 1e-9, 1e-9)  # rad and m: exact synthetic data still need finite weights


class NoiseSource(StrEnum):
    """Whose noise explains the residuals."""

    CAMERA = "camera"
    ROBOT = "robot"


def from_scales(source: NoiseSource, rotation: float, translation: float) -> Noise:
    """The noise of one source alone."""
    rotation = max(float(rotation), LEAST.camera_rotation)
    translation = max(float(translation), LEAST.camera_translation)
    if source is NoiseSource.CAMERA:
        return Noise(rotation, translation)
    return Noise(LEAST.camera_rotation, LEAST.camera_translation, rotation, translation)


def scales(source: NoiseSource, noise: Noise) -> tuple[float, float]:
    """Rotation (rad) and translation (m) standard deviation of that source."""
    if source is NoiseSource.CAMERA:
        return noise.camera_rotation, noise.camera_translation
    return noise.robot_rotation, noise.robot_translation


def estimated(
    equations: Equations, start: Estimate, noise: Noise, source: NoiseSource
) -> tuple[Estimate, Noise]:
    """The maximum-likelihood estimate and the noise of ``source`` that the residuals themselves show.

    ``noise`` is where the search begins; its other source is dropped.
    """
    rotation, translation = scales(source, noise)
    estimate = start
    for _ in range(_ROUNDS):
        noise = from_scales(source, rotation, translation)
        estimate = ml.maximize(equations, estimate.X, estimate.Z, noise, steps=3)
        shown = _shown_over_expected(equations, estimate, noise, source)
        rotation, translation = rotation * shown[1] ** 0.5, translation * shown[0] ** 0.5
        if np.abs(np.log(np.maximum(shown, 1e-30))).max() < _SETTLED or min(rotation, translation) < 1e-9:
            break
    noise = from_scales(source, rotation, translation)
    return ml.maximize(equations, estimate.X, estimate.Z, noise), noise


def _components(equations: Equations, estimate: Estimate, noise: Noise, source: NoiseSource) -> list[Array]:
    """For translation and rotation noise: the share of the residual's covariance it causes (n, 6, 6)."""
    shares = []
    for columns, sigma in ((slice(0, 3), scales(source, noise)[1]), (slice(3, 6), scales(source, noise)[0])):
        if source is NoiseSource.CAMERA:
            root = np.zeros((len(equations.H), 6, 3))
            root[:, columns] = sigma * np.eye(3)
        else:
            root = sigma * ml.robot_levers(equations, estimate.X, estimate.Z)[..., columns]
        shares.append(root @ np.swapaxes(root, -1, -2))
    return shares


def _shown_over_expected(
    equations: Equations, estimate: Estimate, noise: Noise, source: NoiseSource
) -> Array:
    """Squared translation and rotation residuals over their expectation; 1 when the noise is right."""
    W = ml.whitener(equations, estimate.X, estimate.Z, noise)
    J = ml.whitened(W, ml.jacobian(equations, estimate.X, estimate.Z, estimate.residuals))
    r = ml.whitened(W, estimate.residuals[..., None])[..., 0]
    covariance = np.linalg.inv(np.einsum("nij,nik->jk", J, J))
    ratios = []
    for share in _components(equations, estimate, noise, source):
        K = ml.whitened(W, np.swapaxes(ml.whitened(W, share), -1, -2))
        fitted = np.sum(np.einsum("nij,nik->jk", J, K @ J) * covariance)
        expected = np.einsum("nii->", K) - fitted
        ratios.append(float(np.einsum("ni,nij,nj->", r, K, r)) / max(float(expected), 1e-12))
    return np.array(ratios)


def restricted_log_likelihood(equations: Equations, estimate: Estimate, noise: Noise) -> float:
    """How well that noise explains the residuals; compare camera against robot noise on the same samples."""
    V = ml.residual_covariances(equations, estimate.X, estimate.Z, noise)
    log_V = float(np.linalg.slogdet(V)[1].sum())
    return -0.5 * (log_V + float(np.linalg.slogdet(estimate.information)[1]) + estimate.cost)
