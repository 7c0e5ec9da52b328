"""Compiled loop that paints a plate with a picture: trilinear by each pixel's footprint, exact rims."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.compiled import allocation_free
from plant_emulator.core.camera.rasteriser import beyond, most_reach, share_below, within
from plant_emulator.core.camera.rays import (
    PlatePoint,
    Rays,
    Surface,
    meet_plate,
    places_on_plate,
    row_homography,
    shaded,
)

Grey = NDArray[np.uint8]
Real32 = NDArray[np.float32]
Real64 = NDArray[np.float64]


_STRIDE = 16  # pixels


class Panel(NamedTuple):
    """A picture between two edges across and two down, in metres; ``levels``: the finest first."""

    edges_x: Real64
    edges_y: Real64
    levels: tuple[Grey, ...]


class _Room(NamedTuple):
    """Where the homography of a row and the places of its pixels are noted."""

    h: Real64
    places: Real64


def paint_panel(
    out: Grey,
    rays: Rays,
    homographies: Real64,
    panel: Panel,
    box: tuple[int, int, int, int],
    surface: Surface,
) -> None:
    """Paint one picture plate over ``out`` inside ``box``; arguments as of ``rasteriser.paint_plate``."""
    room = _Room(np.empty((3, 3)), np.empty((3, box[3] - box[2])))
    _paint_rows(out, rays, homographies, panel, box, surface, room)


@allocation_free(nogil=True)
def _paint_rows(
    out: Grey,
    rays: Rays,
    homographies: Real64,
    panel: Panel,
    box: tuple[int, int, int, int],
    surface: Surface,
    room: _Room,
) -> None:
    (edges_x, edges_y, levels), light = panel, surface.light
    top, bottom, first, last = box
    h, places = room.h, room.places
    reach_s, reach_t = most_reach(rays, homographies, box)
    texels_per_m = levels[0].shape[1] / (edges_x[1] - edges_x[0])
    for i in range(top, bottom):
        row_homography(homographies, i, out.shape[0], h)
        places_on_plate(rays.x[i, first:last], rays.y[i, first:last], h, places)
        level, rise = _level(rays, h, i, first, texels_per_m), 0.0
        for k in range(last - first):
            if k % _STRIDE == 0:  # a footprint changes by a part in a thousand over so few pixels
                far = min(k + _STRIDE, last - 1 - first)
                rise = (_level(rays, h, i, first + far, texels_per_m) - level) / max(far - k, 1)
            s, t = places[0, k], places[1, k]
            seen = places[2, k] > 1e-9 and not (beyond(s, reach_s, edges_x) or beyond(t, reach_t, edges_y))
            alpha = 1.0 if seen else 0.0
            if seen and not (within(s, reach_s, edges_x, 0) and within(t, reach_t, edges_y, 0)):
                alpha = _share(meet_plate(rays, h, i, first + k), edges_x, edges_y)
            if alpha > 0.0:
                grey = _sampled(
                    levels, (s - edges_x[0]) * texels_per_m, (t - edges_y[0]) * texels_per_m, level
                )
                lit = (light[0] + light[1] * s + light[2] * t) * shaded(s, t, surface.shadow)
                value = alpha * grey * lit + (1.0 - alpha) * out[i, first + k]
                out[i, first + k] = np.uint8(min(max(value, 0.0), 255.0) + 0.5)
            level += rise


@allocation_free(inline="always")
def _level(rays: Rays, h: Real64, i: int, j: int, texels_per_m: float) -> float:
    """How often the picture is to be halved for the footprint of pixel (i, j); negative: it is finer."""
    at = meet_plate(rays, h, i, j)
    area = abs(at.s_u * at.t_v - at.s_v * at.t_u)
    return 0.5 * math.log2(max(area * texels_per_m * texels_per_m, 1e-12))


@allocation_free(inline="always")
def _share(at: PlatePoint, edges_x: Real64, edges_y: Real64) -> float:
    """The pixel's share in the panel."""
    return _strip(at.s, abs(at.s_u), abs(at.s_v), edges_x) * _strip(at.t, abs(at.t_u), abs(at.t_v), edges_y)


@allocation_free(inline="always")
def _strip(centre: float, a: float, b: float, edges: Real64) -> float:
    """The pixel's share between the two edges; ``a`` and ``b`` are its extents across them."""
    long, short = max(a, b), min(a, b)
    return share_below(edges[1] - centre, long, short) - share_below(edges[0] - centre, long, short)


@allocation_free
def _sampled(levels: tuple[Grey, ...], column: float, row: float, level: float) -> float:
    """The picture at a place in finest texels (their corners at integers), halved ``level`` times."""
    fine, share = 0, 0.0
    if level > 0.0:
        exact = min(level, len(levels) - 1.000001)
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
