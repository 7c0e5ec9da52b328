"""Cameras and poses that several tests look through."""

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foundation.configuration import load
from plant_emulator.config.scene import SceneConfig
from plant_emulator.core.camera.exposures import CameraView
from plant_emulator.core.camera.scene import Scene, rotation_matrix
from plant_emulator.core.camera.stereo_camera import StereoCamera
from plant_emulator.core.mechanics.geometry import transform
from tests.support.paths import CONFIGS

CLEAN: dict[str, Any] = {
    "camera": {"noise_grey": 0.0, "blur_px": 0.0, "vignetting": 0.0},
    "wall": {"lighting_gradient_per_m": [0.0, 0.0]},
}
# T of the start pose in B, from the contract: approach along x, right is -y, down is -z.
X_BT_START = transform(
    np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.array([3.89355, 0.0, 1.00825])
)
FACING = np.diag([1.0, -1.0, -1.0])  # a camera or marker that looks the other one in the face

Matrix = NDArray[np.float64]


def scene_config(overrides: dict[str, Any] | None = None) -> SceneConfig:
    """The shipped scene with overrides."""
    return load(SceneConfig, CONFIGS / "scene.yaml", overrides)


def camera(overrides: dict[str, Any] | None = None) -> StereoCamera:
    """A camera in the shipped scene with overrides."""
    config = scene_config(overrides)
    return StereoCamera(config.camera, Scene(config), config.seed)


def even_plate(middle_m: tuple[float, float], size_m: tuple[float, float], grey: float) -> dict[str, Any]:
    """A passer of one grey that stands on the wall, in O."""
    even = {"mean_grey": grey, "contrast_grey": 0.0, "velocity_m_s": [0.0, 0.0, 0.0]}
    return even | {"start_m": [*middle_m, 1e-9], "size_m": list(size_m)}


@cache
def clean_camera() -> StereoCamera:
    """The shipped camera without blur, noise, vignetting and lighting gradient."""
    return camera(CLEAN)


@cache
def shipped_camera() -> StereoCamera:
    """The shipped camera."""
    return camera()


def start_view(scene: Scene, X_BT: Matrix = X_BT_START) -> CameraView:
    """Camera and marker with the tool at ``X_BT``."""
    X_WT = scene.mounts.X_WB @ X_BT
    return CameraView(X_WT @ scene.mounts.X_TC, X_WT @ scene.mounts.X_TM)


def wall_view(
    scene: Scene, distance: float, angles_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> CameraView:
    """The camera ``distance`` metres in front of O, and no tool marker in sight."""
    X_OC = transform(FACING @ rotation_matrix(angles_deg), np.array([0.0, 0.05, distance]))
    X_WC = scene.mounts.X_WO @ X_OC
    return CameraView(X_WC, X_WC @ transform(FACING, np.array([0.0, 0.0, -1.0])))


def random_view(scene: Scene, generator: np.random.Generator) -> CameraView:
    """A random camera 0.5 to 2 m from the wall at any roll, and the tool marker somewhere before it."""
    turn = generator.uniform([-25.0, -25.0, -180.0], [25.0, 25.0, 180.0])
    distance = generator.uniform(0.5, 2.0)
    place = np.array(
        [generator.uniform(-0.3, 0.3) * distance, generator.uniform(-0.2, 0.2) * distance, distance]
    )
    X_WC = scene.mounts.X_WO @ transform(FACING @ rotation_matrix(tuple(turn)), place)
    marker = generator.uniform([-0.25, -0.1, 0.3], [0.25, 0.1, 0.6])
    return CameraView(
        X_WC, X_WC @ transform(FACING @ rotation_matrix(tuple(generator.uniform(-30, 30, 3))), marker)
    )
