"""Sub-pixel matching of patches between two pictures of the same surface from different places.

A patch is not merely shifted between keyframe and picture but turned, scaled and slanted. The small plane
that its neighbours' depths define, and the predicted camera pose, give that distortion; what is left to
find is a shift, by Lucas-Kanade in its inverse compositional form (Baker and Matthews 2004), with mean and
contrast normalised out.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from foundation.compiled import allocation_free
from vision_pc.core import se3
from vision_pc.core.odometry.keyframes.keyframe import Indices, Keyframe
from vision_pc.core.odometry.keyframes.templates import FLAT, Patches, is_inside
from vision_pc.core.odometry.tracking import Flags
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraModel, Image

Whole = NDArray[np.int32]

_LEAST_LIKENESS = 0.3  # [M] normalised cross-correlation of a match: 0.44 is what heavy noise leaves
_STEPS = 20
_CONVERGED = 0.002  # px
_WANDERED = 4.0  # px from the guess, after which it is another patch
_ONE = np.uintp(1)
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
) -> tuple[Array, Flags]:
    """Where ``eye`` of a camera about at ``X_C0C`` sees the keyframe's points, px (n, 2), and which of them
    are believed.

    ``image`` is what it sees, ``guess`` (n, 2) px within about two pixels. Believed: converged near the
    guess, with enough normalised cross-correlation.
    """
    X_EK = se3.inverse(X_C0C @ eye.X_CE) @ keyframe.X_C0C
    warps = distortions(keyframe.rays, keyframe.surfaces, X_EK, keyframe_eye, eye)
    sought = keyframe.templates.patches()
    found = _Matches(guess.copy(), np.full(len(guess), -1.0))
    _match(sought, keyframe.rows, image, found, warps, _room(sought.side))
    return found.ends, found.likeness >= _LEAST_LIKENESS


class _Matches(NamedTuple):
    """Of patches (n,): ``ends`` (n, 2) px from the guesses to the matches, ``likeness`` (n,), -1: none."""

    ends: Array
    likeness: Array


class _Room(NamedTuple):
    """Where each pixel of a patch is sought: column and row of the pixel above and left of it, and the rest;
    what the picture shows there, four grey levels in a word.
    """

    column: Whole
    row: Whole
    words: Whole
    right: Array
    down: Array


def _room(side: int) -> _Room:
    column, row, words = np.empty((3, side * side), dtype=np.int32)
    right, down = np.empty((2, side * side))
    return _Room(column, row, words, right, down)


@allocation_free(nogil=True)
def _match(sought: Patches, rows: Indices, image: Image, found: _Matches, warps: Array, room: _Room) -> None:
    """Fill ``found``, which begins with the guesses."""
    half = sought.side // 2
    for n in range(len(rows)):
        patterns, products = sought.patterns[rows[n]], sought.products[rows[n]]
        hxx, hxy, hyy = products[0], products[1], products[2]
        determinant = hxx * hyy - hxy * hxy
        if not determinant >= 1e-12:
            continue
        a, b, c, d = warps[n, 0, 0], warps[n, 0, 1], warps[n, 1, 0], warps[n, 1, 1]
        first_x, first_y = found.ends[n, 0], found.ends[n, 1]
        x, y = first_x, first_y
        for _ in range(_STEPS):
            if not is_inside(image, x, y, (a, b, c, d), half):
                break
            bx, by, alike = _compare(image, x, y, (a, b, c, d), patterns, sought.side, room)
            if alike < -1.0:
                break
            u, v = (hyy * bx - hxy * by) / determinant, (hxx * by - hxy * bx) / determinant
            x, y = x - (a * u + b * v), y - (c * u + d * v)
            if not math.hypot(x - first_x, y - first_y) < _WANDERED:
                break
            if math.hypot(u, v) < _CONVERGED:
                found.ends[n, 0], found.ends[n, 1] = x, y
                found.likeness[n] = alike
                break


@allocation_free(fastmath={"contract", "reassoc"})
def _compare(
    image: Image,
    x: float,
    y: float,
    warp: tuple[float, float, float, float],
    patterns: Array,
    side: int,
    room: _Room,
) -> tuple[float, float, float]:
    """What ``image`` shows, brought to mean 0 and norm 1, projected on the patterns: the gradient-weighted
    difference, and the normalised cross-correlation; -2 for that where the picture is flat.

    Nothing is subtracted from what is seen: all three patterns have mean 0, so its mean drops out.
    """
    a, b, c, d = warp
    half, count = side // 2, side * side
    for i in range(side):
        column, row = x + b * (i - half) - a * half, y + d * (i - half) - c * half
        for j in range(side):
            k = i * side + j
            across, along = column + a * j, row + c * j
            left, top = np.int32(across), np.int32(along)
            room.column[k], room.row[k] = left, top
            room.right[k], room.down[k] = across - left, along - top
    for k in range(count):
        x0, y0 = np.uintp(room.column[k]), np.uintp(room.row[k])  # unsigned: no place counts from the end
        word = np.uint32(image[y0, x0]) | (np.uint32(image[y0, x0 + _ONE]) << np.uint32(8))
        word |= np.uint32(image[y0 + _ONE, x0]) << np.uint32(16)
        word |= np.uint32(image[y0 + _ONE, x0 + _ONE]) << np.uint32(24)
        room.words[k] = np.int32(word)
    return _project_rows(room.words, room.right, room.down, patterns)


@allocation_free(fastmath={"contract", "reassoc"})
def _project_rows(words: Whole, right: Array, down: Array, patterns: Array) -> tuple[float, float, float]:
    """The second half of ``_compare``: everything is in a row here, which compilers vectorise."""
    patch, gx, gy = patterns[0], patterns[1], patterns[2]
    byte, count = np.int32(255), words.shape[0]
    total = squares = alike = along_x = along_y = 0.0
    for k in range(count):
        word = words[k]
        upper, lower = float(word & byte), float((word >> np.int32(16)) & byte)
        upper += right[k] * (float((word >> np.int32(8)) & byte) - upper)
        lower += right[k] * (float((word >> np.int32(24)) & byte) - lower)
        value = upper + down[k] * (lower - upper)
        total += value
        squares += value * value
        alike += value * patch[k]
        along_x += value * gx[k]
        along_y += value * gy[k]
    norm = math.sqrt(max(squares - total * total / count, 0.0))
    if norm < FLAT:
        return 0.0, 0.0, -2.0
    return along_x / norm, along_y / norm, alike / norm
