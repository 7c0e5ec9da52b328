"""Procedural wall texture: seeded, periodic, rich at every scale the camera resolves; its mip levels."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from plant_emulator.config.surroundings import WallConfig
from plant_emulator.core.camera.fetching import Pairs
from plant_emulator.core.camera.wall import wall_painter

SIZE_BITS = 12
SIZE = 1 << SIZE_BITS
LEVELS = 5
_COARSEST_BITS = 3
# Weight of the noise that is added at 2**3, 2**4 … 2**11 cells to the period.
_CLOUD_WEIGHTS = (0.15, 0.20, 0.25, 0.30, 0.35, 0.40, 0.45, 0.45, 0.30)
# Cells to the period (as a power of two) of the sharp-edged stones and pits, which make good corners.
_PATCH_BITS = (7, 8, 9, 10)
_PATCH_WEIGHT = 0.9
_PATCH_DETAIL_BITS = 2  # patches are cut out at 4 x 4 samples a cell, so that their rims are steep

Grey = NDArray[np.uint8]
Field = NDArray[np.float32]
Texture = tuple[Pairs, ...]


def wall_texture(seed: int, mean_grey: float, contrast_grey: float) -> Grey:
    """The wall's finest level, (4096, 4096) uint8, periodic in both directions.

    ``mean_grey`` and ``contrast_grey`` are its mean and standard deviation in grey levels. Texel (row,
    column) of any level is centred at (row + 0.5, column + 0.5) in units of that level's texels, which is the
    half-texel shift that averaging two by two needs.
    """
    generator = np.random.default_rng(seed)
    total = np.zeros((1 << _COARSEST_BITS, 1 << _COARSEST_BITS), dtype=np.float32)
    for bits in range(_COARSEST_BITS, SIZE_BITS + 1):
        octave = bits - _COARSEST_BITS
        if octave < len(_CLOUD_WEIGHTS):
            cells = generator.standard_normal(total.shape, dtype=np.float32)
            total += np.float32(_CLOUD_WEIGHTS[octave]) * cells
        if bits - _PATCH_DETAIL_BITS in _PATCH_BITS:
            total += np.float32(_PATCH_WEIGHT) * _patches(generator, bits - _PATCH_DETAIL_BITS)
        if bits < SIZE_BITS:
            total = _doubled(total)
    mean, deviation = cv2.meanStdDev(total)
    scale = contrast_grey / float(deviation[0, 0])
    finest = cv2.convertScaleAbs(np.maximum(total * scale + (mean_grey - float(mean[0, 0]) * scale), 0.0))
    return np.asarray(finest, dtype=np.uint8)


def _patches(generator: np.random.Generator, bits: int) -> Field:
    """Stones and pits: noise pressed towards -1.5, 0 and 1.5, the flat ground covering about four fifths."""
    field = generator.standard_normal((1 << bits, 1 << bits), dtype=np.float32)
    for _ in range(_PATCH_DETAIL_BITS):
        field = _doubled(field)
    raised = np.clip((np.abs(field) - np.float32(1.0)) * np.float32(6.0), 0.0, 1.5)
    return np.asarray(np.copysign(raised, field), dtype=np.float32)


def _doubled(field: Field) -> Field:
    """The periodic field interpolated to twice the samples a side."""
    margin = 4
    wrapped = np.pad(field, margin, mode="wrap")
    large = cv2.resize(wrapped, None, fx=2.0, fy=2.0, interpolation=cv2.INTER_CUBIC)
    size = 2 * field.shape[0]
    return np.ascontiguousarray(large[2 * margin : 2 * margin + size, 2 * margin : 2 * margin + size])


def bared(finest: Grey, wall: WallConfig) -> Grey:
    """A copy whose bare patches have lost contrast, within a rim of an eighth of their radius."""
    result = finest.copy()
    per_m = 1000.0 / wall.texel_mm
    for patch in wall.bare_patches:
        column, row = SIZE / 2.0 + per_m * patch.centre_m[0], SIZE / 2.0 - per_m * patch.centre_m[1]
        radius = per_m * patch.radius_m
        rows, columns = (np.arange(math.floor(m - radius), math.ceil(m + radius) + 1) for m in (row, column))
        far = np.hypot(rows[:, None] + 0.5 - row, columns + 0.5 - column) / radius
        lost = (1.0 - patch.contrast) * np.clip(8.0 * (1.0 - far), 0.0, 1.0)
        places = np.ix_(rows % SIZE, columns % SIZE)
        grey = result[places].astype(np.float32)
        result[places] = np.rint(grey + (wall.mean_grey - grey) * lost).astype(np.uint8)
    return result


def packed_levels(finest: Grey) -> Texture:
    """The finest level and its mip levels, each packed for the painter."""
    levels = [finest]
    for _ in range(LEVELS - 1):
        coarser = cv2.resize(levels[-1], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        levels.append(np.asarray(coarser, dtype=np.uint8))
    return tuple(wall_painter.packed(level) for level in levels)
