"""Compiled loops that paint the wall: trilinear sampling of its periodic texture, vectorised row segment by
segment.

Each texel is stored together with its right, lower and diagonal neighbour in one 32-bit word, so that a
sample costs one load. Coordinates, blending and light are separate loops over short buffers, because
compilers vectorise those and leave only the loads scalar.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Grey = NDArray[np.uint8]
Words = NDArray[np.int32]
Real32 = NDArray[np.float32]
Real64 = NDArray[np.float64]
Scalar32 = Any  # np.float32 inside compiled code: type checkers see it as a plain float at the call

TILE_ROWS = 16
TILE_COLUMNS = 128
_NEAR = np.float32(1e-6)  # smallest inverse depth, per metre, that still counts as in front
_ZERO, _HALF, _ONE, _WHITE = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(255.0)


@njit(cache=True, nogil=True)
def packed(texture: Grey) -> Words:
    """Flat words of a periodic square texture: texel, right, lower and lower right neighbour, 8 bits each."""
    size = texture.shape[0]
    words = np.empty(size * size, dtype=np.int32)
    for row in range(size):
        below = (row + 1) % size
        for column in range(size):
            right = (column + 1) % size
            word = np.uint32(texture[row, column]) | (np.uint32(texture[row, right]) << np.uint32(8))
            word |= np.uint32(texture[below, column]) << np.uint32(16)
            word |= np.uint32(texture[below, right]) << np.uint32(24)
            words[row * size + column] = np.int32(word)
    return words


@njit(cache=True, fastmath=True, error_model="numpy", nogil=True)
def paint_wall(
    out: Grey,
    ray_x: Real32,
    ray_y: Real32,
    homography: Real64,
    pixel_area: float,
    levels: tuple[Words, ...],
    finest_bits: int,
    light: Real64,
    sky: int,
) -> None:
    """Fill ``out`` (height, width) with the wall as seen along the rays.

    ``homography`` maps (ray_x, ray_y, 1) to (texel column, texel row, 1) of the finest level times the
    inverse depth; ``pixel_area`` is one pixel's area in normalised coordinates; ``levels`` are packed mip
    levels, the finest 2**finest_bits texels to a side; ``light`` is a row that maps the ray to brightness
    times the inverse depth. Rays that miss the wall get the grey ``sky``.
    """
    height, width = out.shape
    h, row_of_light = homography.astype(np.float32), light.astype(np.float32)
    # The area of a pixel on the plane is area / w**3 with w the inverse depth; its root is the footprint.
    root_area = np.float32(np.sqrt(abs(np.linalg.det(homography)) * pixel_area))
    fine = np.empty(TILE_COLUMNS, dtype=np.int32)
    coarse = np.empty(TILE_COLUMNS, dtype=np.int32)
    parts = np.empty((4, TILE_COLUMNS), dtype=np.float32)
    fine_x, fine_y, coarse_x, coarse_y = parts[0], parts[1], parts[2], parts[3]
    fine_grey = np.empty(TILE_COLUMNS, dtype=np.float32)
    coarse_grey = np.empty(TILE_COLUMNS, dtype=np.float32)
    for top in range(0, height, TILE_ROWS):
        bottom = min(top + TILE_ROWS, height)
        for left in range(0, width, TILE_COLUMNS):
            right = min(left + TILE_COLUMNS, width)
            row, column = (top + bottom) // 2, (left + right) // 2
            w = max(h[2, 0] * ray_x[row, column] + h[2, 1] * ray_y[row, column] + h[2, 2], _NEAR)
            level = _level(root_area / (w * np.sqrt(w)), len(levels))
            scale, bits = np.float32(1.0 / (1 << level)), finest_bits - level
            fine_texture, coarse_texture = levels[level], levels[level + 1]
            for i in range(top, bottom):
                xs, ys, target = ray_x[i, left:right], ray_y[i, left:right], out[i, left:right]
                _locate(xs, ys, h, scale, bits, fine, coarse, fine_x, fine_y, coarse_x, coarse_y)
                _load(fine_texture, fine, right - left)
                _interpolate(fine, fine_x, fine_y, fine_grey)
                _load(coarse_texture, coarse, right - left)
                _interpolate(coarse, coarse_x, coarse_y, coarse_grey)
                _blend(target, xs, ys, h[2], row_of_light, root_area * scale, fine_grey, coarse_grey, sky)


@njit(cache=True, nogil=True)
def _level(footprint: Scalar32, count: int) -> int:
    """The finer of the two mip levels between which a footprint in finest texels lies."""
    level = 0
    while footprint > 2.0 and level < count - 2:
        footprint *= 0.5
        level += 1
    return level


@njit(cache=True, fastmath=True, error_model="numpy", nogil=True)
def _locate(
    xs: Real32,
    ys: Real32,
    h: Real32,
    scale: Scalar32,
    bits: int,
    fine: Words,
    coarse: Words,
    fine_x: Real32,
    fine_y: Real32,
    coarse_x: Real32,
    coarse_y: Real32,
) -> None:
    """Fill in, for two mip levels, each sample's texel above and left of it, and the parts beyond that."""
    mask, shift = np.int32((1 << bits) - 1), np.int32(bits)
    half_mask, half_shift = np.int32((1 << (bits - 1)) - 1), np.int32(bits - 1)
    for j in range(xs.shape[0]):
        x, y = xs[j], ys[j]
        factor = scale / max(h[2, 0] * x + h[2, 1] * y + h[2, 2], _NEAR)
        along = (h[0, 0] * x + h[0, 1] * y + h[0, 2]) * factor
        down = (h[1, 0] * x + h[1, 1] * y + h[1, 2]) * factor
        u, v = along - _HALF, down - _HALF
        column, row = np.floor(u), np.floor(v)
        fine_x[j], fine_y[j] = u - column, v - row
        fine[j] = np.int32(
            np.int32(np.int32(np.int32(row) & mask) << shift) | np.int32(np.int32(column) & mask)
        )
        u, v = along * _HALF - _HALF, down * _HALF - _HALF
        column, row = np.floor(u), np.floor(v)
        coarse_x[j], coarse_y[j] = u - column, v - row
        at_row = np.int32(np.int32(np.int32(row) & half_mask) << half_shift)
        coarse[j] = np.int32(at_row | np.int32(np.int32(column) & half_mask))


@njit(cache=True, nogil=True)
def _load(texture: Words, words: Words, count: int) -> None:
    """Replace each index in ``words`` by the texel word found there."""
    for j in range(count):
        words[j] = texture[np.uint32(words[j])]


@njit(cache=True, fastmath=True, nogil=True)
def _interpolate(words: Words, part_x: Real32, part_y: Real32, grey: Real32) -> None:
    byte = np.int32(255)
    for j in range(words.shape[0]):
        word, a = words[j], part_x[j]
        upper_left, upper_right = np.float32(word & byte), np.float32((word >> np.int32(8)) & byte)
        lower_left = np.float32((word >> np.int32(16)) & byte)
        lower_right = np.float32((word >> np.int32(24)) & byte)
        upper = upper_left + (upper_right - upper_left) * a
        lower = lower_left + (lower_right - lower_left) * a
        grey[j] = upper + (lower - upper) * part_y[j]


@njit(cache=True, fastmath=True, error_model="numpy", nogil=True)
def _blend(
    target: Grey,
    xs: Real32,
    ys: Real32,
    depth_row: Real32,
    light_row: Real32,
    root_area: Scalar32,
    fine: Real32,
    coarse: Real32,
    sky: int,
) -> None:
    """Blend the two levels by each pixel's own footprint, light them, round; the sky where the ray misses."""
    for j in range(xs.shape[0]):
        x, y = xs[j], ys[j]
        inverse_depth = depth_row[0] * x + depth_row[1] * y + depth_row[2]
        w = max(inverse_depth, _NEAR)
        share = min(max(root_area / (w * np.sqrt(w)) - _ONE, _ZERO), _ONE)
        light = (light_row[0] * x + light_row[1] * y + light_row[2]) / w
        grey = (fine[j] + (coarse[j] - fine[j]) * share) * light
        rounded = np.int32(min(max(grey, _ZERO), _WHITE) + _HALF)
        target[j] = np.uint8(rounded if inverse_depth > _NEAR else np.int32(sky))
