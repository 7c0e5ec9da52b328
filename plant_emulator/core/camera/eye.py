"""One eye: its exact lens, and the painting of everything that it sees, back to front."""

import math
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plant_emulator.config.camera import CameraConfig
from plant_emulator.core.camera import rasteriser, rays
from plant_emulator.core.camera.exposures import Capture
from plant_emulator.core.camera.plates import Placed, Plate, Sheets, placed, ray_to_plane, sheets
from plant_emulator.core.camera.rays import Lens
from plant_emulator.core.camera.scene import Cover, Scene
from plant_emulator.core.camera.surroundings import shadow_on
from plant_emulator.core.camera.wall import bores, wall_painter
from plant_emulator.core.camera.wall.wall_texture import SIZE, SIZE_BITS, Texture
from plant_emulator.core.mechanics.geometry import rotation_from_vector, transform

Matrix = NDArray[np.float64]


_ROW_SEARCHES = 4  # each is wrong by the share of a row that the shutter moves a point by: far below 1


class TrueEye(NamedTuple):
    """``X_CE``: the eye's pose (4x4) in the left one at the first capture. ``drifts``: the right one does."""

    lens: Lens
    X_CE: Matrix
    drifts: bool

    def pose(self, drift_px: tuple[float, float]) -> Matrix:
        """X_CE (4x4) after a drift that adds (disparity, rows) px at the principal point."""
        if not self.drifts or drift_px == (0.0, 0.0):
            return self.X_CE
        yaw, pitch = (math.atan(px / focal) for px, focal in zip(drift_px, self.lens.focal, strict=True))
        turn = rotation_from_vector(np.array([0.0, yaw, 0.0])) @ rotation_from_vector(
            np.array([pitch, 0.0, 0.0])
        )
        return np.asarray(self.X_CE @ transform(turn, np.zeros(3)), dtype=np.float64)

    def project(self, X_WC: Matrix, points: Matrix, drift_px: tuple[float, float] = (0.0, 0.0)) -> Matrix:
        """Exact image coordinates (n, 2) px of points (n, 3) in W; NaN behind the eye."""
        return self.seen_from(X_WC @ self.pose(drift_px), points)

    def seen_from(self, X_WE: Matrix, points: Matrix) -> Matrix:
        """The same where the eye's own pose in W is known."""
        return self.lens.project((points - X_WE[:3, 3]) @ X_WE[:3, :3])


def true_eyes(config: CameraConfig) -> tuple[TrueEye, TrueEye]:
    """The left and the right eye as they truly are."""
    rectification = config.rectification
    twist = rotation_from_vector(np.radians(np.array(rectification.right_eye_rotation_deg)))
    lens = Lens(
        config.lens_difference.added_to(config.lens), -rectification.disparity_px, rectification.vertical_px
    )
    right = TrueEye(lens, transform(twist, np.array([config.baseline_m, 0.0, 0.0])), drifts=True)
    return TrueEye(Lens(config.lens), np.eye(4), drifts=False), right


def as_read(project: Callable[[float], Matrix], config: CameraConfig) -> Matrix:
    """Image coordinates (n, 2) px of points that move while the rows are read.

    ``project`` gives them for an instant (s) after the capture; each point is seen when its own row is read.
    Between first, middle and last row its way is taken for a parabola.
    """
    line_s, last = config.shutter.line_s, float(config.height_px - 1)
    middle = project(0.0)
    if line_s == 0.0:
        return middle
    early, late = project(-0.5 * line_s * last), project(0.5 * line_s * last)
    way, bow, seen = late - early, late + early - 2.0 * middle, middle
    for _ in range(_ROW_SEARCHES):
        share = np.clip(2.0 * seen[:, 1:] / last - 1.0, -1.0, 1.0)  # NaN, behind the eye, stays
        seen = middle + 0.5 * share * way + 0.5 * (share * share) * bow
    return seen


Grey = NDArray[np.uint8]

_SKY_GREY = 90  # what rays that never meet the wall show


class Eye:
    """Paints what one eye sees, (height, width) uint8."""

    def __init__(self, true: TrueEye, config: CameraConfig, scene: Scene, texture: Texture) -> None:
        self.true = true
        self.lens = true.lens
        self._size = (config.width_px, config.height_px)
        readout_s = config.shutter.line_s * (config.height_px - 1)
        self._ends_s = (0.0,) if readout_s == 0.0 else (-0.5 * readout_s, 0.5 * readout_s)
        self._rays = true.lens.ray_map(*self._size)
        self._widest = np.array([extreme(axis) for axis in self._rays for extreme in (np.min, np.max)])
        self._scene = scene
        self._texture = texture

    def painted(self, capture: Capture, covers: Sequence[Cover] = ()) -> Grey:
        """What the eye sees, without point spread and noise.

        ``covers`` lie over whatever else is on the wall, or on the tool.
        """
        width, height = self._size
        picture = np.empty((height, width), dtype=np.uint8)
        # at the first and the last row; one for all rows when they are exposed at once
        views = [capture.view_at(end_s) for end_s in self._ends_s]
        X_CE = self.true.pose(capture.drift_px)
        X_EWs = np.stack([np.linalg.inv(view.X_WC @ X_CE) for view in views])
        X_EOs = X_EWs @ self._scene.mounts.X_WO
        X_EMs = np.stack([X_EW @ view.X_WM for X_EW, view in zip(X_EWs, views, strict=True)])
        time_s = 1e-9 * capture.capture_ns
        edge_m = self._scene.config.lighting.shadow.edge_m(time_s)
        self._paint_wall(picture, X_EOs, edge_m)
        for group in (self._on_wall, self._sheets(_of("O", covers))):
            X_OPs = self._slid(group.poses, capture.view.X_WO)
            self._paint_plates(picture, group, X_EOs @ X_OPs[:, None], X_OPs, edge_m)
        for passer, group in zip(self._scene.passers, self._passing, strict=True):
            X_OPs = np.stack([passer.pose(time_s + end_s) for end_s in self._ends_s])
            self._paint_plates(picture, group, (X_EOs @ X_OPs)[None], X_OPs[:1], edge_m)
        for group in (self._on_tool, self._sheets(_of("M", covers))):
            X_EPs = X_EMs @ group.poses[:, None]
            # only light asks where in the scene the tool is
            X_OPs = np.linalg.inv(X_EOs[0]) @ X_EPs[:, 0] if self._scene.shaded else group.poses
            self._paint_plates(picture, group, X_EPs, X_OPs, edge_m)
        return picture

    @cached_property
    def _bores(self) -> tuple[bores.Bore, ...]:
        wall = self._scene.config.wall
        return tuple(bores.bore(hole, wall) for hole in wall.drill_holes)

    @cached_property
    def _on_wall(self) -> Sheets:
        return self._sheets(self._scene.wall_plates)

    @cached_property
    def _on_tool(self) -> Sheets:
        return self._sheets(self._scene.tool_plates)

    @cached_property
    def _passing(self) -> list[Sheets]:
        return [self._sheets((passer.plate,)) for passer in self._scene.passers]

    def _slid(self, X_OPs: Matrix, X_WO: Matrix | None) -> Matrix:
        """Where plates (n, 4, 4) in O are, in the O of the scene, once the object has slid to ``X_WO``."""
        there = self._scene.mounts.X_WO
        if X_WO is None or np.array_equal(X_WO, there):
            return X_OPs
        return np.asarray(np.linalg.inv(there) @ X_WO @ X_OPs)

    def _sheets(self, plates: tuple[Plate, ...]) -> Sheets:
        return sheets(plates, self._scene.config.wall.lighting_gradient_per_m)

    def _paint_wall(self, picture: Grey, X_EOs: Matrix, edge_m: float) -> None:
        wall = self._scene.config.wall
        per_m = 1000.0 / wall.texel_mm
        to_texels = np.array([[per_m, 0.0, SIZE / 2.0], [0.0, per_m, SIZE / 2.0], [0.0, 0.0, 1.0]])
        homographies = (to_texels @ ray_to_plane(X_EOs))[[0, -1]]
        along, down = wall.lighting_gradient_per_m[0] / per_m, -wall.lighting_gradient_per_m[1] / per_m
        shadow = shadow_on(self._scene.config.lighting.shadow, np.eye(4), edge_m)
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
        if self._bores:
            bores.cut(picture, self._rays, self._bores, self._view(X_EOs, edge_m), X_EOs[0], self.lens)

    def _view(self, X_EOs: Matrix, edge_m: float) -> bores.View:
        """How the eye sees the wall's plane."""
        shadow = shadow_on(self._scene.config.lighting.shadow, np.eye(4), edge_m)
        return bores.view(X_EOs, self._scene.config.wall, shadow)

    def _paint_plates(
        self, picture: Grey, group: Sheets, X_EPs: Matrix, X_OPs: Matrix, edge_m: float
    ) -> None:
        """Paint ``group``, at ``X_EPs`` (n, m, 4, 4) in the eye and ``X_OPs`` (n, 4, 4) in the scene."""
        if not group.plates:
            return
        for one in placed(group.rims, X_EPs, self.lens, self._size, self._widest):
            plate = group.plates[one.number]
            surface = self._surface(group, one, X_OPs[one.number], edge_m)
            grid = rasteriser.Grid(plate.edges_x, plate.edges_y, plate.grey)
            rasteriser.paint_plate(picture, self._rays, one.homographies, grid, one.box, surface)

    def _surface(self, group: Sheets, one: Placed, X_OP: Matrix, edge_m: float) -> rays.Surface:
        plate, eye_P = group.plates[one.number], one.eye_P
        curve, across, up = plate.bend
        return rays.Surface(
            group.lights[one.number],
            np.array([curve, across, -up, eye_P[0], -eye_P[1], eye_P[2]]),
            shadow_on(self._scene.config.lighting.shadow, X_OP, edge_m),
        )


def _of(parent: str, covers: Sequence[Cover]) -> tuple[Plate, ...]:
    """The covers that move with ``parent``."""
    return tuple(cover.plate for cover in covers if cover.parent == parent)
