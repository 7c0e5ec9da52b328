"""A small renderer of its own for the vision tests: markers by exact ray casting, a wall by supersampled
warping.

It shares no code with the plant's stereo camera, so that a mistake in either cannot hide in both.
"""

import functools
import math
from typing import NamedTuple

import cv2
import numpy as np

from foundation.compiled import kernel
from vision_pc.core import se3
from vision_pc.core.perception import intrinsics
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, CameraModel, Image, StereoPair

BLACK, WHITE = 22.0, 208.0
DICTIONARY = cv2.aruco.DICT_5X5_1000


def cropped(camera: CameraCalibration) -> CameraCalibration:
    """The middle of a camera's pictures, a quarter of its pixels: for tests that need many."""
    width, height = camera.width // 2, camera.height // 2
    eyes = []
    for eye in (camera.left, camera.right):
        K = eye.K.copy()
        K[:2, 2] -= (0.5 * (camera.width - width), 0.5 * (camera.height - height))
        eyes.append(eye._replace(K=K))
    return CameraCalibration(width, height, *eyes)


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


def exact_corners(eye: CameraModel, marker: Marker) -> Array:
    """Where ``eye`` sees the corners, px."""
    return intrinsics.project(eye, se3.apply(marker.X_CA, object_points(marker.size)))


def facing(x: float, y: float, z: float, tilt_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Array:
    """X_CA of a marker at (x, y, z) that faces the camera, then tilted about its own axes."""
    return se3.transform(np.diag([1.0, -1.0, -1.0]) @ se3.exp_so3(np.radians(tilt_deg)), (x, y, z))


def draw_marker(picture: Array, eye: CameraModel, marker: Marker, samples: int = 8) -> None:
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
    dictionary = cv2.aruco.getPredefinedDictionary(marker.dictionary)
    bits = cv2.aruco.generateImageMarker(dictionary, marker.marker_id, dictionary.markerSize + 2) > 127
    X_AE = se3.inverse(marker.X_CA) @ eye.X_CE
    lens = np.concatenate([[eye.K[0, 0], eye.K[1, 1], eye.K[0, 2], eye.K[1, 2]], eye.distortion])
    _paint(picture[y0:y1, x0:x1], int(x0), int(y0), lens, X_AE, marker.size, half, bits, samples)


@kernel
def _paint(
    patch: Array,
    x0: int,
    y0: int,
    lens: Array,
    X_AE: Array,
    size: float,
    half: float,
    bits: Array,
    samples: int,
) -> None:
    """Every pixel of ``patch`` is the mean of rays through a sheared grid of samples² points of it.

    Sheared, so that an edge along rows or columns meets samples² different places.
    """
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = lens
    count = bits.shape[0]
    for i in range(patch.shape[0]):
        for j in range(patch.shape[1]):
            grey = cover = 0.0
            for a in range(samples):
                for b in range(samples):
                    u = x0 + j + (b + (a + 0.5) / samples) / samples - 0.5
                    v = y0 + i + (a + (b + 0.5) / samples) / samples - 0.5
                    xd, yd = (u - cx) / fx, (v - cy) / fy
                    x, y = xd, yd
                    for _ in range(0 if k1 == 0.0 else 8):  # fixed point: contracts for any lens used here
                        r2 = x * x + y * y
                        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
                        tx = 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
                        ty = p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
                        x, y = (xd - tx) / radial, (yd - ty) / radial
                    slope = X_AE[2, 0] * x + X_AE[2, 1] * y + X_AE[2, 2]
                    depth = -X_AE[2, 3] / slope
                    along = X_AE[0, 3] + depth * (X_AE[0, 0] * x + X_AE[0, 1] * y + X_AE[0, 2])
                    up = X_AE[1, 3] + depth * (X_AE[1, 0] * x + X_AE[1, 1] * y + X_AE[1, 2])
                    if abs(along) > half or abs(up) > half:
                        continue
                    cover += 1.0
                    column = math.floor((along / size + 0.5) * count)
                    row = math.floor((0.5 - up / size) * count)
                    inside = 0 <= column < count and 0 <= row < count
                    grey += BLACK if inside and not bits[row, column] else WHITE
            share = cover / samples**2
            patch[i, j] = patch[i, j] * (1.0 - share) + grey / samples**2


def wall_texture(seed: int, contrast: float, size: int = 2000) -> Array:
    """A band-limited random texture (size, size) with edges and blobs at several scales, about
    ±``contrast`` std.
    """
    total = _pattern(seed, size)
    return np.asarray(118.0 + contrast * total / total.std(), dtype=np.float32)


@functools.lru_cache(maxsize=4)
def _pattern(seed: int, size: int) -> Array:
    generator = np.random.default_rng(seed)
    total = np.zeros((size, size), dtype=np.float32)
    for sigma in (1.5, 3.0, 6.0, 12.0, 30.0):
        field = cv2.GaussianBlur(generator.standard_normal((size, size)).astype(np.float32), (0, 0), sigma)
        field /= field.std()
        total += np.tanh(3.0 * field)
    return total


def draw_wall(eye: CameraModel, shape: tuple[int, int], texture: Array, texel: float, X_CW: Array) -> Array:
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
    samples: int = 8,
) -> StereoPair:
    """A stereo pair of ``markers`` (painted in order) over a plain or textured ``wall`` (texture, texel,
    X_CW).
    """
    pictures = []
    for eye in (camera.left, camera.right):
        shape = (camera.height, camera.width)
        picture = np.full(shape, 118.0, np.float32) if wall is None else draw_wall(eye, shape, *wall)
        for marker in markers:
            draw_marker(picture, eye, marker, samples)
        pictures.append(finish(picture, generator, noise, blur))
    return StereoPair(pictures[0], pictures[1], capture_ns, frame_id)
