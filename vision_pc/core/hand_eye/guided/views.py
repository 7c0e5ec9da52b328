"""Views of the marker that may be sampled: random ones, and which of them keep all bounds.

The marker must be off the rim and off what the tool hides, in both pictures; the tool off the marker's plane;
the hand within turn and reach of its start. Whether the arm can go there is the controller's to say: a
refused pose is not proposed again, nor are its neighbours.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vision_pc.config.hand_eye import GuidedSettings
from vision_pc.core import se3
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.perception import intrinsics
from vision_pc.core.perception.markers import corner_points
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration

_NEIGHBOUR_RAD, _NEIGHBOUR_M = math.radians(12.0), 0.10

Flags = NDArray[np.bool_]


class Surroundings(NamedTuple):
    """What bounds the views: the camera, the starting pose of the hand, and what the tool hides.

    ``hidden``: for each eye rectangles (u_min, v_min, u_max, v_max) px. ``tool_C`` (3,): the tool's middle in
    the camera.
    """

    camera: CameraCalibration
    X_BT_start: Array
    hidden: tuple[tuple[tuple[float, float, float, float], ...], ...]
    tool_C: Array


def nominal_mount(settings: GuidedSettings) -> Array:
    """X_TC (4, 4) as measured by tape."""
    return se3.transform(
        se3.exp_so3(np.radians(settings.mount_rotation_deg)), np.array(settings.mount_position_m)
    )


def surroundings(
    camera: CameraCalibration,
    X_BT_start: Array,
    X_CM: Array | None,
    carried: Sequence[tuple[float, float, float, float]],
    settings: GuidedSettings,
) -> Surroundings:
    """The bounds at the starting pose.

    ``X_CM`` is the tool marker as seen there (None: no tool in view), ``carried`` what moves with it:
    rectangles x_min, y_min, x_max, y_max in its plane.
    """
    if X_CM is None:
        return Surroundings(camera, X_BT_start, ((), ()), se3.inverse(nominal_mount(settings))[:3, 3])
    hidden = []
    for eye in (camera.left, camera.right):
        rectangles = []
        for x0, y0, x1, y1 in carried:
            corners = np.array([[x0, y0, 0.0], [x1, y0, 0.0], [x1, y1, 0.0], [x0, y1, 0.0]])
            pixels = intrinsics.project(eye, se3.apply(X_CM, corners))
            low, high = np.nanmin(pixels, axis=0), np.nanmax(pixels, axis=0)
            rectangles.append((float(low[0]), float(low[1]), float(high[0]), float(high[1])))
        hidden.append(tuple(rectangles))
    return Surroundings(camera, X_BT_start, tuple(hidden), X_CM[:3, 3])


def random_views(settings: GuidedSettings, camera: CameraCalibration, rng: np.random.Generator) -> Array:
    """Random poses X_CP (n, 4, 4) of the marker before the camera: place, distance, tilt, roll."""
    n = settings.candidates
    pixels = rng.uniform((0.0, 0.0), (camera.width, camera.height), (n, 2))
    rays = np.c_[intrinsics.normalised(camera.left, pixels), np.ones(n)]
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    p = rays * rng.uniform(*settings.distance_m, n)[:, None]
    azimuth = rng.uniform(0.0, 2.0 * math.pi, n)
    # more than the sine of evenly spread normals: oblique views tell most, and are few in any case
    tilt = math.radians(settings.obliquity_deg) * np.sqrt(rng.uniform(0.0, 1.0, n))
    roll = math.radians(settings.roll_deg) * rng.uniform(-1.0, 1.0, n)
    leaning = np.c_[np.cos(azimuth) * tilt, np.sin(azimuth) * tilt, np.zeros(n)]
    facing = np.diag([1.0, -1.0, -1.0])
    spin = stacks.exp_so3(np.c_[np.zeros((n, 2)), roll])
    return stacks.transform(_towards(rays) @ stacks.exp_so3(leaning) @ facing @ spin, p)


def _towards(rays: Array) -> Array:
    """Rotations (n, 3, 3) that turn the optical axis onto ``rays``, without roll."""
    axis = np.cross(np.array([0.0, 0.0, 1.0]), rays)
    sine = np.linalg.norm(axis, axis=1)
    angle = np.arctan2(sine, rays[:, 2])
    return stacks.exp_so3(axis * (angle / np.maximum(sine, 1e-12))[:, None])


def beside_refused(X_BT: Array, refused: Sequence[Array]) -> Flags:
    """Which candidates (n,) are neighbours of a pose that the controller has refused."""
    beside = np.zeros(len(X_BT), dtype=bool)
    for pose in refused:
        apart = stacks.angle(np.swapaxes(X_BT[:, :3, :3], -1, -2) @ pose[:3, :3])
        moved = np.linalg.norm(X_BT[:, :3, 3] - pose[:3, 3], axis=1)
        beside |= (apart < _NEIGHBOUR_RAD) & (moved < _NEIGHBOUR_M)
    return beside


def obliquity(X_CP: Array) -> Array:
    """Angle (n,) between the line of sight and the marker's normal."""
    p = X_CP[:, :3, 3]
    cosine = -np.einsum("ni,ni->n", p, X_CP[:, :3, 2]) / np.linalg.norm(p, axis=1)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


def keep_bounds(X_BT: Array, X_CP: Array, around: Surroundings, settings: GuidedSettings) -> Flags:
    """Which candidates keep view, clearance, turn and reach (n,)."""
    n = len(X_BT)
    start = around.X_BT_start
    turned = stacks.angle(np.swapaxes(X_BT[:, :3, :3], -1, -2) @ start[:3, :3])
    moved = np.linalg.norm(X_BT[:, :3, 3] - start[:3, 3], axis=1)
    ahead = np.einsum("ni,ni->n", around.tool_C - X_CP[:, :3, 3], X_CP[:, :3, 2])
    keep: Flags = (turned <= math.radians(settings.turn_deg)) & (moved <= settings.reach_m)
    keep &= (ahead >= settings.clearance_m) & (obliquity(X_CP) <= math.radians(settings.obliquity_deg) + 1e-9)
    corners = corner_points(1.5 * settings.marker_size_m)  # with the quiet zone
    points = (corners @ np.swapaxes(X_CP[:, :3, :3], -1, -2)) + X_CP[:, None, :3, 3]
    size = (around.camera.width, around.camera.height)
    for eye, hidden in zip((around.camera.left, around.camera.right), around.hidden, strict=True):
        pixels = intrinsics.project(eye, points.reshape(-1, 3)).reshape(n, 4, 2)
        low, high = pixels.min(axis=1), pixels.max(axis=1)  # NaN behind the camera: fails every comparison
        m = settings.margin_px
        keep &= (low >= m).all(axis=1) & (high <= np.array(size) - m).all(axis=1)
        for u0, v0, u1, v1 in hidden:
            beside = (high[:, 0] < u0 - m) | (low[:, 0] > u1 + m)
            keep &= beside | (high[:, 1] < v0 - m) | (low[:, 1] > v1 + m)
    return keep
