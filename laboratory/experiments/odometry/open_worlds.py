"""Roads and rooms for the odometry matrix: what cameras look at that hang on no arm.

A car on a road at a metre a picture, a drone that turns about in a hall, a camera in a hand. Lenses, bases
and rates are those of well-known recordings of such kind; what rectification leaves is drawn.
CastWorld axes: x right, y down, z ahead.
"""

from collections.abc import Callable
from typing import NamedTuple
from zlib import crc32

import numpy as np

from laboratory.experiments.odometry.ray_casting import CastWorld, RayCaster, Rectangle, noisy, rough_texture
from laboratory.experiments.odometry.sequences import Sequence
from vision_pc.config.camera import CameraSettings, EyeSettings, PinholePair
from vision_pc.config.vision import RectifiedPairSettings
from vision_pc.core import se3
from vision_pc.core.perception import intrinsics
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, StereoPair

Vector = tuple[float, float, float]

DISPARITY_PX, ROWS_PX = 0.3, 0.25  # [S] what rectification of such recordings leaves, at most
_NOISE_GREY = 1.5
_EYE_M = 1.65  # a car's camera above the road
_ROAD_M = 300.0


class PairLens(NamedTuple):
    """Of a rectified pair: focal length, principal point, picture size, px; base m; pairs a second."""

    f_px: float
    cx_px: float
    cy_px: float
    width: int
    height: int
    baseline_m: float
    rate_hz: float


CAR = PairLens(718.9, 607.2, 185.2, 1241, 376, 0.537, 10.0)
DRONE = PairLens(458.0, 376.0, 240.0, 752, 480, 0.110, 20.0)
HAND = PairLens(380.0, 320.0, 240.0, 640, 480, 0.063, 10.0)


DrawnWorld = Callable[[np.random.Generator, int, PairLens], tuple[CastWorld, Array]]


class OpenKind(NamedTuple):
    """What it is in ``words``, the lens, and what ``drawn`` for so many pictures: a world and the way X_WC
    (n, 4, 4) through it.
    """

    words: str
    lens: PairLens
    drawn: DrawnWorld


def open_sequence(name: str, seed: int, count: int) -> Sequence:
    """``count`` pairs of kind ``name``, as ``seed`` draws them."""
    kind, rng = OPEN_KINDS[name], np.random.default_rng((0x0E0, seed, crc32(name.encode())))
    world, X_WC = kind.drawn(rng, count, kind.lens)
    stated = _stated_camera(kind.lens)
    off = rng.uniform(-1.0, 1.0, 2) * (DISPARITY_PX, ROWS_PX)
    true = intrinsics.with_offset(_camera(stated), float(off[0]), float(off[1]))
    caster, pairs = RayCaster(world), []
    for k, X in enumerate(X_WC):
        grey = caster.pictures(true, X, k / kind.lens.rate_hz)
        left, right = (noisy(one, _NOISE_GREY, rng) for one in grey)
        pairs.append(StereoPair(left, right, round(k * 1e9 / kind.lens.rate_hz), k))
    return Sequence(pairs, np.stack([se3.inverse(X_WC[0]) @ X for X in X_WC]), stated)


def _stated_camera(lens: PairLens) -> RectifiedPairSettings:
    return RectifiedPairSettings(
        fx_px=lens.f_px, fy_px=lens.f_px, cx_px=lens.cx_px, cy_px=lens.cy_px,
        baseline_m=lens.baseline_m, width_px=lens.width, height_px=lens.height,
    )  # fmt: skip


def _camera(stated: RectifiedPairSettings) -> CameraCalibration:
    eye = EyeSettings(fx_px=stated.fx_px, fy_px=stated.fy_px, cx_px=stated.cx_px, cy_px=stated.cy_px)
    pair = PinholePair(left=eye, right=eye, baseline_m=stated.baseline_m)
    size = {"width_px": stated.width_px, "height_px": stated.height_px}
    return intrinsics.calibration(
        CameraSettings.model_validate(size | {"stale_ms": 1e3, "frozen_frames": 0, "calibration": pair})
    )


def _box(
    centre: Vector, size: Vector, texture: int, texel_m: float, velocity: Vector = (0.0, 0.0, 0.0)
) -> list[Rectangle]:
    """The six sides of a box."""
    lo = [c - 0.5 * s for c, s in zip(centre, size, strict=True)]
    hi = [c + 0.5 * s for c, s in zip(centre, size, strict=True)]
    x, y, z = (size[0], 0.0, 0.0), (0.0, size[1], 0.0), (0.0, 0.0, size[2])
    first = (lo[0], lo[1], lo[2])
    sides = [
        (first, x, y), ((lo[0], lo[1], hi[2]), x, y),
        (first, z, y), ((hi[0], lo[1], lo[2]), z, y),
        (first, x, z), ((lo[0], hi[1], lo[2]), x, z),
    ]  # fmt: skip
    return [Rectangle(*side, texture, texel_m, velocity) for side in sides]


def _textures(rng: np.random.Generator, contrasts: tuple[float, ...]) -> Array:
    return np.stack([rough_texture(rng, contrast, float(rng.uniform(90, 150))) for contrast in contrasts])


def _road(speed_m: float = 1.1, open_land: bool = False, traffic: bool = False) -> DrawnWorld:
    """A road between houses; ``open_land``: plain asphalt, and hardly anything within 15 m. ``traffic``: cars
    that come, and one ahead that goes as fast.
    """

    def drawn(rng: np.random.Generator, count: int, lens: PairLens) -> tuple[CastWorld, Array]:
        textures = _textures(rng, (3.0 if open_land else 8.0, 30.0, 35.0, 25.0, 40.0, 12.0))
        ground = Rectangle((-150.0, _EYE_M, -20.0), (300.0, 0.0, 0.0), (0.0, 0.0, 400.0), 0, 0.02)
        hills = Rectangle((-400.0, _EYE_M - 25.0, 400.0), (800.0, 0.0, 0.0), (0.0, 25.0, 0.0), 5, 0.3)
        rectangles = [ground, hills, *_beside(rng, -1.0, open_land), *_beside(rng, 1.0, open_land)]
        if traffic:
            size, ahead = (1.8, 1.6, 4.4), (0.0, 0.0, speed_m * lens.rate_hz)
            for k in range(4):
                there = (-1.9, _EYE_M - 0.8, 30.0 + 25.0 * k)
                rectangles += _box(there, size, 2, 0.01, (0.0, 0.0, -10.0))
            rectangles += _box((1.3, _EYE_M - 0.8, 14.0), size, 1, 0.01, ahead)
        return CastWorld(rectangles, textures), _road_path(rng, count, speed_m)

    return drawn


def _beside(rng: np.random.Generator, side: float, open_land: bool) -> list[Rectangle]:
    """Marks, houses, trees and parked cars on one ``side`` of the road (−1 left)."""
    found = [
        Rectangle((side * 3.5 - 0.08, _EYE_M - 0.003, z), (0.15, 0.0, 0.0), (0.0, 0.0, 3.0), 2, 0.2)
        for z in np.arange(0.0, _ROAD_M, 9.0)
    ]
    z = float(rng.uniform(-5.0, 10.0))
    while z < _ROAD_M:
        away = float(rng.uniform(25.0, 60.0) if open_land else rng.uniform(7.0, 16.0))
        long, tall = float(rng.uniform(8.0, 20.0)), float(rng.uniform(5.0, 12.0))
        centre = (side * (away + 4.0), _EYE_M - 0.5 * tall, z + 0.5 * long)
        found += _box(centre, (8.0, tall, long), int(rng.integers(1, 5)), 0.03)
        z += long + float(rng.uniform(2.0, 15.0))
    z = float(rng.uniform(0.0, 10.0))
    while z < _ROAD_M:
        away = float(rng.uniform(15.0, 25.0) if open_land else rng.uniform(4.5, 6.5))
        if rng.random() < 0.5:
            found += _box((side * away, _EYE_M - 0.7, z), (1.8, 1.4, 4.2), int(rng.integers(1, 5)), 0.01)
        else:
            wide = float(rng.uniform(1.0, 3.0))
            crown = (side * away - wide, _EYE_M - 5.0, z)
            found.append(Rectangle(crown, (2.0 * wide, 0.0, 0.0), (0.0, 3.5, 0.0), 4, 0.015))
            found += _box((side * away, _EYE_M - 0.8, z), (0.3, 1.6, 0.3), 3, 0.01)
        z += float(rng.uniform(6.0, 18.0)) + (40.0 if open_land else 0.0)
    return found


def _road_path(rng: np.random.Generator, count: int, speed_m: float) -> Array:
    bend = float(rng.uniform(-0.006, 0.006))
    found, X = [], se3.transform(np.eye(3), (1.0, 0.0, 0.0))
    for k in range(count):
        shaken = se3.transform(se3.exp_so3(rng.normal(0.0, 8e-4, 3)), (0.0, 0.01 * np.sin(1.1 * k), 0.0))
        found.append(X @ shaken)
        X = X @ se3.transform(se3.exp_so3((0.0, bend * np.sin(k / 15.0), 0.0)), (0.0, 0.0, speed_m))
    return np.stack(found)


def _room(rng: np.random.Generator, size: Vector, contrasts: tuple[float, ...], things: int) -> CastWorld:
    """A closed room, ``size`` wide, high and long, with boxes and pictures along its walls."""
    wide, high, long = size
    rectangles = [one._replace(texture=k % 3) for k, one in enumerate(_box((0.0, 0.0, 0.0), size, 0, 0.012))]
    for _ in range(things):
        w, h, d = (float(side) for side in rng.uniform(0.4, 1.4, 3))
        side, along = float(rng.choice([-1.0, 1.0])), float(rng.uniform(-0.4, 0.4))
        centre = (side * (wide - w) / 2, (high - h) / 2, along * long)
        if rng.random() < 0.5:
            centre = (along * wide, (high - h) / 2, side * (long - d) / 2)
        rectangles += _box(centre, (w, h, d), int(rng.integers(0, len(contrasts))), 0.006)
        at = (side * (wide / 2 - 0.02), -high / 4, float(rng.uniform(-0.4, 0.4)) * long)
        number = int(rng.integers(0, len(contrasts)))
        rectangles.append(Rectangle(at, (0.0, 0.0, 1.2), (0.0, 0.8, 0.0), number, 0.004))
    return CastWorld(rectangles, _textures(rng, contrasts))


def _rotation(yaw: float, pitch: float, roll: float) -> Array:
    axes = ((0.0, yaw, 0.0), (pitch, 0.0, 0.0), (0.0, 0.0, roll))
    turn: Array = np.linalg.multi_dot([se3.exp_so3(axis) for axis in axes])
    return turn


def _flown(
    contrasts: tuple[float, ...],
) -> DrawnWorld:
    """About a hall, turning by up to 60 degrees a second."""

    def drawn(rng: np.random.Generator, count: int, lens: PairLens) -> tuple[CastWorld, Array]:
        world = _room(rng, (9.0, 4.5, 11.0), contrasts, 14)
        phases, found = rng.uniform(0.0, 2.0 * np.pi, 6), []
        for t in np.arange(count) / lens.rate_hz:
            swing = np.sin(np.array([0.55, 0.8, 0.45, 0.75, 1.7, 1.3]) * t + phases)
            found.append(
                se3.transform(_rotation(*(swing[3:] * (1.4, 0.15, 0.15))), swing[:3] * (1.6, 0.5, 2.0))
            )
        return world, np.stack(found)

    return drawn


def _hand_held_world(
    contrasts: tuple[float, ...],
) -> DrawnWorld:
    """In a hand that shakes, around in a small room and back to where it began."""

    def drawn(rng: np.random.Generator, count: int, lens: PairLens) -> tuple[CastWorld, Array]:
        world = _room(rng, (5.0, 2.6, 6.0), contrasts, 10)
        phases, found = rng.uniform(0.0, 2.0 * np.pi, 4), []
        turn = float(rng.choice([-1.0, 1.0]))
        for k in range(count):
            u = 2.0 * np.pi * k / (count - 1)
            shake = 0.02 * np.sin(np.array([9.0, 7.0, 8.0, 5.0]) * k / lens.rate_hz + phases)
            place = (0.8 * np.cos(u), 0.1 * np.sin(2.0 * u) + shake[0], np.sin(u))
            yaw, pitch = turn * 0.7 * np.sin(u) + shake[1], 0.1 * np.sin(2.0 * u) + shake[2]
            found.append(se3.transform(_rotation(yaw, pitch, shake[3]), place))
        return world, np.stack(found)

    return drawn


_RICH, _PLAIN = (18.0, 25.0, 20.0, 35.0), (4.0, 6.0, 5.0, 25.0)

OPEN_KINDS: dict[str, OpenKind] = {
    "road": OpenKind("a car between houses, 1.1 m a pair", CAR, _road()),
    "road_fast": OpenKind("the same, 2.2 m a pair", CAR, _road(speed_m=2.2)),
    "road_open": OpenKind("a car in open land, 20 to 80 m", CAR, _road(open_land=True)),
    "road_traffic": OpenKind("a car in traffic", CAR, _road(traffic=True)),
    "drone": OpenKind("a drone in a hall, 20 pairs/s", DRONE, _flown(_RICH)),
    "drone_5hz": OpenKind("the same, 5 pairs/s", DRONE._replace(rate_hz=5.0), _flown(_RICH)),
    "drone_plain": OpenKind("plain walls, 10 pairs/s", DRONE._replace(rate_hz=10.0), _flown(_PLAIN)),
    "hand": OpenKind("in a hand, around a room", HAND, _hand_held_world(_RICH)),
    "hand_plain": OpenKind("the same, plain walls", HAND, _hand_held_world(_PLAIN)),
}
