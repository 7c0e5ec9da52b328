"""The rays of an eye's pixels, and where they meet a plate."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.compiled import kernel

Real32 = NDArray[np.float32]
Real64 = NDArray[np.float64]


class Rays(NamedTuple):
    """Normalised undistorted ray of each pixel centre: ``x`` and ``y`` (height, width)."""

    x: Real32
    y: Real32


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


@kernel(nogil=True, inline="always")
def row_homography(homographies: Real64, i: int, height: int) -> Real64:
    """The homography (3, 3) of row ``i``, between those of the picture's first and last row (2, 3, 3)."""
    h: Real64 = homographies[0] + (homographies[1] - homographies[0]) * (i / (height - 1))
    return h


@kernel(nogil=True, inline="always")
def shaded(s: float, t: float, shadow: Real64) -> float:
    """The share of light that the shadow leaves at (s, t)."""
    if shadow[3] == 1.0:
        return 1.0
    beyond = shadow[0] * s + shadow[1] * t + shadow[2] + 0.5
    return float(shadow[3] + (1.0 - shadow[3]) * min(max(beyond, 0.0), 1.0))


@kernel(nogil=True, inline="always")
def highlight(s: float, t: float, glare: Real64) -> float:
    """The grey that glare adds at (s, t)."""
    if glare[3] == 0.0:
        return 0.0
    return float(glare[3] * math.exp(-glare[2] * ((s - glare[0]) ** 2 + (t - glare[1]) ** 2)))


@kernel(nogil=True, inline="always")
def bent(s: float, t: float, bend: Real64) -> tuple[float, float]:
    """Where the ray that meets the plate's plane at (s, t) meets its bent surface, by two steps along it."""
    bent_s, bent_t = s, t
    for _ in range(2):
        rise = bend[0] * (bend[1] * bent_s + bend[2] * bent_t) ** 2 / bend[5]
        bent_s, bent_t = s + (bend[3] - s) * rise, t + (bend[4] - t) * rise
    return bent_s, bent_t


@kernel(nogil=True, inline="always")
def place_on_plate(ray_x: Real32, ray_y: Real32, h: Real64, i: int, j: int) -> tuple[bool, float, float]:
    """Whether the ray of pixel (i, j) meets the plate in front, and where: half of ``meet_plate``."""
    x, y = np.float64(ray_x[i, j]), np.float64(ray_y[i, j])
    w = h[2, 0] * x + h[2, 1] * y + h[2, 2]
    if w <= 1e-9:
        return False, 0.0, 0.0
    s = (h[0, 0] * x + h[0, 1] * y + h[0, 2]) / w
    t = (h[1, 0] * x + h[1, 1] * y + h[1, 2]) / w
    return True, s, t


@kernel(nogil=True, inline="always")
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
    dx_du = (np.float64(rays.x[i, j1]) - rays.x[i, j0]) / (j1 - j0)
    dy_du = (np.float64(rays.y[i, j1]) - rays.y[i, j0]) / (j1 - j0)
    dx_dv = (np.float64(rays.x[i1, j]) - rays.x[i0, j]) / (i1 - i0)
    dy_dv = (np.float64(rays.y[i1, j]) - rays.y[i0, j]) / (i1 - i0)
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
