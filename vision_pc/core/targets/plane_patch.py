"""A plane from a patch that both eyes see, by direct alignment: where it is, how it lies, how well known.

Unknown are the inverse depth 1/Z = a + b (x − x0) + c (y − y0) over the left eye's rays (x, y, 1), which is
what any plane is; the right eye's rows; gain and offset of its grey levels. Gauss-Newton minimises the
difference of the greys, with Huber's weights. What is left over is alike in neighbouring pixels, for both
pictures are smoothed and interpolated; the covariance takes its autocorrelation into account. JᵀJ alone would
be 1.8 times too sure.
"""

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from foundation.compiled import kernel
from vision_pc.core import se3
from vision_pc.core.perception import intrinsics
from vision_pc.core.se3 import Array
from vision_pc.core.targets.patch_texture import explained, refuse_bare
from vision_pc.core.targets.target import TargetRefused
from vision_pc.core.types import CameraCalibration, Image, StereoPair

_SMOOTHED = 1.1  # px; interpolation between the pixels of sharper pictures is off by more than the noise is
_ROUNDS = 15
_CONVERGED_PX = 2e-4
_HUBER = 2.5
_ROW_STD = 0.5  # px that the right eye's rows may be off what is believed
_LAGS = 5  # px over which what is left over is alike
_STEEPEST = math.radians(65.0)
_LEAST_PIXELS = 300
_FLOOR_PX = 0.004  # [M] what interpolation leaves (docs/targets.md)
_CURVED = 0.04  # 1/m [E] of a wall that rises by 4 mm over a metre: its middle lies off the plane
_MORE = 1.5  # [M] variance over what the residuals tell: gradients are noisy too

Mask = NDArray[np.bool_]


class PlanePatch(NamedTuple):
    """The plane n·P = 1 in C: ``n`` (3,) 1/m, with the covariance (3, 3) of ``theta`` = (a, b, c).

    ``ray`` (3,) is the left eye's through the patch's middle, z = 1. ``quality`` the share of the texture
    that it explains.
    """

    theta: Array
    covariance: Array
    ray: Array
    quality: float
    offset_rate: float

    @property
    def n(self) -> Array:
        """The plane's normal over its distance from C, (3,) 1/m."""
        return normal_of(self.theta, self.ray)

    def meet(self, ray: Array) -> Array:
        """Where a ray (3,) from C meets the plane."""
        return np.asarray(ray / (self.n @ ray))


def normal_of(theta: Array, ray: Array) -> Array:
    """n with n·P = 1 for the plane of ``theta`` = (a, b, c) about ``ray``."""
    a, b, c = theta
    return np.array([b, c, a - b * ray[0] - c * ray[1]])


class _Patch(NamedTuple):
    """Greys (n, n) of the left eye, its rays x, y (n, n) less the middle's, weights 0 or 1 (n, n)."""

    grey: Array
    x: Array
    y: Array
    used: Array


class _Right(NamedTuple):
    """The right eye: its smoothed picture about the match, the corner of that; R_EC, p_EC, lens."""

    grey: Array
    left: int
    top: int
    R: Array
    p: Array
    focal: Array
    centre: Array
    distortion: Array


def align(
    pair: StereoPair,
    camera: CameraCalibration,
    pixel: Array,
    inverse_depth: float,
    half: int,
    used: Mask | None = None,
) -> PlanePatch:
    """The plane of the patch of 2 ``half`` + 1 px about ``pixel`` (2,) of the left eye.

    ``inverse_depth`` (1/m) is right to about a pixel of disparity. ``used`` (2 half + 1, same): what of the
    patch is the surface. Raises TargetRefused: ``target.low_texture``, ``target.depth_edge``,
    ``target.not_planar`` (also too steep), ``target.outside_picture``.
    """
    patch, ray = _patch(pair.left, camera, pixel, half, used)
    right = _right(pair.right, camera, ray, inverse_depth, half)
    theta, sums, inside = _aligned(patch, right, ray, inverse_depth)
    if not inside or not np.isfinite(theta).all():
        raise TargetRefused("target.outside_picture", "target: the right eye does not see all of the patch")
    if np.linalg.cond(sums.H) > 1e14:
        raise TargetRefused("target.low_texture", "target: the surface about it shows too little")
    G = np.linalg.inv(sums.H)
    whole = _MORE * G @ _spread(sums.J, sums.residuals, sums.weights, _LAGS) @ G
    rate = _disparity_rate(camera)
    floor = (_FLOOR_PX / rate) ** 2
    reach = float(np.abs(patch.x).max())
    bent = (_CURVED * reach**2 / 3.0) ** 2
    covariance = whole[:3, :3] + np.diag([floor + bent, 3.0 * floor / reach**2, 3.0 * floor / reach**2])
    quality = explained(patch.grey, sums.residuals, patch.used > 0.0, whole[0, 0] ** 0.5 * rate)
    if used is None:  # beside a hole its rim tells too, and its width is looked at
        refuse_bare(patch.grey, sums.residuals)
    plane = PlanePatch(theta[:3], covariance, ray, quality, 1.0 / rate)
    _refuse_steep(plane)
    return plane


def _patch(
    image: Image, camera: CameraCalibration, pixel: Array, half: int, used: Mask | None
) -> tuple[_Patch, Array]:
    u, v = np.rint(pixel).astype(int)
    height, width = image.shape
    if not (half + 3 <= u < width - half - 3 and half + 3 <= v < height - half - 3):
        raise TargetRefused(
            "target.outside_picture", f"target: {half} px about it are not all in the picture"
        )
    grey = _smooth(image[v - half - 3 : v + half + 4, u - half - 3 : u + half + 4])[3:-3, 3:-3]
    columns, rows = np.meshgrid(np.arange(u - half, u + half + 1), np.arange(v - half, v + half + 1))
    pixels = np.column_stack([columns.ravel(), rows.ravel()]).astype(np.float64)
    rays = intrinsics.normalised(camera.left, pixels).reshape(*grey.shape, 2)
    middle = intrinsics.normalised(camera.left, pixel[None])[0]
    mask = np.ones(grey.shape) if used is None else used.astype(np.float64)
    patch = _Patch(
        np.ascontiguousarray(grey),
        np.ascontiguousarray(rays[..., 0] - middle[0]),
        np.ascontiguousarray(rays[..., 1] - middle[1]),
        mask,
    )
    return patch, np.append(middle, 1.0)


def _right(image: Image, camera: CameraCalibration, ray: Array, inverse_depth: float, half: int) -> _Right:
    """The right eye, cut to twice as far about the match as the patch reaches."""
    eye = camera.right
    X_EC = se3.inverse(eye.X_CE)
    at = X_EC[:3, :3] @ ray + inverse_depth * X_EC[:3, 3]
    u, v = np.rint(intrinsics.distorted(eye, (at[:2] / at[2])[None])[0]).astype(int)
    height, width = image.shape
    left, top = max(u - 2 * half - 8, 0), max(v - half - 12, 0)
    part = image[top : min(v + half + 13, height), left : min(u + 2 * half + 9, width)]
    if min(part.shape) < half:
        raise TargetRefused("target.outside_picture", "target: the right eye does not see it")
    focal, centre = np.array([eye.K[0, 0], eye.K[1, 1]]), eye.K[:2, 2].copy()
    R, p = np.ascontiguousarray(X_EC[:3, :3]), X_EC[:3, 3].copy()
    return _Right(_smooth(part), left, top, R, p, focal, centre, np.asarray(eye.distortion, dtype=np.float64))


def _smooth(image: Image) -> Array:
    return np.asarray(cv2.GaussianBlur(image.astype(np.float64), (7, 7), _SMOOTHED))


def _disparity_rate(camera: CameraCalibration) -> float:
    """Pixels of disparity for 1/m of inverse depth."""
    return float(camera.right.K[0, 0] * np.linalg.norm(camera.right.X_CE[:3, 3]))


def _refuse_steep(plane: PlanePatch) -> None:
    n, ray = plane.n, plane.ray
    steep = math.acos(min(abs(float(n @ ray)) / float(np.linalg.norm(n) * np.linalg.norm(ray)), 1.0))
    if plane.theta[0] <= 0.0 or steep > _STEEPEST:
        raise TargetRefused(
            "target.not_planar",
            f"target: the surface is {math.degrees(steep):.0f} degrees off the line of sight, "
            f"limit {math.degrees(_STEEPEST):.0f}",
        )


class _Sums(NamedTuple):
    """Room for a round: information (6, 6), gradient (6,), Jacobian (n, n, 6), residuals, weights."""

    H: Array
    g: Array
    J: Array
    residuals: Array
    weights: Array


def _aligned(patch: _Patch, right: _Right, ray: Array, inverse_depth: float) -> tuple[Array, _Sums, bool]:
    """(a, b, c, rows px, gain, offset) and the last round's sums. False where it leaves the right picture."""
    count = patch.grey.shape[0]
    theta = np.array([inverse_depth, 0.0, 0.0, 0.0, 1.0, 0.0])
    sums = _Sums(
        np.zeros((6, 6)), np.zeros(6), np.zeros((count, count, 6)), *np.zeros((2, count, count))
    )  # fmt: skip
    inside = _iterated(patch, right, ray, theta, sums)
    return theta, sums, inside


@kernel(nogil=True)
def _iterated(patch: _Patch, right: _Right, ray: Array, theta: Array, sums: _Sums) -> bool:
    """Gauss-Newton from ``theta``, which is changed in place."""
    scale, reach = 1e9, max(np.abs(patch.x).max(), 1e-9)
    rate = right.focal[0] * math.sqrt((right.p**2).sum())
    inside = True
    for turn in range(_ROUNDS + 1):
        total, used, inside = _summed(patch, right, ray, theta, scale, sums)
        if used < _LEAST_PIXELS:
            return False
        scale = max(math.sqrt(total / used), 0.3)
        prior = scale * scale / (_ROW_STD * _ROW_STD)
        sums.H[3, 3] += prior
        sums.g[3] -= theta[3] * prior
        if turn == _ROUNDS:
            break
        for m in range(6):
            sums.H[m, m] += 1e-12
        step = np.linalg.solve(sums.H, sums.g)
        theta += step
        if max(abs(step[0]), abs(step[1]) * reach, abs(step[2]) * reach) * rate < _CONVERGED_PX:
            break
    return inside


@kernel(nogil=True)
def _summed(
    patch: _Patch, right: _Right, ray: Array, theta: Array, scale: float, sums: _Sums
) -> tuple[float, float, bool]:
    """Fill ``sums`` at ``theta``: sum of squares, number of pixels, whether all are in the right picture."""
    H, g, J, residuals, weights = sums
    H[:] = 0.0
    g[:] = 0.0
    total, used, inside, count = 0.0, 0.0, True, patch.grey.shape[0]
    for i in range(count):
        for j in range(count):
            weights[i, j] = 0.0
            if patch.used[i, j] == 0.0:
                continue
            seen = _right_grey(patch, right, ray, theta, i, j, J[i, j])
            if math.isnan(seen):
                inside = False
                continue
            residual = patch.grey[i, j] - seen
            weight = 1.0 if abs(residual) <= _HUBER * scale else _HUBER * scale / abs(residual)
            residuals[i, j], weights[i, j] = residual, weight
            total += min(residual * residual, (_HUBER * scale) ** 2)
            used += 1.0
            for m in range(6):
                g[m] += weight * J[i, j, m] * residual
                for n in range(m + 1):
                    H[m, n] += weight * J[i, j, m] * J[i, j, n]
    for m in range(6):
        for n in range(m):
            H[n, m] = H[m, n]
    return total, used, inside


@kernel(nogil=True)
def _right_grey(patch: _Patch, right: _Right, ray: Array, theta: Array, i: int, j: int, J: Array) -> float:
    """What the right eye shows of pixel (i, j) of the patch, gain and offset applied, and its derivative.

    NaN outside of the right picture.
    """
    dx, dy = patch.x[i, j], patch.y[i, j]
    x, y = ray[0] + dx, ray[1] + dy
    rho = theta[0] + theta[1] * dx + theta[2] * dy
    R, p, k = right.R, right.p, right.distortion
    px = R[0, 0] * x + R[0, 1] * y + R[0, 2] + rho * p[0]
    py = R[1, 0] * x + R[1, 1] * y + R[1, 2] + rho * p[1]
    pz = R[2, 0] * x + R[2, 1] * y + R[2, 2] + rho * p[2]
    if pz < 1e-3:
        return math.nan
    xe, ye = px / pz, py / pz
    r2 = xe * xe + ye * ye
    radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    u = right.focal[0] * (xe * radial + 2.0 * k[2] * xe * ye + k[3] * (r2 + 2.0 * xe * xe)) + right.centre[0]
    v = right.focal[1] * (ye * radial + k[2] * (r2 + 2.0 * ye * ye) + 2.0 * k[3] * xe * ye) + right.centre[1]
    u, v = u - right.left, v + theta[3] - right.top
    height, width = right.grey.shape
    if not (u >= 1.0 and v >= 1.0 and u < width - 2.0 and v < height - 2.0):
        return math.nan
    grey, along, down = _sampled(right.grey, u, v)
    gain = theta[4]
    u_rho = right.focal[0] * (p[0] - xe * p[2]) / pz  # the distortion's own change is a thousandth of it
    v_rho = right.focal[1] * (p[1] - ye * p[2]) / pz
    change = gain * (along * u_rho + down * v_rho)
    J[0], J[1], J[2] = change, change * dx, change * dy
    J[3], J[4], J[5] = gain * down, grey, 1.0
    return float(gain * grey + theta[5])


@kernel(nogil=True)
def _sampled(image: Array, u: float, v: float) -> tuple[float, float, float]:
    """Grey at (u, v) and its change by u and v, by Keys' cubic convolution (1981)."""
    column, row = int(u), int(v)  # both positive
    wu, du = _cubic(u - column)
    wv, dv = _cubic(v - row)
    grey = along = down = 0.0
    for m in range(4):
        line = slope = 0.0
        for n in range(4):
            value = image[row - 1 + m, column - 1 + n]
            line += wu[n] * value
            slope += du[n] * value
        grey += wv[m] * line
        along += wv[m] * slope
        down += dv[m] * line
    return float(grey), float(along), float(down)


@kernel(nogil=True, inline="always")
def _cubic(t: float) -> tuple[tuple[float, float, float, float], tuple[float, float, float, float]]:
    """Keys' weights, and their derivatives, of the four neighbours of a place ``t`` beyond the second."""
    tt, ttt = t * t, t * t * t
    weights = (
        -0.5 * ttt + tt - 0.5 * t,
        1.5 * ttt - 2.5 * tt + 1.0,
        -1.5 * ttt + 2.0 * tt + 0.5 * t,
        0.5 * ttt - 0.5 * tt,
    )
    slopes = (
        -1.5 * tt + 2.0 * t - 0.5,
        4.5 * tt - 5.0 * t,
        -4.5 * tt + 4.0 * t + 0.5,
        1.5 * tt - t,
    )
    return weights, slopes


@kernel(nogil=True)
def _spread(J: Array, residuals: Array, weights: Array, lags: int) -> Array:
    """The covariance (6, 6) of Jᵀ W r when residuals are as alike in neighbours as these are."""
    count = residuals.shape[0]
    total = np.zeros((6, 6))
    for di in range(lags + 1):
        for dj in range(-lags, lags + 1):
            if di == 0 and dj < 0:
                continue
            alike = pairs = 0.0
            part = np.zeros((6, 6))
            for i in range(count - di):
                for j in range(max(0, -dj), count - max(0, dj)):
                    w = weights[i, j] * weights[i + di, j + dj]
                    if w == 0.0:
                        continue
                    alike += w * residuals[i, j] * residuals[i + di, j + dj]
                    pairs += 1.0
                    for m in range(6):
                        scaled = w * J[i, j, m]
                        for n in range(6):
                            part[m, n] += scaled * J[i + di, j + dj, n]
            if pairs > 0.0:
                # Parzen's window keeps the sum positive where single estimates are chance.
                fade = (1.0 - di / (lags + 1.0)) * (1.0 - abs(dj) / (lags + 1.0))
                scale = fade * alike / pairs
                if di == 0 and dj == 0:
                    total += scale * part
                else:
                    total += scale * (part + part.T)
    return total
