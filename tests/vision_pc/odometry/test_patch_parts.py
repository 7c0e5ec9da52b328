"""What the parts of a patch tell of where it was found: as far off as it truly is, at depth steps too."""

from typing import NamedTuple

import numpy as np
import pytest

from vision_pc.config.vision import VisionConfig
from vision_pc.core import se3
from vision_pc.core.odometry import patches
from vision_pc.core.odometry.keyframes.keyframe import Keyframe
from vision_pc.core.odometry.keyframes.templates import Templates
from vision_pc.core.perception import intrinsics
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, Image

SIDE = 21
MIDDLE = np.array([639.5, 359.5])  # the principal point
SHIFT = np.array([0.37, -0.21])
BEHIND = 12.0  # times as far in columns is what lies behind seen elsewhere
STRIPE = 36.0  # px: width of what lies before it, and of the gaps between


class World(NamedTuple):
    """Grey levels of ``noise`` and of the ``contrast`` of a surface that is seen ``zoom`` times as large when
    it has moved; ``stepped``: in stripes, with another behind.
    """

    noise: float
    contrast: float = 9.0
    stepped: bool = False
    zoom: float = 1.0

    def picture(self, moved: Array, zoom: float) -> Image:
        """The surface as seen when it has ``moved`` by so many px before it was seen larger."""
        x, y = np.meshgrid(np.arange(400.0, 880.0), np.arange(150.0, 570.0))
        x, y = ((at - middle) / zoom + middle for at, middle in zip((x, y), MIDDLE, strict=True))
        grey = texture(1, x - moved[0], y - moved[1], self.contrast)
        if self.stepped:
            behind = texture(2, x - BEHIND * moved[0], y - moved[1], self.contrast)
            grey = np.where((x - moved[0]) % (2.0 * STRIPE) < STRIPE, grey, behind)
        grey += np.random.default_rng(3 + int(moved.any())).normal(0.0, self.noise, grey.shape)
        whole = np.full((720, 1280), 128, dtype=np.uint8)
        whole[150:570, 400:880] = np.clip(np.round(grey), 0, 255)
        return whole


def texture(seed: int, x: Array, y: Array, contrast: float) -> Array:
    """Waves of all directions, 6 to 30 px long."""
    generator, found = np.random.default_rng(seed), np.full(x.shape, 128.0)
    for _ in range(20):
        angle, phase = generator.uniform(0.0, 2.0 * np.pi, 2)
        k = 2.0 * np.pi / generator.uniform(6.0, 30.0)
        found += contrast * np.sin(k * np.cos(angle) * x + k * np.sin(angle) * y + phase)
    return found


class Told(NamedTuple):
    """Errors (n, 2) px of matches, and what their parts tell (n,)."""

    errors: Array
    stds: Array

    @property
    def ratio(self) -> float:
        """Error² over variance: 1 where parts tell the truth."""
        return float((self.errors**2).mean() / (self.stds**2).mean())


def told(camera: CameraCalibration, config: VisionConfig, world: World) -> Told:
    """Of points all over the middle of the picture, those of every fourth column at the rim of a stripe."""
    columns, rows = np.arange(468.0, 812.0, STRIPE / 4.0), np.arange(210.0, 510.0, 20.0)
    pixels = np.stack(np.meshgrid(columns, rows), axis=2).reshape(-1, 2)
    before, after = world.picture(np.zeros(2), 1.0), world.picture(SHIFT, world.zoom)
    rays, every = intrinsics.normalised(camera.left, pixels), np.arange(len(pixels))
    facing = np.tile((0.0, 0.0, 1.0), (len(pixels), 1))
    keyframe = Keyframe(
        0, se3.identity(), before, before, every, pixels, rays, facing, rays,
        np.zeros(len(pixels), dtype=bool), np.zeros((2, len(pixels))), Templates(before, pixels, SIDE), every,
    )  # fmt: skip
    nearer = se3.transform(np.eye(3), (0.0, 0.0, 1.0 - 1.0 / world.zoom))
    eye, guess = camera.left, (pixels - MIDDLE) * world.zoom + MIDDLE
    found, good, stds = patches.found(keyframe, after, guess, nearer, eye, eye)
    return Told((found - guess - SHIFT * world.zoom)[good], stds[good])


@pytest.mark.parametrize(
    "world", [World(2.0), World(2.0, contrast=4.0), World(4.0, zoom=1.3)], ids=["clean", "pale", "nearer"]
)
def test_noise_is_told_as_large_as_it_is(
    camera: CameraCalibration, config: VisionConfig, world: World
) -> None:
    """In px of the picture that is looked at, whatever texture and size are. Up to 1.7 times too
    small before a pale surface: noise makes a template's slopes look steeper than they are.
    """
    seen = told(camera, config, world)
    assert len(seen.stds) > 400
    assert 0.6 < seen.ratio < 1.7**2


def test_a_patch_half_on_what_lies_behind_is_told_uncertain(
    camera: CameraCalibration, config: VisionConfig
) -> None:
    clean, stepped = (told(camera, config, World(2.0, stepped=step)) for step in (False, True))
    away = np.linalg.norm(stepped.errors, axis=1)
    between = (away > 0.2) & (away < 0.9)  # what would be taken for a good match
    assert between.sum() > 20, "these steps would mislead nobody"
    assert np.median(stepped.stds[between]) > 5.0 * np.median(clean.stds)
    assert stepped.stds[between].min() > np.median(clean.stds)


def test_a_patch_that_shows_nothing_is_told_as_far_off_as_any(
    camera: CameraCalibration, config: VisionConfig
) -> None:
    """Asked where no match was found, nothing is divided by nothing."""
    pixels, flat = np.array([[300.0, 200.0]]), np.full((720, 1280), 77, dtype=np.uint8)
    one = np.zeros(1, dtype=np.int64)
    rays = intrinsics.normalised(camera.left, pixels)
    keyframe = Keyframe(
        0, se3.identity(), flat, flat, one, pixels, rays, np.array([[0.0, 0.0, 1.0]]), rays,
        np.zeros(1, dtype=bool), np.zeros((2, 1)), Templates(flat, pixels, SIDE), one,
    )  # fmt: skip
    eye = camera.left
    _, good, stds = patches.found(keyframe, flat, pixels, se3.identity(), eye, eye)
    assert (good.tolist(), stds.tolist()) == ([False], [3.0])
