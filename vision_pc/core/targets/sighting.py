"""What a target is measured in, what is asked for, and what of it an eye can see."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from vision_pc.config.programs import TargetSettings
from vision_pc.config.vision import MarkerSettings
from vision_pc.core.odometry.moving_regions import static_pixels
from vision_pc.core.perception import intrinsics
from vision_pc.core.perception.intrinsics import as_believed
from vision_pc.core.se3 import Array
from vision_pc.core.targets import row_matching
from vision_pc.core.targets.target import Kind, TargetRefused
from vision_pc.core.types import CameraCalibration, FrameObservation, StereoPair

_HIDDEN_RADIUS_PX = 12


class Sighted(NamedTuple):
    """A pair with what is believed of its camera: markers' ``observation``, and the settings."""

    pair: StereoPair
    camera: CameraCalibration
    observation: FrameObservation
    markers: MarkerSettings
    settings: TargetSettings

    @property
    def believed(self) -> CameraCalibration:
        """The camera with all that markers have told of it."""
        return as_believed(self.camera, self.observation)


class Click(NamedTuple):
    """A place in the left eye's picture, px; ``other``: the same in the right one, where that is wanted."""

    pixel: Array
    kind: Literal["auto", "plane", "hole"] = "auto"
    diameter_mm: float | None = None
    other: Array | None = None


class KnownTarget(NamedTuple):
    """A target as it is believed to be: X_CO with its covariance (6, 6)."""

    kind: Kind
    X_CO: Array
    covariance: Array
    diameter_m: float | None


def visible(sighted: Sighted, camera: CameraCalibration, known: KnownTarget) -> Array:
    """The left eye's pixel (2,) of a known target. Raises TargetRefused where either eye cannot see it."""
    pixels = [intrinsics.project(eye, known.X_CO[None, :3, 3])[0] for eye in (camera.left, camera.right)]
    for pixel in pixels:
        row_matching.refuse_outside(pixel, camera)
    refuse_hidden(sighted, camera, pixels, _HIDDEN_RADIUS_PX)
    return np.asarray(pixels[0])


def refuse_hidden(
    sighted: Sighted, camera: CameraCalibration, pixels: Sequence[Array], radius_px: int
) -> None:
    """Raises TargetRefused where an eye sees the tool at its pixel (2,); ``pixels``: the left eye's first."""
    X_CM = sighted.observation.X_CM
    if X_CM is None:
        return
    for mask, pixel in zip(static_pixels(X_CM, sighted.markers.tool, camera), pixels, strict=False):
        left, top, right, bottom = region(pixel[0], pixel[1], radius_px, camera)
        if not mask[top:bottom, left:right].all():
            raise TargetRefused("target.hidden", "target: the tool is before it")


def region(u: float, v: float, reach: int, camera: CameraCalibration) -> tuple[int, int, int, int]:
    """Left, top, right and bottom, px, of what lies within ``reach`` of a pixel and in the picture."""
    return (
        max(int(u) - reach, 0),
        max(int(v) - reach, 0),
        min(int(u) + reach + 1, camera.width),
        min(int(v) + reach + 1, camera.height),
    )
