"""The stereo camera as it truly is: renders what its two eyes see, and projects points exactly."""

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from plant_emulator.core import rasteriser, wall_painter
from plant_emulator.core.geometry import transform
from plant_emulator.core.lens import Lens
from plant_emulator.core.scene import Plate, Scene, rotation_matrix
from plant_emulator.core.wall_texture import SIZE, SIZE_BITS, wall_texture
from plant_emulator.scene_config import CameraConfig, WallConfig

Grey = NDArray[np.uint8]
Matrix = NDArray[np.float64]

LEFT, RIGHT = 0, 1
_SKY_GREY = 90  # what rays that never meet the wall show
_FULL_GREY_MARGIN_PX = 2  # a plate's rim touches pixels this far outside its projected corners


class StereoCamera:
    """Renders stereo pairs by projective geometry with anti-aliasing. Deterministic for each (seed,
    frame_id).

    Poses are 4x4: ``X_WC`` of the left eye and ``X_WM`` of the tool marker in the world W, OpenCV axes for
    the camera.
    """

    def __init__(self, config: CameraConfig, scene: Scene, seed: int) -> None:
        self.config = config
        self.scene = scene
        self._seed = seed
        rectification = config.rectification
        self.lenses = (
            Lens(config.lens),
            Lens(config.lens, -rectification.disparity_px, rectification.vertical_px),
        )
        twist = rotation_matrix(rectification.right_eye_rotation_deg)
        self.X_C_eye = (np.eye(4), transform(twist, np.array([config.baseline_m, 0.0, 0.0])))
        self._rays = tuple(lens.ray_map(config.width_px, config.height_px) for lens in self.lenses)
        self._texture = _packed_texture(scene.config.wall)
        self._texels_per_m = 1000.0 / scene.config.wall.texel_mm
        generator = np.random.default_rng((seed, 0x6E6F697365))
        self._noise = np.clip(
            np.rint(
                generator.standard_normal(rasteriser.NOISE_LENGTH) * config.noise_grey * rasteriser.NOISE_UNIT
            ),
            -32768,
            32767,
        ).astype(np.int16)

    def render(self, X_WC: Matrix, X_WM: Matrix, frame_id: int) -> tuple[Grey, Grey]:
        """The two eyes' pictures (left, right), each (height, width) uint8."""
        return self.render_eye(LEFT, X_WC, X_WM, frame_id), self.render_eye(RIGHT, X_WC, X_WM, frame_id)

    def render_eye(self, eye: int, X_WC: Matrix, X_WM: Matrix, frame_id: int) -> Grey:
        """One eye's picture, (height, width) uint8; ``eye`` is LEFT or RIGHT."""
        X_WE = X_WC @ self.X_C_eye[eye]
        X_EW = np.linalg.inv(X_WE)
        X_EO, X_EM = X_EW @ self.scene.mounts.X_WO, X_EW @ X_WM
        picture = np.empty((self.config.height_px, self.config.width_px), dtype=np.uint8)
        self._paint_wall(picture, eye, X_EO)
        for plate in self.scene.wall_plates:
            self._paint_plate(picture, eye, X_EO, plate)
        for plate in self.scene.tool_plates:
            self._paint_plate(picture, eye, X_EM, plate)
        return self._exposed(picture, eye, frame_id)

    def project(self, X_WC: Matrix, points: Matrix) -> tuple[Matrix, Matrix]:
        """Exact image coordinates (left, right), each (n, 2) px, of points (n, 3) in W; NaN behind the
        camera.
        """
        left, right = (
            lens.project((points - X_WE[:3, 3]) @ X_WE[:3, :3])
            for lens, X_WE in zip(self.lenses, (X_WC @ X for X in self.X_C_eye), strict=True)
        )
        return left, right

    def project_corners(self, X_WC: Matrix, X_WM: Matrix) -> dict[int, tuple[Matrix, Matrix]]:
        """Marker id → its four printed corners in (left, right) image coordinates, (4, 2) px each, ArUco
        order.
        """
        parents = {"O": self.scene.mounts.X_WO, "M": X_WM}
        return {
            marker: self.project(X_WC, corners @ parents[parent][:3, :3].T + parents[parent][:3, 3])
            for marker, (parent, corners) in self.scene.marker_corners().items()
        }

    def _paint_wall(self, picture: Grey, eye: int, X_EO: Matrix) -> None:
        per_m = self._texels_per_m
        to_texels = np.array([[per_m, 0.0, SIZE / 2.0], [0.0, per_m, SIZE / 2.0], [0.0, 0.0, 1.0]])
        homography = to_texels @ _ray_to_plane(X_EO)
        gradient = self.scene.config.wall.lighting_gradient_per_m
        slope = np.array([gradient[0], -gradient[1]]) / per_m
        light = slope @ homography[:2] + (1.0 - slope.sum() * SIZE / 2.0) * homography[2]
        pixel_area = 1.0 / float(np.prod(self.lenses[eye].focal))
        ray_x, ray_y = self._rays[eye]
        wall_painter.paint_wall(
            picture, ray_x, ray_y, homography, pixel_area, self._texture, SIZE_BITS, light, _SKY_GREY
        )

    def _paint_plate(self, picture: Grey, eye: int, X_E_parent: Matrix, plate: Plate) -> None:
        X_EP = X_E_parent @ plate.X_parent_plate
        if X_EP[:3, 2] @ X_EP[:3, 3] >= 0.0:
            return  # seen from behind, where no plate of this scene has anything to show
        box = self._bounding_box(eye, X_EP, plate)
        if box is None:
            return
        light = np.array([1.0, 0.0, 0.0])
        if plate.lit_by_wall:
            gradient = np.array(self.scene.config.wall.lighting_gradient_per_m)
            R, p = plate.X_parent_plate[:2, :2], plate.X_parent_plate[:2, 3]
            light = np.array([1.0 + gradient @ p, gradient @ R[:, 0], -(gradient @ R[:, 1])])
        rasteriser.paint_plate(
            picture,
            *self._rays[eye],
            _ray_to_plane(X_EP),
            plate.edges_x,
            plate.edges_y,
            plate.grey,
            box,
            light,
        )

    def _bounding_box(self, eye: int, X_EP: Matrix, plate: Plate) -> tuple[int, int, int, int] | None:
        """Pixel rows and columns (top, bottom, left, right; half open) that the plate may touch; None when
        outside.
        """
        height, width = self.config.height_px, self.config.width_px
        x0, x1, y0, y1 = plate.edges_x[0], plate.edges_x[-1], -plate.edges_y[-1], -plate.edges_y[0]
        corners = np.array([[x0, y0, 0.0], [x1, y0, 0.0], [x1, y1, 0.0], [x0, y1, 0.0]])
        in_eye = corners @ X_EP[:3, :3].T + X_EP[:3, 3]
        if not (in_eye[:, 2] > 0.02).any():
            return None
        if not (in_eye[:, 2] > 0.02).all():
            return (0, height, 0, width)
        image = self.lenses[eye].project(in_eye)
        low = np.floor(image.min(axis=0)).astype(int) - _FULL_GREY_MARGIN_PX
        high = np.ceil(image.max(axis=0)).astype(int) + _FULL_GREY_MARGIN_PX + 1
        left, top = max(int(low[0]), 0), max(int(low[1]), 0)
        right, bottom = min(int(high[0]), width), min(int(high[1]), height)
        return (top, bottom, left, right) if top < bottom and left < right else None

    def _exposed(self, picture: Grey, eye: int, frame_id: int) -> Grey:
        """The picture after point spread, exposure, vignetting and noise."""
        config = self.config
        if config.blur_px > 0.0:
            size = 2 * int(np.ceil(2.5 * config.blur_px)) + 1
            cv2.GaussianBlur(picture, (size, size), config.blur_px, dst=picture)
        if config.noise_grey == 0.0 and config.vignetting == 0.0 and config.exposure_gain == 1.0:
            return picture
        centre = self.lenses[eye].centre
        corner_squared = (config.width_px / 2.0) ** 2 + (config.height_px / 2.0) ** 2
        key = (self._seed * 0x2545F4914F6CDD1D + frame_id * 2 + eye) & 0x7FFF_FFFF_FFFF_FFFF
        rasteriser.finish(
            picture,
            self._noise,
            key,
            config.exposure_gain,
            config.vignetting / corner_squared,
            centre[0],
            centre[1],
        )
        return picture


@lru_cache(maxsize=1)
def _packed_texture(wall: WallConfig) -> tuple[NDArray[np.int32], ...]:
    """Packed mip levels, kept for the next camera before the same wall: they cost most of a second."""
    levels = wall_texture(wall.texture_seed, wall.mean_grey, wall.contrast_grey)
    return tuple(wall_painter.packed(level) for level in levels)


def _ray_to_plane(X_EP: Matrix) -> Matrix:
    """Homography (3x3) from a normalised ray (x, y, 1) to coordinates (x right, y down) on the plane z_P = 0.

    Its third component is 1/depth: positive where the ray meets the plane in front of the eye.
    """
    columns = np.stack([X_EP[:3, 0], -X_EP[:3, 1], X_EP[:3, 3]], axis=1)
    return np.asarray(np.linalg.inv(columns), dtype=np.float64)
