"""Pictures of boards as a distorted camera sees them: every pixel's ray back to the board's plane."""

from typing import NamedTuple

import cv2
import numpy as np

from vision_pc.core.se3 import Array
from vision_pc.core.types import Image
from vision_pc.core.zhang_intrinsics import Charuco, Checkerboard, charuco_board

_SUPER = 3  # samples a pixel and axis
_PAPER, _INK = 225.0, 35.0
_TEXTURE_PX_A_SQUARE = 60


class BoardCamera(NamedTuple):
    """A camera that photographs boards: ``K`` px, ``distortion`` k1 k2 p1 p2 k3, size, blur and noise."""

    K: Array
    distortion: Array
    width: int
    height: int
    blur_px: float = 0.6
    noise_grey: float = 2.0


class BoardRenderer:
    """Renders boards through one camera; the rays are computed once."""

    def __init__(self, camera: BoardCamera) -> None:
        self.camera = camera
        step = 1.0 / _SUPER
        u = np.arange(camera.width * _SUPER) * step + 0.5 * step - 0.5
        v = np.arange(camera.height * _SUPER) * step + 0.5 * step - 0.5
        grid = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 1, 2)
        until = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 12, 1e-9)
        rays = cv2.undistortPointsIter(grid, camera.K, camera.distortion, np.eye(3), np.eye(3), until)
        self._rays = np.asarray(rays, dtype=np.float64).reshape(-1, 2)

    def render(self, board: Checkerboard | Charuco, X_CB: Array, rng: np.random.Generator) -> Image:
        """The grey picture (height, width) of ``board`` at ``X_CB`` (4, 4), its corner grid's origin at B."""
        x, y = self._on_board(X_CB)
        fine = _checker(board, x, y) if isinstance(board, Checkerboard) else _charuco(board, x, y)
        c = self.camera
        grey = fine.reshape(c.height, _SUPER, c.width, _SUPER).mean(axis=(1, 3))
        grey = cv2.GaussianBlur(grey, (0, 0), c.blur_px) if c.blur_px > 0.0 else grey
        grey = grey + rng.normal(size=grey.shape) * c.noise_grey
        picture: Image = np.clip(np.rint(grey), 0, 255).astype(np.uint8)
        return picture

    def _on_board(self, X_CB: Array) -> tuple[Array, Array]:
        to_board = np.linalg.inv(np.stack([X_CB[:3, 0], X_CB[:3, 1], X_CB[:3, 3]], axis=1))
        h = self._rays @ to_board[:, :2].T + to_board[:, 2]
        return h[:, 0] / h[:, 2], h[:, 1] / h[:, 2]


def _checker(board: Checkerboard, x: Array, y: Array) -> Array:
    """Squares around the inner corners, a white rim of one square; grey table beyond."""
    i, j = np.floor(x / board.square_m), np.floor(y / board.square_m)
    inside = (i >= -1) & (i < board.columns) & (j >= -1) & (j < board.rows)
    rim = (i >= -2) & (i < board.columns + 1) & (j >= -2) & (j < board.rows + 1)
    dark = inside & ((i + j) % 2 == 0)
    return np.where(dark, _INK, np.where(rim, _PAPER, 120.0))


def _charuco(board: Charuco, x: Array, y: Array) -> Array:
    """OpenCV's own picture of the board, looked up without blur of its own."""
    size = (board.columns * _TEXTURE_PX_A_SQUARE, board.rows * _TEXTURE_PX_A_SQUARE)
    texture = np.asarray(charuco_board(board).generateImage(size, marginSize=0), dtype=np.float64)
    u = np.floor(x / board.square_m * _TEXTURE_PX_A_SQUARE).astype(int)
    v = np.floor(y / board.square_m * _TEXTURE_PX_A_SQUARE).astype(int)
    inside = (u >= 0) & (u < size[0]) & (v >= 0) & (v < size[1])
    value = texture[np.clip(v, 0, size[1] - 1), np.clip(u, 0, size[0] - 1)]
    return np.where(inside, _INK + (_PAPER - _INK) * value / 255.0, _PAPER)


def random_board_pose(camera: BoardCamera, board: Checkerboard | Charuco, rng: np.random.Generator) -> Array:
    """A board pose X_CB (4, 4) with the whole board in the picture, tilted up to 40°, rolled up to 30°."""
    extent = np.array([board.columns, board.rows]) * board.square_m
    centre = 0.5 * (extent - (board.square_m if isinstance(board, Checkerboard) else 0.0))
    for _ in range(1000):
        angles = np.radians(rng.uniform([-40.0, -40.0, -30.0], [40.0, 40.0, 30.0]))
        R = np.asarray(cv2.Rodrigues(angles)[0])
        depth = rng.uniform(1.2, 2.4) * camera.K[0, 0] * extent[0] / camera.width
        pixel = rng.uniform([0.0, 0.0], [camera.width, camera.height])
        ray = np.linalg.solve(camera.K, np.append(pixel, 1.0))
        X = np.eye(4)
        X[:3, :3] = R
        X[:3, 3] = ray * depth - R @ np.append(centre, 0.0)
        margin = board.square_m
        outline = np.array([[a, b, 0.0] for a in (-margin, extent[0]) for b in (-margin, extent[1])])
        seen = cv2.projectPoints(
            outline @ R.T + X[:3, 3], np.zeros(3), np.zeros(3), camera.K, camera.distortion
        )[0]
        inside = (
            (seen > 8.0).all()
            and (seen[..., 0] < camera.width - 8).all()
            and (seen[..., 1] < camera.height - 8).all()
        )
        if inside:
            return X
    raise ValueError("the board does not fit into this picture")
