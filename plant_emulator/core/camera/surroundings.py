"""What stands or passes before the wall as plates: blocks, passers."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from plant_emulator.config.camera import ShadowConfig
from plant_emulator.config.surroundings import (
    BlockConfig,
    PasserConfig,
    WallConfig,
)
from plant_emulator.core.camera.plates import Plate, plain_plate
from plant_emulator.core.mechanics.geometry import rotation_from_vector, transform

Array = NDArray[np.float64]

NO_SHADOW = np.array([0.0, 0.0, 0.0, 1.0])


def shadow_on(config: ShadowConfig, X_OP: Array, edge_m: float) -> Array:
    """(per m right, per m down, constant, factor) of a plate at X_OP (4x4).

    The first three give the distance beyond the shadow's edge, ``edge_m`` now, in widths of its ramp.
    """
    if config.factor == 1.0:
        return NO_SHADOW.copy()
    normal = np.array(config.normal)
    right, up, origin = (normal @ X_OP[:2, column] for column in (0, 1, 3))
    beyond = np.array([right, -up, origin - edge_m]) / config.penumbra_m
    return np.append(beyond, config.factor)


Grey = NDArray[np.uint8]
Matrix = NDArray[np.float64]

_TEXEL_M = 0.004
_MULTIPLE = 32  # texels: of this both sides of a picture are multiples, and its largest clouds so wide
_SIDE_LIGHT = 0.5  # of a block's sides, as a share of the wall's mean


def rough_picture(seed: int, size_m: tuple[float, float], mean_grey: float, contrast_grey: float) -> Grey:
    """A rough surface as wide as ``size_m`` and at least as high: clouds of every size from 4 mm to 13 cm."""
    generator = np.random.default_rng(seed)
    width = _MULTIPLE * max(round(size_m[0] / _TEXEL_M / _MULTIPLE), 1)
    height = _MULTIPLE * math.ceil(size_m[1] * width / size_m[0] / _MULTIPLE)
    total = np.zeros((height, width), dtype=np.float32)
    texels = _MULTIPLE
    while texels >= 1:
        cells = generator.standard_normal((height // texels, width // texels), dtype=np.float32)
        total += cv2.resize(cells, (width, height), interpolation=cv2.INTER_CUBIC)
        texels //= 2
    grey = mean_grey + contrast_grey * (total - total.mean()) / total.std()
    return np.asarray(np.clip(np.rint(grey), 0, 255), dtype=np.uint8)


def front_of(size_m: tuple[float, float], middle_O: tuple[float, float, float]) -> Plate:
    """A rectangle parallel to the wall, as an outline."""
    (w, h), X = size_m, transform(np.eye(3), np.array(middle_O))
    return plain_plate(X, (-0.5 * w, 0.5 * w), (-0.5 * h, 0.5 * h), 0.0)


def block_outline(block: BlockConfig, grey: float = 0.0) -> tuple[Plate, ...]:
    """The sides of a block in one grey, and its face."""
    (x, y), (w, h), depth = block.centre_m, block.size_m, block.depth_m
    plates = []
    for turns, reach, length in ((0, w, h), (1, h, w), (2, w, h), (3, h, w)):  # right, up, left, down
        about = transform(
            rotation_from_vector(np.array([0.0, 0.0, 0.5 * np.pi * turns])), np.array([x, y, 0.0])
        )
        outwards = rotation_from_vector(np.array([0.0, 0.5 * np.pi, 0.0]))
        X_OP = about @ transform(outwards, np.array([0.5 * reach, 0.0, 0.5 * depth]))
        plates.append(plain_plate(X_OP, (-0.5 * depth, 0.5 * depth), (-0.5 * length, 0.5 * length), grey))
    return *plates, front_of(block.size_m, (x, y, depth))


def block_plates(block: BlockConfig, wall: WallConfig) -> tuple[Plate, ...]:
    """The sides of a block, and its face over them."""
    *sides, face = block_outline(block, _SIDE_LIGHT * wall.mean_grey)
    picture = rough_picture(block.texture_seed, block.size_m, wall.mean_grey, wall.contrast_grey)
    return *sides, _covered(face, picture, lit_by_wall=True)


def passer_plate(passer: PasserConfig) -> Plate:
    """What passes, at its place at time 0."""
    picture = rough_picture(passer.texture_seed, passer.size_m, passer.mean_grey, passer.contrast_grey)
    return _covered(front_of(passer.size_m, passer.place_m(0.0)), picture, lit_by_wall=False)


def _covered(outline: Plate, picture: Grey, lit_by_wall: bool) -> Plate:
    """The outline filled with a picture as wide as it and at least as high, a cell for each of its texels."""
    (left, right), (top, bottom) = outline.edges_x, outline.edges_y
    edges_x, texel_m = np.linspace(left, right, picture.shape[1] + 1, retstep=True)
    edges_y = np.append(np.arange(top, bottom - 1e-6, float(texel_m)), bottom)
    grey = picture[: len(edges_y) - 1].astype(np.float32)
    return Plate(outline.X_parent_plate, edges_x, edges_y, grey, lit_by_wall)
