"""The stereo camera as it truly is: renders what its two eyes see, and projects points exactly."""

from collections.abc import Sequence
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from plant_emulator.config.camera import CameraConfig
from plant_emulator.config.surroundings import WallConfig
from plant_emulator.core.camera import rasteriser
from plant_emulator.core.camera.camera_motion import STILL, CameraMotion, CameraView, Capture
from plant_emulator.core.camera.exposures import Shot
from plant_emulator.core.camera.eye import Eye
from plant_emulator.core.camera.imager import AutoExposure, Imager
from plant_emulator.core.camera.scene import Cover, Scene
from plant_emulator.core.camera.true_eye import true_eyes
from plant_emulator.core.camera.wall.wall_texture import Texture, drilled, packed_levels, wall_texture

Grey = NDArray[np.uint8]
Matrix = NDArray[np.float64]

LEFT, RIGHT = 0, 1
_NOISE_STREAM = 0x6E6F697365


class StereoCamera:
    """Renders stereo pairs by projective geometry, anti-aliased. Deterministic for each (seed, frame_id),
    with auto exposure for the sequence of pictures.

    Poses are 4x4: ``X_WC`` of the left eye and ``X_WM`` of the tool marker in the world W, OpenCV axes for
    the camera. ``motion`` matters only with motion blur or a rolling shutter; the poses are those at the
    middle of the exposure of the middle row.
    """

    def __init__(self, config: CameraConfig, scene: Scene, seed: int) -> None:
        self.config = config
        self.scene = scene
        self._seed = seed
        texture = _texture(_painted(scene.config.wall))
        self.eyes = tuple(Eye(true, config, scene, texture) for true in true_eyes(config))
        generator = np.random.default_rng((seed, _NOISE_STREAM))
        grey = generator.standard_normal(rasteriser.NOISE_LENGTH) * config.noise_grey
        noise = np.clip(np.rint(grey * rasteriser.NOISE_UNIT), -32768, 32767).astype(np.int16)
        self._imagers = [Imager(config, k, eye.lens.centre, noise) for k, eye in enumerate(self.eyes)]
        self._exposure = AutoExposure(config.auto_exposure)

    def render(
        self, X_WC: Matrix, X_WM: Matrix, frame_id: int, motion: CameraMotion = STILL
    ) -> tuple[Grey, Grey]:
        """The two eyes' pictures (left, right), each (height, width) uint8."""
        view = CameraView(X_WC, X_WM)
        return self.render_eye(LEFT, view, frame_id, motion), self.render_eye(RIGHT, view, frame_id, motion)

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

    def project_corners(self, X_WC: Matrix, X_WM: Matrix) -> dict[int, tuple[Matrix, Matrix]]:
        """Marker id → its four printed corners in (left, right), (4, 2) px each, in ArUco's order."""
        parents = {"O": self.scene.mounts.X_WO, "M": X_WM}
        return {
            marker: self.project(X_WC, corners @ parents[parent][:3, :3].T + parents[parent][:3, 3])
            for marker, (parent, corners) in self.scene.marker_corners().items()
        }

    def _captured(self, eye: int, capture: Capture, covers: Sequence[Cover] = ()) -> Grey:
        """One eye's picture of a capture."""
        samples, exposure_s = self.config.motion_blur_samples, 1e-6 * self.config.exposure_us
        pictures = [
            self.eyes[eye].painted(capture, exposure_s * ((k + 0.5) / samples - 0.5), covers)
            for k in range(samples)
        ]
        picture = pictures[0] if samples == 1 else rasteriser.mean_of(np.stack(pictures))
        return self._exposed(picture, eye, capture)

    def _exposed(self, picture: Grey, eye: int, capture: Capture) -> Grey:
        """The picture after point spread, exposure, dirt, vignetting and noise."""
        config = self.config
        if config.blur_px > 0.0:
            size = 2 * int(np.ceil(2.5 * config.blur_px)) + 1
            cv2.GaussianBlur(picture, (size, size), config.blur_px, dst=picture)
        gain = config.exposure_gain * self._exposure.gain(picture, config.exposure_gain, capture.capture_ns)
        self._imagers[eye].expose(picture, self._key(eye, capture.frame_id), gain)
        return picture

    def _even(self, grey: int, eye: int, frame_id: int) -> Grey:
        """A picture of one level and the sensor's noise."""
        picture = np.full((self.config.height_px, self.config.width_px), grey, dtype=np.uint8)
        self._imagers[eye].sense(picture, self._key(eye, frame_id), 1.0, 0.0)
        return picture

    def _key(self, eye: int, frame_id: int) -> int:
        """What chooses the noise of one picture."""
        return (self._seed * 0x2545F4914F6CDD1D + frame_id * 2 + eye) & 0x7FFF_FFFF_FFFF_FFFF


def _painted(wall: WallConfig) -> WallConfig:
    """What of a wall its texture shows: light, relief and what stands before it are not in it."""
    plain = {"lighting_gradient_per_m": (0.0, 0.0), "undulation_mm": 0.0, "undulation_length_m": 1.0}
    paint = tuple(hole for hole in wall.drill_holes if hole.depth_m == 0.0)
    return wall.model_copy(update=plain | {"drill_holes": paint, "blocks": ()})


@lru_cache(maxsize=1)
def _texture(wall: WallConfig) -> Texture:
    """Packed mip levels, kept for the next camera before the same wall: they cost most of a second."""
    plain = wall_texture(wall.texture_seed, wall.mean_grey, wall.contrast_grey)
    return packed_levels(drilled(plain, wall))
