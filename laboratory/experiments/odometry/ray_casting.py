"""Pictures of worlds made of rectangles: for odometry beyond the wall that the emulated camera looks at.

One ray a pixel; a rectangle's texture is looked up in the pyramid level whose texels are as large as the
pixel is there, between levels and between texels, so that what is far off does not flicker.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.compiled import kernel
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, CameraModel, Image

_SIZE = 512  # texels of the finest level's side, a power of two
_NEAR, _FAR = 0.05, 1e9  # m
_MOST_SAMPLES = 8  # of a pixel that a slanted surface draws out

Texels = NDArray[np.float32]
Lens = tuple[float, float, float, float]


class Rectangle(NamedTuple):
    """A textured rectangle: its ``corner``, its sides (3,) along and up from there, m, the number of its
    texture, how large a texel is, and how it moves, m/s.
    """

    corner: tuple[float, float, float]
    along: tuple[float, float, float]
    up: tuple[float, float, float]
    texture: int
    texel_m: float
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)


class CastWorld(NamedTuple):
    """Rectangles, the textures (k, side, side) that they refer to, and the grey of what no ray hits."""

    rectangles: list[Rectangle]
    textures: Array
    sky_grey: float = 200.0


class RayCaster:
    """Takes pictures of one world."""

    def __init__(self, world: CastWorld) -> None:
        self._world = world
        self._levels = _pyramids(world.textures)
        self._plain = _as_table(world.rectangles)
        self._velocities = np.array([one.velocity for one in world.rectangles], dtype=np.float64)

    def pictures(self, camera: CameraCalibration, X_WC: Array, at_s: float = 0.0) -> tuple[Array, Array]:
        """Grey levels (height, width) that both eyes of a camera at ``X_WC`` see, without noise."""
        table = self._plain.copy()
        table[:, :3] += at_s * self._velocities
        left, right = (
            self._render_eye(eye, X_WC @ eye.X_CE, table, (camera.height, camera.width))
            for eye in (camera.left, camera.right)
        )
        return left, right

    def _render_eye(self, eye: CameraModel, X_WE: Array, table: Array, shape: tuple[int, int]) -> Array:
        grey = np.empty(shape, dtype=np.float32)
        lens = (float(eye.K[0, 0]), float(eye.K[1, 1]), float(eye.K[0, 2]), float(eye.K[1, 2]))
        _cast(grey, lens, np.ascontiguousarray(X_WE[:3]), table, self._levels, self._world.sky_grey)
        return np.asarray(grey, dtype=np.float64)


def noisy(grey: Array, noise_grey: float, rng: np.random.Generator) -> Image:
    """The picture that a sensor makes of ``grey``."""
    return np.clip(np.rint(grey + rng.normal(0.0, noise_grey, grey.shape)), 0, 255).astype(np.uint8)


def rough_texture(rng: np.random.Generator, contrast_grey: float, mean_grey: float = 120.0) -> Array:
    """A texture (side, side) that repeats without a seam: speckles of every size, and stones with edges."""
    grey = np.zeros((_SIZE, _SIZE))
    for size in (2, 4, 8, 16, 64):
        speckles = _blurred_noise(rng, size)
        grey += speckles / speckles.std()
    stones = np.zeros((_SIZE, _SIZE))
    for _ in range(250):
        x, y = rng.integers(0, _SIZE, 2)
        w, h = rng.integers(6, 60, 2)
        columns, rows = np.arange(x, x + w) % _SIZE, np.arange(y, y + h) % _SIZE
        stones[np.ix_(rows, columns)] = rng.normal(0.0, 1.0)
    grey += 2.0 * stones
    return np.asarray(mean_grey + contrast_grey * (grey - grey.mean()) / grey.std())


def _blurred_noise(rng: np.random.Generator, size: int) -> Array:
    """White noise (side, side), blurred over the seam."""
    frequency = np.fft.fftfreq(_SIZE)
    fall = np.exp(-2.0 * (np.pi * size) ** 2 * frequency**2)
    spectrum = np.fft.fft2(rng.normal(0.0, 1.0, (_SIZE, _SIZE))) * np.outer(fall, fall)
    return np.asarray(np.fft.ifft2(spectrum).real)


def _pyramids(textures: Array) -> Texels:
    """All levels (k, texels) of ``textures`` (k, side, side), the finest first, one after the other."""
    levels = [np.asarray(textures, dtype=np.float32)]
    while levels[-1].shape[1] > 1:
        finer = levels[-1]
        levels.append(
            0.25 * (finer[:, ::2, ::2] + finer[:, 1::2, ::2] + finer[:, ::2, 1::2] + finer[:, 1::2, 1::2])
        )
    return np.concatenate([level.reshape(len(textures), -1) for level in levels], axis=1)


def _as_table(rectangles: list[Rectangle]) -> Array:
    """A row a rectangle: corner, unit vectors along and up, normal, lengths, texture, texels a metre."""
    rows = []
    for one in rectangles:
        along, up = np.array(one.along), np.array(one.up)
        lengths = np.linalg.norm(along), np.linalg.norm(up)
        a, u = along / lengths[0], up / lengths[1]
        rows.append([*one.corner, *a, *u, *np.cross(a, u), *lengths, one.texture, 1.0 / one.texel_m])
    return np.array(rows, dtype=np.float64)


@kernel(fastmath=True)
def _bilinear(texels: Texels, texture: int, x: float, y: float, level: int) -> float:
    side = _SIZE >> level
    first = (4 * _SIZE * _SIZE - 4 * side * side) // 3
    u, v = x / (1 << level) - 0.5, y / (1 << level) - 0.5
    i, j = math.floor(u), math.floor(v)
    right, down = u - i, v - j
    mask = side - 1
    x0, x1, y0, y1 = int(i) & mask, (int(i) + 1) & mask, int(j) & mask, (int(j) + 1) & mask
    upper = (1.0 - right) * texels[texture, first + y0 * side + x0] + right * texels[
        texture, first + y0 * side + x1
    ]
    lower = (1.0 - right) * texels[texture, first + y1 * side + x0] + right * texels[
        texture, first + y1 * side + x1
    ]
    grey: float = (1.0 - down) * upper + down * lower
    return grey


@kernel(fastmath=True)
def _texel(texels: Texels, texture: int, x: float, y: float, wide: float) -> float:
    """The grey at ``x``, ``y`` texels of the finest level, where a pixel is ``wide`` texels."""
    level = min(max(math.log2(max(wide, 1.0)), 0.0), 8.0)
    lower = int(level)
    share = level - lower
    return (1.0 - share) * _bilinear(texels, texture, x, y, lower) + share * _bilinear(
        texels, texture, x, y, lower + 1
    )


@kernel(fastmath=True)
def _bounds(
    lens: Lens, pose: Array, table: Array, k: int, width: int, height: int
) -> tuple[int, int, int, int]:
    """First and last column, first and last row (excluded) of the pixels that rectangle ``k`` may cover."""
    fx, fy, cx, cy = lens
    left, right, top, bottom = 1e9, -1e9, 1e9, -1e9
    behind = 0
    for corner in range(4):
        a, u = (corner & 1) * table[k, 12], (corner >> 1) * table[k, 13]
        x = table[k, 0] + a * table[k, 3] + u * table[k, 6] - pose[0, 3]
        y = table[k, 1] + a * table[k, 4] + u * table[k, 7] - pose[1, 3]
        z = table[k, 2] + a * table[k, 5] + u * table[k, 8] - pose[2, 3]
        depth = pose[0, 2] * x + pose[1, 2] * y + pose[2, 2] * z
        if depth < _NEAR:
            behind += 1
            continue
        column = cx + fx * (pose[0, 0] * x + pose[1, 0] * y + pose[2, 0] * z) / depth
        row = cy + fy * (pose[0, 1] * x + pose[1, 1] * y + pose[2, 1] * z) / depth
        left, right, top, bottom = min(left, column), max(right, column), min(top, row), max(bottom, row)
    if behind == 4:
        return 0, 0, 0, 0
    if behind:
        return 0, width, 0, height
    return (
        int(min(max(left, 0.0), width)), int(min(max(right + 1.0, 0.0), width)),
        int(min(max(top, 0.0), height)), int(min(max(bottom + 1.0, 0.0), height)),
    )  # fmt: skip


@kernel(fastmath=True)
def _shade(
    pose: Array, x: float, y: float, depth: float, fx: float, table: Array, k: int, texels: Texels
) -> float:
    """The grey of rectangle ``k`` on the ray (x, y, 1) at ``depth``, over all that the pixel covers there."""
    dx = pose[0, 0] * x + pose[0, 1] * y + pose[0, 2]
    dy = pose[1, 0] * x + pose[1, 1] * y + pose[1, 2]
    dz = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2]
    px = depth * dx + pose[0, 3] - table[k, 0]
    py = depth * dy + pose[1, 3] - table[k, 1]
    pz = depth * dz + pose[2, 3] - table[k, 2]
    fine = table[k, 15]
    at_a = fine * (px * table[k, 3] + py * table[k, 4] + pz * table[k, 5])
    at_u = fine * (px * table[k, 6] + py * table[k, 7] + pz * table[k, 8])
    rate = abs(dx * table[k, 9] + dy * table[k, 10] + dz * table[k, 11])
    facing = max(rate / math.sqrt(dx * dx + dy * dy + dz * dz), 0.02)
    wide = depth / fx * fine  # texels that a pixel covers across
    va = dx * table[k, 3] + dy * table[k, 4] + dz * table[k, 5]  # along the ray it is drawn out
    vu = dx * table[k, 6] + dy * table[k, 7] + dz * table[k, 8]
    size = max(math.sqrt(va * va + vu * vu), 1e-9)
    count = min(int(1.0 / facing) + 1, _MOST_SAMPLES)
    texture, total = int(table[k, 14]), 0.0
    for n in range(count):
        off = ((n + 0.5) / count - 0.5) * wide / facing / size
        total += _texel(texels, texture, at_a + off * va, at_u + off * vu, max(wide, wide / facing / count))
    return total / count


@kernel(fastmath=True)
def _cast(grey: Texels, lens: Lens, pose: Array, table: Array, texels: Texels, sky: float) -> None:
    """Fill ``grey`` with what an eye at ``pose`` (3, 4) sees."""
    fx, fy, cx, cy = lens
    height, width = grey.shape
    nearest = np.full(grey.shape, _FAR)
    hit = np.full(grey.shape, -1)
    for k in range(table.shape[0]):
        nx, ny, nz = table[k, 9], table[k, 10], table[k, 11]
        ox, oy, oz = table[k, 0] - pose[0, 3], table[k, 1] - pose[1, 3], table[k, 2] - pose[2, 3]
        away = ox * nx + oy * ny + oz * nz
        first, last, top, bottom = _bounds(lens, pose, table, k, width, height)
        for row in range(top, bottom):
            y = (row - cy) / fy
            for column in range(first, last):
                x = (column - cx) / fx
                dx = pose[0, 0] * x + pose[0, 1] * y + pose[0, 2]
                dy = pose[1, 0] * x + pose[1, 1] * y + pose[1, 2]
                dz = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2]
                t = away / (dx * nx + dy * ny + dz * nz)
                if not _NEAR < t < nearest[row, column]:
                    continue
                px, py, pz = t * dx - ox, t * dy - oy, t * dz - oz
                a = px * table[k, 3] + py * table[k, 4] + pz * table[k, 5]
                u = px * table[k, 6] + py * table[k, 7] + pz * table[k, 8]
                if 0.0 <= a <= table[k, 12] and 0.0 <= u <= table[k, 13]:
                    nearest[row, column], hit[row, column] = t, k
    for row in range(height):
        for column in range(width):
            k = hit[row, column]
            if k < 0:
                grey[row, column] = sky
                continue
            x, y = (column - cx) / fx, (row - cy) / fy
            grey[row, column] = _shade(pose, x, y, nearest[row, column], fx, table, k, texels)
