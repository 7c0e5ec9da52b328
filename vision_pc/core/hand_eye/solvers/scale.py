"""One scale between the lengths of camera and hand: what camera lengths must be multiplied by to fit.

It is 1 if both sides have the same unit and the target the size that was said. Lengths mistaken (millimetres,
inches, a square measured wrongly) leave rotations alone, so any solver fits them, and puts the rest into X.
"""

import math
from typing import NamedTuple

import numpy as np

from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.solvers import consensus, separable
from vision_pc.core.hand_eye.solvers import maximum_likelihood as ml
from vision_pc.core.hand_eye.solvers.maximum_likelihood import Equations, Noise
from vision_pc.core.hand_eye.solvers.separable import Parts
from vision_pc.core.se3 import Array

_BEST = 4  # triples to go on from
_CONCENTRATIONS = 6
_RIDGE = 1e-12
_STEPS = 6
_LARGEST_STEP = 0.5  # of the scale's reciprocal


class Scale(NamedTuple):
    """The factor on camera lengths and its standard deviation; ``std`` is infinite where nothing tells it."""

    factor: float
    std: float


def rough(p: Parts) -> float:
    """The scale of the samples that agree best, whatever it is; not above 0 where no scale makes sense.

    λ R_X t_P + t_X − R_Hᵀ t_Z = −R_Hᵀ t_H is linear in (t_X, t_Z, λ) once R_X is known. All may be spoiled
    by a few bad samples, so it begins with triples and goes on with the better half of the samples.
    """
    n = len(p.H)
    wanted = (n + 4) // 2
    factors, misfits = _fitted(p, consensus.triple_weights(n))
    score = np.sort(misfits, axis=-1)[..., wanted - 1]
    found = []
    for k in np.argsort(score, kind="stable")[:_BEST]:
        factor, misfit = factors[k], misfits[k]
        for _ in range(_CONCENTRATIONS):
            kept = np.zeros(n)
            kept[np.argsort(misfit, kind="stable")[:wanted]] = 1.0
            factor, misfit = _fitted(p, kept)
        found.append((float(np.sort(misfit)[wanted - 1]), float(factor)))
    return min(found)[1]


def _fitted(p: Parts, weights: Array) -> tuple[Array, Array]:
    """The scale (...) for sample ``weights`` (..., n), and each sample's misfit (..., n) in rad m."""
    X, Z = separable.solve(p, weights)
    R_X = X[..., :3, :3]
    shifted = R_X[..., None, :, :] @ p.P[:, :3, 3, None]
    rows = np.concatenate([np.broadcast_to(p.translation_rows, (*shifted.shape[:-1], 6)), shifted], axis=-1)
    right = p.translation_rows[:, :, 3:] @ p.H[:, :3, 3, None]
    squares = np.swapaxes(rows, -1, -2) @ rows
    normal = np.sum(weights[..., None, None] * squares, axis=-3)
    ridge = _RIDGE * np.trace(normal, axis1=-2, axis2=-1)[..., None, None] * np.eye(7)
    gathered = np.sum(weights[..., None, None] * (np.swapaxes(rows, -1, -2) @ right), axis=-3)
    unknown = np.linalg.solve(normal + ridge, gathered)
    shifts = np.linalg.norm((right - rows @ unknown[..., None, :, :])[..., 0], axis=-1)
    turns, _ = consensus.misfits(p, X, Z)
    return unknown[..., 6, 0], turns * shifts


def refined(equations: Equations, X: Array, Z: Array, noise: Noise) -> tuple[Scale, float]:
    """The most likely scale, X and Z as further unknowns, and the rms shift (m, a component) that it leaves.

    The residual is t_P − t_predicted/λ: the camera measures, so its noise does not draw λ towards 0.
    """
    reciprocal, shift = 1.0, noise.camera_translation
    for _ in range(_STEPS):
        P = stacks.transform(equations.P[:, :3, :3], equations.P[:, :3, 3] / reciprocal)
        scaled = equations._replace(P=P)
        r = ml.residuals(scaled.H, P, X, Z)
        by_scale = np.zeros((len(r), 6, 1))
        by_scale[:, :3, 0] = -ml.predicted(scaled.H, X, Z)[:, :3, 3]
        shift = float(np.sqrt(np.mean(r[:, :3] ** 2)))
        W = ml.whitener(scaled, X, Z, noise)
        slope = np.concatenate([ml.jacobian(scaled, X, Z, r), by_scale], axis=-1)
        J = ml.whitened(W, slope).reshape(-1, slope.shape[-1])
        information = J.T @ J
        try:
            covariance = np.linalg.inv(information)
        except np.linalg.LinAlgError:
            return Scale(1.0, math.inf), shift
        step = covariance @ (J.T @ ml.whitened(W, r[..., None]).reshape(-1))
        X, Z = ml.moved(X, Z, -step[:-1], scaled.tied)
        reciprocal *= 1.0 - float(np.clip(step[-1], -_LARGEST_STEP, _LARGEST_STEP))
        if step @ information @ step < 1e-12:
            break
    return Scale(1.0 / reciprocal, float(np.sqrt(covariance[-1, -1])) / reciprocal), shift
