"""A wall with holes as two eyes see it, drawn by the tests' own renderer."""

from typing import NamedTuple

import cv2
import numpy as np

from foundation.configuration import load
from tests.support.paths import CONFIGS
from tests.vision_pc.rendering import Marker, draw_marker, draw_wall, facing, finish, wall_texture
from vision_pc.config.vision import VisionConfig
from vision_pc.core import se3
from vision_pc.core.perception import intrinsics
from vision_pc.core.perception.look import observe
from vision_pc.core.se3 import Array
from vision_pc.core.targets.sighting import Sighted
from vision_pc.core.types import StereoPair

VISION = load(VisionConfig, CONFIGS / "vision.yaml")
CAMERA = intrinsics.calibration(VISION.camera)
TEXEL = 0.001
SIZE = 2000
HOLES = ((-0.16, 0.05), (0.14, 0.07), (0.02, -0.14))
DIAMETER = 0.045
X_CM = facing(0.20, 0.16, 0.42)


class WallScene(NamedTuple):
    """A pair, and where the wall truly is in C."""

    pair: StereoPair
    X_CW: Array

    def sighted(self) -> Sighted:
        """With what the markers in the pair tell."""
        observation = observe(self.pair, CAMERA, VISION.markers)
        return Sighted(self.pair, CAMERA, observation, VISION.markers, VISION.targets)

    def point(self, x: float, y: float) -> Array:
        """A place of the wall (m, x right, y up) in C, (3,)."""
        return se3.apply(self.X_CW, np.array([[x, y, 0.0]]))[0]

    def pixel(self, x: float, y: float, eye: str = "left") -> Array:
        """Where an eye sees it."""
        return intrinsics.project(getattr(CAMERA, eye), self.point(x, y)[None])[0]


def rock(seed: int = 3, contrast: float = 22.0) -> Array:
    """A rough wall with drill holes painted on it."""
    texture = wall_texture(seed, contrast, SIZE)
    for x, y in HOLES:
        centre = (SIZE - 1) / 2 + np.array([x, -y]) / TEXEL
        for radius, grey in ((1.2 * DIAMETER / 2, 160.0), (DIAMETER / 2, 16.0)):
            at = tuple(np.rint(centre * 256).astype(int).tolist())
            cv2.circle(texture, at, round(radius / TEXEL * 256), grey, cv2.FILLED, cv2.LINE_AA, 8)
    return texture


def scene(
    texture: Array, X_CW: Array, seed: int = 1, step: tuple[float, Array] | None = None, tool: bool = True
) -> WallScene:
    """``step``: left of this column of the wall, m, another plane is nearer: X_CW of it."""
    generator, pictures = np.random.default_rng(seed), []
    for eye in (CAMERA.left, CAMERA.right):
        shape = (CAMERA.height, CAMERA.width)
        picture = draw_wall(eye, shape, texture, TEXEL, X_CW)
        if step is not None:
            x, X_CN = step
            near = draw_wall(eye, shape, texture, TEXEL, X_CN)
            edge = intrinsics.project(eye, se3.apply(X_CN, np.array([[x, -2.0, 0.0], [x, 2.0, 0.0]])))
            columns = np.interp(np.arange(CAMERA.height), *np.sort(edge[:, ::-1], axis=0).T)
            beside = np.arange(CAMERA.width)[None] < columns[:, None]
            picture = np.where(beside, near, picture)
        if tool:
            draw_marker(picture, eye, Marker(VISION.markers.tool.id, 0.1, X_CM, 0.15), 4)
        pictures.append(finish(picture, generator))
    return WallScene(StereoPair(pictures[0], pictures[1], 0, seed), X_CW)
