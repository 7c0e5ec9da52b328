"""Drill holes with depth: tubes straight into the wall, cut into the painted picture pixel by pixel.

A ray that meets the wall inside the mouth goes on to the tube's wall or its bottom, so that the two eyes see
different insides. The mouth's edge is anti-aliased as plates are: it lies exactly where it should.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.compiled import allocation_free
from plant_emulator.config.surroundings import DrillHoleConfig, WallConfig
from plant_emulator.core.camera.plates import ray_to_plane
from plant_emulator.core.camera.rasteriser import share_below
from plant_emulator.core.camera.rays import Lens, Rays, meet_plate, row_homography, shaded
from plant_emulator.core.camera.wall.wall_painter import relief_height
from plant_emulator.core.camera.wall.wall_texture import SIZE

Grey = NDArray[np.uint8]
Matrix = NDArray[np.float64]

_ANGLES = 256
_BREAKS = 5  # places where a rim may have broken out
_COLLAR = 0.25  # width of the brighter rim as a share of the radius
_COLLAR_SHARE = 0.6  # of its own grey that the rim shows; the rest is the wall's
_FADE = 0.7  # diameters into the tube at which its wall is 1/e as bright as at the mouth
_LIT = 0.45  # of the wall's mean grey that the tube's wall has at the mouth
_NEAREST_M = 0.05


class Bore(NamedTuple):
    """A tube: (place right, down; radius; depth; greys of bottom, rim and its own wall), and its mouth.

    ``mouth`` (256,) and ``collar`` (256,): how far (m) from the middle mouth and brighter rim reach, by angle
    from x towards down.
    """

    shape: Matrix
    mouth: Matrix
    collar: Matrix


class View(NamedTuple):
    """How one eye sees the wall's plane, in metres right and down.

    ``homographies`` (2, 3, 3) at the first and last row; ``eye`` (3,) its foot and its distance; ``relief``
    (3,) = (height m, waves per metre, what O is from the texture's corner, m); ``light`` (3,) and ``shadow``
    (4,) as ``rays.Surface``.
    """

    homographies: Matrix
    eye: Matrix
    relief: Matrix
    light: Matrix
    shadow: Matrix


def bore(hole: DrillHoleConfig, wall: WallConfig) -> Bore:
    """The tube of a hole that has depth."""
    radius, angles = 0.0005 * hole.diameter_mm, np.linspace(0.0, 2.0 * np.pi, _ANGLES, endpoint=False)
    draw = np.random.default_rng(hole.seed)
    broken = np.zeros(_ANGLES)
    for _ in range(_BREAKS if hole.broken > 0.0 else 0):
        middle, half = draw.uniform(0.0, 2.0 * np.pi), math.radians(draw.uniform(6.0, 20.0))
        off = np.abs((angles - middle + np.pi) % (2.0 * np.pi) - np.pi) / half
        broken = np.maximum(broken, draw.uniform(0.3, 1.0) * hole.broken * np.clip(1.0 - off**2, 0.0, 1.0))
    ragged = 0.04 * radius * draw.standard_normal(_ANGLES // 8).repeat(8)
    mouth = radius * (1.0 + broken)
    shape = np.array(
        [hole.centre_m[0], -hole.centre_m[1], radius, hole.depth_m, hole.grey, hole.rim_grey,
         _LIT * wall.mean_grey]
    )  # fmt: skip
    return Bore(shape, mouth, mouth + _COLLAR * radius + ragged)


def height_of_wall(wall: WallConfig, x: float, y: float) -> float:
    """How far (m) the undulating wall stands before its plane at a place of O."""
    corner = SIZE / 2.0 * wall.texel_mm / 1000.0
    u, v = (np.float32((place + corner) / wall.undulation_length_m) for place in (x, -y))
    return 1e-3 * wall.undulation_mm * float(relief_height(u, v))


def hole_places(wall: WallConfig) -> Matrix:
    """Middles (n, 3) in O of the mouths of all drill holes."""
    middles = [(*hole.centre_m, height_of_wall(wall, *hole.centre_m)) for hole in wall.drill_holes]
    return np.array(middles, dtype=np.float64).reshape(-1, 3)


def view(X_EOs: Matrix, wall: WallConfig, shadow: Matrix) -> View:
    """The wall as an eye sees it at the instants of the first and the last row, or of all."""
    centre_O = -X_EOs[0][:3, :3].T @ X_EOs[0][:3, 3]
    right, up = wall.lighting_gradient_per_m
    return View(
        ray_to_plane(X_EOs)[[0, -1]],
        np.array([centre_O[0], -centre_O[1], centre_O[2]]),
        np.array([wall.undulation_mm, 1000.0 / wall.undulation_length_m, SIZE / 2.0 * wall.texel_mm])
        / 1000.0,
        np.array([1.0, right, -up]),
        shadow,
    )


def cut(picture: Grey, rays: Rays, tubes: tuple[Bore, ...], seen: View, X_EO: Matrix, lens: Lens) -> None:
    """Cut the tubes into ``picture`` as far as they are in it; ``X_EO`` (4, 4) places them in the picture."""
    height, width = picture.shape
    for tube in tubes:
        x, down = tube.shape[:2]
        reach = float(tube.collar.max()) + abs(seen.relief[0])
        middle = X_EO[:3, :3] @ np.array([x, -down, 0.0]) + X_EO[:3, 3]
        if middle[2] < _NEAREST_M + reach:
            continue
        u, v = lens.project(middle[None])[0]
        across = 1.5 * reach * float(lens.focal.max()) / (middle[2] - reach) + 4.0
        if not (math.isfinite(u) and math.isfinite(v)):
            continue
        top, bottom = max(math.floor(v - across), 0), min(math.ceil(v + across) + 1, height)
        left, right = max(math.floor(u - across), 0), min(math.ceil(u + across) + 1, width)
        if top < bottom and left < right:
            _cut_bore(picture, rays, tube, seen, (top, bottom, left, right), np.empty((3, 3)))


@allocation_free(nogil=True)
def _cut_bore(
    picture: Grey, rays: Rays, tube: Bore, seen: View, box: tuple[int, int, int, int], h: Matrix
) -> None:
    shape, mouth, collar = tube
    for i in range(box[0], box[1]):
        row_homography(seen.homographies, i, picture.shape[0], h)
        for j in range(box[2], box[3]):
            at = meet_plate(rays, h, i, j)
            if not at.in_front:
                continue
            s, t = _on_wall(at.s, at.t, seen)
            x, y = s - shape[0], t - shape[1]
            far = math.hypot(x, y)
            if far > 2.0 * shape[2]:
                continue
            n = max(far, 1e-9)
            a = abs(x * at.s_u + y * at.t_u) / n
            b = abs(x * at.s_v + y * at.t_v) / n
            long, short = max(a, b, 1e-9), max(min(a, b), 1e-12)
            turn = (math.atan2(y, x) / (2.0 * math.pi)) % 1.0
            lit = (seen.light[0] + seen.light[1] * s + seen.light[2] * t) * shaded(s, t, seen.shadow)
            grey = np.float64(picture[i, j])
            rim = _COLLAR_SHARE * share_below(_edge(collar, turn) - far, long, short)
            grey += rim * (shape[5] * lit - grey)
            inside = share_below(_edge(mouth, turn) - far, long, short)
            if inside > 0.0:
                grey += inside * (grey_inside(x, y, s, t, shape, seen.eye) * lit - grey)
            picture[i, j] = np.uint8(min(max(grey, 0.0), 255.0) + 0.5)


@allocation_free(inline="always")
def _on_wall(s: float, t: float, seen: View) -> tuple[float, float]:
    """Where the ray that meets the wall's plane at (s, t) meets the undulating wall, as ``wall_painter``."""
    if seen.relief[0] == 0.0:
        return s, t
    bent_s, bent_t, per_m, corner = s, t, seen.relief[1], seen.relief[2]
    for _ in range(2):
        u, v = np.float32((bent_s + corner) * per_m), np.float32((bent_t + corner) * per_m)
        rise = seen.relief[0] * np.float64(relief_height(u, v)) / seen.eye[2]
        bent_s, bent_t = s + (seen.eye[0] - s) * rise, t + (seen.eye[1] - t) * rise
    return bent_s, bent_t


@allocation_free(inline="always")
def _edge(reach: Matrix, turn: float) -> float:
    """What ``reach`` is at an angle of ``turn`` turns, between its entries."""
    place = turn * _ANGLES
    first = int(place) % _ANGLES
    part = place - math.floor(place)
    return float(reach[first] + (reach[(first + 1) % _ANGLES] - reach[first]) * part)


@allocation_free(inline="always")
def grey_inside(x: float, y: float, s: float, t: float, shape: Matrix, eye: Matrix) -> float:
    """The grey of what the ray that enters at (x, y) from the middle meets in the tube."""
    radius, depth = shape[2], shape[3]
    far = math.hypot(x, y)
    if far > 0.98 * radius:  # where the rim has broken out the ray begins at the tube's wall
        x, y = x * 0.98 * radius / far, y * 0.98 * radius / far
    kx, ky = (s - eye[0]) / eye[2], (t - eye[1]) / eye[2]  # sideways for each metre down
    a = kx * kx + ky * ky
    b = x * kx + y * ky
    c = x * x + y * y - radius * radius
    down = depth
    if a > 1e-12:
        down = min(depth, (-b + math.sqrt(max(b * b - a * c, 0.0))) / a)
    if down >= depth:
        return float(shape[4])
    turn = math.atan2(y + ky * down, x + kx * down) * radius
    grain = 0.85 + 0.3 * scatter(math.floor(turn / 0.004), math.floor(down / 0.004))
    return float(shape[4] + (shape[6] - shape[4]) * grain * math.exp(-down / (2.0 * radius * _FADE)))


@allocation_free(inline="always")
def scatter(i: float, j: float) -> float:
    """A number in 0…1 that looks random for each cell."""
    mixed = math.sin(12.9898 * i + 78.233 * j) * 43758.5453
    return mixed - math.floor(mixed)
