"""Poses of rigid bodies from points seen by both eyes: Gauss-Newton on all reprojection errors together.

Unknowns are every body's pose, its printed size relative to the nominal one, and the right eye's offset (x,
y in px) that the bodies share. Size and offset have Gaussian priors: a monocular range hangs on the size, a
stereo range on the offset, and with both the weaker belief gives way.
"""

import math
from typing import NamedTuple

import numba
import numpy as np

from vision_pc.core import se3
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, StereoOffset

_BODY = 7  # unknowns of a body: δp, δθ, relative size
_ITERATIONS = 12
_CONVERGED = 1e-6  # m, rad; what is left after such a step is its square
_HUBER = 3.0  # standard deviations beyond which a residual counts linearly


class View(NamedTuple):
    """A body's points and where the eyes see them.

    ``points`` (n, 3) in the body's frame; ``rays`` (2, n, 2) undistorted x/z, y/z in the left and right
    eye's axes; ``seen`` (2, n) 0 where not measured, 1 where measured with the usual noise, between where
    with more.
    """

    points: Array
    rays: Array
    seen: Array


class Beliefs(NamedTuple):
    """What is assumed beforehand: corner noise, print size, offset of the right eye."""

    corner_std_px: float
    print_size_std: float
    offset: StereoOffset


class Solution(NamedTuple):
    """Poses of the bodies in C and what they cost.

    ``covariances`` whole, ``biases`` the part owed to size and offset; ``chi2`` per body, robust, priors
    excluded; ``residuals_px`` per body rms; ``sizes`` relative; ``offset`` after this evidence.
    """

    X_CA: list[Array]
    covariances: list[Array]
    biases: list[Array]
    chi2: list[float]
    residuals_px: list[float]
    sizes: list[float]
    size_stds: list[float]
    offset: StereoOffset


def solve(views: list[View], starts: list[Array], camera: CameraCalibration, beliefs: Beliefs) -> Solution:
    """The most probable poses of all ``views`` together, from ``starts`` (one 4×4 each)."""
    eyes = _eyes(camera)
    count = len(views)
    poses, sizes = [X.copy() for X in starts], np.zeros(count)
    offset = np.array([beliefs.offset.x_px, beliefs.offset.y_px])
    believed = offset.copy()
    prior = np.array([beliefs.offset.std_x_px, beliefs.offset.std_y_px]) ** -2.0
    for _ in range(_ITERATIONS):
        H, g, sums = _normal_equations(views, poses, sizes, offset, eyes, beliefs.corner_std_px)
        H[np.diag_indices(count * _BODY)] += np.tile([0.0] * 6 + [beliefs.print_size_std**-2.0], count)
        g[6 : count * _BODY : _BODY] -= sizes * beliefs.print_size_std**-2.0
        H[[-2, -1], [-2, -1]] += prior
        g[-2:] -= (offset - believed) * prior
        step = np.linalg.solve(H, g)
        for k in range(count):
            poses[k] = se3.retract(poses[k], step[k * _BODY : k * _BODY + 6])
        sizes += step[6 : count * _BODY : _BODY]
        offset += step[-2:]
        if np.abs(step[:-2]).max() < _CONVERGED:
            break
    covariance = _inverse(H)
    blocks = [slice(k * _BODY, k * _BODY + 6) for k in range(count)]
    noise = [_inverse(H[block, block]) for block in blocks]
    return Solution(
        poses,
        [covariance[block, block] for block in blocks],
        [covariance[block, block] - part for block, part in zip(blocks, noise, strict=True)],
        [float(s[0]) for s in sums],
        [math.sqrt(float(s[1]) / max(float(s[2]), 1.0)) for s in sums],
        [1.0 + float(size) for size in sizes],
        [math.sqrt(float(covariance[k * _BODY + 6, k * _BODY + 6])) for k in range(count)],
        StereoOffset(float(offset[0]), float(offset[1]), *np.sqrt(np.diag(covariance)[-2:]).tolist()),
    )


def _inverse(H: Array) -> Array:
    return np.asarray(np.linalg.inv(H), dtype=np.float64)


def _eyes(camera: CameraCalibration) -> Array:
    """Both eyes as (2, 14): R_EC row by row, p_EC, focal lengths."""
    rows = []
    for eye in (camera.left, camera.right):
        X_EC = se3.inverse(eye.X_CE)
        rows.append(np.concatenate([X_EC[:3, :3].ravel(), X_EC[:3, 3], [eye.K[0, 0], eye.K[1, 1]]]))
    return np.stack(rows)


def _normal_equations(
    views: list[View], poses: list[Array], sizes: Array, offset: Array, eyes: Array, std_px: float
) -> tuple[Array, Array, list[Array]]:
    """H and g of the step H x = g over all bodies and the offset, and each body's (χ², Σ px², count)."""
    unknowns = len(views) * _BODY + 2
    H, g, sums = np.zeros((unknowns, unknowns)), np.zeros(unknowns), []
    for k, view in enumerate(views):
        h, b, s = _accumulate(view.points, view.rays, view.seen, poses[k], sizes[k], offset, eyes, std_px)
        rows = np.r_[k * _BODY : (k + 1) * _BODY, unknowns - 2 : unknowns]
        H[np.ix_(rows, rows)] += h
        g[rows] += b
        sums.append(s)
    return H, g, sums


@numba.njit(cache=True, nogil=True)
def _accumulate(
    points: Array, rays: Array, seen: Array, X: Array, size: float, offset: Array, eyes: Array, std_px: float
) -> tuple[Array, Array, Array]:
    """One body's 9×9 information, 9 gradient over [δp, δθ, size, offset], and (robust χ², Σ residual²,
    count).
    """
    H, g, sums = np.zeros((9, 9)), np.zeros(9), np.zeros(3)
    J = np.zeros((2, 9))
    R_CA = X[:3, :3].copy()
    for eye in range(2):
        R = eyes[eye, :9].copy().reshape(3, 3)
        for i in range(points.shape[0]):
            if seen[eye, i] == 0.0:
                continue
            turned = R_CA @ points[i]
            arm = turned * (1.0 + size)
            seen_at = R @ (arm + X[:3, 3]) + eyes[eye, 9:12]
            depth = max(seen_at[2], 1e-6)
            chi2 = 0.0
            for row in range(2):
                focal = eyes[eye, 12 + row]
                ratio = seen_at[row] / depth
                gradient = focal * (R[row] - ratio * R[2]) / depth  # ∂pixel/∂point in C
                J[row, :3] = gradient
                J[row, 3] = arm[1] * gradient[2] - arm[2] * gradient[1]
                J[row, 4] = arm[2] * gradient[0] - arm[0] * gradient[2]
                J[row, 5] = arm[0] * gradient[1] - arm[1] * gradient[0]
                J[row, 6] = gradient @ turned
                J[row, 7:] = 0.0
                J[row, 7 + row] = float(eye)
                residual = focal * (rays[eye, i, row] - ratio) - eye * offset[row]
                sums[1] += residual * residual
                error = seen[eye, i] * residual / std_px
                chi2 += error * error
                J[row] *= seen[eye, i] / std_px
                weight = 1.0 if abs(error) <= _HUBER else _HUBER / abs(error)
                for a in range(9):
                    scaled = weight * J[row, a]
                    g[a] += scaled * error
                    for b in range(a + 1):
                        H[a, b] += scaled * J[row, b]
            sums[0] += chi2 if chi2 <= _HUBER**2 else _HUBER * (2.0 * math.sqrt(chi2) - _HUBER)
            sums[2] += 2.0
    for a in range(9):
        for b in range(a):
            H[b, a] = H[a, b]
    return H, g, sums
