"""Small data sets for the tests, all from seeded generators."""

import numpy as np

from laboratory.experiments.hand_eye import scenes
from laboratory.experiments.hand_eye.scenes import HandEyeScene
from vision_pc.config.choices import Setup
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.samples import PosePairs, pose_pairs
from vision_pc.core.se3 import Array


def random_poses(rng: np.random.Generator, count: int, turn: float = 1.0, shift: float = 0.5) -> Array:
    return stacks.transform(
        stacks.exp_so3(rng.normal(size=(count, 3)) * turn), rng.normal(size=(count, 3)) * shift
    )


def random_scene(rng: np.random.Generator, count: int = 12) -> HandEyeScene:
    X, Z = random_poses(rng, 2)
    return HandEyeScene(random_poses(rng, count), X, Z)


def exact_pairs(scene: HandEyeScene, setup: Setup = Setup.EYE_IN_HAND) -> PosePairs:
    """Noise-free samples of ``scene``, whose H is the hand's pose or its inverse."""
    X_BT = scene.X_BT if setup is Setup.EYE_IN_HAND else stacks.inverse(scene.X_BT)
    return pose_pairs(X_BT, scene.P(), setup)


def noisy_pairs(
    seed: int | list[int], count: int = 15, rotation_deg: float = 0.1, translation_mm: float = 0.5
) -> tuple[PosePairs, HandEyeScene]:
    rng = np.random.default_rng(seed)
    scene = scenes.viewing_scene(rng, count)
    return scenes.measured(scene, scenes.noise(rotation_deg, translation_mm), rng), scene
