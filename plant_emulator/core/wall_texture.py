"""Procedural wall texture: seeded, periodic, rich at every scale that the camera resolves, with its mip
levels.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

SIZE_BITS = 12
SIZE = 1 << SIZE_BITS
LEVELS = 5
_CELLS_PER_PERIOD = (8, 16, 32, 64, 128, 256, 512, 1024, 2048)
_AMPLITUDES = (0.30, 0.35, 0.45, 0.55, 0.60, 0.60, 0.55, 0.45, 0.30)
_PATCH_OCTAVES = (5, 6, 7)  # thresholded softly: sharp-edged stones and pits, which make good corners
_PATCH_WEIGHT = 0.8

Grey = NDArray[np.uint8]
Field = NDArray[np.float32]


def wall_texture(seed: int, mean_grey: float, contrast_grey: float) -> tuple[Grey, ...]:
    """Mip levels of the wall, finest first: (4096, 4096), (2048, 2048) … uint8; each repeats seamlessly in
    both directions.

    ``mean_grey`` and ``contrast_grey`` are the mean and the standard deviation of the finest level in grey
    levels. Texel (row, column) of a level is centred at (row + 0.5, column + 0.5) in units of that level's
    texels, which is the half-texel shift that averaging two by two needs.
    """
    generator = np.random.default_rng(seed)
    total = np.zeros((SIZE, SIZE), dtype=np.float32)
    for octave, (cells, amplitude) in enumerate(zip(_CELLS_PER_PERIOD, _AMPLITUDES, strict=True)):
        field = _octave(generator, cells)
        cv2.scaleAdd(field, amplitude, total, total)
        if octave in _PATCH_OCTAVES:
            cv2.scaleAdd(_soft_threshold(_octave(generator, cells)), _PATCH_WEIGHT, total, total)
    mean, deviation = cv2.meanStdDev(total)
    scale = contrast_grey / float(deviation[0, 0])
    finest = np.clip(np.rint(total * scale + (mean_grey - float(mean[0, 0]) * scale)), 0, 255).astype(
        np.uint8
    )
    return _mip_levels(finest)


def _octave(generator: np.random.Generator, cells: int) -> Field:
    """One periodic field of unit standard deviation with ``cells`` independent values to the period."""
    margin = 4
    grid = np.pad(generator.standard_normal((cells, cells), dtype=np.float32), margin, mode="wrap")
    factor = SIZE // cells
    large = cv2.resize(grid, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC)
    cut = large[margin * factor : margin * factor + SIZE, margin * factor : margin * factor + SIZE]
    return np.ascontiguousarray(cut, dtype=np.float32) / np.float32(cut.std())


def _soft_threshold(field: Field) -> Field:
    """Field pressed towards two values above and below +0.8: patches that cover about a fifth, with steep
    rims.
    """
    return np.asarray(np.clip((field - np.float32(0.8)) * np.float32(5.0), -0.25, 1.5), dtype=np.float32)


def _mip_levels(finest: Grey) -> tuple[Grey, ...]:
    levels = [finest]
    for _ in range(LEVELS - 1):
        above = levels[-1]
        levels.append(
            np.asarray(cv2.resize(above, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        )
    return tuple(levels)
