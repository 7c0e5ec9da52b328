"""The rays of an eye's pixels, and where they meet a plate."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.compiled import allocation_free
from plant_emulator.core.camera.fetching import fetch_line

Real32 = NDArray[np.float32]
Real64 = NDArray[np.float64]


class Rays(NamedTuple):
    """Normalised undistorted ray of each pixel centre: ``x`` and ``y`` (height, width)."""

    x: Real32
    y: Real32


@allocation_free(inline="always")
def fetch_rays(rays: Rays, i: int, first: int, last: int) -> None:
    """Hint that the rays of row ``i`` from column ``first`` to ``last`` will be wanted."""
    begin = i * rays.x.shape[1] + first
    fetch_line(rays.x, begin, last - first)
    fetch_line(rays.y, begin, last - first)


class Surface(NamedTuple):
    """What a plate's surface is like.

    ``light`` (3,) = (constant, per metre right, per metre down) multiplies the grey. ``bend`` (6,) =
    (curvature 1/m, its direction: right, down; the eye's foot on the plate: right, down (m); its height (m)).
    ``shadow`` (4,) and ``glare`` (4,) as ``lighting`` makes them.
    """

    light: Real64
    bend: Real64
    shadow: Real64
    glare: Real64


class PlatePoint(NamedTuple):
    """Where a pixel's ray meets a plate: s right, t down (m), and their change from pixel to pixel (u, v)."""

    in_front: bool
    s: float
    t: float
    s_u: float
    s_v: float
    t_u: float
    t_v: float


@allocation_free(inline="always")
def row_homography(homographies: Real64, i: int, height: int, h: Real64) -> None:
    """Fill ``h`` (3, 3) for row ``i``, between those of the picture's first and last row (2, 3, 3)."""
    share = i / (height - 1)
    for m in range(3):
        for n in range(3):
            h[m, n] = homographies[0, m, n] + (homographies[1, m, n] - homographies[0, m, n]) * share


@allocation_free(inline="always")
def shaded(s: float, t: float, shadow: Real64) -> float:
    """The share of light that the shadow leaves at (s, t)."""
    if shadow[3] == 1.0:
        return 1.0
    beyond = shadow[0] * s + shadow[1] * t + shadow[2] + 0.5
    return float(shadow[3] + (1.0 - shadow[3]) * min(max(beyond, 0.0), 1.0))


@allocation_free(inline="always")
def highlight(s: float, t: float, glare: Real64) -> float:
    """The grey that glare adds at (s, t)."""
    if glare[3] == 0.0:
        return 0.0
    return float(glare[3] * math.exp(-glare[2] * ((s - glare[0]) ** 2 + (t - glare[1]) ** 2)))


@allocation_free(inline="always")
def bent(s: float, t: float, bend: Real64) -> tuple[float, float]:
    """Where the ray that meets the plate's plane at (s, t) meets its bent surface, by two steps along it."""
    bent_s, bent_t = s, t
    for _ in range(2):
        rise = bend[0] * (bend[1] * bent_s + bend[2] * bent_t) ** 2 / bend[5]
        bent_s, bent_t = s + (bend[3] - s) * rise, t + (bend[4] - t) * rise
    return bent_s, bent_t


@allocation_free
def places_on_plate(xs: Real32, ys: Real32, h: Real64, places: Real64) -> None:
    """Fill ``places`` (3, n or more): where the rays ``xs``, ``ys`` (n,) meet the plate; the inverse depth.

    Half of ``meet_plate``, for a line of pixels at once; where the inverse depth is not positive the rest
    means nothing.
    """
    h00, h01, h02, h10, h11, h12 = h[0, 0], h[0, 1], h[0, 2], h[1, 0], h[1, 1], h[1, 2]
    h20, h21, h22 = h[2, 0], h[2, 1], h[2, 2]
    for k in range(xs.shape[0]):
        x, y = np.float64(xs[k]), np.float64(ys[k])
        w = h20 * x + h21 * y + h22
        places[0, k] = (h00 * x + h01 * y + h02) / w
        places[1, k] = (h10 * x + h11 * y + h12) / w
        places[2, k] = w


@allocation_free(inline="always")
def meet_plate(rays: Rays, h: Real64, i: int, j: int) -> PlatePoint:
    """Where the ray of pixel (i, j) meets the plate.

    ``h`` (3, 3) maps (ray x, ray y, 1) to (s, t, 1) times the inverse depth.
    """
    x, y = np.float64(rays.x[i, j]), np.float64(rays.y[i, j])
    w = h[2, 0] * x + h[2, 1] * y + h[2, 2]
    if w <= 1e-9:
        return PlatePoint(False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    height, width = rays.x.shape
    i0, i1 = max(i - 1, 0), min(i + 1, height - 1)
    j0, j1 = max(j - 1, 0), min(j + 1, width - 1)
    s = (h[0, 0] * x + h[0, 1] * y + h[0, 2]) / w
    t = (h[1, 0] * x + h[1, 1] * y + h[1, 2]) / w
    per_column, per_row = 0.5 if j1 - j0 == 2 else 1.0, 0.5 if i1 - i0 == 2 else 1.0
    dx_du = (np.float64(rays.x[i, j1]) - rays.x[i, j0]) * per_column
    dy_du = (np.float64(rays.y[i, j1]) - rays.y[i, j0]) * per_column
    dx_dv = (np.float64(rays.x[i1, j]) - rays.x[i0, j]) * per_row
    dy_dv = (np.float64(rays.y[i1, j]) - rays.y[i0, j]) * per_row
    s_x, s_y = (h[0, 0] - s * h[2, 0]) / w, (h[0, 1] - s * h[2, 1]) / w
    t_x, t_y = (h[1, 0] - t * h[2, 0]) / w, (h[1, 1] - t * h[2, 1]) / w
    return PlatePoint(
        True,
        s,
        t,
        s_x * dx_du + s_y * dy_du,
        s_x * dx_dv + s_y * dy_dv,
        t_x * dx_du + t_y * dy_du,
        t_x * dx_dv + t_y * dy_dv,
    )
