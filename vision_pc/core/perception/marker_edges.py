"""Corners of square markers from straight lines along their four edges.

Detectors' own corner refinements pull corners inward or outward by a fifth of a pixel and more. Here the
light across every edge is sampled at many places, each profile gives one sub-pixel edge point (the centroid
of its gradient), a robust line is laid through each edge's points, and neighbouring lines are intersected.

A camera whose grey levels do not go with the light (gamma), or whose white is cut off, shows every edge
moved towards the black side, a quarter of a pixel and more. A marker then looks smaller than it is: one of 46
pixels by one per cent, and its distance is wrong by as much. Edges inside the marker tell: where white turns
to black along a line of cells they are moved one way, where black turns to white the other way, and their
places between the outer edges are known.
"""

import math
from collections.abc import Callable
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from foundation.compiled import kernel
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image

Cells = NDArray[np.bool_]

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
_FEWEST_INNER = 12  # profiles
_LEAST_CELL_PX = 4.0  # of smaller cells a profile shows the next edges too
_CELL_REACH = 0.45  # of a cell to either side
_ALONG = (0.3, 0.5, 0.7)  # of a cell's side: where profiles cross it
_MOST_STD_PX = 0.03
_ROUNDS, _OUTLIER = 4, 3.0


def refine(
    image: Image, corners: Array, undistort: Callable[[Array], Array], outward_px: float = 0.0
) -> Array | None:
    """Straight image coordinates x/z, y/z (4, 2) of the corners, or None when an edge cannot be followed.

    ``corners`` (4, 2): approximate corners in pixels of ``image``, within about two pixels, in ArUco's order.
    ``undistort`` maps pixels (n, 2) to straight image coordinates, in which the final lines are fitted.
    ``outward_px``: how much farther out edges are than they are seen (``edge_shift``).
    """
    pixels = np.ascontiguousarray(corners, dtype=np.float64)
    for _ in range(_PASSES):  # a narrow window sees only part of the way to the edge
        points, weights = _edge_points(image, pixels, outward_px)
        refined = _corners_from_points(points, weights)
        moved = np.abs(refined - pixels).max()
        pixels = refined
        if not np.abs(refined - corners).max() < _REACH:  # also NaN
            return None
        if moved < _CONVERGED:
            break
    return np.asarray(_corners_from_points(undistort(points.reshape(-1, 2)).reshape(points.shape), weights))


@kernel(nogil=True)
def _edge_points(image: Image, corners: Array, outward_px: float) -> tuple[Array, Array]:
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
            out = offset + outward_px
            points[edge, k, 0], points[edge, k, 1] = cx + nx * out, cy + ny * out
            weights[edge, k] = 1.0
    return points, weights


@kernel(nogil=True, inline="always")
def grey_between(image: Image | Array, x: float, y: float) -> float:
    """The grey between an image's pixels, bilinear; the pixel right of and below (x, y) must be there."""
    column, row = int(x), int(y)
    a, b = x - column, y - row
    upper = image[row, column] * (1.0 - a) + image[row, column + 1] * a
    lower = image[row + 1, column] * (1.0 - a) + image[row + 1, column + 1] * a
    return float(upper * (1.0 - b) + lower * b)


@kernel(nogil=True)
def _profile_centroid(
    image: Image, cx: float, cy: float, nx: float, ny: float, steps: int
) -> tuple[float, float]:
    """Centroid (px along the normal) of one profile's gradient, and the rise in grey levels across it; 0 for
    both where there is hardly any. The profile must lie within the image.
    """
    first = last = moment = 0.0
    for j in range(-steps, steps + 1):
        s = j * _PROFILE_STEP
        value = grey_between(image, cx + nx * s, cy + ny * s)
        if j == -steps:
            first = value
        else:
            moment += (s - 0.5 * _PROFILE_STEP) * (value - last)
        last = value
    rise = last - first
    if abs(rise) < 1.0:
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


@lru_cache(maxsize=256)
def cells_of(dictionary: str, number: int) -> Cells:
    """Which cells (n, n) of marker ``number`` are white, its black border among them."""
    book = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    return np.asarray(cv2.aruco.generateImageMarker(book, number, book.markerSize + 2) > 127)


def edge_shift(image: Image, corners: Array, cells: Cells) -> float | None:
    """By how many px edges of a marker are seen on their black side; None where too little of it tells.

    ``corners`` (4, 2) px as its outer edges were seen, in ArUco's order; ``cells`` (n, n) as ``cells_of``.
    """
    count = len(cells)
    square = np.array([[0, 0], [count, 0], [count, count], [0, count]], dtype=np.float32)
    H = cv2.getPerspectiveTransform(square, corners.astype(np.float32))
    rates, places = _inner_edges(image, np.asarray(H, dtype=np.float64), cells)
    if len(rates) < _FEWEST_INNER:
        return None
    used = np.ones(len(rates), dtype=bool)
    shift = spread = 0.0
    for _ in range(_ROUNDS):
        shift = float(rates[used] @ places[used] / (rates[used] @ rates[used]))
        off = np.abs(places - shift * rates)
        spread = 1.4826 * float(np.median(off)) + 1e-6
        used = off < _OUTLIER * spread
    return shift if spread < _MOST_STD_PX * np.sqrt(rates[used] @ rates[used]) else None


@kernel(nogil=True)
def _inner_edges(image: Image, H: Array, cells: Cells) -> tuple[Array, Array]:
    """Of profiles across the edges between cells: how many px the edge moves for each px of shift, against
    the place that the outer edges give it, and how many px it has moved (n,).

    Outer edges have moved inwards themselves: what lies between them is expected moved by what is left of
    that.
    """
    count = cells.shape[0]
    most = 2 * count * (count - 1) * len(_ALONG)
    rates, places, n = np.empty(most), np.empty(most), 0
    for axis in range(2):
        for line in range(count):
            for k in range(1, count):
                low, high = (
                    (cells[line, k - 1], cells[line, k])
                    if axis == 0
                    else (cells[k - 1, line], cells[k, line])
                )
                if low == high:
                    continue
                for share in _ALONG:
                    x, y = (float(k), line + share) if axis == 0 else (line + share, float(k))
                    moved = _profile_shift(image, H, x, y, axis)
                    if np.isfinite(moved):
                        rates[n] = (1.0 if low else -1.0) - (1.0 - 2.0 * k / count)
                        places[n] = moved
                        n += 1
    return rates[:n], places[:n]


@kernel(nogil=True)
def _profile_shift(image: Image, H: Array, x: float, y: float, axis: int) -> float:
    """How far (px, along the axis) from (x, y) in cells an edge is seen; NaN where it cannot be told."""
    dx, dy = (_CELL_REACH, 0.0) if axis == 0 else (0.0, _CELL_REACH)
    u, v = mapped(H, x, y)
    first_u, first_v = mapped(H, x - dx, y - dy)
    last_u, last_v = mapped(H, x + dx, y + dy)
    along_u, along_v = last_u - first_u, last_v - first_v
    length = np.hypot(along_u, along_v)
    if not length >= 2.0 * _CELL_REACH * _LEAST_CELL_PX:  # also NaN
        return np.nan
    along_u, along_v = along_u / length, along_v / length
    steps = int(min(0.5 * length, _REACH) / _PROFILE_STEP)
    for end in (-steps * _PROFILE_STEP, steps * _PROFILE_STEP):
        column, row = u + along_u * end, v + along_v * end
        if not (0.0 <= column < image.shape[1] - 1 and 0.0 <= row < image.shape[0] - 1):
            return np.nan
    offset, rise = _profile_centroid(image, u, v, along_u, along_v, steps)
    return offset if abs(rise) >= _CONTRAST else np.nan


@kernel(nogil=True, inline="always")
def mapped(H: Array, x: float, y: float) -> tuple[float, float]:
    """Where the homography ``H`` (3, 3) takes a place."""
    w = H[2, 0] * x + H[2, 1] * y + H[2, 2]
    return (H[0, 0] * x + H[0, 1] * y + H[0, 2]) / w, (H[1, 0] * x + H[1, 1] * y + H[1, 2]) / w
