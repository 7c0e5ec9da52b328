"""Maximum likelihood for H X P = Z on SE(3), with the residual where the measurement is made: in the camera.

The camera's measurement P is compared with its prediction X⁻¹ H⁻¹ Z, both parts in camera axes.
As the mismatch of H X P against Z in the base instead, the lever arms mix rotation noise into translation,
and the result is five times worse (docs/hand_eye.md).

Perturbations are those of ``se3.retract``: [δp; δθ] in the outer frame's axes, here X first, then Z.
"""

from typing import NamedTuple

import numpy as np

from protocol.errors import MeasurementFailed
from vision_pc.config.choices import Setup
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.se3 import Array

_STEPS = 60
_CONVERGED = 1e-20  # squared length of a step in units of standard deviations


class Noise(NamedTuple):
    """Standard deviations a component, rad and m: of the target in the camera, of the hand in the base."""

    camera_rotation: float
    camera_translation: float
    robot_rotation: float = 0.0
    robot_translation: float = 0.0


class Equations(NamedTuple):
    """H X P = Z over the samples: ``H``, ``P`` (n, 4, 4), ``weights`` (n,).

    ``setup`` says where the hand is, from which the lever arm of robot noise is counted.
    """

    H: Array
    P: Array
    weights: Array
    setup: Setup = Setup.EYE_IN_HAND


class Estimate(NamedTuple):
    """The most likely X and Z (4, 4), the information matrix of their perturbation (12, 12),

    camera-frame residuals (n, 6) as [translation; rotation], and the weighted sum of squares ``cost``.
    """

    X: Array
    Z: Array
    information: Array
    residuals: Array
    cost: float


def predicted(H: Array, X: Array, Z: Array) -> Array:
    """The target in the camera, X⁻¹ H⁻¹ Z (n, 4, 4)."""
    return stacks.inverse(X) @ stacks.inverse(H) @ Z


def residuals(H: Array, P: Array, X: Array, Z: Array) -> Array:
    """Measured minus predicted target poses in camera axes (n, 6): translation, then rotation vector."""
    expected = predicted(H, X, Z)
    turned = P[:, :3, :3] @ np.swapaxes(expected[:, :3, :3], -1, -2)
    return np.concatenate([P[:, :3, 3] - expected[:, :3, 3], stacks.log_so3(turned)], axis=-1)


def jacobian(equations: Equations, X: Array, Z: Array, r: Array) -> Array:
    """The derivative (n, 6, 12) of ``residuals`` by [δp_X, δθ_X, δp_Z, δθ_Z]."""
    n = len(equations.H)
    R_X_transposed = X[:3, :3].T
    R_H_transposed = np.swapaxes(equations.H[:, :3, :3], -1, -2)
    to_camera = R_X_transposed @ R_H_transposed
    lever = (R_H_transposed @ (Z[:3, 3] - equations.H[:, :3, 3])[..., None])[..., 0] - X[:3, 3]
    bend = stacks.hat(r[:, 3:])
    log_slope = np.eye(3) + 0.5 * bend + (bend @ bend) / 12.0
    J = np.zeros((n, 6, 12))
    J[:, :3, 0:3] = R_X_transposed
    J[:, :3, 3:6] = -R_X_transposed @ stacks.hat(lever)
    J[:, 3:, 3:6] = log_slope @ R_X_transposed
    J[:, :3, 6:9] = -to_camera
    J[:, 3:, 9:12] = -log_slope @ to_camera
    return J


def robot_levers(equations: Equations, X: Array, Z: Array) -> Array:
    """How the hand's own [δp; δθ], in camera axes, shows in the residual: (n, 6, 6), up to sign."""
    to_camera = X[:3, :3].T @ np.swapaxes(equations.H[:, :3, :3], -1, -2)
    hand = equations.H[:, :3, 3] if equations.setup is Setup.EYE_IN_HAND else np.zeros((len(equations.H), 3))
    lever = (to_camera @ (Z[:3, 3] - hand)[..., None])[..., 0]
    L = np.tile(np.eye(6), (len(lever), 1, 1))
    L[:, :3, 3:] = -stacks.hat(lever)
    return L


def residual_covariances(equations: Equations, X: Array, Z: Array, noise: Noise) -> Array:
    """The covariance of each sample's residual (n, 6, 6) from camera and robot noise."""
    V = np.zeros((len(equations.H), 6, 6))
    V[:] = np.diag([noise.camera_translation**2] * 3 + [noise.camera_rotation**2] * 3)
    if noise.robot_rotation > 0.0 or noise.robot_translation > 0.0:
        L = robot_levers(equations, X, Z)
        scale = np.array([noise.robot_translation**2] * 3 + [noise.robot_rotation**2] * 3)
        V += (L * scale) @ np.swapaxes(L, -1, -2)
    return V


def whitener(equations: Equations, X: Array, Z: Array, noise: Noise) -> Array:
    """Matrices (n, 6, 6) that turn each residual into independent ones of unit variance, times √weight.

    For camera noise alone they are diagonal and come as that diagonal, (n, 6, 1).
    """
    root = np.sqrt(equations.weights)[:, None, None]
    if noise.robot_rotation == 0.0 and noise.robot_translation == 0.0:
        scale = np.array([1.0 / noise.camera_translation] * 3 + [1.0 / noise.camera_rotation] * 3)
        return np.asarray(root * scale[:, None])
    return np.asarray(root * np.linalg.inv(np.linalg.cholesky(residual_covariances(equations, X, Z, noise))))


def whitened(W: Array, J: Array) -> Array:
    """``W`` of ``whitener`` applied to ``J`` (n, 6, k)."""
    return W * J if W.shape[-1] == 1 else W @ J


def maximize(equations: Equations, X: Array, Z: Array, noise: Noise, steps: int = _STEPS) -> Estimate:
    """The local maximum of the likelihood that Gauss-Newton with Levenberg damping reaches from X, Z (4, 4).

    Raises MeasurementFailed (``measurement.hand_eye.singular``) when the information matrix has no inverse.
    """
    r, J, cost = _linearised(equations, X, Z, noise)
    damping = 0.0
    for _ in range(steps):
        information, gradient = J.T @ J, J.T @ r
        step = _solved(information, gradient[:, None], damping)[:, 0]
        candidate_X, candidate_Z = moved(X, Z, -step)
        new_r, new_J, new_cost = _linearised(equations, candidate_X, candidate_Z, noise)
        length = float(step @ information @ step)
        if new_cost <= cost * (1.0 + 1e-12):
            X, Z, r, J, cost = candidate_X, candidate_Z, new_r, new_J, new_cost
            damping = 0.0 if damping < 1e-6 else damping / 10.0
        elif length > 1e-9:
            damping = max(10.0 * damping, 1e-4)
            continue
        if length < _CONVERGED * max(1.0, cost) or (length <= 1e-9 and damping > 0.0):
            break
    return Estimate(X, Z, J.T @ J, residuals(equations.H, equations.P, X, Z), cost)


def covariance_of_X(estimate: Estimate) -> Array:
    """The covariance (6, 6) of X's perturbation [δp; δθ] in hand axes, m² and rad², with Z unknown.

    Raises MeasurementFailed as ``covariance`` does.
    """
    return covariance(estimate.information)[:6, :6]


def covariance(information: Array) -> Array:
    """The inverse of ``information`` (k, k).

    Raises MeasurementFailed (``measurement.hand_eye.singular``) when it has none.
    """
    return _solved(information, np.eye(len(information)))


def _linearised(equations: Equations, X: Array, Z: Array, noise: Noise) -> tuple[Array, Array, float]:
    r = residuals(equations.H, equations.P, X, Z)
    J = jacobian(equations, X, Z, r)
    W = whitener(equations, X, Z, noise)
    white_r = whitened(W, r[..., None]).reshape(-1)
    return white_r, whitened(W, J).reshape(-1, J.shape[-1]), float(white_r @ white_r)


def cost(equations: Equations, X: Array, Z: Array, noise: Noise) -> float:
    """The weighted sum of squared normalised residuals."""
    r = residuals(equations.H, equations.P, X, Z)
    white = whitened(whitener(equations, X, Z, noise), r[..., None])
    return float(np.sum(white * white))


def _solved(information: Array, right: Array, damping: float = 0.0) -> Array:
    """The columns (k, m) that ``information`` (k, k), its scaled diagonal damped, maps to ``right``."""
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    scaled = information / np.outer(scale, scale) + damping * np.eye(len(scale))
    try:
        return np.asarray(np.linalg.solve(scaled, right / scale[:, None]) / scale[:, None])
    except np.linalg.LinAlgError as error:
        raise MeasurementFailed(
            "measurement.hand_eye.singular",
            "the samples leave X undetermined: information matrix is singular",
        ) from error


def moved(X: Array, Z: Array, step: Array) -> tuple[Array, Array]:
    """X and Z moved by ``step`` (12,)."""
    return _retracted(X, step[:6]), _retracted(Z, step[6:])


def _retracted(X: Array, delta: Array) -> Array:
    return stacks.transform(stacks.exp_so3(delta[3:]) @ X[:3, :3], X[:3, 3] + delta[:3])
