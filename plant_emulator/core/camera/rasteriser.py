"""Compiled inner loops of the renderer: plates with exact edge coverage, vignetting and noise.

A picture is made of float32 ray maps (one normalised ray per pixel centre, the lens distortion already
inverted), so every loop here is projective geometry only. Plate edges are anti-aliased analytically: the part
of a square pixel that lies beyond a straight edge is the integral of a trapezoid, so an edge is placed
exactly and not to a fraction of a sample grid.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.compiled import allocation_free, kernel
from plant_emulator.core.camera.rays import (
    PlatePoint,
    Rays,
    Surface,
    bent,
    fetch_rays,
    meet_plate,
    places_on_plate,
    row_homography,
    shaded,
)

Grey = NDArray[np.uint8]
Real32 = NDArray[np.float32]
Real64 = NDArray[np.float64]

_MARGIN = 1.3  # for what lenses add to the extent of a pixel
_NEAR = 1e-9  # smallest inverse depth, 1/m, that still counts as in front
NOISE_LENGTH = 1 << 20
NOISE_UNIT = 256.0  # noise is kept in 1/256 grey levels


class Grid(NamedTuple):
    """Cells of one ``grey`` (rows, columns) each, between ``edges_x`` and ``edges_y`` (m), ascending."""

    edges_x: Real64
    edges_y: Real64
    grey: Real32


class _Room(NamedTuple):
    """Where a row's homography, its pixels' places and their shares in cells are noted."""

    h: Real64
    places: Real64
    weight_x: Real64
    weight_y: Real64


def paint_plate(
    out: Grey, rays: Rays, homographies: Real64, grid: Grid, box: tuple[int, int, int, int], surface: Surface
) -> None:
    """Paint one plate over ``out`` inside ``box`` (top, bottom, left, right); its rim blends with the rest.

    ``homographies`` (2, 3, 3) map (ray x, ray y, 1) to plate coordinates (x right, y down) in metres times
    the inverse depth, at the picture's first and last row.
    """
    rows, columns = grid.grey.shape
    width = box[3] - box[2]
    room = _Room(np.empty((3, 3)), np.empty((3, width)), np.empty(columns), np.empty(rows))
    _paint_rows(out, rays, homographies, grid, box, surface, room)


@allocation_free(nogil=True)
def _paint_rows(
    out: Grey,
    rays: Rays,
    homographies: Real64,
    grid: Grid,
    box: tuple[int, int, int, int],
    surface: Surface,
    room: _Room,
) -> None:
    light, bend, shadow = surface
    edges_x, edges_y, grey = grid
    top, bottom, left, right = box
    h, places = room.h, room.places
    for i in range(top, bottom):
        fetch_rays(rays, i + 1, left, right)
        row_homography(homographies, i, out.shape[0], h)
        reach_s, reach_t = _most_reach(rays, h, i, (left, right))
        places_on_plate(rays.x[i, left:right], rays.y[i, left:right], h, places)
        column = row = 0  # cells change slowly along a line of pixels: the search starts where it ended
        for k in range(right - left):
            s, t = places[0, k], places[1, k]
            if places[2, k] <= _NEAR:
                continue
            if bend[0] != 0.0:
                s, t = bent(s, t, bend)
            if _beyond(s, reach_s, edges_x) or _beyond(t, reach_t, edges_y):
                continue
            column, row = _first_cell(edges_x, s - reach_s, column), _first_cell(edges_y, t - reach_t, row)
            lit = (light[0] + light[1] * s + light[2] * t) * shaded(s, t, shadow)
            if _within(s, reach_s, edges_x, column) and _within(t, reach_t, edges_y, row):
                value = grey[row, column] * lit
            else:
                at, under = meet_plate(rays, h, i, left + k), np.float64(out[i, left + k])
                value = _blended(at, (s, t), grid, room, (column, row), lit, under)
            out[i, left + k] = np.uint8(min(max(value, 0.0), 255.0) + 0.5)


@allocation_free
def _most_reach(rays: Rays, h: Real64, i: int, columns: tuple[int, int]) -> tuple[float, float]:
    """More than half a pixel's extent on the plate, right and down (m), anywhere in ``columns`` of row ``i``.

    The extent grows with the inverse square of the nearness, which is linear along the row: it is largest at
    an end, up to what lenses add.
    """
    most_s = most_t = 0.0
    for j in (columns[0], columns[1] - 1):
        at = meet_plate(rays, h, i, j)
        if not at.in_front:
            return np.inf, np.inf
        most_s = max(most_s, 0.5 * (abs(at.s_u) + abs(at.s_v)))
        most_t = max(most_t, 0.5 * (abs(at.t_u) + abs(at.t_v)))
    return _MARGIN * most_s, _MARGIN * most_t


@allocation_free(inline="always")
def _beyond(place: float, reach: float, edges: Real64) -> bool:
    """Whether nothing of a pixel is on the plate."""
    return bool(place + reach <= edges[0] or place - reach >= edges[-1])


@allocation_free(inline="always")
def _within(place: float, reach: float, edges: Real64, cell: int) -> bool:
    """Whether all of a pixel is in one cell."""
    return bool(edges[cell] <= place - reach and place + reach <= edges[cell + 1])


@allocation_free(inline="always")
def _blended(
    at: PlatePoint,
    place: tuple[float, float],
    grid: Grid,
    room: _Room,
    cell: tuple[int, int],
    lit: float,
    under: float,
) -> float:
    """The grey of a pixel where cells, or the plate and what is ``under`` it, meet; ``cell`` is a guess."""
    (s, t), (edges_x, edges_y, grey), weight_x, weight_y = place, grid, room.weight_x, room.weight_y
    s_u, s_v, t_u, t_v = abs(at.s_u), abs(at.s_v), abs(at.t_u), abs(at.t_v)
    s_reach, t_reach = 0.5 * (s_u + s_v), 0.5 * (t_u + t_v)
    column, row = _first_cell(edges_x, s - s_reach, cell[0]), _first_cell(edges_y, t - t_reach, cell[1])
    if _within(s, s_reach, edges_x, column) and _within(t, t_reach, edges_y, row):
        return float(grey[row, column] * lit)
    last_column = _cell_weights(s, s_u, s_v, edges_x, column, weight_x)
    last_row = _cell_weights(t, t_u, t_v, edges_y, row, weight_y)
    total = alpha = 0.0
    for k in range(row, last_row):
        for m in range(column, last_column):
            alpha += weight_y[k] * weight_x[m]
            total += weight_y[k] * weight_x[m] * grey[k, m]
    return total * lit + (1.0 - alpha) * under


@allocation_free(inline="always")
def _first_cell(edges: Real64, place: float, guess: int) -> int:
    """The cell that contains ``place``, the first or last one for places beyond the edges."""
    while guess > 0 and edges[guess] > place:
        guess -= 1
    while guess < edges.shape[0] - 2 and edges[guess + 1] <= place:
        guess += 1
    return guess


@allocation_free(inline="always")
def _cell_weights(centre: float, a: float, b: float, edges: Real64, first: int, weights: Real64) -> int:
    """Fill ``weights`` from ``first`` on with the pixel's share in each strip; returns where that ends.

    ``a`` and ``b`` are the pixel's extents across the strips along its two sides.
    """
    long, short = max(a, b), min(a, b)
    below = share_below(edges[first] - centre, long, short)
    k = first
    while k < weights.shape[0] and (k == first or below < 1.0):
        above = share_below(edges[k + 1] - centre, long, short)
        weights[k] = above - below
        below = above
        k += 1
    return k


@allocation_free(inline="always")
def share_below(distance: float, long: float, short: float) -> float:
    """Share of a pixel on the near side of a straight edge at ``distance`` from its centre.

    The pixel's extents across the edge along its two sides are ``long`` >= ``short``: the convolution of two
    boxes.
    """
    reach, flat = 0.5 * (long + short), 0.5 * (long - short)
    if distance >= reach:
        return 1.0
    if distance <= -reach:
        return 0.0
    if distance > flat:
        return 1.0 - (reach - distance) ** 2 / (2.0 * long * short)
    if distance < -flat:
        return (reach + distance) ** 2 / (2.0 * long * short)
    return 0.5 + distance / long


@kernel(fastmath=True, nogil=True)
def finish(
    picture: Grey,
    noise: NDArray[np.int16],
    key: int,
    gain: float,
    falloff: float,
    centre_u: float,
    centre_v: float,
) -> None:
    """Apply gain, vignetting (1 - falloff r², r in pixels from the centre) and noise to ``picture`` in place.

    Each row takes its noise from a place in ``noise`` that a hash of ``key`` and the row chooses:
    reproducible, and with no pattern that stands still from frame to frame.
    """
    height, width = picture.shape
    span = np.uint64(noise.shape[0] - width)
    gain32, falloff32, centre32 = np.float32(gain), np.float32(gain * falloff), np.float32(centre_u)
    unit = np.float32(1.0 / NOISE_UNIT)
    for i in range(height):
        start = np.int64(_mixed(np.uint64(key) + np.uint64(i) * np.uint64(0x9E3779B97F4A7C15)) % span)
        row_noise = noise[start : start + width]
        row = picture[i]
        vertical = gain32 - falloff32 * np.float32((i - centre_v) ** 2)
        for j in range(width):
            du = np.float32(j) - centre32
            value = np.float32(row[j]) * (vertical - falloff32 * du * du) + np.float32(row_noise[j]) * unit
            row[j] = np.uint8(min(max(value + np.float32(0.5), np.float32(0.0)), np.float32(255.0)))


@kernel(nogil=True, error_model="numpy", inline="always")
def _mixed(value: np.uint64) -> np.uint64:
    """The splitmix64 finaliser."""
    value = (value ^ (value >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    value = (value ^ (value >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return value ^ (value >> np.uint64(31))
