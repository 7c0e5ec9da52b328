"""How well a patch was found, told by its parts: whether they agree on where it is.

A patch that lies half on a box and half on the wall behind is found somewhere between the two, and each part
of it would go another way. So would the parts of a patch that noise or a bad likeness leaves uncertain, or
whose surface is none. Each part's pull on the match, about the mean of all (which is nought where the match
converged), tells the match's covariance (White 1980, by clusters).
"""

import math

from foundation.compiled import allocation_free
from vision_pc.core.odometry.keyframes.templates import FLAT
from vision_pc.core.odometry.limits import PATCH_PX
from vision_pc.core.se3 import Array

_ACROSS = 3  # parts of a patch's side
_PART = PATCH_PX // _ACROSS
MOST_PX = 3.0


@allocation_free(fastmath={"contract", "reassoc"})
def match_std(
    seen: Array, patterns: Array, products: Array, warp: tuple[float, float, float, float], side: int
) -> float:
    """The standard deviation of where a patch was found, px of one coordinate; 3 px where nothing tells, and
    at most. ``seen`` (side²,): grey levels there, under the distortion ``warp``, which are overwritten;
    ``patterns`` (3, side²) and ``products`` (3,) as of ``Patches``.
    """
    total = squares = likeness = 0.0
    for k in range(side * side):
        total += seen[k]
        squares += seen[k] * seen[k]
        likeness += seen[k] * patterns[0, k]  # of mean 0: the mean of what is seen drops out
    mean = total / (side * side)
    norm = math.sqrt(max(squares - total * mean, 0.0))
    if norm < FLAT or likeness <= 0.0:
        return MOST_PX
    likeness /= norm
    for k in range(side * side):
        seen[k] = (seen[k] - mean) / norm - likeness * patterns[0, k]
    sxx, sxy, syy = _pulls(patterns, seen, side)
    # u = H⁻¹ b / likeness in the keyframe's px, moved into the picture by the distortion
    a, b, c, d = warp
    hxx, hxy, hyy = products[0], products[1], products[2]
    determinant = hxx * hyy - hxy * hxy
    ixx, ixy, iyy = hyy / determinant, -hxy / determinant, hxx / determinant
    pxx, pxy = a * ixx + b * ixy, a * ixy + b * iyy
    pyx, pyy = c * ixx + d * ixy, c * ixy + d * iyy
    across = pxx * pxx * sxx + 2.0 * pxx * pxy * sxy + pxy * pxy * syy
    along = pyx * pyx * sxx + 2.0 * pyx * pyy * sxy + pyy * pyy * syy
    return min(math.sqrt(0.5 * (across + along)) / likeness, MOST_PX)


@allocation_free(fastmath={"contract", "reassoc"})
def _pulls(patterns: Array, missed: Array, side: int) -> tuple[float, float, float]:
    """The sums xx, xy, yy of the parts' pulls squared, about their mean."""
    sxx = sxy = syy = bx_all = by_all = 0.0
    parts = _ACROSS * _ACROSS
    for part in range(parts):
        first = part // _ACROSS * _PART * side + part % _ACROSS * _PART
        bx = by = 0.0
        for i in range(_PART):
            for j in range(_PART):  # of a length known beforehand: compilers unroll it
                k = first + i * side + j
                bx += patterns[1, k] * missed[k]
                by += patterns[2, k] * missed[k]
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
