"""Compiled loops that paint the wall: trilinear sampling of its periodic texture, vectorised row segment by
segment.

Each texel is stored together with its right, lower and diagonal neighbour in one 32-bit word, so that a
sample costs one load. Coordinates, blending and light are separate loops over short buffers, because
compilers vectorise those and leave only the loads scalar.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.compiled import kernel
from plant_emulator.core.camera.fetching import fetch_ahead
from plant_emulator.core.camera.rays import Rays

Grey = NDArray[np.uint8]
Words = NDArray[np.int32]
Real32 = NDArray[np.float32]
Real64 = NDArray[np.float64]
Scalar32 = Any  # np.float32 inside compiled code: type checkers see it as a plain float at the call

TILE_ROWS = 16
TILE_COLUMNS = 128
_NEAR = np.float32(1e-6)  # smallest inverse depth, per metre, that still counts as in front
_ZERO, _HALF, _ONE, _TWO = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(2.0)
_EIGHT, _WHITE = np.float32(8.0), np.float32(255.0)
_SECOND_WAVE, _SECOND_PHASE = np.float32(1.37), np.float32(0.3)


@kernel(nogil=True)
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


class WallTexture(NamedTuple):
    """Packed mip levels of the wall, the finest 2**finest_bits texels to a side."""

    levels: tuple[Words, ...]
    finest_bits: int


@kernel(fastmath=True, error_model="numpy", nogil=True)
def paint_wall(
    out: Grey,
    rays: Rays,
    homographies: Real64,
    pixel_area: float,
    wall: WallTexture,
    light: Real64,
    relief: Real64,
    sky: int,
) -> None:
    """Fill ``out`` (height, width) with the wall as seen along the rays.

    ``homographies`` (2, 3, 3) map (ray x, ray y, 1) to (texel column, texel row, 1) of the finest level times
    the inverse depth, at the first and the last row; ``pixel_area`` is one pixel's area in normalised
    coordinates; ``light`` = (constant, per texel column, per texel row) multiplies the grey, and so does the
    shadow of the four numbers after them, as ``lighting`` makes it but by texel; ``relief`` = (height
    over the eye's distance, waves per texel, the eye's foot on the wall: column, row). Rays that miss get the
    grey ``sky``.
    """
    height, width = out.shape
    ray_x, ray_y, levels, finest_bits = rays.x, rays.y, wall.levels, wall.finest_bits
    middle = 0.5 * (homographies[0] + homographies[1])
    # The area of a pixel on the plane is area / w**3 with w the inverse depth; its root is the footprint.
    root_area = np.float32(np.sqrt(abs(np.linalg.det(middle)) * pixel_area))
    h, lamp, bump = middle.astype(np.float32), light.astype(np.float32), relief.astype(np.float32)
    places = np.empty((4, TILE_COLUMNS), dtype=np.float32)
    along, down, part_x, part_y = places[0], places[1], places[2], places[3]
    words = np.empty(TILE_COLUMNS, dtype=np.int32)
    fine = np.empty(TILE_COLUMNS, dtype=np.float32)
    coarse = np.empty(TILE_COLUMNS, dtype=np.float32)
    for top in range(0, height, TILE_ROWS):
        bottom = min(top + TILE_ROWS, height)
        for left in range(0, width, TILE_COLUMNS):
            right = min(left + TILE_COLUMNS, width)
            row, column = (top + bottom) // 2, (left + right) // 2
            w = max(h[2, 0] * ray_x[row, column] + h[2, 1] * ray_y[row, column] + h[2, 2], _NEAR)
            level = _level(root_area / (w * np.sqrt(w)), len(levels))
            scale, bits, count = np.float32(1.0 / (1 << level)), finest_bits - level, right - left
            fine_texture, coarse_texture = levels[level], levels[level + 1]
            at_fine = at_coarse = np.int32(0)
            for i in range(top, bottom):
                xs, ys = ray_x[i, left:right], ray_y[i, left:right]
                _row_homography(homographies, i / (height - 1), h)
                _meet(xs, ys, h, along, down)
                if relief[0] != 0.0:
                    _bend(along, down, bump, count)
                _locate(along, down, scale, bits, words, part_x, part_y, count)
                ahead, at_fine = words[count // 2] - at_fine, words[count // 2]
                if i > top:
                    fetch_ahead(fine_texture, words, ahead, count)  # the next row, if it goes on like this
                _load(fine_texture, words, count)
                _interpolate(words, part_x, part_y, fine, count)
                _locate(along, down, scale * _HALF, bits - 1, words, part_x, part_y, count)
                ahead, at_coarse = words[count // 2] - at_coarse, words[count // 2]
                if i > top:
                    fetch_ahead(coarse_texture, words, ahead, count)
                _load(coarse_texture, words, count)
                _interpolate(words, part_x, part_y, coarse, count)
                if light[6] != 1.0:
                    _shade(fine, coarse, along, down, lamp, count)
                _blend(out[i, left:right], xs, ys, h, along, down, lamp, root_area * scale, fine, coarse, sky)


@kernel(nogil=True)
def _row_homography(homographies: Real64, share: float, h: Real32) -> None:
    """Fill ``h`` with the homography ``share`` of the way down the picture."""
    for m in range(3):
        for n in range(3):
            first = homographies[0, m, n]
            h[m, n] = np.float32(first + (homographies[1, m, n] - first) * share)


@kernel(nogil=True)
def _level(footprint: Scalar32, count: int) -> int:
    """The finer of the two mip levels between which a footprint in finest texels lies."""
    level = 0
    while footprint > 2.0 and level < count - 2:
        footprint *= 0.5
        level += 1
    return level


@kernel(fastmath=True, error_model="numpy", nogil=True)
def _meet(xs: Real32, ys: Real32, h: Real32, along: Real32, down: Real32) -> None:
    """Fill in where the rays meet the plane, in finest texels."""
    for j in range(xs.shape[0]):
        x, y = xs[j], ys[j]
        depth = _ONE / max(h[2, 0] * x + h[2, 1] * y + h[2, 2], _NEAR)
        along[j] = (h[0, 0] * x + h[0, 1] * y + h[0, 2]) * depth
        down[j] = (h[1, 0] * x + h[1, 1] * y + h[1, 2]) * depth


@kernel(fastmath=True, nogil=True)
def _bend(along: Real32, down: Real32, relief: Real32, count: int) -> None:
    """Move the meeting points from the plane to the undulating wall, by two steps along each ray."""
    for j in range(count):
        u, v = along[j], down[j]
        bent_u, bent_v = u, v
        for _ in range(2):
            rise = relief[0] * _relief(bent_u * relief[1], bent_v * relief[1])
            bent_u, bent_v = u + (relief[2] - u) * rise, v + (relief[3] - v) * rise
        along[j], down[j] = bent_u, bent_v


@kernel(fastmath=True, nogil=True, inline="always")
def _relief(x: Scalar32, y: Scalar32) -> Scalar32:
    """Height of the undulation, -1…1, at a place counted in wavelengths."""
    return _HALF * (_wave(x) + _wave(_SECOND_WAVE * y + _SECOND_PHASE))


@kernel(fastmath=True, nogil=True, inline="always")
def _wave(turns: Scalar32) -> Scalar32:
    """A sine made of parabolas, once continuously differentiable: compilers vectorise it."""
    t = turns - np.floor(turns + _HALF)
    return _EIGHT * t * (_ONE - _TWO * abs(t))


@kernel(fastmath=True, nogil=True)
def _locate(
    along: Real32,
    down: Real32,
    scale: Scalar32,
    bits: int,
    words: Words,
    part_x: Real32,
    part_y: Real32,
    count: int,
) -> None:
    """Fill ``words`` with the index of the texel above and left of each place, ``part_*`` with the rest."""
    mask, shift = np.int32((1 << bits) - 1), np.int32(bits)
    for j in range(count):
        u, v = along[j] * scale - _HALF, down[j] * scale - _HALF
        column, row = np.floor(u), np.floor(v)
        part_x[j], part_y[j] = u - column, v - row
        at_row = np.int32(np.int32(np.int32(row) & mask) << shift)
        words[j] = np.int32(at_row | np.int32(np.int32(column) & mask))


@kernel(nogil=True)
def _load(texture: Words, words: Words, count: int) -> None:
    """Replace each index in ``words`` by the texel word found there."""
    for j in range(count):
        words[j] = texture[np.uint32(words[j])]


@kernel(fastmath=True, nogil=True)
def _interpolate(words: Words, part_x: Real32, part_y: Real32, grey: Real32, count: int) -> None:
    byte = np.int32(255)
    for j in range(count):
        word, a = words[j], part_x[j]
        upper_left, upper_right = np.float32(word & byte), np.float32((word >> np.int32(8)) & byte)
        lower_left = np.float32((word >> np.int32(16)) & byte)
        lower_right = np.float32((word >> np.int32(24)) & byte)
        upper = upper_left + (upper_right - upper_left) * a
        lower = lower_left + (lower_right - lower_left) * a
        grey[j] = upper + (lower - upper) * part_y[j]


@kernel(fastmath=True, nogil=True)
def _shade(fine: Real32, coarse: Real32, along: Real32, down: Real32, light: Real32, count: int) -> None:
    """Take from both levels the light that the shadow keeps."""
    for j in range(count):
        beyond = light[3] * along[j] + light[4] * down[j] + light[5] + _HALF
        left = light[6] + (_ONE - light[6]) * min(max(beyond, _ZERO), _ONE)
        fine[j] *= left
        coarse[j] *= left


@kernel(fastmath=True, error_model="numpy", nogil=True)
def _blend(
    target: Grey,
    xs: Real32,
    ys: Real32,
    h: Real32,
    along: Real32,
    down: Real32,
    light: Real32,
    root_area: Scalar32,
    fine: Real32,
    coarse: Real32,
    sky: int,
) -> None:
    """Blend the two levels by each pixel's own footprint, light them, round; the sky where the ray misses."""
    for j in range(xs.shape[0]):
        inverse_depth = h[2, 0] * xs[j] + h[2, 1] * ys[j] + h[2, 2]
        w = max(inverse_depth, _NEAR)
        share = min(max(root_area / (w * np.sqrt(w)) - _ONE, _ZERO), _ONE)
        lit = light[0] + light[1] * along[j] + light[2] * down[j]
        grey = (fine[j] + (coarse[j] - fine[j]) * share) * lit
        rounded = np.int32(min(max(grey, _ZERO), _WHITE) + _HALF)
        target[j] = np.uint8(rounded if inverse_depth > _NEAR else np.int32(sky))
