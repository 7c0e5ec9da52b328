"""Compiled loops that paint the wall: trilinear sampling of its periodic texture, vectorised row segment by
segment.

Each texel is stored together with its lower neighbour in 16 bits, so that one load of 32 bits takes all four
texels of a sample. Coordinates, blending and light are separate loops over short buffers, because compilers
vectorise those and leave only the loads scalar.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.compiled import allocation_free
from plant_emulator.core.camera.fetching import Pairs, fetch_ahead, load_both, pairs_of
from plant_emulator.core.camera.rays import Rays, fetch_rays

Grey = NDArray[np.uint8]
Words = NDArray[np.int32]
Real32 = NDArray[np.float32]
Real64 = NDArray[np.float64]
Scalar32 = Any  # np.float32 inside compiled code: type checkers see it as a plain float at the call
Word = Any  # np.int32

TILE_ROWS = 16
TILE_COLUMNS = 128
MARGIN = 32
_NEAR = np.float32(1e-6)  # smallest inverse depth, per metre, that still counts as in front
_ZERO, _HALF, _ONE, _TWO = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(2.0)
_EIGHT, _WHITE = np.float32(8.0), np.float32(255.0)
_SECOND_WAVE, _SECOND_PHASE = np.float32(1.37), np.float32(0.3)


def packed(texture: Grey) -> Pairs:
    """Flat pairs of a periodic square texture: each texel and, in the upper 8 bits, its lower neighbour.

    A row goes on for ``MARGIN`` texels into its own beginning: the last texel has its right neighbour, and
    rows are not a power of two apart, where they would drive each other out of the cache.
    """
    return np.pad(pairs_of(texture), ((0, 0), (0, MARGIN)), mode="wrap").ravel()


class WallTexture(NamedTuple):
    """Packed mip levels of the wall, the finest 2**finest_bits texels to a side."""

    levels: tuple[Pairs, ...]
    finest_bits: int


class _Tile(NamedTuple):
    """Pixels ``top`` to ``bottom`` and ``left`` to ``right``, and the two mip levels that show there.

    The finer one has 2**``bits`` texels to a side, ``scale`` of them to one of the finest of all.
    """

    top: int
    bottom: int
    left: int
    right: int
    fine: Pairs
    coarse: Pairs
    bits: int
    scale: Scalar32


class _Light(NamedTuple):
    """``light`` and ``relief`` as ``paint_wall`` takes them."""

    lamp: Real32
    relief: Real32
    sky: int


class _Line(NamedTuple):
    """Room for the homography of a row, and for a segment of it: places, parts, greys, indices."""

    h: Real32
    along: Real32
    down: Real32
    part_x: Real32
    part_y: Real32
    fine: Real32
    coarse: Real32
    words: Words


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
    middle = 0.5 * (homographies[0] + homographies[1])
    # The area of a pixel on the plane is area / w**3 with w the inverse depth; its root is the footprint.
    root_area = np.float32(np.sqrt(abs(np.linalg.det(middle)) * pixel_area))
    lit = _Light(light.astype(np.float32), relief.astype(np.float32), sky)
    along, down, part_x, part_y, fine, coarse = np.empty((6, TILE_COLUMNS), dtype=np.float32)
    words = np.empty(TILE_COLUMNS, dtype=np.int32)
    line = _Line(middle.astype(np.float32), along, down, part_x, part_y, fine, coarse, words)
    _paint_tiles(out, rays, homographies, root_area, wall, lit, line)


@allocation_free(fastmath=True, nogil=True)
def _paint_tiles(
    out: Grey,
    rays: Rays,
    homographies: Real64,
    root_area: Scalar32,
    wall: WallTexture,
    lit: _Light,
    line: _Line,
) -> None:
    """Fill ``out`` tile by tile; ``root_area`` is in texels of the finest level."""
    height, width = out.shape
    h = line.h
    for top in range(0, height, TILE_ROWS):
        bottom = min(top + TILE_ROWS, height)
        for left in range(0, width, TILE_COLUMNS):
            right = min(left + TILE_COLUMNS, width)
            row, column = (top + bottom) // 2, (left + right) // 2
            w = max(h[2, 0] * rays.x[row, column] + h[2, 1] * rays.y[row, column] + h[2, 2], _NEAR)
            level = _level(root_area / (w * np.sqrt(w)), len(wall.levels))
            fine, coarse = wall.levels[level], wall.levels[level + 1]
            scale = np.float32(1.0 / (1 << level))
            tile = _Tile(top, bottom, left, right, fine, coarse, wall.finest_bits - level, scale)
            _paint_tile(out, rays, homographies, root_area * scale, tile, lit, line)


@allocation_free(fastmath=True)
def _paint_tile(
    out: Grey, rays: Rays, homographies: Real64, root_area: Scalar32, tile: _Tile, lit: _Light, line: _Line
) -> None:
    """Fill one tile, whose pixels share two mip levels; ``root_area`` is in texels of the finer one."""
    along, down, part_x, part_y, words = line.along, line.down, line.part_x, line.part_y, line.words
    left, right, bits, scale = tile.left, tile.right, tile.bits, tile.scale
    count, at_fine, at_coarse = right - left, np.int32(0), np.int32(0)
    for i in range(tile.top, tile.bottom):
        xs, ys = rays.x[i, left:right], rays.y[i, left:right]
        fetch_rays(rays, i + 1, left, right)
        _row_homography(homographies, i / (out.shape[0] - 1), line.h)
        _meet(xs, ys, line.h, along, down)
        if lit.relief[0] != 0.0:
            _bend(along, down, lit.relief, count)
        _locate(along, down, scale, bits, words, part_x, part_y, count)
        ahead, at_fine = words[count // 2] - at_fine, words[count // 2]
        if i > tile.top:
            fetch_ahead(tile.fine, words, ahead, count)  # the next row, if it goes on like this
        _load(tile.fine, words, count)
        _interpolate(words, part_x, part_y, line.fine, count)
        _locate(along, down, scale * _HALF, bits - 1, words, part_x, part_y, count)
        ahead, at_coarse = words[count // 2] - at_coarse, words[count // 2]
        if i > tile.top:
            fetch_ahead(tile.coarse, words, ahead, count)
        _load(tile.coarse, words, count)
        _interpolate(words, part_x, part_y, line.coarse, count)
        if lit.lamp[6] != 1.0:
            _shade(line.fine, line.coarse, along, down, lit.lamp, count)
        _blend(out[i, left:right], xs, ys, line, lit, root_area)


@allocation_free
def _row_homography(homographies: Real64, share: float, h: Real32) -> None:
    """Fill ``h`` with the homography ``share`` of the way down the picture."""
    for m in range(3):
        for n in range(3):
            first = homographies[0, m, n]
            h[m, n] = np.float32(first + (homographies[1, m, n] - first) * share)


@allocation_free
def _level(footprint: Scalar32, count: int) -> int:
    """The finer of the two mip levels between which a footprint in finest texels lies."""
    level = 0
    while footprint > 2.0 and level < count - 2:
        footprint *= 0.5
        level += 1
    return level


@allocation_free(fastmath=True)
def _meet(xs: Real32, ys: Real32, h: Real32, along: Real32, down: Real32) -> None:
    """Fill in where the rays meet the plane, in finest texels."""
    h00, h01, h02, h10, h11, h12 = h[0, 0], h[0, 1], h[0, 2], h[1, 0], h[1, 1], h[1, 2]
    h20, h21, h22 = h[2, 0], h[2, 1], h[2, 2]
    for j in range(xs.shape[0]):
        x, y = xs[j], ys[j]
        depth = _ONE / max(h20 * x + h21 * y + h22, _NEAR)
        along[j] = (h00 * x + h01 * y + h02) * depth
        down[j] = (h10 * x + h11 * y + h12) * depth


@allocation_free(fastmath=True)
def _bend(along: Real32, down: Real32, relief: Real32, count: int) -> None:
    """Move the meeting points from the plane to the undulating wall, by two steps along each ray."""
    height, waves, foot_u, foot_v = relief[0], relief[1], relief[2], relief[3]
    for j in range(count):
        u, v = along[j], down[j]
        bent_u, bent_v = u, v
        for _ in range(2):
            rise = height * relief_height(bent_u * waves, bent_v * waves)
            bent_u, bent_v = u + (foot_u - u) * rise, v + (foot_v - v) * rise
        along[j], down[j] = bent_u, bent_v


@allocation_free(fastmath=True, inline="always")
def relief_height(x: Scalar32, y: Scalar32) -> Scalar32:
    """Height of the undulation, -1…1, at a place counted in wavelengths."""
    return _HALF * (_wave(x) + _wave(_SECOND_WAVE * y + _SECOND_PHASE))


@allocation_free(fastmath=True, inline="always")
def _wave(turns: Scalar32) -> Scalar32:
    """A sine made of parabolas, once continuously differentiable: compilers vectorise it."""
    t = turns - np.floor(turns + _HALF)
    return _EIGHT * t * (_ONE - _TWO * abs(t))


@allocation_free(fastmath=True)
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
    mask, row_length = np.int32((1 << bits) - 1), np.int32((1 << bits) + MARGIN)
    for j in range(count):
        u, v = along[j] * scale - _HALF, down[j] * scale - _HALF
        column, row = np.floor(u), np.floor(v)
        part_x[j], part_y[j] = u - column, v - row
        at_row = np.int32(np.int32(np.int32(row) & mask) * row_length)
        words[j] = np.int32(at_row + np.int32(np.int32(column) & mask))


@allocation_free
def _load(texture: Pairs, words: Words, count: int) -> None:
    """Replace each index in ``words`` by the pair found there and the one right of it."""
    for j in range(count):
        words[j] = load_both(texture, np.intp(words[j]))


@allocation_free(fastmath=True)
def _interpolate(words: Words, part_x: Real32, part_y: Real32, grey: Real32, count: int) -> None:
    for j in range(count):
        word, a = words[j], part_x[j]
        upper_left, lower_left = _byte(word, 0), _byte(word, 8)
        upper_right, lower_right = _byte(word, 16), _byte(word, 24)
        upper = upper_left + (upper_right - upper_left) * a
        lower = lower_left + (lower_right - lower_left) * a
        grey[j] = upper + (lower - upper) * part_y[j]


@allocation_free(inline="always")
def _byte(word: Word, shift: int) -> Scalar32:
    """The 8 bits of ``word`` from ``shift`` on; kept at 32 bits, since vectors of 64 hold half as many."""
    return np.float32(np.int32(np.int32(word >> np.int32(shift)) & np.int32(255)))


@allocation_free(fastmath=True)
def _shade(fine: Real32, coarse: Real32, along: Real32, down: Real32, light: Real32, count: int) -> None:
    """Take from both levels the light that the shadow keeps."""
    for j in range(count):
        beyond = light[3] * along[j] + light[4] * down[j] + light[5] + _HALF
        left = light[6] + (_ONE - light[6]) * min(max(beyond, _ZERO), _ONE)
        fine[j] *= left
        coarse[j] *= left


@allocation_free(fastmath=True)
def _blend(target: Grey, xs: Real32, ys: Real32, line: _Line, lit: _Light, root_area: Scalar32) -> None:
    """Blend the two levels by each pixel's own footprint, light them, round; the sky where the ray misses."""
    along, down, fine, coarse, sky = line.along, line.down, line.fine, line.coarse, np.int32(lit.sky)
    # read once: compilers give up where too many arrays might overlap
    h20, h21, h22 = line.h[2, 0], line.h[2, 1], line.h[2, 2]
    even, per_column, per_row = lit.lamp[0], lit.lamp[1], lit.lamp[2]
    for j in range(xs.shape[0]):
        inverse_depth = h20 * xs[j] + h21 * ys[j] + h22
        w = max(inverse_depth, _NEAR)
        share = min(max(root_area / (w * np.sqrt(w)) - _ONE, _ZERO), _ONE)
        lit_by = even + per_column * along[j] + per_row * down[j]
        grey = (fine[j] + (coarse[j] - fine[j]) * share) * lit_by
        rounded = np.int32(min(max(grey, _ZERO), _WHITE) + _HALF)
        target[j] = np.uint8(rounded if inverse_depth > _NEAR else sky)
