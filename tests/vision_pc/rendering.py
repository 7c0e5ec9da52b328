"""A small renderer of its own for the vision tests: markers by exact ray casting, a wall by supersampled
warping.

It shares no code with the plant's stereo camera, so that a mistake in either cannot hide in both.
"""

from typing import NamedTuple

import cv2
import numpy as np

from vision_pc.core import intrinsics, se3
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, EyeModel, Image, StereoPair

BLACK, WHITE = 22.0, 208.0
DICTIONARY = cv2.aruco.DICT_5X5_1000


class Marker(NamedTuple):
    """A printed marker: its number, side in metres, its pose in C, the width of the white rim, the
    dictionary.
    """

    marker_id: int
    size: float
    X_CA: Array
    rim: float = 0.25
    dictionary: int = DICTIONARY


def object_points(size: float) -> Array:
    """Corners (4, 3) in ArUco's order."""
    return 0.5 * size * np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])


def exact_corners(eye: EyeModel, marker: Marker) -> Array:
    """Where ``eye`` sees the corners, px."""
    return intrinsics.project(eye, se3.apply(marker.X_CA, object_points(marker.size)))


def facing(x: float, y: float, z: float, tilt_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Array:
    """X_CA of a marker at (x, y, z) that faces the camera, then tilted about its own axes."""
    return se3.transform(np.diag([1.0, -1.0, -1.0]) @ se3.exp_so3(np.radians(tilt_deg)), (x, y, z))


def draw_marker(picture: Array, eye: EyeModel, marker: Marker, samples: int = 8) -> None:
    """Lay ``marker`` over ``picture`` (float, in place): every pixel is the mean of samples² rays."""
    half = marker.size * (0.5 + marker.rim)
    outline = intrinsics.project(eye, se3.apply(marker.X_CA, object_points(2.0 * half)))
    if not np.isfinite(outline).all():
        return
    height, width = picture.shape
    x0, y0 = np.maximum(np.floor(outline.min(axis=0)).astype(int) - 2, 0)
    x1, y1 = np.minimum(np.ceil(outline.max(axis=0)).astype(int) + 3, (width, height))
    if x1 <= x0 or y1 <= y0:
        return
    sub = (np.arange(samples) + 0.5) / samples - 0.5
    u = (np.arange(x0, x1)[:, None] + sub).ravel()
    v = (np.arange(y0, y1)[:, None] + sub).ravel()
    grid = np.stack(np.meshgrid(u, v), axis=-1)
    n = np.arange(samples)  # sheared, so that an edge along rows or columns meets samples² different places
    grid[..., 0] += ((np.resize(n, len(v)) + 0.5) / samples - 0.5)[:, None] / samples
    grid[..., 1] += ((np.resize(n, len(u)) + 0.5) / samples - 0.5)[None, :] / samples
    grid = grid.reshape(-1, 2)
    rays = np.column_stack([intrinsics.normalised(eye, grid), np.ones(len(grid))])
    X_AE = se3.inverse(marker.X_CA) @ eye.X_CE
    directions = rays @ X_AE[:3, :3].T
    depth = -X_AE[2, 3] / directions[:, 2]
    on_plane = X_AE[:2, 3] + directions[:, :2] * depth[:, None]
    bits = cv2.aruco.generateImageMarker(
        cv2.aruco.getPredefinedDictionary(marker.dictionary), marker.marker_id, 7
    )
    column = np.floor((on_plane[:, 0] / marker.size + 0.5) * 7).astype(int)
    row = np.floor((0.5 - on_plane[:, 1] / marker.size) * 7).astype(int)
    inside = (column >= 0) & (column < 7) & (row >= 0) & (row < 7)
    grey = np.full(len(grid), WHITE)
    grey[inside] = np.where(bits[row[inside], column[inside]] > 127, WHITE, BLACK)
    seen = (np.abs(on_plane).max(axis=1) <= half).astype(float)

    def pooled(values: Array) -> Array:
        return values.reshape(y1 - y0, samples, x1 - x0, samples).mean(axis=(1, 3))

    cover = pooled(seen)
    patch = picture[y0:y1, x0:x1]
    patch[:] = patch * (1.0 - cover) + pooled(grey * seen)


def wall_texture(seed: int, contrast: float, size: int = 3000) -> Array:
    """A band-limited random texture (size, size) with edges and blobs at several scales, about
    ±``contrast`` std.
    """
    generator = np.random.default_rng(seed)
    total = np.zeros((size, size), dtype=np.float32)
    for sigma in (1.5, 3.0, 6.0, 12.0, 30.0):
        field = cv2.GaussianBlur(generator.standard_normal((size, size)).astype(np.float32), (0, 0), sigma)
        field /= field.std()
        total += np.tanh(3.0 * field)
    return np.asarray(118.0 + contrast * total / total.std(), dtype=np.float32)


def draw_wall(eye: EyeModel, shape: tuple[int, int], texture: Array, texel: float, X_CW: Array) -> Array:
    """The wall's picture (float32): plane z = 0 of ``X_CW``, texture centred there, 2×2 supersampled; no
    distortion.
    """
    height, width = shape
    X_EW = se3.inverse(eye.X_CE) @ X_CW
    n = texture.shape[0]
    plane_from_texel = np.array(
        [[texel, 0, -texel * (n - 1) / 2], [0, -texel, texel * (n - 1) / 2], [0, 0, 1.0]]
    )
    big = eye.K.copy()
    big[:2] *= 2.0
    big[:2, 2] += 0.5
    H = big @ np.column_stack([X_EW[:3, 0], X_EW[:3, 1], X_EW[:3, 3]]) @ plane_from_texel
    doubled = cv2.warpPerspective(
        texture, H, (2 * width, 2 * height), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT
    )
    return cv2.resize(doubled, (width, height), interpolation=cv2.INTER_AREA)


def finish(picture: Array, generator: np.random.Generator, noise: float = 2.0, blur: float = 0.6) -> Image:
    """The picture as a sensor delivers it: blurred, noisy, eight bits."""
    soft = cv2.GaussianBlur(np.asarray(picture, dtype=np.float32), (0, 0), blur) if blur > 0.0 else picture
    noisy = soft + noise * generator.standard_normal(soft.shape, dtype=np.float32)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def render(
    camera: CameraCalibration,
    markers: tuple[Marker, ...],
    generator: np.random.Generator,
    *,
    noise: float = 2.0,
    blur: float = 0.6,
    wall: tuple[Array, float, Array] | None = None,
    capture_ns: int = 0,
    frame_id: int = 0,
) -> StereoPair:
    """A stereo pair of ``markers`` (painted in order) over a plain or textured ``wall`` (texture, texel,
    X_CW).
    """
    pictures = []
    for eye in (camera.left, camera.right):
        shape = (camera.height, camera.width)
        picture = np.full(shape, 118.0, np.float32) if wall is None else draw_wall(eye, shape, *wall)
        for marker in markers:
            draw_marker(picture, eye, marker)
        pictures.append(finish(picture, generator, noise, blur))
    return StereoPair(pictures[0], pictures[1], capture_ns, frame_id)
