"""What the true camera would see, without painting it: corners, wall points, and what hides what."""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from foundation.compiled import kernel
from plant_emulator.config.camera import CameraConfig
from plant_emulator.core.camera.exposures import CameraView, Capture
from plant_emulator.core.camera.eye import TrueEye, as_read, true_eyes
from plant_emulator.core.camera.scene import Plate, Scene
from vision_pc.core import se3_stacks
from vision_pc.core.se3 import Array, apply, inverse

Flags = NDArray[np.bool_]

_RIM_PX = 3.0  # OpenCV's detector leaves out what is nearer to the picture's rim
_ON_IT_M = 1e-6
_BOTH = (0, 1)  # the left eye and the right one
_TRACKABLE = 0.4  # share of the wall's contrast below which nothing holds a tracked point


class SeenMarker(NamedTuple):
    """The exact corners (4, 2) px of one marker in each eye; None where it is out of view or hidden."""

    left: Array | None
    right: Array | None


class _Screens(NamedTuple):
    """Rectangles before the wall: W in the axes of each (k, 4, 4), corners ``low`` and ``high`` (k, 2)."""

    X_PW: Array
    low: Array
    high: Array


class _Glance:
    """One capture as both eyes get it: what all points have in common is found once."""

    def __init__(self, shown: Capture, eyes: tuple[TrueEye, TrueEye], camera: CameraConfig) -> None:
        self.shown = shown
        self._eyes = eyes
        self._camera = camera
        self._turned = [eye.pose(shown.drift_px) for eye in eyes]
        self._views: dict[float, CameraView] = {}

    def seen(self, eye: int, points: Array, on_tool: bool = False) -> Array:
        """Pixels (n, 2) of points (n, 3), in M if ``on_tool`` and else in W, each as its row is read."""

        def at(offset_s: float) -> Array:
            view = self._view(offset_s)
            points_W = apply(view.X_WM, points) if on_tool else points
            return self._eyes[eye].seen_from(view.X_WC @ self._turned[eye], points_W)

        return as_read(at, self._camera)

    def eye_W(self, eye: int) -> Array:
        """Where the eye is, (3,), at the capture."""
        return np.asarray((self.shown.view.X_WC @ self._turned[eye])[:3, 3])

    def _view(self, offset_s: float) -> CameraView:
        if offset_s not in self._views:
            self._views[offset_s] = self.shown.view_at(offset_s)
        return self._views[offset_s]


class TrueView:
    """Projections of the true scene through the true camera. In view is what is ``rim_px`` from the rim."""

    def __init__(self, camera: CameraConfig, scene: Scene, rim_px: float = _RIM_PX) -> None:
        self._rim_px = rim_px
        self._camera = camera
        self._eyes = true_eyes(camera)
        self._size = np.array([camera.width_px, camera.height_px], dtype=np.float64)
        self._scene = scene
        wall = scene.config.wall
        self._wall_is_plain = not (wall.bare_patches or wall.blocks or scene.config.passers)
        self._standing = _screens(scene.mounts.X_WO, scene.standing)
        corners = scene.marker_corners()
        self._hung = [number for number, (parent, _) in corners.items() if parent == "O"]
        self._hung_O = np.reshape([corners[number][1] for number in self._hung], (-1, 3))
        self._carried = [number for number, (parent, _) in corners.items() if parent == "M"]
        outlines = [_outline(plate) for plate in scene.tool_plates]
        self._carried_M = np.reshape([*(corners[number][1] for number in self._carried), *outlines], (-1, 3))
        self._latest: _Glance | None = None

    def markers(self, shown: Capture) -> dict[int, SeenMarker]:
        """Every marker's exact corners in both eyes."""
        left, right = (self._corners(shown, eye) for eye in _BOTH)
        return {number: SeenMarker(pixels, right[number]) for number, pixels in left.items()}

    def _corners(self, shown: Capture, eye: int) -> dict[int, Array | None]:
        """What one eye sees of every marker: pixels (4, 2), None where it is out of view or hidden."""
        glance = self._glance(shown)
        slid = shown.view.X_WO
        hung_W = apply(self._scene.mounts.X_WO if slid is None else slid, self._hung_O)
        hung = glance.seen(eye, hung_W).reshape(-1, 4, 2)
        behind = np.asarray(self._behind(glance, eye, hung_W).reshape(-1, 4).any(axis=1))
        on_tool = glance.seen(eye, self._carried_M, on_tool=True).reshape(-1, 4, 2)
        carried, outlines = np.split(on_tool, [len(self._carried)])
        hiding = [outline.astype(np.float32) for outline in outlines if np.isfinite(outline).all()]
        found = {number: self._whole(carried[k], []) for k, number in enumerate(self._carried)}
        for number, pixels, is_behind in zip(self._hung, hung, behind, strict=True):
            found[number] = None if is_behind else self._whole(pixels, hiding)
        return found

    def project(self, shown: Capture, points_W: Array) -> tuple[Array, Array]:
        """Exact (left, right) pixels (n, 2) of points (n, 3) that rest in W; NaN behind the eye."""
        left, right = (self._glance(shown).seen(eye, points_W) for eye in _BOTH)
        return left, right

    def inside(self, pixels: Array) -> Array:
        """Which ``pixels`` (n, 2) lie in the picture; NaN does not."""
        with np.errstate(invalid="ignore"):
            low, high = self._rim_px, self._size - 1.0 - self._rim_px
            return np.asarray(np.all((pixels >= low) & (pixels <= high), axis=1))

    def hidden(self, shown: Capture, points_W: Array) -> tuple[Flags, Flags]:
        """Which of the points (n, 3) something before the wall hides from the left and the right eye."""
        left, right = (self._behind(self._glance(shown), eye, points_W) for eye in _BOTH)
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
        return points[~self._behind(self._glance(shown), 0, points)]

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

    def _behind(self, glance: _Glance, eye: int, points_W: Array) -> Flags:
        """Which of the points (n, 3) lie behind something that stands or passes before the wall."""
        eye_W, behind = glance.eye_W(eye), np.zeros(len(points_W), dtype=bool)
        _hide(self._standing, eye_W, points_W, behind)
        passing = self._scene.passing(1e-9 * glance.shown.capture_ns)
        if passing:
            _hide(_screens(self._scene.mounts.X_WO, passing), eye_W, points_W, behind)
        return behind

    def _glance(self, shown: Capture) -> _Glance:
        """What all that is asked of one capture has in common."""
        if self._latest is None or self._latest.shown is not shown:
            self._latest = _Glance(shown, self._eyes, self._camera)
        return self._latest


@kernel(nogil=True)
def _hide(screens: _Screens, eye_W: Array, points_W: Array, behind: Flags) -> None:
    """Set in ``behind`` (n,) which of the points (n, 3) lie behind a screen, seen from ``eye_W`` (3,)."""
    for k in range(screens.X_PW.shape[0]):
        X, low, high = screens.X_PW[k], screens.low[k], screens.high[k]
        eye_x, eye_y, height = _transform_point(X, eye_W)
        if height <= 0.0:
            continue
        for i in range(points_W.shape[0]):
            x, y, depth = _transform_point(X, points_W[i])
            if depth < -_ON_IT_M:
                share = height / (height - depth)
                across, up = eye_x + (x - eye_x) * share, eye_y + (y - eye_y) * share
                behind[i] |= low[0] <= across <= high[0] and low[1] <= up <= high[1]


@kernel(nogil=True)
def _transform_point(X: Array, p: Array) -> tuple[float, float, float]:
    """The point ``p`` (3,) in the axes of X (4, 4)."""
    return (
        X[0, 0] * p[0] + X[0, 1] * p[1] + X[0, 2] * p[2] + X[0, 3],
        X[1, 0] * p[0] + X[1, 1] * p[1] + X[1, 2] * p[2] + X[1, 3],
        X[2, 0] * p[0] + X[2, 1] * p[1] + X[2, 2] * p[2] + X[2, 3],
    )


def _screens(X_WO: Array, plates: Sequence[Plate]) -> _Screens:
    """The rectangles of ``plates``, which stand in O."""
    poses = [X_WO @ plate.X_parent_plate for plate in plates]
    low = [(plate.edges_x[0], -plate.edges_y[-1]) for plate in plates]
    high = [(plate.edges_x[-1], -plate.edges_y[0]) for plate in plates]
    return _Screens(
        se3_stacks.inverse(np.reshape(poses, (-1, 4, 4))), np.reshape(low, (-1, 2)), np.reshape(high, (-1, 2))
    )


def _outline(plate: Plate) -> Array:
    """Corners (4, 3) of a plate in its parent's axes; its y counts downwards."""
    x0, x1 = plate.edges_x[0], plate.edges_x[-1]
    y0, y1 = -plate.edges_y[0], -plate.edges_y[-1]
    return apply(plate.X_parent_plate, np.array([[x0, y0, 0.0], [x1, y0, 0.0], [x1, y1, 0.0], [x0, y1, 0.0]]))
