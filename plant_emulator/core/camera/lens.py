"""The true lens of one eye: exact projection, and the ray map that inverts it for every pixel."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.compiled import kernel
from plant_emulator.config.camera import LensConfig
from plant_emulator.core.camera.rays import Rays

Real64 = NDArray[np.float64]
Real32 = NDArray[np.float32]


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
