"""The true lens of one eye: exact projection, and the ray map that inverts it for every pixel."""

import numpy as np
from numpy.typing import NDArray

from plant_emulator.scene_config import LensConfig

Real64 = NDArray[np.float64]
Real32 = NDArray[np.float32]


class Lens:
    """Pinhole with Brown-Conrady distortion; pixel (0, 0) is centred at image coordinates (0, 0), as in
    OpenCV.
    """

    def __init__(self, config: LensConfig, shift_u_px: float = 0.0, shift_v_px: float = 0.0) -> None:
        self.focal = np.array([config.fx_px, config.fy_px])
        self.centre = np.array([config.cx_px + shift_u_px, config.cy_px + shift_v_px])
        self._k = (config.k1, config.k2, config.k3)
        self._p = (config.p1, config.p2)

    def project(self, points: Real64) -> Real64:
        """Image coordinates (n, 2) px of points (n, 3) in the eye's axes; NaN for points not in front of it."""
        depth = np.where(points[:, 2:3] > 1e-6, points[:, 2:3], np.nan)
        image: Real64 = self._distorted(points[:, :2] / depth) * self.focal + self.centre
        return image

    def ray_map(self, width: int, height: int) -> tuple[Real32, Real32]:
        """Normalised undistorted ray (x, y) for each pixel centre: two (height, width) arrays.

        Newton's method on the distortion polynomial, to 1e-13 in normalised coordinates. Raises ValueError
        when the polynomial cannot be inverted within the picture.
        """
        v, u = np.mgrid[0:height, 0:width]
        target = (np.stack([u.ravel(), v.ravel()], axis=1) - self.centre) / self.focal
        rays = target.copy()
        for _ in range(20):
            step = self._newton_step(rays, target)
            rays -= step
            if np.abs(step).max() < 1e-13:
                break
        if not np.abs(self._distorted(rays) - target).max() < 1e-9:
            raise ValueError("the lens distortion cannot be inverted inside the picture")
        return (
            rays[:, 0].reshape(height, width).astype(np.float32),
            rays[:, 1].reshape(height, width).astype(np.float32),
        )

    def _distorted(self, rays: Real64) -> Real64:
        x, y = rays[:, 0], rays[:, 1]
        k1, k2, k3 = self._k
        p1, p2 = self._p
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        return np.stack(
            [
                x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
            ],
            axis=1,
        )

    def _newton_step(self, rays: Real64, target: Real64) -> Real64:
        x, y = rays[:, 0], rays[:, 1]
        k1, k2, k3 = self._k
        p1, p2 = self._p
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))
        xx = radial + x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
        yy = radial + y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
        xy = x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
        error = self._distorted(rays) - target
        determinant = xx * yy - xy * xy
        return np.stack(
            [
                (yy * error[:, 0] - xy * error[:, 1]) / determinant,
                (xx * error[:, 1] - xy * error[:, 0]) / determinant,
            ],
            axis=1,
        )
