"""The rays of an eye's pixels, and where they meet a plate."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.compiled import allocation_free, kernel
from plant_emulator.config.camera import LensConfig
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
    ``shadow`` (4,) as ``shadow_on`` makes it.
    """

    light: Real64
    bend: Real64
    shadow: Real64


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


_STRAIGHT = 0.01  # coefficients below it bend a marker's side by less than its rim is wide


class Optics(NamedTuple):
    """``focal`` and ``centre`` (2,) px; ``coefficients`` (5,) of the distortion: k1, k2, p1, p2, k3."""

    focal: Real64
    centre: Real64
    coefficients: Real64


class Lens:
    """Pinhole with Brown-Conrady distortion; pixel (0, 0) is centred at image coordinates (0, 0), as in
    OpenCV. ``bends``: straight lines are visibly bent, as in pictures that nobody rectified.
    """

    def __init__(self, config: LensConfig, shift_u_px: float = 0.0, shift_v_px: float = 0.0) -> None:
        self.focal = np.array([config.fx_px, config.fy_px])
        self.centre = np.array([config.cx_px + shift_u_px, config.cy_px + shift_v_px])
        self._coefficients = np.array([config.k1, config.k2, config.p1, config.p2, config.k3])
        self.optics = Optics(self.focal, self.centre, self._coefficients)
        self.bends = bool(np.abs(self._coefficients).max() > _STRAIGHT)

    def project(self, points: Real64) -> Real64:
        """Image coordinates (n, 2) px of points (n, 3) in the eye's axes; NaN where not in front."""
        return np.asarray(_project_all(points, self.optics))

    def ray_map(self, width: int, height: int) -> Rays:
        """The rays of all pixels of a picture.

        Newton's method on the distortion polynomial. Raises ValueError when the polynomial cannot be inverted
        within the picture, that is where the distorted picture would fold over.
        """
        return _ray_map(
            width,
            height,
            tuple(self.focal.tolist()),
            tuple(self.centre.tolist()),
            tuple(self._coefficients.tolist()),
        )


@lru_cache(maxsize=4)
def _ray_map(
    width: int, height: int, focal: tuple[float, ...], centre: tuple[float, ...], k: tuple[float, ...]
) -> Rays:
    """The rays of all pixels through this lens, read-only, kept for the next camera that has it: campaigns
    make one for every run. Raises ValueError as ``ray_map``.
    """
    ray_x = np.empty((height, width), dtype=np.float32)
    ray_y = np.empty((height, width), dtype=np.float32)
    worst = _invert(ray_x, ray_y, np.array(focal), np.array(centre), np.array(k))
    if not worst < 1e-10:
        raise ValueError("the lens distortion cannot be inverted everywhere inside the picture")
    for component in (ray_x, ray_y):
        component.flags.writeable = False
    return Rays(ray_x, ray_y)


@kernel(nogil=True)
def _distort(x: float, y: float, k: Real64) -> tuple[float, float]:
    """Brown-Conrady distortion of a normalised point; ``k`` = (k1, k2, p1, p2, k3) as in OpenCV."""
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    return (
        x * radial + 2.0 * k[2] * x * y + k[3] * (r2 + 2.0 * x * x),
        y * radial + k[2] * (r2 + 2.0 * y * y) + 2.0 * k[3] * x * y,
    )


@kernel(nogil=True)
def projected(point: Real64, optics: Optics) -> tuple[float, float]:
    """Image coordinates (px) of ``point`` (3,) in the eye's axes; NaN where it is not in front."""
    depth = point[2] if point[2] > 1e-6 else np.nan
    u, v = _distort(point[0] / depth, point[1] / depth, optics.coefficients)
    return u * optics.focal[0] + optics.centre[0], v * optics.focal[1] + optics.centre[1]


@kernel(nogil=True)
def _project_all(points: Real64, optics: Optics) -> Real64:
    image = np.empty((points.shape[0], 2))
    for i in range(points.shape[0]):
        image[i, 0], image[i, 1] = projected(points[i], optics)
    return image


@kernel(nogil=True)
def _invert(ray_x: Real32, ray_y: Real32, focal: Real64, centre: Real64, k: Real64) -> float:
    """Fill the ray map; returns the worst remaining distance, infinity where the polynomial folds over."""
    worst = 0.0
    for i in range(ray_x.shape[0]):
        for j in range(ray_x.shape[1]):
            want_x, want_y = (j - centre[0]) / focal[0], (i - centre[1]) / focal[1]
            x, y = want_x, want_y
            error = np.inf
            for _ in range(20):
                got_x, got_y = _distort(x, y, k)
                error_x, error_y = got_x - want_x, got_y - want_y
                error = np.hypot(error_x, error_y)
                r2 = x * x + y * y
                radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
                slope = 2.0 * (k[0] + r2 * (2.0 * k[1] + r2 * 3.0 * k[4]))
                xx = radial + x * x * slope + 2.0 * k[2] * y + 6.0 * k[3] * x
                yy = radial + y * y * slope + 6.0 * k[2] * y + 2.0 * k[3] * x
                xy = x * y * slope + 2.0 * k[2] * x + 2.0 * k[3] * y
                determinant = xx * yy - xy * xy
                if determinant <= 0.0:
                    return np.inf
                if error < 1e-13:
                    break
                x -= (yy * error_x - xy * error_y) / determinant
                y -= (xx * error_y - xy * error_x) / determinant
            worst = max(worst, error)
            ray_x[i, j], ray_y[i, j] = x, y
    return worst
