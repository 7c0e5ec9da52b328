"""Corners of a marker from all of its light: its pattern, projected and blurred, is fitted to the pixels.

Unknown are the four corners, the blur, the light of ink and paper and how both change across the marker; the
cells are known. Gauss-Newton steps, damped, on the difference of picture and model, as in direct alignment
(Baker and Matthews 2004, forwards additive). Where white is cut off, the model may
be whiter than the picture.
"""

import math
from typing import NamedTuple

import cv2
import numpy as np

from foundation.compiled import kernel
from vision_pc.core.perception.marker_edges import grey_between, mapped
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image

_LONGEST_PX = 120.0  # [D] of an edge; pictures of longer ones are made smaller, as the model costs their area
_STEPS = 25
_CONVERGED = 1e-3  # [D] of the squares of what is left: less than one step more may gain
_CONVERGED_PX = 0.01  # [D]
_STIFF = 1e3  # [D] damping at which no step gains
_HELD = 1e12  # [D] weight of a blur that may not go on
_FAR = 2.0  # [D] cells from where it began: another thing
_STEP_PX = 0.01  # of a corner, for the derivative
_LEAST_BLUR, _MOST_BLUR = 0.1, 16.0  # variances, px²
_PARAMETERS = 15  # corners, variance of the blur, six of light
_CUT_OFF = 0.003  # [D] weight of a pixel as white as can be, where the model is whiter
_WHITE = 255.0  # where a picture's light is cut off
_SPILL = 2.2  # σ of the blur: the ground's light reaches so far into the paper
_QUIET = 1.0  # cells of paper around the border that are believed in
_LIKE = 0.85  # correlation of picture and model below which it is another thing
_OTHER_CELL = 0.45  # [D] of the step from ink to paper: a cell that differs by more, at the mean, is another
_CUT_STD = 0.1  # [M] of the blur: what is left where all white is cut off
_FLOOR_PX = 0.01  # [M] what sampling leaves in the model, without noise (rendered markers, version 0.2.0)
_LEAK, _LEAK_FROM = 0.2, 0.7  # [M] of the ground's light through the paper: the same, over blur; in cells


class TemplateFit(NamedTuple):
    """Corners (4, 2) px, their standard deviation a coordinate, the correlation of picture and model, σ of
    the blur in px, and how many cells look otherwise.
    """

    corners: Array
    std_px: float
    likeness: float
    blur_px: float
    wrong_cells: int


class _Linearised(NamedTuple):
    """Mean squared difference of picture and model, normal matrix and right side of the step, likeness, and
    what each cell (n, n) has more than its model, of the step from ink to paper; how many pixels.
    """

    cost: float
    normal: Array
    right: Array
    likeness: float
    excess: Array
    pixels: float


class _Guess(NamedTuple):
    quad: Array
    blur: float
    light: Array


def fit(image: Image, corners: Array, cells: Array) -> TemplateFit | None:
    """The marker with ``cells`` (n, n, border included; ink 0, paper 1) near ``corners``; None: it is not.

    ``corners`` (4, 2) px in ArUco's order, right within about a cell.
    """
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
    if not edges.min() >= 4.0:  # also NaN
        return None
    cells = np.ascontiguousarray(cells, dtype=np.float64)
    scale = min(1.0, _LONGEST_PX / float(edges.max()))
    if scale == 1.0:
        return _fit_here(image, np.ascontiguousarray(corners, dtype=np.float64), cells)
    low = np.maximum((corners.min(axis=0) - 0.3 * np.ptp(corners, axis=0)).astype(int), 0)
    high = np.maximum((corners.max(axis=0) + 0.3 * np.ptp(corners, axis=0)).astype(int) + 2, low)
    part = image[low[1] : high[1], low[0] : high[0]]
    if min(part.shape) * scale < 5.0:
        return None
    small = np.asarray(cv2.resize(part, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)
    found = _fit_here(small, (corners - low + 0.5) * scale - 0.5, cells)
    if found is None:
        return None
    corners = (found.corners + 0.5) / scale - 0.5 + low
    return found._replace(corners=corners, std_px=found.std_px / scale, blur_px=found.blur_px / scale)


def _fit_here(image: Image, quad: Array, cells: Array) -> TemplateFit | None:
    if not _is_convex(quad):
        return None
    guess, last = _fitted(image, quad, cells)
    if not (last.likeness >= _LIKE and np.isfinite(guess.quad).all()):
        return None
    unclipped = last.normal[9, 9] / last.pixels  # of white that is cut off nearly nothing is
    variances = np.diag(np.linalg.inv(last.normal + 1e-9 * np.eye(_PARAMETERS)))[:8]
    variance = last.cost / unclipped * variances.mean()
    if not np.isfinite(variance):
        return None
    blur_px = math.sqrt(guess.blur)
    leak = _leak_px(blur_px, len(cells), guess.quad)
    std = math.sqrt(
        max(float(variance), 0.0) + _FLOOR_PX**2 + leak**2 + (_CUT_STD * blur_px * (1.0 - unclipped)) ** 2
    )
    wrong = int((np.abs(last.excess) > _OTHER_CELL).sum())
    return TemplateFit(guess.quad, std, last.likeness, blur_px, wrong)


def _leak_px(blur_px: float, count: int, corners: Array) -> float:
    """What corners are off by where the paper is narrower than the blur is wide."""
    shortest = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).min()
    spill = _SPILL * blur_px * count / max(float(shortest), 1.0)
    return _LEAK * blur_px * max(spill - _LEAK_FROM, 0.0) ** 2


@kernel(nogil=True, error_model="numpy")
def _fitted(image: Image, quad: Array, cells: Array) -> tuple[_Guess, _Linearised]:
    """The best guess, and what is left there; its likeness is 0 where there is none."""
    (ax, ay), (bx, by) = quad[2] - quad[0], quad[3] - quad[1]
    cell = math.sqrt(0.5 * abs(ax * by - ay * bx)) / len(cells)
    guess = _Guess(quad, 0.7, _first_light(image, quad))
    last, damping = _linearised(image, guess, cells), 1e-3
    for _ in range(_STEPS):
        if not math.isfinite(last.cost):
            break
        damped = last.normal.copy()
        for k in range(_PARAMETERS):
            damped[k, k] += damping * damped[k, k] + 1e-9
        step = np.linalg.solve(damped, last.right)
        blur = min(max(guess.blur + step[8], _LEAST_BLUR), _MOST_BLUR)
        if blur != guess.blur + step[8]:
            held = last.right.copy()
            damped[8, 8], held[8] = _HELD, _HELD * (blur - guess.blur)
            step = np.linalg.solve(damped, held)
        step *= min(1.0, cell / max(np.abs(step[:8]).max(), 1e-9))
        tried = _Guess(guess.quad + step[:8].copy().reshape(4, 2), blur, guess.light + step[9:])
        if not np.abs(tried.quad - quad).max() < _FAR * cell:  # also NaN
            return guess, _Linearised(math.nan, last.normal, last.right, 0.0, last.excess, 1.0)
        there = _linearised(image, tried, cells)
        gained = 1.0 - there.cost / last.cost
        if gained > 0.0:
            guess, last, damping = tried, there, max(0.2 * damping, 1e-6)
        else:
            damping = max(10.0 * damping, 1.0)  # half the step
        if (
            0.0 < gained < _CONVERGED * (damping < 0.1)
            or damping > _STIFF
            or np.abs(step[:8]).max() < _CONVERGED_PX
        ):
            break
    return guess, last


@kernel(nogil=True, error_model="numpy")
def _linearised(image: Image, guess: _Guess, cells: Array) -> _Linearised:
    quad, count, sigma = guess.quad, len(cells), math.sqrt(guess.blur)
    margin = 3.0 * sigma + 2.0 + np.abs(quad[2] - quad[0]).max() * _QUIET / count
    x0, y0 = int(max(quad[:, 0].min() - margin, 0.0)), int(max(quad[:, 1].min() - margin, 0.0))
    x1 = int(min(quad[:, 0].max() + margin + 1.0, image.shape[1]))
    y1 = int(min(quad[:, 1].max() + margin + 1.0, image.shape[0]))
    nothing, none = np.zeros((_PARAMETERS, _PARAMETERS)), np.zeros((count, count))
    if x1 - x0 < 5 or y1 - y0 < 5 or not _is_convex(quad):
        return _Linearised(math.inf, nothing, nothing[0], 0.0, none, 1.0)
    views = _views(quad)
    reach = int(3.0 * sigma) + 1
    sharp = _pattern(views[1], cells, (x0 - reach, y0 - reach), (y1 - y0 + 2 * reach, x1 - x0 + 2 * reach))
    model = _softened(sharp, np.exp(-0.5 * np.arange(-reach, reach + 1) ** 2 / guess.blur))
    shortest = math.inf
    for k in range(4):
        shortest = min(shortest, math.hypot(quad[k, 0] - quad[k - 1, 0], quad[k, 1] - quad[k - 1, 1]))
    seen = 0.5 + max(_QUIET / count - _SPILL * sigma / shortest, 0.2 * _QUIET / count)
    window = image[y0:y1, x0:x1]
    products, of_grey, excess = _differences(window, model, views, (x0, y0), guess.light, seen, count)
    unclipped = products[9, 9]
    if unclipped < 2 * _PARAMETERS:
        return _Linearised(math.inf, nothing, nothing[0], 0.0, none, 1.0)
    normal, right = products[:15, :15].copy(), products[:15, 15].copy()
    return _Linearised(
        products[15, 15] / of_grey[0], normal, right, _correlation(of_grey), excess, of_grey[0]
    )


@kernel(nogil=True, error_model="numpy")
def _correlation(sums: Array) -> float:
    """Of two quantities, from ``sums`` of 1, a, b, a², b², a b."""
    n, a, b, aa, bb, ab = sums
    return float((n * ab - a * b) / math.sqrt(max((n * aa - a * a) * (n * bb - b * b), 1e-9)))


@kernel(nogil=True, error_model="numpy")
def _derivatives(
    row: Array, by_corner: Array, slope: tuple[float, float, float], X: float, Y: float, m: float
) -> None:
    """Fill into ``row`` (16,) the derivatives of a grey level by corners (0 to 7) and light (9 to 14)."""
    along, down, beyond = slope
    for k in range(8):
        D = by_corner[k]
        row[k] = (
            (along * D[0] + down * D[3] + beyond * D[6]) * X
            + (along * D[1] + down * D[4] + beyond * D[7]) * Y
            + along * D[2]
            + down * D[5]
            + beyond * D[8]
        )
    row[9], row[10], row[11] = 1.0, X, Y
    row[12], row[13], row[14] = m, m * X, m * Y


@kernel(nogil=True, error_model="numpy")
def _differences(
    window: Image,
    model: Array,
    views: tuple[Array, Array, Array],
    corner: tuple[int, int],
    light: Array,
    seen: float,
    count: int,
) -> tuple[Array, Array, Array]:
    """Of the marker's pixels: products (16, 16) of the derivatives and the difference, summed; number, grey
    of picture and model, their squares and product, summed; the mean excess of each cell.
    """
    H, back, by_corner = views
    products, row, sums = np.zeros((16, 16)), np.empty(16), np.zeros(6)
    excess, pixels = np.zeros((count, count)), np.full((count, count), 1e-9)
    for i in range(1, window.shape[0] - 1):
        for j in range(1, window.shape[1] - 1):
            X, Y = mapped(back, corner[0] + j, corner[1] + i)
            if not max(abs(X), abs(Y)) <= seen:  # also NaN
                continue
            gain, m = light[3] + light[4] * X + light[5] * Y, model[i, j]
            grey, value = light[0] + light[1] * X + light[2] * Y + gain * m, float(window[i, j])
            shown = min(grey, _WHITE)
            weight = 1.0 if value < _WHITE or grey < _WHITE else _CUT_OFF
            dx = -0.5 * gain * (model[i, j + 1] - model[i, j - 1])
            dy = -0.5 * gain * (model[i + 1, j] - model[i - 1, j])
            w = H[2, 0] * X + H[2, 1] * Y + H[2, 2]
            along, down = dx / w, dy / w
            beyond = -along * (corner[0] + j) - down * (corner[1] + i)
            around = model[i, j + 1] + model[i, j - 1] + model[i + 1, j] + model[i - 1, j]
            row[8], row[15] = 0.5 * gain * (around - 4.0 * m), value - grey
            _derivatives(row, by_corner, (along, down, beyond), X, Y, m)
            for a in range(16):
                for b in range(16):
                    products[a, b] += weight * row[a] * row[b]
            terms = (1.0, value, shown, value * value, shown * shown, value * shown)
            for k in range(6):
                sums[k] += terms[k]
            if max(abs(X), abs(Y)) < 0.5:
                at, across = _cell(Y, count), _cell(X, count)
                excess[at, across] += (value - shown) / max(gain, 1.0)
                pixels[at, across] += 1.0
    return products, sums, excess / pixels


@kernel(nogil=True, error_model="numpy")
def _homography(quad: Array) -> Array:
    """From the square of side 1 about 0 (corners in ArUco's order, y down) to ``quad`` (Heckbert 1989)."""
    ax, ay, bx, by = quad[0, 0], quad[0, 1], quad[1, 0], quad[1, 1]
    cx, cy, dx, dy = quad[2, 0], quad[2, 1], quad[3, 0], quad[3, 1]
    ux, uy, vx, vy = bx - cx, by - cy, dx - cx, dy - cy
    sx, sy = ax - bx + cx - dx, ay - by + cy - dy
    across = ux * vy - vx * uy
    g, h = (sx * vy - vx * sy) / across, (ux * sy - sx * uy) / across
    H = np.array(
        [[bx - ax + g * bx, dx - ax + h * dx, ax], [by - ay + g * by, dy - ay + h * dy, ay], [g, h, 1.0]]
    )
    H[:, 2] += 0.5 * (H[:, 0] + H[:, 1])
    return H


@kernel(nogil=True, error_model="numpy")
def _is_convex(quad: Array) -> bool:
    """Whether all four turns are clockwise (y down) and none is nearly straight."""
    for k in range(4):
        ax, ay = quad[k, 0] - quad[k - 1, 0], quad[k, 1] - quad[k - 1, 1]
        bx, by = quad[(k + 1) % 4, 0] - quad[k, 0], quad[(k + 1) % 4, 1] - quad[k, 1]
        if not ax * by - ay * bx > 0.05 * math.hypot(ax, ay) * math.hypot(bx, by):
            return False
    return True


@kernel(nogil=True, error_model="numpy")
def _cell(place: float, count: int) -> int:
    """Row or column of a cell, ``place`` from −0.5 to 0.5."""
    return min(max(int((place + 0.5) * count), 0), count - 1)


@kernel(nogil=True, error_model="numpy")
def _views(quad: Array) -> tuple[Array, Array, Array]:
    """The homography of ``quad``, its inverse, and its derivatives by the corners' coordinates (8, 9)."""
    H, by_corner = _homography(quad), np.empty((8, 9))
    for k in range(8):
        tried = quad.copy()
        tried[k // 2, k % 2] += _STEP_PX
        by_corner[k] = (_homography(tried) - H).ravel() / _STEP_PX
    return H, np.asarray(np.linalg.inv(H), dtype=np.float64), by_corner


@kernel(nogil=True, error_model="numpy")
def _pattern(back: Array, cells: Array, corner: tuple[int, int], shape: tuple[int, int]) -> Array:
    """The share of paper in each pixel of a window, paper without end around the marker.

    A pixel counts as the rectangle along the marker's axes that is as wide as the pixel's root mean square:
    exact for an upright marker, and smooth in the corners for all.
    """
    count = len(cells)
    made = np.ones(shape)
    for i in range(shape[0]):
        for j in range(shape[1]):
            u, v = corner[0] + j, corner[1] + i
            X, Y = mapped(back, u, v)
            if not max(abs(X), abs(Y)) * count < 0.5 * count + 2.0:
                continue
            w = abs(back[2, 0] * u + back[2, 1] * v + back[2, 2]) / count
            wide = math.hypot(back[0, 0] - X * back[2, 0], back[0, 1] - X * back[2, 1]) / w
            high = math.hypot(back[1, 0] - Y * back[2, 0], back[1, 1] - Y * back[2, 1]) / w
            left, top = (X + 0.5) * count - 0.5 * wide, (Y + 0.5) * count - 0.5 * high
            ink = 0.0
            for k in range(max(int(top), 0), min(int(top + high) + 1, count)):
                across = min(top + high, k + 1.0) - max(top, k)
                for m in range(max(int(left), 0), min(int(left + wide) + 1, count)):
                    along = min(left + wide, m + 1.0) - max(left, m)
                    if across > 0.0 and along > 0.0:
                        ink += (1.0 - cells[k, m]) * across * along
            made[i, j] -= ink / (wide * high)
    return made


@kernel(nogil=True, error_model="numpy")
def _softened(sharp: Array, weights: Array) -> Array:
    """Blurred along both axes by ``weights`` (odd), smaller by their length less one."""
    weights = weights / weights.sum()
    lost = len(weights) - 1
    rows, columns = sharp.shape[0] - lost, sharp.shape[1] - lost
    half, made = np.zeros((rows, columns + lost)), np.zeros((rows, columns))
    for i in range(rows):
        for k in range(lost + 1):
            for j in range(columns + lost):
                half[i, j] += weights[k] * sharp[i + k, j]
        for k in range(lost + 1):
            for j in range(columns):
                made[i, j] += weights[k] * half[i, j + k]
    return made


@kernel(nogil=True, error_model="numpy")
def grey_at(image: Image, quads: Array, places: Array) -> Array:
    """The grey levels (n, m) of each of ``quads`` (n, 4, 2) px at ``places`` (m, 2), x and y of a square of
    side 1 about 0; outside of the picture those of its rim.
    """
    grey = np.empty((len(quads), len(places)))
    for n in range(len(quads)):
        H = _homography(quads[n])
        for m in range(len(places)):
            x, y = mapped(H, places[m, 0], places[m, 1])
            grey[n, m] = grey_between(
                image, min(max(x, 0.0), image.shape[1] - 1.001), min(max(y, 0.0), image.shape[0] - 1.001)
            )
    return grey


@kernel(nogil=True, error_model="numpy")
def _first_light(image: Image, quad: Array) -> Array:
    """Ink and paper from the light on the border's middle and just outside of it."""
    H = _homography(quad)
    dark, bright = 0.0, 0.0
    for k in range(40):
        along = -0.4 + 0.8 * (k // 4) / 9.0
        for depth, inside in ((0.43, True), (0.57, False)):
            x, y = ((along, depth), (depth, along), (along, -depth), (-depth, along))[k % 4]
            u, v = mapped(H, x, y)
            column, row = int(u + 0.5), int(v + 0.5)
            if 0 <= row < image.shape[0] and 0 <= column < image.shape[1]:
                if inside:
                    dark += image[row, column] / 40.0
                else:
                    bright += image[row, column] / 40.0
    return np.array([dark, 0.0, 0.0, max(bright - dark, 5.0), 0.0, 0.0])
