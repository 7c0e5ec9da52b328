"""The stereo camera as it truly is: renders what its two eyes see, and projects points exactly."""

from collections.abc import Sequence
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from foundation.compiled import kernel
from plant_emulator.config.camera import CameraConfig
from plant_emulator.config.surroundings import WallConfig
from plant_emulator.core.camera import rasteriser
from plant_emulator.core.camera.exposures import STILL, CameraMotion, CameraView, Capture, Shot
from plant_emulator.core.camera.eye import Eye, true_eyes
from plant_emulator.core.camera.scene import Cover, Scene
from plant_emulator.core.camera.wall.wall_texture import Texture, bared, packed_levels, wall_texture

Grey = NDArray[np.uint8]


Real32 = NDArray[np.float32]
Noise = NDArray[np.int16]

_WHITE = 255


class Imager:
    """What one eye's lens and sensor make of the light: ``centre`` (2,) px of its vignetting."""

    def __init__(self, config: CameraConfig, centre: NDArray[np.float64], noise: Noise) -> None:
        self._noise = noise
        self._centre = (float(centre[0]), float(centre[1]))
        self._falloff = config.vignetting / ((config.width_px / 2.0) ** 2 + (config.height_px / 2.0) ** 2)
        self._noisy = config.noise_grey > 0.0
        levels = np.arange(_WHITE + 2) / _WHITE
        self._response = (_WHITE * np.minimum(levels, 1.0) ** config.response_gamma).astype(np.float32)
        self._straight = config.response_gamma == 1.0

    def expose(self, picture: Grey, key: int, gain: float) -> None:
        """Turn the light in ``picture`` into grey levels, in place; ``key`` chooses the noise."""
        if self._straight:
            self.sense(picture, key, gain, self._falloff)
            return
        _expose(picture, gain, self._falloff, self._centre, self._response)
        self.sense(picture, key, 1.0, 0.0)

    def sense(self, picture: Grey, key: int, gain: float, falloff: float) -> None:
        """Apply gain, vignetting and noise to ``picture`` in place."""
        if self._noisy or falloff != 0.0 or gain != 1.0:
            rasteriser.finish(picture, self._noise, key, gain, falloff, *self._centre)


@kernel(nogil=True)
def _expose(
    picture: Grey, gain: float, falloff: float, centre: tuple[float, float], response: Real32
) -> None:
    """Vignetting, gain, saturation and response curve, in place."""
    black, white, half = np.float32(0.0), np.float32(_WHITE), np.float32(0.5)
    for i in range(picture.shape[0]):
        row, vertical = picture[i], (i - centre[1]) ** 2
        for j in range(row.shape[0]):
            r2 = (j - centre[0]) ** 2 + vertical
            falls = row[j] * np.float32(gain * (1.0 - falloff * r2))
            light = np.float32(min(max(falls, black), white))
            k = np.intp(light)
            part = light - np.float32(k)
            row[j] = np.uint8(np.int32(response[k] + (response[k + 1] - response[k]) * part + half))


Matrix = NDArray[np.float64]

LEFT, RIGHT = 0, 1
_NOISE_STREAM = 0x6E6F697365


class StereoCamera:
    """Renders stereo pairs by projective geometry, anti-aliased. Deterministic for each (seed, frame_id).

    Poses are 4x4: ``X_WC`` of the left eye and ``X_WM`` of the tool marker in the world W, OpenCV axes for
    the camera. ``motion`` matters only with a rolling shutter; the poses are those at the
    middle of the exposure of the middle row.
    """

    def __init__(self, config: CameraConfig, scene: Scene, seed: int) -> None:
        self.config = config
        self.scene = scene
        self._seed = seed
        texture = _texture(_without_bodies(scene.config.wall))
        self.eyes = tuple(Eye(true, config, scene, texture) for true in true_eyes(config))
        generator = np.random.default_rng((seed, _NOISE_STREAM))
        grey = generator.standard_normal(rasteriser.NOISE_LENGTH) * config.noise_grey
        noise = np.clip(np.rint(grey * rasteriser.NOISE_UNIT), -32768, 32767).astype(np.int16)
        self._imagers = [Imager(config, eye.lens.centre, noise) for eye in self.eyes]

    def render(self, X_WC: Matrix, X_WM: Matrix, frame_id: int) -> tuple[Grey, Grey]:
        """The two eyes' pictures (left, right), each (height, width) uint8."""
        view = CameraView(X_WC, X_WM)
        return self.render_eye(LEFT, view, frame_id), self.render_eye(RIGHT, view, frame_id)

    def take(self, shot: Shot) -> tuple[Grey, Grey]:
        """The two eyes' pictures of ``shot``. Raises RequestRefused when it covers a marker unknown here."""
        return self.take_eye(LEFT, shot), self.take_eye(RIGHT, shot)

    def take_eye(self, eye: int, shot: Shot) -> Grey:
        """One eye's picture of ``shot``; ``eye`` is LEFT or RIGHT. Raises as ``take``."""
        if shot.blind is not None:
            return self._even(shot.blind.grey, eye, shot.shown.frame_id)
        return self._captured(eye, shot.shown, [self.scene.cover(fault) for fault in shot.covers])

    def render_eye(self, eye: int, view: CameraView, frame_id: int, motion: CameraMotion = STILL) -> Grey:
        """One eye's picture, (height, width) uint8; ``eye`` is LEFT or RIGHT."""
        return self._captured(eye, Capture(frame_id, 0, view, motion))

    def project(self, X_WC: Matrix, points: Matrix) -> tuple[Matrix, Matrix]:
        """Exact image coordinates (left, right), each (n, 2) px, of points (n, 3) in W; NaN behind it."""
        left, right = (eye.true.project(X_WC, points) for eye in self.eyes)
        return left, right

    def _captured(self, eye: int, capture: Capture, covers: Sequence[Cover] = ()) -> Grey:
        """One eye's picture of a capture."""
        picture, config = self.eyes[eye].painted(capture, covers), self.config
        if config.blur_px > 0.0:
            size = 2 * int(np.ceil(2.5 * config.blur_px)) + 1
            cv2.GaussianBlur(picture, (size, size), config.blur_px, dst=picture)
        self._imagers[eye].expose(picture, self._key(eye, capture.frame_id), config.exposure_gain)
        return picture

    def _even(self, grey: int, eye: int, frame_id: int) -> Grey:
        """A picture of one level and the sensor's noise."""
        picture = np.full((self.config.height_px, self.config.width_px), grey, dtype=np.uint8)
        self._imagers[eye].sense(picture, self._key(eye, frame_id), 1.0, 0.0)
        return picture

    def _key(self, eye: int, frame_id: int) -> int:
        """What chooses the noise of one picture."""
        return (self._seed * 0x2545F4914F6CDD1D + frame_id * 2 + eye) & 0x7FFF_FFFF_FFFF_FFFF


def _without_bodies(wall: WallConfig) -> WallConfig:
    """What of a wall its texture shows: light, relief and what stands before it are not in it."""
    plain = {"lighting_gradient_per_m": (0.0, 0.0), "undulation_mm": 0.0, "undulation_length_m": 1.0}
    return wall.model_copy(update=plain | {"drill_holes": (), "blocks": ()})


@lru_cache(maxsize=1)
def _texture(wall: WallConfig) -> Texture:
    """Packed mip levels, kept for the next camera before the same wall: they cost most of a second."""
    plain = wall_texture(wall.texture_seed, wall.mean_grey, wall.contrast_grey)
    return packed_levels(bared(plain, wall))
