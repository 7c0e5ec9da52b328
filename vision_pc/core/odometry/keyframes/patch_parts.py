"""How well a patch was found, told by its parts: whether they agree on where it is.

A patch that lies half on a box and half on the wall behind is found somewhere between the two, and each part
of it would go another way. So would the parts of a patch that noise or a bad likeness leaves uncertain, or
whose surface is none. Each part's pull on the match, about the mean of all (which is nought where the match
converged), tells the match's covariance (White 1980, by clusters).
"""

import math

import numpy as np

from foundation.compiled import allocation_free
from vision_pc.core.odometry.keyframes.keyframe import Indices, Keyframe
from vision_pc.core.odometry.keyframes.templates import FLAT, Patches, is_inside
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image

_ACROSS = 3  # parts of a patch's side
_LEAST_LIKENESS = 0.1  # with less nothing is told
_MOST_PX = 3.0
_ONE = np.uintp(1)


def match_stds(keyframe: Keyframe, image: Image, ends: Array, warps: Array) -> Array:
    """The standard deviation (n,) of where ``image`` shows the keyframe's points, px of one coordinate, found
    at ``ends`` (n, 2) under the distortions ``warps`` (n, 2, 2); 3 px where nothing tells, and at most.
    """
    sought = keyframe.templates.patches()
    stds = np.full(len(ends), _MOST_PX)
    _tell(sought, keyframe.rows, image, ends, warps, stds, np.empty(sought.side * sought.side))
    return stds


@allocation_free(nogil=True)
def _tell(
    sought: Patches, rows: Indices, image: Image, ends: Array, warps: Array, stds: Array, seen: Array
) -> None:
    half = sought.side // 2
    for n in range(len(rows)):
        patterns, products = sought.patterns[rows[n]], sought.products[rows[n]]
        hxx, hxy, hyy = products[0], products[1], products[2]
        determinant = hxx * hyy - hxy * hxy
        a, b, c, d = warps[n, 0, 0], warps[n, 0, 1], warps[n, 1, 0], warps[n, 1, 1]
        if not determinant >= 1e-12 or not is_inside(image, ends[n, 0], ends[n, 1], (a, b, c, d), half):
            continue
        likeness = _sampled(image, ends[n, 0], ends[n, 1], (a, b, c, d), patterns[0], sought.side, seen)
        if likeness < _LEAST_LIKENESS:
            continue
        sxx, sxy, syy = _pulls(patterns, seen, likeness, sought.side)
        # u = H⁻¹ b / likeness in the keyframe's px, moved into the picture by the distortion
        ixx, ixy, iyy = hyy / determinant, -hxy / determinant, hxx / determinant
        pxx, pxy = a * ixx + b * ixy, a * ixy + b * iyy
        pyx, pyy = c * ixx + d * ixy, c * ixy + d * iyy
        across = pxx * pxx * sxx + 2.0 * pxx * pxy * sxy + pxy * pxy * syy
        along = pyx * pyx * sxx + 2.0 * pyx * pyy * sxy + pyy * pyy * syy
        stds[n] = min(math.sqrt(0.5 * (across + along)) / likeness, _MOST_PX)


@allocation_free(fastmath={"contract", "reassoc"})
def _sampled(
    image: Image,
    x: float,
    y: float,
    warp: tuple[float, float, float, float],
    patch: Array,
    side: int,
    seen: Array,
) -> float:
    """Fill ``seen`` with what ``image`` shows, of mean 0 and norm 1; its likeness to ``patch``, -1: flat."""
    a, b, c, d = warp
    half, count = side // 2, side * side
    for i in range(side):
        column, row = x + b * (i - half) - a * half, y + d * (i - half) - c * half
        for j in range(side):
            across, along = column + a * j, row + c * j
            left, top = np.uintp(across), np.uintp(along)  # unsigned: no place counts from the end
            fx, fy = across - left, along - top
            upper, lower = float(image[top, left]), float(image[top + _ONE, left])
            upper += fx * (float(image[top, left + _ONE]) - upper)
            lower += fx * (float(image[top + _ONE, left + _ONE]) - lower)
            seen[i * side + j] = upper + fy * (lower - upper)
    total = squares = likeness = 0.0
    for k in range(count):
        total += seen[k]
        squares += seen[k] * seen[k]
        likeness += seen[k] * patch[k]  # of mean 0: the mean of what is seen drops out
    mean = total / count
    norm = math.sqrt(max(squares - total * mean, 0.0))
    if norm < FLAT:
        return -1.0
    for k in range(count):
        seen[k] = (seen[k] - mean) / norm
    return likeness / norm


@allocation_free(fastmath={"contract", "reassoc"})
def _pulls(patterns: Array, seen: Array, likeness: float, side: int) -> tuple[float, float, float]:
    """The sums xx, xy, yy of the parts' pulls squared, about their mean."""
    sxx = sxy = syy = bx_all = by_all = 0.0
    parts = _ACROSS * _ACROSS
    for part in range(parts):
        top, left = part // _ACROSS, part % _ACROSS
        bx = by = 0.0
        for i in range(top * side // _ACROSS, (top + 1) * side // _ACROSS):
            for j in range(left * side // _ACROSS, (left + 1) * side // _ACROSS):
                k = i * side + j
                missed = seen[k] - likeness * patterns[0, k]
                bx += patterns[1, k] * missed
                by += patterns[2, k] * missed
        sxx += bx * bx
        sxy += bx * by
        syy += by * by
        bx_all += bx
        by_all += by
    few = parts / (parts - 1.0)
    return (
        few * (sxx - bx_all * bx_all / parts),
        few * (sxy - bx_all * by_all / parts),
        few * (syy - by_all * by_all / parts),
    )
