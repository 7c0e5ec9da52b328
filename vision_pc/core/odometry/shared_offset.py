"""The offset that all disparities of a recording share, found from the recording itself.

Rectification that leaves the right eye turned by a hundredth of a degree moves its columns by a tenth of a
pixel. That puts far points at wrong depths, and far more so than near ones; as the camera goes on, what it
sees of both no longer fits one motion. So an offset shows wherever a way leads past near and far things,
and it does not where all is about equally far: there it is as good as a change of scale.
"""

import math
from typing import NamedTuple

import numpy as np

from vision_pc.core.odometry.keyframes.keyframe_map import HeldViews
from vision_pc.core.se3 import Array

_TIMES = 2.0  # of what views that err apart would leave: those of one point share what its patch gets wrong
_FEW_PAIRS = 2.0  # [E] with so few the variance is twice as large: of three that agree little is known
_FLOOR_PX = 0.03  # matching's own bias
_ENOUGH = 0.5  # of what was believed before
_MOST_PX = 3.0  # more is no rectified pair
_SPREAD = 1.4826  # from the median of deviations to a standard deviation
_SETTLED = 12  # [M] pairs: a drive's first twelve find its offset to 0.1 px of what all find


class FoundOffset(NamedTuple):
    """Of the right eye's columns (picture minus model), and its standard deviation."""

    px: float
    std_px: float


class SharedOffset:
    """Learns the right eye's offset from pairs, where it ``learns``."""

    def __init__(self, learns: bool) -> None:
        self._learns = learns
        self._pairs: list[FoundOffset] = []

    @property
    def is_settled(self) -> bool:
        """Whether so many pairs told that further ones need not be waited for."""
        return len(self._pairs) >= _SETTLED

    def learn(self, views_by_offset: Array, views: HeldViews, noise_px: float) -> None:
        """A pair was located: its ``views`` miss by ``views_by_offset`` (2, n, 2) px a px of an offset."""
        if not self._learns:
            return
        precision = (views.weights[:, :, None] / noise_px) ** 2
        information = float((precision * views_by_offset**2).sum())
        if information > 0.0:
            score = float((precision * views_by_offset * views.errors_px).sum())
            self._pairs.append(FoundOffset(score / information, information**-0.5))

    def found(self, std_px: float) -> FoundOffset | None:
        """The offset, None where it is not known much better than to ``std_px``, which was believed of it
        before: pairs are weighed by what they know, and must agree.
        """
        if not self._pairs:
            return None
        offsets, stds = np.array(self._pairs).T
        weights = stds**-2.0
        offset = float((weights * offsets).sum() / weights.sum())
        spread = _SPREAD * float(np.median(np.abs(offsets - offset))) / math.sqrt(len(offsets))
        known = FoundOffset(offset, math.hypot(_TIMES * float(weights.sum()) ** -0.5, spread, _FLOOR_PX))
        if known.std_px >= _ENOUGH * std_px or abs(offset) >= _MOST_PX:
            return None
        return known._replace(std_px=known.std_px * math.sqrt(1.0 + _FEW_PAIRS / len(offsets)))
