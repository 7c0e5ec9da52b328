"""Sub-pixel matching of patches between two pictures of the same surface from different places.

A patch is not merely shifted between keyframe and picture but turned, scaled and slanted. The small plane
that its neighbours' depths define, and the predicted camera pose, give that distortion; what is left to
find is a shift, by Lucas-Kanade in its inverse compositional form (Baker and Matthews 2004), with mean and
contrast normalised out.
"""

import math

import numba
import numpy as np
from scipy.spatial import cKDTree

from vision_pc.config import OdometrySettings
from vision_pc.core import se3
from vision_pc.core.odometry.keyframe_map import Keyframe
from vision_pc.core.odometry.tracking import Flags
from vision_pc.core.se3 import Array
from vision_pc.core.types import EyeModel, Image

_STEPS = 20
_CONVERGED = 0.002  # px
_WANDERED = 4.0  # px from the guess, after which it is another patch
_NEIGHBOURS = 10
_SLANTED = (
    0.5  # share of the inverse depth that the fitted plane may miss by before it is thought a depth edge
)


def planes(rays: Array, depths: Array) -> Array:
    """The plane (n, 3) around each point, as the vector m with m · [x, y, 1] = 1/depth for rays (x, y) on it.

    ``rays`` (n, 2) and ``depths`` (n,) of all points of a keyframe: each plane is fitted to the point's
    neighbours, whose inverse depths are all about equally uncertain. Facing the camera where neighbours are
    few or lie elsewhere.
    """
    inverse_depths = 1.0 / depths
    facing = np.zeros((len(rays), 3))
    facing[:, 2] = inverse_depths
    if len(rays) < _NEIGHBOURS:
        return facing
    _, near = cKDTree(rays).query(rays, k=_NEIGHBOURS)
    design = np.concatenate([rays[near] - rays[:, None], np.ones((*near.shape, 1))], axis=2)
    values = inverse_depths[near]
    weights = np.ones_like(values)
    for _ in range(3):
        normal = np.einsum("nki,nk,nkj->nij", design, weights, design) + 1e-12 * np.eye(3)
        fitted = np.linalg.solve(normal, np.einsum("nki,nk,nk->ni", design, weights, values)[..., None])[
            ..., 0
        ]
        missed = np.abs(np.einsum("nki,ni->nk", design, fitted) - values)
        scale = np.maximum(2.0 * np.median(missed, axis=1, keepdims=True), 1e-9)
        weights = 1.0 / (1.0 + (missed / scale) ** 2)
    smooth = np.abs(fitted[:, 2] - inverse_depths) < _SLANTED * inverse_depths
    fitted[:, 2] = inverse_depths - (fitted[:, :2] * rays).sum(axis=1)
    return np.where(smooth[:, None], fitted, facing)


def distortions(rays: Array, surfaces: Array, X_EK: Array, keyframe_eye: EyeModel, eye: EyeModel) -> Array:
    """How small offsets in the keyframe map to ``eye`` (n, 2, 2), px to px.

    ``rays`` (n, 2) of the points in the keyframe, ``surfaces`` (n, 3) from ``planes``, ``X_EK`` the
    keyframe's left eye in the eye that looks: the homography R + p mᵀ, linearised at each point.
    """
    H = X_EK[:3, :3] + X_EK[:3, 3, None] * surfaces[:, None, :]
    seen = np.einsum("nij,nj->ni", H, np.column_stack([rays, np.ones(len(rays))]))
    seen_rays = seen[:, :2] / seen[:, 2:]
    J = (H[:, :2, :2] - seen_rays[:, :, None] * H[:, 2, None, :2]) / seen[:, 2, None, None]
    return np.asarray(J * np.diag(eye.K)[:2, None] / np.diag(keyframe_eye.K)[None, :2])


def found(
    keyframe: Keyframe,
    image: Image,
    guess: Array,
    X_C0C: Array,
    keyframe_eye: EyeModel,
    eye: EyeModel,
    settings: OdometrySettings,
) -> tuple[Array, Flags]:
    """Where ``eye`` of a camera about at ``X_C0C`` sees the keyframe's points, px (n, 2), and which are
    believed.

    ``image`` is what it sees, ``guess`` (n, 2) px within about two pixels. Believed: converged near the
    guess, with the configured normalised cross-correlation.
    """
    X_EK = se3.inverse(X_C0C @ eye.X_CE) @ keyframe.X_C0C
    warps = distortions(keyframe.rays, keyframe.surfaces, X_EK, keyframe_eye, eye)
    ends, likeness = _match(keyframe.left, image, keyframe.pixels, guess, warps, settings.patch_px // 2)
    return ends, likeness >= settings.likeness


@numba.njit(cache=True, nogil=True)
def _match(
    keyframe: Image, image: Image, centres: Array, guess: Array, warps: Array, half: int
) -> tuple[Array, Array]:
    side = 2 * half + 1
    patch, gx, gy, seen = np.empty((4, side, side))
    ends, likeness = guess.copy(), np.full(len(centres), -1.0)
    for n in range(len(centres)):
        if not _sample(keyframe, centres[n, 0], centres[n, 1], 1.0, 0.0, 0.0, 1.0, half, patch):
            continue
        norm = _normalise(patch)
        if norm < 1e-6:
            continue
        hxx, hxy, hyy = _gradients(patch, gx, gy)
        determinant = hxx * hyy - hxy * hxy
        if determinant < 1e-12:
            continue
        a, b, c, d = warps[n, 0, 0], warps[n, 0, 1], warps[n, 1, 0], warps[n, 1, 1]
        x, y = guess[n]
        for _ in range(_STEPS):
            if not _sample(image, x, y, a, b, c, d, half, seen) or _normalise(seen) < 1e-6:
                break
            bx = by = 0.0
            for i in range(1, side - 1):
                for j in range(1, side - 1):
                    error = seen[i, j] - patch[i, j]
                    bx += gx[i, j] * error
                    by += gy[i, j] * error
            u, v = (hyy * bx - hxy * by) / determinant, (hxx * by - hxy * bx) / determinant
            x, y = x - (a * u + b * v), y - (c * u + d * v)
            if not math.hypot(x - guess[n, 0], y - guess[n, 1]) < _WANDERED:
                break
            if math.hypot(u, v) < _CONVERGED:
                ends[n, 0], ends[n, 1] = x, y
                likeness[n] = (seen * patch).sum()
                break
    return ends, likeness


@numba.njit(cache=True, nogil=True)
def _sample(
    image: Image, x: float, y: float, a: float, b: float, c: float, d: float, half: int, patch: Array
) -> bool:
    """Fill ``patch`` from ``image`` around (x, y) under the distortion [[a, b], [c, d]]; False if it leaves
    it.
    """
    height, width = image.shape
    reach_x, reach_y = half * (abs(a) + abs(b)), half * (abs(c) + abs(d))
    if not (
        x - reach_x >= 0.0 and y - reach_y >= 0.0 and x + reach_x < width - 1 and y + reach_y < height - 1
    ):
        return False
    for i in range(2 * half + 1):
        v = i - half
        for j in range(2 * half + 1):
            u = j - half
            column, row = x + a * u + b * v, y + c * u + d * v
            left, top = int(column), int(row)
            fx, fy = column - left, row - top
            upper = image[top, left] + fx * (float(image[top, left + 1]) - image[top, left])
            lower = image[top + 1, left] + fx * (float(image[top + 1, left + 1]) - image[top + 1, left])
            patch[i, j] = upper + fy * (lower - upper)
    return True


@numba.njit(cache=True, nogil=True)
def _normalise(patch: Array) -> float:
    """The norm of ``patch`` about its mean; the patch is brought to mean 0 and norm 1."""
    patch -= patch.mean()
    norm = math.sqrt((patch * patch).sum())
    if norm > 0.0:
        patch /= norm
    return norm


@numba.njit(cache=True, nogil=True)
def _gradients(patch: Array, gx: Array, gy: Array) -> tuple[float, float, float]:
    """Fill the central differences of ``patch`` and return their sums of squares xx, xy, yy over the inner
    part.
    """
    side = patch.shape[0]
    hxx = hxy = hyy = 0.0
    for i in range(1, side - 1):
        for j in range(1, side - 1):
            x = 0.5 * (patch[i, j + 1] - patch[i, j - 1])
            y = 0.5 * (patch[i + 1, j] - patch[i - 1, j])
            gx[i, j], gy[i, j] = x, y
            hxx, hxy, hyy = hxx + x * x, hxy + x * y, hyy + y * y
    return hxx, hxy, hyy
