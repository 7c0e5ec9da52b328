"""Corners of a marker from all of its light: its pattern, projected and blurred, is fitted to the pixels.

Unknown are the four corners, the blur, the light of ink and paper and how both change across the marker. The
cells are either known (the number was read) or found with them (it was not). Gauss-Newton steps, damped, on
the difference of picture and model, as in direct alignment (Baker and Matthews 2004, forwards additive).
"""

import math
from typing import NamedTuple

import numpy as np

from foundation.compiled import kernel
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image

LONGEST_PX = 120.0  # of an edge; longer ones have profiles enough, and the model costs their area
_STEPS = 25
_CONVERGED = 0.01  # px
_STEP_PX = 0.01  # of a corner, for the derivative
_LEAST_BLUR, _MOST_BLUR = 0.05, 16.0  # variances, px²
_PARAMETERS = 15  # corners, variance of the blur, six of light
_SPILL = 2.2  # σ of the blur: the ground's light reaches so far into the paper
_QUIET = 1.0  # cells of paper around the border that are believed in
_LIKE = 0.85  # correlation of picture and model below which it is another thing
_FLOOR_PX = 0.01  # [M] what sampling leaves in the model, without noise (rendered markers, version 0.2.0)
_LEAK, _LEAK_FROM = 0.2, 0.7  # [M] of the ground's light through the paper: the same, over blur; in cells


class TemplateFit(NamedTuple):
    """Corners (4, 2) px, their standard deviation a coordinate, the correlation of picture and model, σ of
    the blur, and the cells (n, n) from ink 0 to paper 1.
    """

    corners: Array
    std_px: float
    likeness: float
    blur_px: float
    cells: Array


def fit(image: Image, corners: Array, cells: Array, known: bool = True) -> TemplateFit | None:
    """The marker with ``cells`` (n, n, border included; ink 0, paper 1) near ``corners``; None: it is not.

    ``corners`` (4, 2) px in ArUco's order, right within about a cell. Cells inside the border are unknown
    where ``known`` is False: what comes back is what the picture shows there.
    """
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
    if not (edges.min() >= 4.0 and edges.max() <= LONGEST_PX and _is_convex(corners)):
        return None
    started = np.ascontiguousarray(corners, dtype=np.float64)
    guessed = np.ascontiguousarray(cells, dtype=np.float64)
    found, variance, likeness, blur, shown = _fit_template(image, started, guessed, known)
    if not (likeness >= _LIKE and np.isfinite(found).all() and np.isfinite(variance)):
        return None
    std = math.sqrt(max(variance, 0.0) + _FLOOR_PX**2 + _leak_px(math.sqrt(blur), len(cells), found) ** 2)
    return TemplateFit(found, std, likeness, math.sqrt(blur), shown)


def _leak_px(blur_px: float, count: int, corners: Array) -> float:
    """What corners are off by where the paper is narrower than the blur is wide."""
    shortest = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).min()
    spill = _SPILL * blur_px * count / max(float(shortest), 1.0)
    return _LEAK * blur_px * max(spill - _LEAK_FROM, 0.0) ** 2


def _fit_template(
    image: Image, corners: Array, cells: Array, known: bool
) -> tuple[Array, float, float, float, Array]:
    """Corners, their mean variance, the likeness, the blur's variance, and the cells."""
    quad, shown = corners.copy(), cells.copy()
    light = _first_light(image, quad)
    blur, damping = 0.7, 1e-3
    before, normal, right, likeness, corrections = _linearised(image, quad, shown, blur, light)
    if not math.isfinite(before):
        return quad, math.nan, 0.0, blur, shown
    for _ in range(_STEPS):
        damped = normal.copy()
        for k in range(_PARAMETERS):
            damped[k, k] *= 1.0 + damping
            damped[k, k] += 1e-9
        step = np.linalg.solve(damped, right)
        moved = np.abs(step[:8]).max()
        if not moved < 20.0:
            return quad, math.nan, 0.0, blur, shown
        tried = quad + step[:8].copy().reshape(4, 2)
        tried_blur = min(max(blur + step[8], _LEAST_BLUR), _MOST_BLUR)
        tried_light = light + step[9:]
        tried_cells = shown if known else _clipped(shown + corrections)
        cost, tried_normal, tried_right, alike, missing = _linearised(
            image, tried, tried_cells, tried_blur, tried_light
        )
        if cost < before:
            better = before - cost
            quad, blur, light, shown = tried, tried_blur, tried_light, tried_cells
            normal, right, likeness, corrections = tried_normal, tried_right, alike, missing
            damping = max(0.2 * damping, 1e-6)
            before = cost
            if moved < _CONVERGED and better < 1e-3 * cost:
                break
        else:
            damping *= 10.0
            if damping > 1e4:
                break
    return quad, _variance(normal, before), likeness, blur, shown


def _linearised(
    image: Image, quad: Array, cells: Array, blur: float, light: Array
) -> tuple[float, Array, Array, float, Array]:
    """Mean squared difference, normal matrix and right side of the step, likeness, change of each cell."""
    count = len(cells)
    normal, right = np.zeros((_PARAMETERS, _PARAMETERS)), np.zeros(_PARAMETERS)
    corrections, weights = np.zeros((count, count)), np.zeros((count, count))
    margin = 3.0 * math.sqrt(blur) + 2.0 + np.abs(quad[2] - quad[0]).max() * _QUIET / count
    x0, y0 = int(max(quad[:, 0].min() - margin, 0.0)), int(max(quad[:, 1].min() - margin, 0.0))
    x1 = int(min(quad[:, 0].max() + margin + 1.0, image.shape[1]))
    y1 = int(min(quad[:, 1].max() + margin + 1.0, image.shape[0]))
    if x1 - x0 < 5 or y1 - y0 < 5 or not _is_convex(quad):
        return math.inf, normal, right, 0.0, corrections
    to_pixels = _homography(quad)
    back: Array = np.linalg.inv(to_pixels).astype(np.float64)
    blurred = _softened(_pattern(back, cells, x0, y0, y1 - y0, x1 - x0), _weights(blur))
    shortest = float(np.linalg.norm(quad - np.roll(quad, 1, axis=0), axis=1).min())
    seen = 0.5 + max(_QUIET / count - _SPILL * math.sqrt(blur) / shortest, 0.2 * _QUIET / count)
    sums = np.zeros(6)  # number, data, model, data², model², data model
    window = image[y0:y1, x0:x1]
    views = np.concatenate([to_pixels[None], back[None], _perturbed_homographies(quad)])
    _summed(window, blurred, views, (x0, y0), light, seen, (normal, right, corrections, weights, sums))
    if sums[0] < 2.0 * _PARAMETERS:
        return math.inf, normal, right, 0.0, corrections
    normal = normal + np.triu(normal, 1).T
    spread = (sums[3] - sums[1] ** 2 / sums[0]) * (sums[4] - sums[2] ** 2 / sums[0])
    likeness = (sums[5] - sums[1] * sums[2] / sums[0]) / math.sqrt(max(spread, 1e-9))
    cost = (sums[3] - 2.0 * sums[5] + sums[4]) / sums[0]
    return cost, normal, right, likeness, corrections / np.maximum(weights, 1.0)


@kernel(nogil=True, error_model="numpy")
def _summed(
    window: Image,
    model: Array,
    views: Array,
    corner: tuple[int, int],
    light: Array,
    seen: float,
    into: tuple[Array, Array, Array, Array, Array],
) -> None:
    """Add every pixel of the marker to ``into``: normal matrix (its upper half), right side, missing light
    and number of pixels of each cell, sums.
    """
    normal, right, corrections, weights, sums = into
    back = views[1]
    count = len(corrections)
    row = np.empty(_PARAMETERS)
    for i in range(1, window.shape[0] - 1):
        for j in range(1, window.shape[1] - 1):
            X, Y = _mapped(back, corner[0] + j, corner[1] + i)
            if not max(abs(X), abs(Y)) <= seen:  # also NaN
                continue
            shown, gain = _slopes(model, i, j, views, (X, Y), light, row)
            value = float(window[i, j])
            off = value - shown
            for k in range(_PARAMETERS):
                right[k] += row[k] * off
                for other in range(k, _PARAMETERS):
                    normal[k, other] += row[k] * row[other]
            if max(abs(X), abs(Y)) < 0.5:
                at, along = _cell(Y, count), _cell(X, count)
                corrections[at, along] += off / max(gain, 1.0)
                weights[at, along] += 1.0
            terms = (1.0, value, shown, value * value, shown * shown, value * shown)
            for k in range(6):
                sums[k] += terms[k]


@kernel(nogil=True, error_model="numpy")
def _slopes(
    model: Array, i: int, j: int, views: Array, place: tuple[float, float], light: Array, row: Array
) -> tuple[float, float]:
    """The light shown at ``place`` of the marker and what paper has more than ink there; ``row`` becomes the
    derivatives.
    """
    X, Y = place
    gain = light[3] + light[4] * X + light[5] * Y
    m = model[i, j]
    dx, dy = 0.5 * (model[i, j + 1] - model[i, j - 1]), 0.5 * (model[i + 1, j] - model[i - 1, j])
    u, v = _mapped(views[0], X, Y)
    for k in range(8):
        a, b = _mapped(views[2 + k], X, Y)
        row[k] = -gain * (dx * (a - u) + dy * (b - v)) / _STEP_PX
    row[8] = 0.5 * gain * (model[i, j + 1] + model[i, j - 1] + model[i + 1, j] + model[i - 1, j] - 4.0 * m)
    row[9], row[10], row[11] = 1.0, X, Y
    row[12], row[13], row[14] = m, m * X, m * Y
    return light[0] + light[1] * X + light[2] * Y + gain * m, gain


def _homography(quad: Array) -> Array:
    """From the square of side 1 about 0 (corners in ArUco's order, y down) to ``quad`` (Heckbert 1989)."""
    (ax, ay), (bx, by), (cx, cy), (dx, dy) = quad
    ux, uy, vx, vy = bx - cx, by - cy, dx - cx, dy - cy
    sx, sy = ax - bx + cx - dx, ay - by + cy - dy
    across = ux * vy - vx * uy
    g, h = (sx * vy - vx * sy) / across, (ux * sy - sx * uy) / across
    H = np.array(
        [[bx - ax + g * bx, dx - ax + h * dx, ax], [by - ay + g * by, dy - ay + h * dy, ay], [g, h, 1.0]]
    )
    H[:, 2] += 0.5 * (H[:, 0] + H[:, 1])
    return H


def _is_convex(quad: Array) -> bool:
    """Whether all four turns are clockwise (y down) and none is nearly straight."""
    for k in range(4):
        ax, ay = quad[k] - quad[k - 1]
        bx, by = quad[(k + 1) % 4] - quad[k]
        if not ax * by - ay * bx > 0.05 * math.hypot(ax, ay) * math.hypot(bx, by):
            return False
    return True


@kernel(nogil=True, error_model="numpy")
def _cell(place: float, count: int) -> int:
    """Row or column of a cell, ``place`` from −0.5 to 0.5."""
    return min(max(int((place + 0.5) * count), 0), count - 1)


def _perturbed_homographies(quad: Array) -> Array:
    """Homographies (8, 3, 3) with one coordinate of one corner moved on by ``_STEP_PX``."""
    made = np.empty((8, 3, 3))
    for k in range(8):
        tried = quad.copy()
        tried[k // 2, k % 2] += _STEP_PX
        made[k] = _homography(tried)
    return made


@kernel(nogil=True, error_model="numpy")
def _mapped(H: Array, x: float, y: float) -> tuple[float, float]:
    w = H[2, 0] * x + H[2, 1] * y + H[2, 2]
    return (H[0, 0] * x + H[0, 1] * y + H[0, 2]) / w, (H[1, 0] * x + H[1, 1] * y + H[1, 2]) / w


@kernel(nogil=True, error_model="numpy")
def _pattern(back: Array, cells: Array, x0: int, y0: int, rows: int, columns: int) -> Array:
    """The share of paper in each pixel of a window, paper without end around the marker.

    A pixel counts as the rectangle along the marker's axes that is as wide as the pixel's root mean square:
    exact for an upright marker, and smooth in the corners for all.
    """
    count = len(cells)
    made = np.ones((rows, columns))
    for i in range(rows):
        for j in range(columns):
            u, v = x0 + j, y0 + i
            w = back[2, 0] * u + back[2, 1] * v + back[2, 2]
            X, Y = _mapped(back, u, v)
            wide = math.hypot(back[0, 0] - X * back[2, 0], back[0, 1] - X * back[2, 1]) / abs(w) * count
            high = math.hypot(back[1, 0] - Y * back[2, 0], back[1, 1] - Y * back[2, 1]) / abs(w) * count
            left, top = (X + 0.5) * count - 0.5 * wide, (Y + 0.5) * count - 0.5 * high
            for k in range(max(int(top), 0), min(int(top + high) + 1, count)):
                across = min(top + high, k + 1.0) - max(top, k)
                for m in range(max(int(left), 0), min(int(left + wide) + 1, count)):
                    along = min(left + wide, m + 1.0) - max(left, m)
                    if across > 0.0 and along > 0.0:
                        made[i, j] -= (1.0 - cells[k, m]) * across * along / (wide * high)
    return made


@kernel(nogil=True, error_model="numpy")
def _softened(sharp: Array, weights: Array) -> Array:
    """Blurred along both axes by ``weights`` (odd), edges repeated."""
    reach = len(weights) // 2
    rows, columns = sharp.shape
    half, made = np.zeros((rows, columns)), np.zeros((rows, columns))
    for i in range(rows):
        for j in range(columns):
            for k in range(-reach, reach + 1):
                half[i, j] += weights[k + reach] * sharp[i, min(max(j + k, 0), columns - 1)]
    for i in range(rows):
        for j in range(columns):
            for k in range(-reach, reach + 1):
                made[i, j] += weights[k + reach] * half[min(max(i + k, 0), rows - 1), j]
    return made


def _weights(variance: float) -> Array:
    """Of a Gaussian."""
    reach = int(3.0 * math.sqrt(variance)) + 1
    weights = np.exp(-0.5 * np.arange(-reach, reach + 1) ** 2 / variance)
    return np.asarray(weights / weights.sum())


def _first_light(image: Image, quad: Array) -> Array:
    """Ink and paper from the light on the border's middle and just outside of it."""
    H = _homography(quad)
    dark, bright = 0.0, 0.0
    for k in range(40):
        along = -0.4 + 0.8 * (k // 4) / 9.0
        for depth, inside in ((0.43, True), (0.57, False)):
            x, y = ((along, depth), (depth, along), (along, -depth), (-depth, along))[k % 4]
            u, v = _mapped(H, x, y)
            column, row = int(u + 0.5), int(v + 0.5)
            if 0 <= row < image.shape[0] and 0 <= column < image.shape[1]:
                if inside:
                    dark += image[row, column] / 40.0
                else:
                    bright += image[row, column] / 40.0
    return np.array([dark, 0.0, 0.0, max(bright - dark, 5.0), 0.0, 0.0])


def _clipped(cells: Array) -> Array:
    """Between ink and paper, and ink in the border."""
    made = np.minimum(np.maximum(cells, 0.0), 1.0)
    made[0], made[-1], made[:, 0], made[:, -1] = 0.0, 0.0, 0.0, 0.0
    return made


def _variance(normal: Array, cost: float) -> float:
    """Mean variance of the corners' coordinates, px²."""
    damped = normal.copy()
    for k in range(_PARAMETERS):
        damped[k, k] += 1e-9
    return float(cost * np.diag(np.linalg.inv(damped))[:8].mean())
