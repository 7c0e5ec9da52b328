"""What the joints leave at the end of a drive: as configured, and as this session's drives have shown.

One unknown scale of the configured spread, with an inverse-gamma prior worth a few drives. Each drive that
was to end at the goal gives its miss by odometry. Joints that were seen not to answer in a band widen the
prior. When fine corrections stop, and what is left after them, follows from the spread.
"""

import math
from typing import NamedTuple

import numpy as np

from nominal_arm.dimensions import BoomDimensions
from vision_pc.config.programs import LocalErrorModelSettings
from vision_pc.core.calibration.arm_fields import boom_levers
from vision_pc.core.calibration.local_error_model import LocalTrack
from vision_pc.core.se3 import Array

_NEAR = 4.0  # residuals: a joint that passes its end by its play is left there, and does so each time
_ACROSS = 2.0  # of a miss, x and y are seen without the look's range
_FADE = 0.5  # what a drive counts of the one after it: a servo leaves the same again, not for ever
_DOUBT = 0.1  # drives that left nothing, beside those seen: joints' ends differ less than they miss by


class ServoSpread(NamedTuple):
    """``variance`` m² in each direction of where a drive ends, and the freedom with which it is known."""

    variance: float
    freedom: float


def servo_spread(track: LocalTrack, settings: LocalErrorModelSettings) -> ServoSpread:
    """What the next drive is expected to leave."""
    if not settings.adaptive.enabled:
        return ServoSpread(settings.servo_std_m**2, math.inf)
    banded = bool(np.any(track.take_up.gaps > settings.adaptive.gap_rad))
    band = settings.adaptive.band_std_m if banded else 0.0
    prior = settings.adaptive.servo_std_m**2 + band**2
    seen = prior + settings.odometry_std_m**2
    freedom = settings.adaptive.servo_freedom
    misses = np.concatenate([track.misses, _left_over(track, settings)])
    squares = float((misses**2).sum() / 3.0 * _ACROSS / seen)
    count = _ACROSS * len(misses)
    scale = (freedom + squares) / (freedom + count)
    return ServoSpread(prior * scale, freedom + count)


def _left_over(track: LocalTrack, settings: LocalErrorModelSettings) -> Array:
    """Misses (n, 3) m of the legs, n 0 or 1: of lengths alone, for they go in a direction of their own."""
    beyond = np.maximum(np.abs(track.left[:1]) - settings.adaptive.residual_rad, 0.0)
    reach = float(np.linalg.norm(track.X_BT_now[:2, 3]))
    return reach * beyond[beyond.any(axis=1)]


def expected_left(track: LocalTrack, dimensions: BoomDimensions, settings: LocalErrorModelSettings) -> Array:
    """Displacement (3,) m in B that the next drive is expected to leave: what drives left, of late above all.

    A drive that did not come near its end is unlike the others and does not count.
    """
    left = track.left[np.abs(track.left).max(axis=1) < _NEAR * settings.adaptive.residual_rad]
    weights = _FADE ** np.arange(len(left))[::-1]
    mean = weights @ left / (weights.sum() + _DOUBT)
    return np.asarray(boom_levers(track.X_BT_now, dimensions) @ mean)


def worth_correcting(variance: float, nudge_m: float, drives: int) -> float:
    """The distance m in x and y beyond which one of ``drives`` further drives is expected to end nearer.

    At least ``nudge_m``. Loose steel may fall to its other side in a drive of less than a millimetre: where
    drives leave more than there is, the end stays as it is.
    """
    return max(nudge_m, math.sqrt(2.0 * after_fine_corrections(variance, nudge_m, drives)))


def after_fine_corrections(variance: float, nudge_m: float, drives: int) -> float:
    """Variance m² in x and y of the end when drives of that ``variance`` repeat while that is worth it.

    With ``drives`` of them at most; the last one stands. Optimal stopping: the square of an end's distance is
    exponential (two directions, alike and normal), and one that is below what the other drives are expected
    to leave, or below ``nudge_m``, is kept.
    """
    kept = 0.5 * nudge_m**2 / variance
    share = 1.0  # of the variance, that the last drive leaves
    for _ in range(drives - 1):
        enough = max(kept, share)
        share = 1.0 - math.exp(-enough) * (1.0 + enough - share)
    return variance * share
