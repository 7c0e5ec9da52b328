"""One eye: its exact lens, and the painting of everything that it sees, back to front."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from plant_emulator.config.camera import CameraConfig
from plant_emulator.core.camera import panel_painter, rasteriser, rays, wall_painter
from plant_emulator.core.camera.camera_motion import Capture
from plant_emulator.core.camera.lighting import NO_GLARE, glare_on, shadow_on
from plant_emulator.core.camera.plates import Plate
from plant_emulator.core.camera.scene import Cover, Scene
from plant_emulator.core.camera.true_eye import TrueEye
from plant_emulator.core.camera.wall_texture import SIZE, SIZE_BITS, Texture

Grey = NDArray[np.uint8]
Matrix = NDArray[np.float64]

_SKY_GREY = 90  # what rays that never meet the wall show
_RIM_PX = 2  # a plate's rim touches pixels this far outside its projected corners
_NEAREST_M = 0.02


class Eye:
    """Paints what one eye sees, (height, width) uint8."""

    def __init__(self, true: TrueEye, config: CameraConfig, scene: Scene, texture: Texture) -> None:
        self.true = true
        self.lens = true.lens
        self._size = (config.width_px, config.height_px)
        readout_s = config.shutter.line_s * (config.height_px - 1)
        self._ends_s = (0.0,) if readout_s == 0.0 else (-0.5 * readout_s, 0.5 * readout_s)
        self._rays = true.lens.ray_map(*self._size)
        self._scene = scene
        self._texture = texture

    def painted(self, capture: Capture, offset_s: float = 0.0, covers: Sequence[Cover] = ()) -> Grey:
        """What the eye sees ``offset_s`` after the capture's instant, without point spread and noise.

        ``covers`` lie over whatever else is on the wall, or on the tool.
        """
        width, height = self._size
        picture = np.empty((height, width), dtype=np.uint8)
        # at the first and the last row; one for all rows when they are exposed at once
        views = [capture.view_at(offset_s + end_s) for end_s in self._ends_s]
        X_CE = self.true.pose(capture.drift_px)
        X_EWs = [np.linalg.inv(view.X_WC @ X_CE) for view in views]
        X_EOs = [X_EW @ self._scene.mounts.X_WO for X_EW in X_EWs]
        X_EMs = [X_EW @ view.X_WM for X_EW, view in zip(X_EWs, views, strict=True)]
        time_s = 1e-9 * capture.capture_ns + offset_s
        self._paint_wall(picture, X_EOs, time_s)
        for plate in (*self._scene.wall_plates, *_of("O", covers)):
            X_OP = plate.X_parent_plate
            self._paint_plate(picture, [X_EO @ X_OP for X_EO in X_EOs], plate, X_OP, time_s)
        for passer in self._scene.passers:
            X_OPs = [passer.pose(time_s + end_s) for end_s in self._ends_s]
            X_EPs = [X_EO @ X_OP for X_EO, X_OP in zip(X_EOs, X_OPs, strict=True)]
            self._paint_plate(picture, X_EPs, passer.plate, X_OPs[0], time_s)
        for plate in (*self._scene.tool_plates, *_of("M", covers)):
            X_EPs = [X_EM @ plate.X_parent_plate for X_EM in X_EMs]
            # only light asks where in the scene the tool is
            X_OP = np.linalg.inv(X_EOs[0]) @ X_EPs[0] if self._scene.shaded else np.eye(4)
            self._paint_plate(picture, X_EPs, plate, X_OP, time_s)
        return picture

    def _paint_wall(self, picture: Grey, X_EOs: list[Matrix], time_s: float) -> None:
        wall = self._scene.config.wall
        per_m = 1000.0 / wall.texel_mm
        to_texels = np.array([[per_m, 0.0, SIZE / 2.0], [0.0, per_m, SIZE / 2.0], [0.0, 0.0, 1.0]])
        homographies = _first_and_last([to_texels @ _ray_to_plane(X_EO) for X_EO in X_EOs])
        along, down = wall.lighting_gradient_per_m[0] / per_m, -wall.lighting_gradient_per_m[1] / per_m
        shadow = shadow_on(self._scene.config.lighting.shadow, np.eye(4), time_s)
        shadow[:2] /= per_m
        shadow[2] -= (shadow[0] + shadow[1]) * SIZE / 2.0
        light = np.array([1.0 - (along + down) * SIZE / 2.0, along, down, *shadow])
        centre_O = -X_EOs[0][:3, :3].T @ X_EOs[0][:3, 3]
        relief = np.array(
            [
                wall.undulation_mm / 1000.0 / centre_O[2],  # height over the eye's distance from the wall
                1.0 / (wall.undulation_length_m * per_m),
                per_m * centre_O[0] + SIZE / 2.0,
                SIZE / 2.0 - per_m * centre_O[1],
            ]
        )
        pixel_area = 1.0 / float(np.prod(self.lens.focal))
        wall_painter.paint_wall(
            picture,
            self._rays,
            homographies,
            pixel_area,
            wall_painter.WallTexture(self._texture, SIZE_BITS),
            light,
            relief,
            _SKY_GREY,
        )

    def _paint_plate(
        self, picture: Grey, X_EPs: list[Matrix], plate: Plate, X_OP: Matrix, time_s: float
    ) -> None:
        if any(X[:3, 2] @ X[:3, 3] >= 0.0 for X in X_EPs):
            return  # seen from behind, where no plate of this scene has anything to show
        boxes = np.array([self._bounds(X, plate) for X in X_EPs])
        top, left = boxes[:, [0, 2]].min(axis=0)
        bottom, right = boxes[:, [1, 3]].max(axis=0)
        if top >= bottom or left >= right:
            return
        surface = self._surface(X_EPs, plate, X_OP, time_s)
        box = (int(top), int(bottom), int(left), int(right))
        homographies = _first_and_last([_ray_to_plane(X) for X in X_EPs])
        if plate.levels:
            panel = panel_painter.Panel(plate.edges_x, plate.edges_y, plate.levels)
            panel_painter.paint_panel(picture, self._rays, homographies, panel, box, surface)
            return
        grid = rasteriser.Grid(plate.edges_x, plate.edges_y, plate.grey)
        rasteriser.paint_plate(picture, self._rays, homographies, grid, box, surface)

    def _surface(self, X_EPs: list[Matrix], plate: Plate, X_OP: Matrix, time_s: float) -> rays.Surface:
        light = np.array([1.0, 0.0, 0.0])
        if plate.lit_by_wall:
            gradient = np.array(self._scene.config.wall.lighting_gradient_per_m)
            R, p = plate.X_parent_plate[:2, :2], plate.X_parent_plate[:2, 3]
            light = np.array([1.0 + gradient @ p, gradient @ R[:, 0], -(gradient @ R[:, 1])])
        eye_P = -np.mean([X[:3, :3].T @ X[:3, 3] for X in X_EPs], axis=0)
        curve, across, up = plate.bend
        lighting = self._scene.config.lighting
        return rays.Surface(
            light,
            np.array([curve, across, -up, eye_P[0], -eye_P[1], eye_P[2]]),
            shadow_on(lighting.shadow, X_OP, time_s),
            glare_on(lighting.glare, X_OP, eye_P) if plate.glossy else NO_GLARE,
        )

    def _bounds(self, X_EP: Matrix, plate: Plate) -> tuple[int, int, int, int]:
        """Pixel rows and columns (top, bottom, left, right; half open) that the plate may touch."""
        width, height = self._size
        x0, x1, y0, y1 = plate.edges_x[0], plate.edges_x[-1], -plate.edges_y[-1], -plate.edges_y[0]
        corners = np.array([[x0, y0, 0.0], [x1, y0, 0.0], [x1, y1, 0.0], [x0, y1, 0.0]])
        rims = corners.copy()
        rims[:, 2] = plate.bend.height(corners[:, 0], corners[:, 1])
        in_eye = np.concatenate([corners, rims]) @ X_EP[:3, :3].T + X_EP[:3, 3]
        if (in_eye[:, 2] <= _NEAREST_M).all():
            return (0, 0, 0, 0)
        if (in_eye[:, 2] <= _NEAREST_M).any():
            return (0, height, 0, width)
        image = self.lens.project(in_eye)
        low = np.clip(np.floor(image.min(axis=0)) - _RIM_PX, 0, [width, height]).astype(int)
        high = np.clip(np.ceil(image.max(axis=0)) + _RIM_PX + 1, 0, [width, height]).astype(int)
        return (int(low[1]), int(high[1]), int(low[0]), int(high[0]))


def _of(parent: str, covers: Sequence[Cover]) -> list[Plate]:
    """The covers that move with ``parent``."""
    return [cover.plate for cover in covers if cover.parent == parent]


def _first_and_last(homographies: list[Matrix]) -> Matrix:
    """Those (2, 3, 3) of the first and of the last row, from both or from the one that all rows share."""
    return np.stack([homographies[0], homographies[-1]])


def _ray_to_plane(X_EP: Matrix) -> Matrix:
    """Homography (3x3) from a normalised ray (x, y, 1) to coordinates (x right, y down) on the plane z_P = 0.

    Its third component is 1/depth: positive where the ray meets the plane in front of the eye.
    """
    columns = np.stack([X_EP[:3, 0], -X_EP[:3, 1], X_EP[:3, 3]], axis=1)
    return np.asarray(np.linalg.inv(columns), dtype=np.float64)
