"""What the true camera would see, without painting it: corners, wall points, and what hides what."""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from plant_emulator.config.camera import CameraConfig
from plant_emulator.core.camera.camera_motion import Capture
from plant_emulator.core.camera.scene import Plate, Scene
from plant_emulator.core.camera.true_eye import TrueEye, as_read, true_eyes
from vision_pc.core.se3 import Array, apply, inverse

Flags = NDArray[np.bool_]

_RIM_PX = 3.0  # OpenCV's detector leaves out what is nearer to the picture's rim


_ON_IT_M = 1e-6
_TRACKABLE = 0.4  # share of the wall's contrast below which nothing holds a tracked point


class SeenMarker(NamedTuple):
    """The exact corners (4, 2) px of one marker in each eye; None where it is out of view or hidden."""

    left: Array | None
    right: Array | None


class TrueView:
    """Projections of the true scene through the true camera. In view is what is ``rim_px`` from the rim."""

    def __init__(self, camera: CameraConfig, scene: Scene, rim_px: float = _RIM_PX) -> None:
        self._rim_px = rim_px
        self._camera = camera
        self._eyes = true_eyes(camera)
        self._size = np.array([camera.width_px, camera.height_px], dtype=np.float64)
        self._scene = scene
        wall = scene.config.wall
        self._wall_is_plain = not (wall.bare_patches or wall.blocks or scene.hiding(0.0))
        self._outlines = [_outline(plate) for plate in scene.tool_plates]

    def markers(self, shown: Capture) -> dict[int, SeenMarker]:
        """Every marker's exact corners in both eyes."""
        hiding = [self._hiding(eye, shown) for eye in self._eyes]
        standing = self._scene.hiding(_time_s(shown))
        seen = {}
        for number, (parent, corners) in self._scene.marker_corners().items():
            on_tool = parent == "M"
            points = corners if on_tool else apply(self._scene.mounts.X_WO, corners)
            both = [
                None
                if not on_tool and self._behind(eye, shown, points, standing).any()
                else self._whole(self._seen_by(eye, shown, points, on_tool), [] if on_tool else hidden)
                for eye, hidden in zip(self._eyes, hiding, strict=True)
            ]
            seen[number] = SeenMarker(*both)
        return seen

    def project(self, shown: Capture, points_W: Array) -> tuple[Array, Array]:
        """Exact (left, right) pixels (n, 2) of points (n, 3) that rest in W; NaN behind the eye."""
        left, right = (self._seen_by(eye, shown, points_W) for eye in self._eyes)
        return left, right

    def inside(self, pixels: Array) -> Array:
        """Which ``pixels`` (n, 2) lie in the picture; NaN does not."""
        with np.errstate(invalid="ignore"):
            low, high = self._rim_px, self._size - 1.0 - self._rim_px
            return np.asarray(np.all((pixels >= low) & (pixels <= high), axis=1))

    def hidden(self, shown: Capture, points_W: Array) -> tuple[Flags, Flags]:
        """Which of the points (n, 3) something before the wall hides from the left and the right eye."""
        standing = self._scene.hiding(_time_s(shown))
        left, right = (self._behind(eye, shown, points_W, standing) for eye in self._eyes)
        return left, right

    def on_wall(self, shown: Capture, rays: Array) -> Array:
        """Points (m, 3) in W where ``rays`` (n, 2) = x/z, y/z of the left eye meet the wall or a block's face
        and find something to see, m ≤ n.
        """
        X_OW, X_WC = inverse(self._scene.mounts.X_WO), shown.view.X_WC
        directions = np.column_stack([rays, np.ones(len(rays))]) @ (X_OW[:3, :3] @ X_WC[:3, :3]).T
        start = apply(X_OW, X_WC[None, :3, 3])[0]
        towards = directions[:, 2] < -1e-6
        along = -start[2] / directions[towards, 2]
        points = start + directions[towards] * along[:, None]
        if self._wall_is_plain:
            return apply(self._scene.mounts.X_WO, points)
        points = self._rough(self._scene.mounts.X_WO, start, points)
        return points[~self._behind(self._eyes[0], shown, points, self._scene.hiding(_time_s(shown)))]

    def _rough(self, X_WO: Array, start: Array, points: Array) -> Array:
        """In W: the points of the wall's plane, or of the block's face before them, that are not bare."""
        wall = self._scene.config.wall
        kept = np.ones(len(points), dtype=bool)
        for patch in wall.bare_patches:
            if patch.contrast < _TRACKABLE:
                kept &= np.linalg.norm(points[:, :2] - patch.centre_m, axis=1) > patch.radius_m
        for block in sorted(wall.blocks, key=lambda block: block.depth_m):
            face = points + (start - points) * (block.depth_m / start[2])
            on_face = np.all(np.abs(face[:, :2] - block.centre_m) <= 0.5 * np.array(block.size_m), axis=1)
            points, kept = np.where(on_face[:, None], face, points), kept | on_face
        return apply(X_WO, points[kept])

    def _whole(self, pixels: Array, hiding: list[Array]) -> Array | None:
        if not self.inside(pixels).all():
            return None
        quad = pixels.astype(np.float32)
        hidden = any(cv2.intersectConvexConvex(quad, other)[0] > 0.0 for other in hiding)
        return None if hidden else pixels

    def _behind(self, eye: TrueEye, shown: Capture, points_W: Array, standing: tuple[Plate, ...]) -> Flags:
        """Which of the points (n, 3) lie behind one of the rectangles ``standing`` before the wall."""
        behind = np.zeros(len(points_W), dtype=bool)
        eye_W = (shown.view.X_WC @ eye.pose(shown.drift_px))[None, :3, 3]
        for plate in standing:
            X_PW = inverse(self._scene.mounts.X_WO @ plate.X_parent_plate)
            (from_P,), points_P = apply(X_PW, eye_W), apply(X_PW, points_W)
            deeper = points_P[:, 2] < -_ON_IT_M
            if from_P[2] <= 0.0 or not deeper.any():
                continue
            share = from_P[2] / np.where(deeper, from_P[2] - points_P[:, 2], np.inf)
            at = from_P[:2] + (points_P[:, :2] - from_P[:2]) * share[:, None]
            low = [plate.edges_x[0], -plate.edges_y[-1]]
            high = [plate.edges_x[-1], -plate.edges_y[0]]
            behind |= deeper & np.all((at >= low) & (at <= high), axis=1)
        return behind

    def _hiding(self, eye: TrueEye, shown: Capture) -> list[Array]:
        outlines = [self._seen_by(eye, shown, outline, on_tool=True) for outline in self._outlines]
        return [o.astype(np.float32) for o in outlines if np.isfinite(o).all()]

    def _seen_by(self, eye: TrueEye, shown: Capture, points: Array, on_tool: bool = False) -> Array:
        """Pixels (n, 2) of points (n, 3), in M if ``on_tool`` and else in W, each as its row is read."""

        def at(offset_s: float) -> Array:
            view = shown.view_at(offset_s)
            return eye.project(view.X_WC, apply(view.X_WM, points) if on_tool else points, shown.drift_px)

        return as_read(at, self._camera)


def _time_s(shown: Capture) -> float:
    return 1e-9 * shown.capture_ns


def _outline(plate: Plate) -> Array:
    """Corners (4, 3) of a plate in its parent's axes; its y counts downwards."""
    x0, x1 = plate.edges_x[0], plate.edges_x[-1]
    y0, y1 = -plate.edges_y[0], -plate.edges_y[-1]
    return apply(plate.X_parent_plate, np.array([[x0, y0, 0.0], [x1, y0, 0.0], [x1, y1, 0.0], [x0, y1, 0.0]]))
