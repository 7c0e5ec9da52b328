"""Pictures of boards taken by the emulator's camera: its exact lens, point spread and noise."""

from functools import lru_cache
from typing import Any, NamedTuple

import cv2
import numpy as np

from plant_emulator.config.scene import SceneConfig
from plant_emulator.core.camera.boards import board_pose
from plant_emulator.core.camera.exposures import CameraView
from plant_emulator.core.camera.scene import Scene
from plant_emulator.core.camera.stereo_camera import LEFT, StereoCamera
from testbed.camera.pairs import board_config
from vision_pc.core import se3
from vision_pc.core.perception.zhang_intrinsics import Charuco, Checkerboard
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image

_BEHIND = se3.transform(np.eye(3), (0.0, 0.0, -5.0))  # the tool marker, out of the camera's sight


class BoardCamera(NamedTuple):
    """A camera that photographs boards: ``K`` px, ``distortion`` k1 k2 p1 p2 k3, size, blur and noise."""

    K: Array
    distortion: Array
    width: int
    height: int
    blur_px: float = 0.6
    noise_grey: float = 2.0


class BoardRenderer:
    """Photographs boards with the emulator's left eye, given the lens of ``camera``."""

    def __init__(self, camera: BoardCamera) -> None:
        self.camera = camera

    def render(self, board: Checkerboard | Charuco, X_CB: Array, rng: np.random.Generator) -> Image:
        """The grey picture (height, width) of ``board`` at ``X_CB`` (4, 4).

        B is OpenCV's board frame: x right, y down, z away; its origin the first inner corner of a
        checkerboard, the corner of a ChArUco board. ``rng`` gives the noise.
        """
        shown = _shown(_plain(self.camera), board)
        X_WB = (
            shown.scene.mounts.X_WO @ board_pose(shown.scene.config.boards[0]) @ se3.inverse(_middle(board))
        )
        X_WC = X_WB @ se3.inverse(X_CB)
        frame_id = int(rng.integers(1 << 40))
        return shown.render_eye(LEFT, CameraView(X_WC, X_WC @ _BEHIND), frame_id)


def _middle(board: Checkerboard | Charuco) -> Array:
    """X_BP: the emulator's frame of the board (in its middle, y up, z towards the viewer) in OpenCV's."""
    squares = np.array([board.columns, board.rows])
    middle = 0.5 * board.square_m * (squares - 1 if isinstance(board, Checkerboard) else squares)
    return se3.transform(np.diag([1.0, -1.0, -1.0]), (*middle, 0.0))


def _plain(camera: BoardCamera) -> tuple[Any, ...]:
    """A camera as numbers, for the cache."""
    lens = (*camera.K[[0, 1, 0, 1], [0, 1, 2, 2]].tolist(), *camera.distortion.tolist())
    return (*lens, camera.width, camera.height, camera.blur_px, camera.noise_grey)


@lru_cache(maxsize=4)
def _shown(camera: tuple[Any, ...], board: Checkerboard | Charuco) -> StereoCamera:
    """The emulator's camera before a wall with that board."""
    names = ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2", "k3")
    width, height, blur, noise = camera[9:]
    marker = {"marker_id": 1, "side_m": 0.1, "quiet_zone_m": 0.01}
    config = SceneConfig.model_validate(
        {
            "seed": 1,
            "wall": {"texture_seed": 7, "texel_mm": 1.0, "mean_grey": 118.0, "contrast_grey": 22.0},
            "object_of_interest": {
                "position_m": (4.0, 0.0, 1.0),
                "markers": [marker | {"centre_m": (40.0, 40.0)}],
            },
            "tool_marker": marker | {"marker_id": 0},
            "boards": [board_config(board)],
            "mount": {},
            "camera": {
                "width_px": width,
                "height_px": height,
                "rate_hz": 10.0,
                "exposure_us": 4000,
                "baseline_m": 0.12,
                "lens": dict(zip(names, camera, strict=False)),
                "blur_px": blur,
                "noise_grey": noise,
            },
        }
    )
    return StereoCamera(config.camera, Scene(config), config.seed)


def random_board_pose(camera: BoardCamera, board: Checkerboard | Charuco, rng: np.random.Generator) -> Array:
    """A board pose X_CB (4, 4) with the whole board in the picture, tilted up to 40°, rolled up to 30°."""
    extent = np.array([board.columns, board.rows]) * board.square_m
    centre = 0.5 * (extent - (board.square_m if isinstance(board, Checkerboard) else 0.0))
    for _ in range(1000):
        R = np.asarray(cv2.Rodrigues(np.radians(rng.uniform([-40.0, -40.0, -30.0], [40.0, 40.0, 30.0])))[0])
        depth = rng.uniform(1.2, 2.4) * camera.K[0, 0] * extent[0] / camera.width
        pixel = rng.uniform([0.0, 0.0], [camera.width, camera.height])
        ray = np.linalg.solve(camera.K, np.append(pixel, 1.0))
        X = se3.transform(R, ray * depth - R @ np.append(centre, 0.0))
        margin = board.square_m
        outline = np.array([[a, b, 0.0] for a in (-margin, extent[0]) for b in (-margin, extent[1])])
        seen = cv2.projectPoints(
            outline @ R.T + X[:3, 3], np.zeros(3), np.zeros(3), camera.K, camera.distortion
        )[0]
        if ((seen > 8.0) & (seen < (camera.width - 8, camera.height - 8))).all():
            return X
    raise ValueError("the board does not fit into this picture")
