"""Whether what a plane explains of a patch is the surface's own texture, all over the patch."""

import cv2
import numpy as np
from numpy.typing import NDArray

from vision_pc.core.se3 import Array
from vision_pc.core.targets.target import TargetRefused

_WORST_PX = 0.25  # disparity that is not known better than this is not known
_EXPLAINED = 0.85  # share of a quadrant's texture that the plane must explain
_LEFT_OVER = 2.5  # grey: what may be left over for all that
_LEAST_SHARE = 0.3
_FINE_PX = 3.0  # σ: what is wider is light and shade
_BLOCK_PX = 10
_FINE_SHARE = 0.3  # [M] bare walls: at most -0.07, walls that show something: from 0.79 on (docs/targets.md)

Mask = NDArray[np.bool_]


def explained(grey: Array, residuals: Array, used: Mask, disparity_std: float) -> float:
    """The share of a patch's texture that its plane explains; all (n, n), ``disparity_std`` px.

    Raises TargetRefused: ``target.low_texture`` where disparity stays unknown, ``target.depth_edge`` or
    ``target.not_planar`` where quarters are off the plane.
    """
    if not disparity_std < _WORST_PX:
        raise TargetRefused(
            "target.low_texture",
            f"target: disparity is known to {disparity_std:.2f} px, limit {_WORST_PX:g} px: bare surface",
        )
    total = _share(grey[used], residuals[used])
    off = _quarters_off(grey, residuals, used)
    if off:
        cause = "target.depth_edge" if off < 4 else "target.not_planar"
        why = f"target: no plane explains {off} of the 4 quarters about it ({total:.2f} of the texture)"
        raise TargetRefused(cause, why)
    if total < _LEAST_SHARE:
        raise TargetRefused(
            "target.low_texture", f"target: both eyes agree on {total:.2f} of the texture only"
        )
    return total


def refuse_bare(grey: Array, residuals: Array) -> None:
    """Raises TargetRefused (``target.low_texture``) for a bare surface, also with a shade's edge across it.

    Greys and what the plane leaves of them, both (n, n). Seen is the share of the fine texture that it
    explains, in the median of small blocks. In what is noise alone two eyes leave twice its variance: −1. An
    edge of shade crosses a few blocks only, and along it a plane may slide and turn.
    """
    fine, left = _without_shade(grey) ** 2, _without_shade(residuals) ** 2
    starts = range(0, len(grey) - _BLOCK_PX + 1, _BLOCK_PX)
    blocks = [(slice(i, i + _BLOCK_PX), slice(j, j + _BLOCK_PX)) for i in starts for j in starts]
    share = float(np.median([1.0 - left[block].sum() / max(fine[block].sum(), 1e-9) for block in blocks]))
    if not share > _FINE_SHARE:
        raise TargetRefused(
            "target.low_texture",
            f"target: both eyes agree on {max(share, 0.0):.2f} of the fine texture, "
            f"at least {_FINE_SHARE:g} is wanted: bare surface",
        )


def _share(grey: Array, residuals: Array) -> float:
    return 1.0 - (float(residuals.std()) / max(float(grey.std()), 1e-9)) ** 2


def _quarters_off(grey: Array, residuals: Array, used: Mask) -> int:
    """How many quarters of the patch the plane leaves unexplained."""
    halves, off = (slice(0, len(grey) // 2), slice(len(grey) // 2, None)), 0
    for part in ((rows, columns) for rows in halves for columns in halves):
        of = used[part]
        if of.sum() >= 20:
            left = residuals[part][of]
            off += float(left.std()) > _LEFT_OVER and _share(grey[part][of], left) < _EXPLAINED
    return off


def _without_shade(values: Array) -> Array:
    return np.asarray(values - cv2.GaussianBlur(np.ascontiguousarray(values), (0, 0), _FINE_PX))
