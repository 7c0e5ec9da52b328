"""Poses of rigid bodies from points seen by both eyes: Gauss-Newton on all reprojection errors together.

Unknowns are every body's pose, its printed size relative to the nominal one, and the right eye's offset (x,
y in px) that the bodies share. Size and offset have Gaussian priors: a monocular range hangs on the size, a
stereo range on the offset, and with both the weaker belief gives way.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.compiled import fused, kernel
from vision_pc.core import se3
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, StereoOffset

Indices = NDArray[np.int64]
Triple = tuple[float, float, float]

_BODY = 7  # unknowns of a body: δp, δθ, relative size
_ITERATIONS = 12
_CONVERGED = 1e-6  # m, rad; what is left after such a step is its square
_HUBER = 3.0  # standard deviations beyond which a residual counts linearly


class BodyView(NamedTuple):
    """A body's points and where the eyes see them.

    ``points`` (n, 3) in the body's frame; ``rays`` (2, n, 2) undistorted x/z, y/z in the left and right
    eye's axes; ``weights`` (2, n) 0 where not measured, 1 where measured with the usual noise, between where
    with more.
    """

    points: Array
    rays: Array
    weights: Array


class Priors(NamedTuple):
    """What is assumed beforehand: corner noise, print size, offset of the right eye, k1 of both eyes.

    ``known``: the offset was found with the camera's other errors, and single frames do not change it.
    """

    corner_std_px: float
    print_size_std: float
    offset: StereoOffset
    radial_std: float = 0.0
    known: bool = False


class BodyPoses(NamedTuple):
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


class _Problem(NamedTuple):
    """What is known of all bodies together; body k owns points ``ends[k]`` to ``ends[k + 1]``.

    ``points`` (n, 3), ``rays`` (2, n, 2), ``weights`` (2, n) as in BodyView. ``eyes`` (2, 14): R_EC row by
    row, p_EC, focal lengths. ``offset`` (2,) px of the right eye; precisions are inverse variances.
    """

    points: Array
    rays: Array
    weights: Array
    ends: Indices
    eyes: Array
    offset: Array
    offset_precision: Array
    size_precision: float
    corner_std_px: float


def solve(views: list[BodyView], starts: list[Array], camera: CameraCalibration, priors: Priors) -> BodyPoses:
    """The most probable poses of all ``views`` together, from ``starts`` (one 4×4 each)."""
    count, offset = len(views), priors.offset
    problem = _Problem(
        np.concatenate([view.points for view in views]),
        np.concatenate([view.rays for view in views], axis=1),
        np.concatenate([view.weights for view in views], axis=1),
        np.cumsum([0, *(len(view.points) for view in views)]),
        _eyes(camera),
        np.array([offset.x_px, offset.y_px]),
        np.array([offset.std_x_px, offset.std_y_px]) ** -2.0,
        priors.print_size_std**-2.0,
        priors.corner_std_px,
    )
    poses, sizes, shift, H, sums = _minimise(problem, np.stack(starts))
    covariance = _inverse(H)
    blocks = [slice(k * _BODY, k * _BODY + 6) for k in range(count)]
    noise = [_inverse(H[block, block]) for block in blocks]
    stds = np.sqrt(np.diag(covariance)).tolist()
    return BodyPoses(
        list(poses),
        [covariance[block, block] for block in blocks],
        [covariance[block, block] - part for block, part in zip(blocks, noise, strict=True)],
        sums[:, 0].tolist(),
        np.sqrt(sums[:, 1] / np.maximum(sums[:, 2], 1.0)).tolist(),
        (1.0 + sizes).tolist(),
        stds[6 : count * _BODY : _BODY],
        StereoOffset(float(shift[0]), float(shift[1]), stds[-2], stds[-1]),
    )


def _inverse(H: Array) -> Array:
    return np.asarray(np.linalg.inv(H), dtype=np.float64)


def _eyes(camera: CameraCalibration) -> Array:
    """Both eyes as (2, 14): R_EC row by row, p_EC, focal lengths."""
    eyes = np.empty((2, 14))
    for row, eye in zip(eyes, (camera.left, camera.right), strict=True):
        X_EC = se3.inverse(eye.X_CE)
        row[:9], row[9:12] = X_EC[:3, :3].ravel(), X_EC[:3, 3]
        row[12], row[13] = eye.K[0, 0], eye.K[1, 1]
    return eyes


@kernel(nogil=True)
def _minimise(problem: _Problem, starts: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Gauss-Newton over all bodies: poses (k, 4, 4), sizes (k,), offset (2,), information, (k, 3) sums.

    The sums are robust χ², Σ residual² and count.
    """
    count = len(starts)
    unknowns = count * _BODY + 2
    poses, sizes, offset = starts.copy(), np.zeros(count), problem.offset.copy()
    H, g, sums = np.zeros((unknowns, unknowns)), np.zeros(unknowns), np.zeros((count, 3))
    for _ in range(_ITERATIONS):
        H[:] = 0.0
        g[:] = 0.0
        for k in range(count):
            h, b, total = _body_equations(problem, k, poses[k], sizes[k], offset)
            _add_body(H, g, h, b, k * _BODY)
            sums[k] = total
            own_size = k * _BODY + 6
            H[own_size, own_size] += problem.size_precision
            g[own_size] -= sizes[k] * problem.size_precision
        for i in range(2):
            H[unknowns - 2 + i, unknowns - 2 + i] += problem.offset_precision[i]
            g[unknowns - 2 + i] -= (offset[i] - problem.offset[i]) * problem.offset_precision[i]
        step = np.linalg.solve(H, g).astype(np.float64)  # for the type checker alone
        for k in range(count):
            first = k * _BODY
            poses[k, :3, :3] = se3.rodrigues(step[first + 3 : first + 6]) @ poses[k, :3, :3].copy()
            poses[k, :3, 3] += step[first : first + 3]
            sizes[k] += step[first + 6]
        offset += step[-2:]
        if np.abs(step[:-2]).max() < _CONVERGED:
            break
    return poses, sizes, offset, H, sums


@kernel(nogil=True)
def _add_body(H: Array, g: Array, h: Array, b: Array, first: int) -> None:
    """Add one body's equations ``h`` (9, 9), ``b`` (9,) to all; its own unknowns begin at ``first``."""
    shared = g.shape[0] - 2 - _BODY  # its last two unknowns are the offset, the last two of all
    for i in range(_BODY + 2):
        row = first + i if i < _BODY else shared + i
        g[row] += b[i]
        for j in range(_BODY + 2):
            column = first + j if j < _BODY else shared + j
            H[row, column] += h[i, j]


@kernel(nogil=True)
def _body_equations(
    problem: _Problem, k: int, X: Array, size: float, offset: Array
) -> tuple[Array, Array, Array]:
    """Body ``k``'s information (9, 9) and gradient (9,) over [δp, δθ, size, offset], and its sums (3,)."""
    H, g, sums, row = np.zeros((9, 9)), np.zeros(9), np.zeros(3), np.zeros(9)
    for eye in range(2):
        R = problem.eyes[eye, :9].copy().reshape(3, 3)
        for i in range(problem.ends[k], problem.ends[k + 1]):
            scale = problem.weights[eye, i] / problem.corner_std_px
            if scale == 0.0:
                continue
            turned = _rotate(X, (problem.points[i, 0], problem.points[i, 1], problem.points[i, 2]))
            a, b, c = turned[0] * (1.0 + size), turned[1] * (1.0 + size), turned[2] * (1.0 + size)
            x, y, z = _rotate(R, (a + X[0, 3], b + X[1, 3], c + X[2, 3]))
            in_eye = x + problem.eyes[eye, 9], y + problem.eyes[eye, 10], z + problem.eyes[eye, 11]
            chi2 = 0.0
            for axis in range(2):
                focal, ratio = problem.eyes[eye, 12 + axis], in_eye[axis] / max(in_eye[2], 1e-6)
                _fill_row(
                    row, _gradient(R, axis, focal, ratio, max(in_eye[2], 1e-6)), turned, (a, b, c), scale
                )
                row[7], row[8] = 0.0, 0.0
                row[7 + axis] = eye * scale
                residual = focal * (problem.rays[eye, i, axis] - ratio) - eye * offset[axis]
                error = problem.weights[eye, i] * residual / problem.corner_std_px
                chi2 += error * error
                sums[1] += residual * residual
                _add_row(H, g, row, error)
            sums[0] += chi2 if chi2 <= _HUBER**2 else _HUBER * (2.0 * math.sqrt(chi2) - _HUBER)
            sums[2] += 2.0
    for i in range(9):
        for j in range(i):
            H[j, i] = H[i, j]
    return H, g, sums


@kernel(nogil=True)
def _gradient(R: Array, axis: int, focal: float, ratio: float, depth: float) -> Triple:
    """∂pixel/∂point in C along one axis of an eye, for a point at ``depth``, ``ratio`` of it off the axis."""
    return (
        focal * (R[axis, 0] - ratio * R[2, 0]) / depth,
        focal * (R[axis, 1] - ratio * R[2, 1]) / depth,
        focal * (R[axis, 2] - ratio * R[2, 2]) / depth,
    )


@kernel(nogil=True)
def _fill_row(row: Array, gradient: Triple, turned: Triple, lever: Triple, scale: float) -> None:
    """Fill the first seven of ``row``, pose and size: ``turned`` is the point from the body's middle, at its
    nominal size, ``lever`` the same at its size.
    """
    (x, y, z), (a, b, c) = gradient, lever
    row[0], row[1], row[2] = x * scale, y * scale, z * scale
    row[3], row[4], row[5] = (b * z - c * y) * scale, (c * x - a * z) * scale, (a * y - b * x) * scale
    row[6] = fused(z, turned[2], fused(y, turned[1], x * turned[0])) * scale


@kernel(nogil=True)
def _rotate(R: Array, v: Triple) -> Triple:
    """R v. No BLAS: it takes ten times as long for three numbers, and adds them in its own order."""
    x, y, z = v
    return (
        fused(R[0, 2], z, fused(R[0, 0], x, R[0, 1] * y)),
        fused(R[1, 2], z, fused(R[1, 0], x, R[1, 1] * y)),
        fused(R[2, 2], z, fused(R[2, 0], x, R[2, 1] * y)),
    )


@kernel(nogil=True)
def _add_row(H: Array, g: Array, row: Array, error: float) -> None:
    """Add one robust row (9,) with its ``error`` to the lower triangle of ``H`` and to ``g``."""
    weight = 1.0 if abs(error) <= _HUBER else _HUBER / abs(error)
    for a in range(9):
        scaled = weight * row[a]
        g[a] += scaled * error
        for b in range(a + 1):
            H[a, b] += scaled * row[b]
