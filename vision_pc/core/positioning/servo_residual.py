"""What the joints leave at the end of a motion: as configured, and as this session's motions have shown.

One unknown scale of the configured spread, with an inverse-gamma prior worth a few motions. Each motion that
was to end at the goal gives its residual by odometry. Joints that were seen not to answer in a band widen the
prior. When corrections stop, and what remains after them, follows from the spread (optimal stopping).
"""

import math
from typing import NamedTuple

import numpy as np

from nominal_arm.dimensions import BoomDimensions
from vision_pc.config.programs import LocalErrorModelSettings
from vision_pc.core.calibration.arm_fields import boom_levers
from vision_pc.core.calibration.local_error_model import LocalTrack
from vision_pc.core.se3 import Array

_NEAR = 4.0  # residuals: a joint that passes its end by its backlash is left there, and does so each time
_ACROSS = 2.0  # of a residual, x and y are seen without the look's range
_FADE = 0.5  # what a motion counts of the one after it: a servo leaves the same again, not for ever
_DOUBT = 0.1  # motions that left nothing, beside those seen: joints' ends differ less than their residuals


class ServoSpread(NamedTuple):
    """``variance`` m² in each direction of where a motion ends, and the freedom with which it is known."""

    variance: float
    freedom: float


def servo_spread(track: LocalTrack, settings: LocalErrorModelSettings) -> ServoSpread:
    """What the next motion is expected to leave."""
    banded = bool(np.any(track.take_up.gaps > settings.take_up.gap_rad))
    prior = settings.servo_std_m**2 + (settings.band_std_m**2 if banded else 0.0)
    seen = prior + settings.odometry_std_m**2
    residuals = np.concatenate([track.residuals, _residual_of_legs(track, settings)])
    squares = float((residuals**2).sum() / 3.0 * _ACROSS / seen)
    count = _ACROSS * len(residuals)
    scale = (settings.servo_freedom + squares) / (settings.servo_freedom + count)
    return ServoSpread(prior * scale, settings.servo_freedom + count)


def _residual_of_legs(track: LocalTrack, settings: LocalErrorModelSettings) -> Array:
    """Residuals (n, 3) m of the legs, n 0 or 1: of lengths alone, for they go in a direction of their own."""
    beyond = np.maximum(np.abs(track.joint_residuals[:1]) - settings.take_up.residual_rad, 0.0)
    reach = float(np.linalg.norm(track.X_BT_now[:2, 3]))
    return reach * beyond[beyond.any(axis=1)]


def expected_residual(
    track: LocalTrack, dimensions: BoomDimensions, settings: LocalErrorModelSettings
) -> Array:
    """Displacement (3,) m in B that the next motion is expected to leave, by the newest ones above all.

    A motion that did not come near its end is unlike the others and does not count.
    """
    near = np.abs(track.joint_residuals).max(axis=1) < _NEAR * settings.take_up.residual_rad
    counted = track.joint_residuals[near]
    weights = _FADE ** np.arange(len(counted))[::-1]
    mean = weights @ counted / (weights.sum() + _DOUBT)
    return np.asarray(boom_levers(track.X_BT_now, dimensions) @ mean)


def worth_correcting(variance: float, nudge_m: float, motions: int) -> float:
    """The distance m in x and y beyond which one of ``motions`` further ones is expected to end nearer.

    At least ``nudge_m``. Loose steel may fall to its other side in a motion of less than a millimetre: where
    motions leave more than there is, the end stays as it is.
    """
    return max(nudge_m, math.sqrt(2.0 * after_corrections(variance, nudge_m, motions)))


def after_corrections(variance: float, nudge_m: float, motions: int) -> float:
    """Variance m² in x and y of the end when motions of that ``variance`` repeat while that is worth it.

    With ``motions`` of them at most; the last one stands. Optimal stopping: the square of an end's distance
    is exponential (two directions, alike and normal), and one that is below what the other motions are
    expected to leave, or below ``nudge_m``, is kept.
    """
    kept = 0.5 * nudge_m**2 / variance
    share = 1.0  # of the variance, that the last motion leaves
    for _ in range(motions - 1):
        enough = max(kept, share)
        share = 1.0 - math.exp(-enough) * (1.0 + enough - share)
    return variance * share
