"""Simulated hand-eye scenes with known truth: where the poses stand, what noise is laid on which of them.

Noise of the camera and of the robot are kept apart on purpose: they give different orders of the methods.
"""

import math
from typing import NamedTuple

import numpy as np

from vision_pc.config.choices import Setup
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.samples import PosePairs, pose_pairs
from vision_pc.core.hand_eye.solvers import maximum_likelihood as ml
from vision_pc.core.hand_eye.solvers.maximum_likelihood import Equations, Noise
from vision_pc.core.se3 import Array, nearest_rotation

# Hua et al. 2024, Table 1: quaternion x, y, z, w (two decimals, norms 0.48 to 0.84) and position in metres
TABLE_1 = np.array(
    [
        [-0.24, 0.40, 0.55, 0.05, 0.04, -0.01, 0.65],
        [0.05, 0.03, 0.39, 0.74, 0.66, -0.14, 0.07],
        [-0.45, 0.42, 0.55, 0.06, 0.06, 0.22, 0.84],
        [-0.04, 0.11, 0.44, 0.70, 0.59, -0.11, 0.39],
        [-0.34, 0.42, 0.31, -0.17, -0.06, 0.01, 0.92],
        [-0.26, 0.35, 0.51, 0.19, 0.27, -0.03, 0.81],
        [-0.08, 0.15, 0.45, -0.66, -0.64, 0.12, 0.39],
        [-0.25, 0.35, 0.53, 0.20, 0.17, -0.03, 0.78],
        [-0.33, 0.49, 0.55, 0.07, 0.07, -0.01, 0.68],
        [0.02, 0.05, 0.41, 0.72, 0.65, -0.13, 0.19],
        [0.12, 0.08, 0.43, 0.16, 0.58, -0.23, 0.14],
        [-0.23, 0.42, 0.39, -0.12, 0.14, -0.32, 0.44],
    ]
)
# The paper's X, section 5.3. Its minus signs were lost in print; these make it orthonormal, right-handed.
PRINTED_X = np.array(
    [
        [0.02473, 0.95395, 0.29817, 0.17564],
        [0.97552, -0.08838, 0.20134, 0.52855],
        [0.21849, 0.28662, -0.93279, 0.94272],
        [0.0, 0.0, 0.0, 1.0],
    ]
)


class HandEyeScene(NamedTuple):
    """The truth, eye in hand: ``X_BT`` (n, 4, 4), the unknowns ``X`` and ``Z`` (4, 4) of H X P = Z."""

    X_BT: Array
    X: Array
    Z: Array

    def P(self) -> Array:
        """The target in the camera without noise (n, 4, 4)."""
        return ml.predicted(self.X_BT, self.X, self.Z)


def table_1_scene() -> HandEyeScene:
    """The paper's twelve poses as the hand's, its X, and a target before the arm."""
    R = stacks.rotation_from_quaternion(TABLE_1[:, [3, 0, 1, 2]])
    X = stacks.transform(nearest_rotation(PRINTED_X[:3, :3]), PRINTED_X[:3, 3])
    Z = stacks.transform(stacks.exp_so3(np.array([0.4, -1.1, 0.7])), np.array([0.8, 0.1, 0.3]))
    return HandEyeScene(stacks.transform(R, TABLE_1[:, 4:]), X, Z)


def viewing_scene(
    rng: np.random.Generator, poses: int, distance_m: float = 0.8, tilt_deg: float = 30.0
) -> HandEyeScene:
    """Poses that look at the target from ``distance_m`` ± 20 %, tilted to ``tilt_deg``, rolled to 60°."""
    X = stacks.transform(stacks.exp_so3(_ball(rng, 1)[0] * math.radians(30.0)), rng.uniform(-0.1, 0.1, 3))
    Z = stacks.transform(
        stacks.exp_so3(_ball(rng, 1)[0] * math.pi), rng.uniform([0.6, -0.3, 0.1], [1.2, 0.3, 0.7])
    )
    tilt = np.concatenate([_disc(rng, poses) * math.radians(tilt_deg), np.zeros((poses, 1))], axis=1)
    roll = np.zeros((poses, 3))
    roll[:, 2] = rng.uniform(-1.0, 1.0, poses) * math.radians(60.0)
    facing = np.diag([1.0, -1.0, -1.0])  # the target's z towards the camera
    R_CT = stacks.exp_so3(roll) @ stacks.exp_so3(tilt) @ facing
    depth = distance_m * rng.uniform(0.8, 1.2, poses)
    t = np.concatenate([_disc(rng, poses) * 0.2 * depth[:, None], depth[:, None]], axis=1)
    return HandEyeScene(Z @ stacks.inverse(stacks.transform(R_CT, t)) @ stacks.inverse(X), X, Z)


def small_rotation_scene(rng: np.random.Generator, poses: int, largest_deg: float = 5.0) -> HandEyeScene:
    """A boom that hardly turns: any two poses within ``largest_deg``, target 1 m before the camera.

    The poses use the ends of that range, as anyone would who has so little. The camera sits where the arm's
    does: 0.2 m left of, 0.05 m above and 0.4 m behind the tool.
    """
    X = stacks.transform(
        stacks.exp_so3(_ball(rng, 1)[0] * math.radians(10.0)), np.array([-0.20, -0.05, -0.40])
    )
    turns = _sphere(rng, poses) * math.radians(0.5 * largest_deg) * 0.999
    X_BT = stacks.transform(stacks.exp_so3(turns), rng.uniform(-0.15, 0.15, (poses, 3)))
    facing = stacks.transform(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 1.0]))
    return HandEyeScene(X_BT, X, X @ facing)


def _sphere(rng: np.random.Generator, count: int) -> Array:
    v = rng.normal(size=(count, 3))
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))


def _ball(rng: np.random.Generator, count: int) -> Array:
    return _sphere(rng, count) * rng.uniform(size=(count, 1)) ** (1.0 / 3.0)


def _disc(rng: np.random.Generator, count: int) -> Array:
    angle, radius = rng.uniform(0.0, 2.0 * math.pi, count), np.sqrt(rng.uniform(size=count))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def noise(rotation_deg: float, translation_mm: float, robot: bool = False) -> Noise:
    """Gaussian noise a component, of the camera or of the robot alone."""
    turn, shift = math.radians(rotation_deg), 1e-3 * translation_mm
    return Noise(1e-12, 1e-12, turn, shift) if robot else Noise(turn, shift)


def measured(scene: HandEyeScene, n: Noise, rng: np.random.Generator) -> PosePairs:
    """The scene's samples with noise on absolute poses, the camera's or the robot's."""
    return measured_with_bad(scene, n, rng, 0)[0]


def measured_with_bad(
    scene: HandEyeScene, n: Noise, rng: np.random.Generator, bad: int
) -> tuple[PosePairs, set[str]]:
    """The same with a gross error of the camera in ``bad`` samples, and the names of those.

    A gross error is a turn of 10° to 60° about any axis and a shift of 50 to 300 mm, as a mistaken marker
    or a pose from another time gives.
    """
    count = len(scene.X_BT)
    true_P = scene.P()
    turn = stacks.exp_so3(rng.normal(size=(count, 3)) * n.camera_rotation)
    P = stacks.transform(
        turn @ true_P[:, :3, :3], true_P[:, :3, 3] + rng.normal(size=(count, 3)) * n.camera_translation
    )
    hand_turn = stacks.exp_so3(rng.normal(size=(count, 3)) * n.robot_rotation)
    X_BT = stacks.transform(
        scene.X_BT[:, :3, :3] @ hand_turn,
        scene.X_BT[:, :3, 3] + rng.normal(size=(count, 3)) * n.robot_translation,
    )
    spoiled = rng.choice(count, bad, replace=False)
    for k in spoiled:
        axis, aim = rng.normal(size=3), rng.normal(size=3)
        turn = axis / np.linalg.norm(axis) * math.radians(rng.uniform(10.0, 60.0))
        shift = aim / np.linalg.norm(aim) * rng.uniform(0.05, 0.3)
        P[k] = stacks.transform(stacks.exp_so3(turn) @ P[k, :3, :3], P[k, :3, 3] + shift)
    return pose_pairs(X_BT, P, Setup.EYE_IN_HAND), {str(k + 1) for k in spoiled}


class Bound(NamedTuple):
    """The least root-mean-square error that an unbiased estimator of X can have (Cramér-Rao)."""

    rotation_deg: float
    translation_mm: float


def bound(scene: HandEyeScene, n: Noise) -> Bound:
    """The Cramér-Rao bound of X for that noise on absolute poses."""
    equations = Equations(scene.X_BT, scene.P(), np.ones(len(scene.X_BT)))
    J = ml.jacobian(equations, scene.X, scene.Z, np.zeros((len(equations.H), 6)))
    white = ml.whitened(ml.whitener(equations, scene.X, scene.Z, n), J).reshape(-1, J.shape[-1])
    variances = np.diag(np.linalg.inv(white.T @ white))[:6]
    return Bound(math.degrees(math.sqrt(variances[3:].sum())), 1e3 * math.sqrt(variances[:3].sum()))
