"""Sub-pixel matching of patches between two pictures of the same surface from different places.

A patch is not merely shifted between keyframe and picture but turned, scaled and slanted. The small plane
that its neighbours' depths define, and the predicted camera pose, give that distortion; what is left to
find is a shift, by Lucas-Kanade in its inverse compositional form (Baker and Matthews 2004), with mean and
contrast normalised out.
"""

import math

import numpy as np
from scipy.spatial import cKDTree

from foundation.compiled import kernel
from vision_pc.config.vision import OdometrySettings
from vision_pc.core import se3
from vision_pc.core.odometry.keyframe_map import Keyframe
from vision_pc.core.odometry.tracking import Flags
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraModel, Image

_STEPS = 20
_CONVERGED = 0.002  # px
_WANDERED = 4.0  # px from the guess, after which it is another patch
_FLAT = 1e-3  # grey levels, the norm below which a patch has no texture
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


def distortions(
    rays: Array, surfaces: Array, X_EK: Array, keyframe_eye: CameraModel, eye: CameraModel
) -> Array:
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
    keyframe_eye: CameraModel,
    eye: CameraModel,
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


@kernel(nogil=True)
def _match(
    keyframe: Image, image: Image, centres: Array, guess: Array, warps: Array, half: int
) -> tuple[Array, Array]:
    side = 2 * half + 1
    patch, gx, gy = np.zeros((3, side, side))
    ends, likeness = guess.copy(), np.full(len(centres), -1.0)
    for n in range(len(centres)):
        if not _sample(keyframe, centres[n, 0], centres[n, 1], half, patch):
            continue
        hxx, hxy, hyy = _gradients(patch, gx, gy)
        determinant = hxx * hyy - hxy * hxy
        if determinant < 1e-12:
            continue
        a, b, c, d = warps[n, 0, 0], warps[n, 0, 1], warps[n, 1, 0], warps[n, 1, 1]
        x, y = guess[n]
        for _ in range(_STEPS):
            if not _is_inside(image, x, y, a, b, c, d, half):
                break
            bx, by, alike = _compare(image, x, y, a, b, c, d, half, patch, gx, gy)
            if alike < -1.0:
                break
            u, v = (hyy * bx - hxy * by) / determinant, (hxx * by - hxy * bx) / determinant
            x, y = x - (a * u + b * v), y - (c * u + d * v)
            if not math.hypot(x - guess[n, 0], y - guess[n, 1]) < _WANDERED:
                break
            if math.hypot(u, v) < _CONVERGED:
                ends[n, 0], ends[n, 1] = x, y
                likeness[n] = alike
                break
    return ends, likeness


@kernel(nogil=True)
def _is_inside(image: Image, x: float, y: float, a: float, b: float, c: float, d: float, half: int) -> bool:
    """Whether a patch around (x, y) under the distortion [[a, b], [c, d]] stays in ``image``."""
    height, width = image.shape
    reach_x, reach_y = half * (abs(a) + abs(b)), half * (abs(c) + abs(d))
    return x - reach_x >= 0.0 and y - reach_y >= 0.0 and x + reach_x < width - 1 and y + reach_y < height - 1


@kernel(nogil=True, inline="always")
def _value(image: Image, column: float, row: float) -> float:
    """The picture's grey level between pixels, bilinear."""
    left, top = int(column), int(row)
    fx, fy = column - left, row - top
    corner = float(image[top, left])
    upper = corner + fx * (float(image[top, left + 1]) - corner)
    corner = float(image[top + 1, left])
    lower = corner + fx * (float(image[top + 1, left + 1]) - corner)
    return upper + fy * (lower - upper)


@kernel(nogil=True)
def _sample(image: Image, x: float, y: float, half: int, patch: Array) -> bool:
    """Fill ``patch`` from ``image`` around (x, y), of mean 0 and norm 1; False if it leaves it or is flat."""
    if not _is_inside(image, x, y, 1.0, 0.0, 0.0, 1.0, half):
        return False
    side = 2 * half + 1
    total = squares = 0.0
    for i in range(side):
        for j in range(side):
            value = _value(image, x + (j - half), y + (i - half))
            patch[i, j] = value
            total += value
            squares += value * value
    mean = total / (side * side)
    norm = math.sqrt(max(squares - total * mean, 0.0))
    if norm < _FLAT:
        return False
    for i in range(side):
        for j in range(side):
            patch[i, j] = (patch[i, j] - mean) / norm
    return True


@kernel(nogil=True, fastmath={"contract", "reassoc"})
def _compare(
    image: Image,
    x: float,
    y: float,
    a: float,
    b: float,
    c: float,
    d: float,
    half: int,
    patch: Array,
    gx: Array,
    gy: Array,
) -> tuple[float, float, float]:
    """What ``image`` shows, brought to mean 0 and norm 1, projected on ``gx``, ``gy`` and ``patch``: the
    gradient-weighted difference, and the normalised cross-correlation; -2 for that where the picture is flat.

    One pass without storing what is seen: all three patterns have mean 0, so its mean drops out.
    """
    side = 2 * half + 1
    total = squares = alike = along_x = along_y = 0.0
    for i in range(side):
        v = i - half
        column, row = x + b * v - a * half, y + d * v - c * half
        for j in range(side):
            value = _value(image, column + a * j, row + c * j)
            total += value
            squares += value * value
            alike += value * patch[i, j]
            along_x += value * gx[i, j]
            along_y += value * gy[i, j]
    norm = math.sqrt(max(squares - total * total / (side * side), 0.0))
    if norm < _FLAT:
        return 0.0, 0.0, -2.0
    return along_x / norm, along_y / norm, alike / norm


@kernel(nogil=True)
def _gradients(patch: Array, gx: Array, gy: Array) -> tuple[float, float, float]:
    """Fill the gradients of ``patch`` and return their sums of squares xx, xy, yy.

    Central differences, zero at the rim, without what only changes brightness or contrast: orthogonal to 1
    and to ``patch``, which is the derivative of a patch that is kept at mean 0 and norm 1.
    """
    side = patch.shape[0]
    for i in range(1, side - 1):
        for j in range(1, side - 1):
            gx[i, j] = 0.5 * (patch[i, j + 1] - patch[i, j - 1])
            gy[i, j] = 0.5 * (patch[i + 1, j] - patch[i - 1, j])
    for g in (gx, gy):
        g[0], g[-1], g[:, 0], g[:, -1] = 0.0, 0.0, 0.0, 0.0
        g -= g.mean()
        g -= patch * (g * patch).sum()
    return (gx * gx).sum(), (gx * gy).sum(), (gy * gy).sum()
