"""Compiled loop that paints a plate with a picture: trilinear by each pixel's footprint, exact rims."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.compiled import allocation_free
from plant_emulator.core.camera.rasteriser import share_below
from plant_emulator.core.camera.rays import Rays, Surface, meet_plate, row_homography, shaded

Grey = NDArray[np.uint8]
Real32 = NDArray[np.float32]
Real64 = NDArray[np.float64]


class Panel(NamedTuple):
    """A picture between two edges across and two down, in metres; ``levels``: the finest first."""

    edges_x: Real64
    edges_y: Real64
    levels: tuple[Grey, ...]


def paint_panel(
    out: Grey,
    rays: Rays,
    homographies: Real64,
    panel: Panel,
    box: tuple[int, int, int, int],
    surface: Surface,
) -> None:
    """Paint one picture plate over ``out`` inside ``box``; arguments as of ``rasteriser.paint_plate``."""
    _paint_rows(out, rays, homographies, panel, box, surface, np.empty((3, 3)))


@allocation_free(nogil=True)
def _paint_rows(
    out: Grey,
    rays: Rays,
    homographies: Real64,
    panel: Panel,
    box: tuple[int, int, int, int],
    surface: Surface,
    h: Real64,
) -> None:
    light = surface.light
    left, top, levels = panel.edges_x[0], panel.edges_y[0], panel.levels
    texels_per_m = levels[0].shape[1] / (panel.edges_x[1] - left)
    for i in range(box[0], box[1]):
        row_homography(homographies, i, out.shape[0], h)
        for j in range(box[2], box[3]):
            at = meet_plate(rays, h, i, j)
            if not at.in_front:
                continue
            alpha = _within(at.s, abs(at.s_u), abs(at.s_v), panel.edges_x)
            alpha *= _within(at.t, abs(at.t_u), abs(at.t_v), panel.edges_y)
            if alpha <= 0.0:
                continue
            footprint = texels_per_m * math.sqrt(abs(at.s_u * at.t_v - at.s_v * at.t_u))
            grey = _sampled(levels, (at.s - left) * texels_per_m, (at.t - top) * texels_per_m, footprint)
            lit = (light[0] + light[1] * at.s + light[2] * at.t) * shaded(at.s, at.t, surface.shadow)
            bright = grey * lit
            value = alpha * bright + (1.0 - alpha) * out[i, j]
            out[i, j] = np.uint8(min(max(value, 0.0), 255.0) + 0.5)


@allocation_free(inline="always")
def _within(centre: float, a: float, b: float, edges: Real64) -> float:
    """The pixel's share between the two edges; ``a`` and ``b`` are its extents across them."""
    long, short = max(a, b), min(a, b)
    return share_below(edges[1] - centre, long, short) - share_below(edges[0] - centre, long, short)


@allocation_free
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


@allocation_free(inline="always")
def _bilinear(picture: Grey, column: float, row: float) -> float:
    height, width = picture.shape
    column, row = min(max(column, 0.0), width - 1.0), min(max(row, 0.0), height - 1.0)
    j, i = min(int(column), width - 2), min(int(row), height - 2)
    a, b = column - j, row - i
    upper = picture[i, j] * (1.0 - a) + picture[i, j + 1] * a
    lower = picture[i + 1, j] * (1.0 - a) + picture[i + 1, j + 1] * a
    return float(upper * (1.0 - b) + lower * b)
