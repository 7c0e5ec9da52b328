"""Corners of square markers from straight lines along their four edges.

Detectors' own corner refinements pull corners inward or outward by a fifth of a pixel and more. Here the
light across every edge is sampled at many places, each profile gives one sub-pixel edge point (the centroid
of its gradient), a robust line is laid through each edge's points, and neighbouring lines are intersected.
"""

import math
from collections.abc import Callable

import numpy as np

from foundation.compiled import kernel
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image

_SAMPLES = 64  # most profiles to an edge
_PROFILE_STEP = 0.25  # px between samples of a profile
_REACH = 3.5  # px to either side of the edge, at most
_LEAST_REACH = 1.25
_BLUR = 2.5  # px that a profile stays away from the data cells behind the border: their light leaks that far
_PASSES = 8
_CONVERGED = 0.05  # px
_FEWEST = 4  # usable profiles that an edge needs
_CELLS = 7.0  # cells along a marker's side, black border included; only bounds the reach
_CONTRAST = 12.0  # grey levels from inside to outside that a profile must show


def refine(image: Image, corners: Array, undistort: Callable[[Array], Array]) -> Array | None:
    """Straight image coordinates x/z, y/z (4, 2) of the corners, or None when an edge cannot be followed.

    ``corners`` (4, 2): approximate corners in pixels of ``image``, within about two pixels, in ArUco's order.
    ``undistort`` maps pixels (n, 2) to straight image coordinates, in which the final lines are fitted.
    """
    pixels = np.ascontiguousarray(corners, dtype=np.float64)
    for _ in range(_PASSES):  # a narrow window sees only part of the way to the edge
        points, weights = _edge_points(image, pixels)
        refined = _corners_from_points(points, weights)
        moved = np.abs(refined - pixels).max()
        pixels = refined
        if not np.abs(refined - corners).max() < _REACH:  # also NaN
            return None
        if moved < _CONVERGED:
            break
    return np.asarray(_corners_from_points(undistort(points.reshape(-1, 2)).reshape(points.shape), weights))


@kernel(nogil=True)
def _edge_points(image: Image, corners: Array) -> tuple[Array, Array]:
    """Edge points (4, samples, 2) in pixels and their weights (4, samples), 0 for unusable ones."""
    points = np.zeros((4, _SAMPLES, 2))
    weights = np.zeros((4, _SAMPLES))
    height, width = image.shape
    centre_x, centre_y = corners[:, 0].mean(), corners[:, 1].mean()
    for edge in range(4):
        ax, ay = corners[edge]
        bx, by = corners[(edge + 1) % 4]
        length = math.hypot(bx - ax, by - ay)
        if not length >= 8.0:  # also NaN
            continue
        dx, dy = (bx - ax) / length, (by - ay) / length
        nx, ny = dy, -dx
        depth = (0.5 * (ax + bx) - centre_x) * nx + (0.5 * (ay + by) - centre_y) * ny
        if depth < 0.0:
            nx, ny, depth = -nx, -ny, -depth
        cell = 2.0 * depth / _CELLS  # across the edge, foreshortened as it is
        reach = min(_REACH, max(_LEAST_REACH, cell - _BLUR))
        margin = reach + 1.0
        count = int(min(_SAMPLES, length - 2.0 * margin))
        steps = int(reach / _PROFILE_STEP + 0.5)
        for k in range(count):
            along = margin + (length - 2.0 * margin) * (k + 0.5) / count
            cx, cy = ax + dx * along, ay + dy * along
            span = steps * _PROFILE_STEP
            x0, x1 = cx - abs(nx) * span, cx + abs(nx) * span
            y0, y1 = cy - abs(ny) * span, cy + abs(ny) * span
            if x0 < 0.0 or y0 < 0.0 or x1 >= width - 1.0 or y1 >= height - 1.0:
                continue
            offset, contrast = _profile_centroid(image, cx, cy, nx, ny, steps)
            if contrast < _CONTRAST or abs(offset) > reach:
                continue
            points[edge, k, 0], points[edge, k, 1] = cx + nx * offset, cy + ny * offset
            weights[edge, k] = 1.0
    return points, weights


@kernel(nogil=True)
def _profile_centroid(
    image: Image, cx: float, cy: float, nx: float, ny: float, steps: int
) -> tuple[float, float]:
    """Centroid (px along the normal) of one profile's gradient, and the rise in grey levels across it."""
    first = last = moment = 0.0
    for j in range(-steps, steps + 1):
        s = j * _PROFILE_STEP
        x, y = cx + nx * s, cy + ny * s
        column, row = int(x), int(y)
        fx, fy = x - column, y - row
        upper = image[row, column] * (1.0 - fx) + image[row, column + 1] * fx
        lower = image[row + 1, column] * (1.0 - fx) + image[row + 1, column + 1] * fx
        value = upper * (1.0 - fy) + lower * fy
        if j == -steps:
            first = value
        else:
            moment += (s - 0.5 * _PROFILE_STEP) * (value - last)
        last = value
    rise = last - first
    if rise < 1.0:
        return 0.0, 0.0
    return moment / rise, rise


@kernel(nogil=True)
def _corners_from_points(points: Array, weights: Array) -> Array:
    """Corners (4, 2): corner i is where edge i−1 meets edge i; NaN when an edge has too few points."""
    lines = np.empty((4, 3))
    corners = np.full((4, 2), np.nan)
    for edge in range(4):
        if (weights[edge] > 0.0).sum() < _FEWEST:
            return corners
        lines[edge] = _robust_line(points[edge], weights[edge])
    for i in range(4):
        a, b = lines[i - 1], lines[i]
        w = a[0] * b[1] - a[1] * b[0]
        if abs(w) < 0.1:
            return np.full((4, 2), np.nan)
        corners[i, 0] = (a[1] * b[2] - a[2] * b[1]) / w
        corners[i, 1] = (a[2] * b[0] - a[0] * b[2]) / w
    return corners


@kernel(nogil=True)
def _robust_line(points: Array, weights: Array) -> Array:
    """(a, b, c) with a x + b y + c = 0, a² + b² = 1: total least squares with Tukey weights."""
    used = weights > 0.0
    x, y = points[used, 0], points[used, 1]
    w = np.ones(x.size)
    line = np.zeros(3)
    for _ in range(4):
        total = w.sum()
        mx, my = (w * x).sum() / total, (w * y).sum() / total
        sxx, syy = (w * (x - mx) ** 2).sum(), (w * (y - my) ** 2).sum()
        sxy = (w * (x - mx) * (y - my)).sum()
        angle = 0.5 * math.atan2(2.0 * sxy, sxx - syy)
        line[0], line[1] = -math.sin(angle), math.cos(angle)
        line[2] = -(line[0] * mx + line[1] * my)
        distance = np.abs(line[0] * x + line[1] * y + line[2])
        limit = max(6.0 * np.median(distance), 1e-9)
        w = np.where(distance < limit, (1.0 - (distance / limit) ** 2) ** 2, 0.0)
    return line
