"""Compiled loop that paints a plate with a picture: trilinear by each pixel's footprint, exact rims."""

import math

import numpy as np
from numpy.typing import NDArray

from foundation.compiled import kernel
from plant_emulator.core.camera.rasteriser import share_below

Grey = NDArray[np.uint8]
Real32 = NDArray[np.float32]
Real64 = NDArray[np.float64]


@kernel(nogil=True)
def paint_panel(
    out: Grey,
    ray_x: Real32,
    ray_y: Real32,
    homographies: Real64,
    edges_x: Real64,
    edges_y: Real64,
    levels: tuple[Grey, ...],
    box: tuple[int, int, int, int],
    light: Real64,
) -> None:
    """Paint one picture plate over ``out`` inside ``box``; arguments as of ``rasteriser.paint_plate``."""
    height, width = out.shape
    texels_per_m = levels[0].shape[1] / (edges_x[1] - edges_x[0])
    for i in range(box[0], box[1]):
        h = homographies[0] + (homographies[1] - homographies[0]) * (i / (height - 1))
        i0, i1 = max(i - 1, 0), min(i + 1, height - 1)
        for j in range(box[2], box[3]):
            j0, j1 = max(j - 1, 0), min(j + 1, width - 1)
            x, y = np.float64(ray_x[i, j]), np.float64(ray_y[i, j])
            w = h[2, 0] * x + h[2, 1] * y + h[2, 2]
            if w <= 1e-9:
                continue
            s = (h[0, 0] * x + h[0, 1] * y + h[0, 2]) / w
            t = (h[1, 0] * x + h[1, 1] * y + h[1, 2]) / w
            dx_du = (np.float64(ray_x[i, j1]) - ray_x[i, j0]) / (j1 - j0)
            dy_du = (np.float64(ray_y[i, j1]) - ray_y[i, j0]) / (j1 - j0)
            dx_dv = (np.float64(ray_x[i1, j]) - ray_x[i0, j]) / (i1 - i0)
            dy_dv = (np.float64(ray_y[i1, j]) - ray_y[i0, j]) / (i1 - i0)
            s_x, s_y = (h[0, 0] - s * h[2, 0]) / w, (h[0, 1] - s * h[2, 1]) / w
            t_x, t_y = (h[1, 0] - t * h[2, 0]) / w, (h[1, 1] - t * h[2, 1]) / w
            s_u, s_v = s_x * dx_du + s_y * dy_du, s_x * dx_dv + s_y * dy_dv
            t_u, t_v = t_x * dx_du + t_y * dy_du, t_x * dx_dv + t_y * dy_dv
            alpha = _within(s, abs(s_u), abs(s_v), edges_x) * _within(t, abs(t_u), abs(t_v), edges_y)
            if alpha <= 0.0:
                continue
            footprint = texels_per_m * math.sqrt(abs(s_u * t_v - s_v * t_u))
            grey = _sampled(
                levels, (s - edges_x[0]) * texels_per_m, (t - edges_y[0]) * texels_per_m, footprint
            )
            bright = grey * (light[0] + light[1] * s + light[2] * t)
            value = alpha * bright + (1.0 - alpha) * out[i, j]
            out[i, j] = np.uint8(min(max(value, 0.0), 255.0) + 0.5)


@kernel(nogil=True, inline="always")
def _within(centre: float, a: float, b: float, edges: Real64) -> float:
    """The pixel's share between the two edges; ``a`` and ``b`` are its extents across them."""
    long, short = max(a, b), min(a, b)
    return share_below(edges[1] - centre, long, short) - share_below(edges[0] - centre, long, short)


@kernel(nogil=True)
def _sampled(levels: tuple[Grey, ...], column: float, row: float, footprint: float) -> float:
    """The picture at a place in finest texels (their corners at integers), blurred to the footprint."""
    fine, share = 0, 0.0
    if footprint > 1.0:
        exact = min(math.log2(footprint), len(levels) - 1.000001)
        fine = int(exact)
        share = exact - fine
    scale = 1.0 / (1 << fine)
    value = _bilinear(levels[fine], column * scale - 0.5, row * scale - 0.5)
    if share > 0.0:
        coarse = _bilinear(levels[fine + 1], 0.5 * column * scale - 0.5, 0.5 * row * scale - 0.5)
        value += (coarse - value) * share
    return value


@kernel(nogil=True, inline="always")
def _bilinear(picture: Grey, column: float, row: float) -> float:
    height, width = picture.shape
    column, row = min(max(column, 0.0), width - 1.0), min(max(row, 0.0), height - 1.0)
    j, i = min(int(column), width - 2), min(int(row), height - 2)
    a, b = column - j, row - i
    upper = picture[i, j] * (1.0 - a) + picture[i, j + 1] * a
    lower = picture[i + 1, j] * (1.0 - a) + picture[i + 1, j + 1] * a
    return float(upper * (1.0 - b) + lower * b)
