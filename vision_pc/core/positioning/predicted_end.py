"""Where a corrected move will end: predicted before it moves, and by odometry before the last look."""

import math
from typing import NamedTuple

import numpy as np

from nominal_arm.dimensions import BoomDimensions
from vision_pc.config.programs import LocalErrorModelSettings, PositioningSettings
from vision_pc.core.calibration.boom_levers import boom_levers, slew_lever
from vision_pc.core.calibration.local_error_model import LocalErrorModel, LocalTrack
from vision_pc.core.positioning.expected_end import ExpectedEnd, expected_end
from vision_pc.core.positioning.look_then_move import doubt_covariance, error_covariance
from vision_pc.core.se3 import Array
from vision_pc.core.types import Look

_NEAR = 4.0  # residuals: a joint that passes its end by its backlash is left there, and does so each time
_ACROSS = 2.0  # of a residual, x and y are seen without the look's range
_FADE = 0.5  # what a motion counts of the one after it: a servo leaves the same again, not for ever
_DOUBT = 0.1  # motions that left nothing, beside those seen: joints' ends differ less than their residuals


_SERVO_FREEDOM = 6.0  # [D] motions that ``servo_std_m`` is worth


class ServoSpread(NamedTuple):
    """``variance`` m² in each direction of where a motion ends, and the freedom with which it is known."""

    variance: float
    freedom: float


def servo_spread(track: LocalTrack, settings: LocalErrorModelSettings) -> ServoSpread:
    """What the next motion is expected to leave."""
    prior = settings.servo_std_m**2
    seen = prior + settings.odometry_std_m**2
    residuals = np.concatenate([track.residuals, _residual_of_legs(track, settings)])
    squares = float((residuals**2).sum() / 3.0 * _ACROSS / seen)
    count = _ACROSS * len(residuals)
    scale = (_SERVO_FREEDOM + squares) / (_SERVO_FREEDOM + count)
    return ServoSpread(prior * scale, _SERVO_FREEDOM + count)


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


_FOUND_PX = 0.2  # markers of known size tell the offset three times as well; holes and planes do not at all
_OTHER_SIDE = 0.5  # of motions that nothing corrects end on either side of the slew's backlash


class PlannedStep(NamedTuple):
    """A step ``x`` (3,) in B with the model's covariance, the share of it to be driven now, and how many
    motions there may be until the end, this one included.
    """

    x: Array
    covariance: Array
    share: float
    motions: int


def predicted_end(
    look: Look,
    fitted: LocalErrorModel,
    track: LocalTrack,
    planned: PlannedStep,
    settings: PositioningSettings,
    map_settings: LocalErrorModelSettings,
) -> ExpectedEnd:
    """The error expected at the end of all motions.

    When a correction follows, the model's error counts for the rest of the way alone. The end of a motion is
    then corrected until odometry finds it small, and odometry's own error counts for all of the way. Nothing
    corrects what backlash leaves of an open-loop step.
    """
    rest = 1.0 if planned.share == 1.0 else (1.0 - planned.share) ** 2
    spread = servo_spread(track, map_settings)
    in_base = rest * planned.covariance + spread.variance * np.eye(3)
    if not settings.corrections:
        in_base += _uncorrected_backlash(planned.x, fitted, map_settings)
    covariance = fitted.R.T @ in_base @ fitted.R
    if settings.corrections:
        across = 0.5 * float(np.trace(covariance[:2, :2]))
        remaining = after_corrections(across, settings.nudge_m, planned.motions)
        shrunk = np.diag([math.sqrt(remaining / across)] * 2 + [1.0])
        covariance = shrunk @ covariance @ shrunk
    covariance += odometry_covariance(planned.x, look, map_settings)  # the model, too, has its lengths
    covariance += _look_covariance(look, track, settings)
    return expected_end(np.zeros(3), covariance, settings.tolerance_m, spread.freedom)


def end_by_odometry(
    residuals: list[Array],
    look: Look,
    track: LocalTrack,
    settings: PositioningSettings,
    map_settings: LocalErrorModelSettings,
) -> ExpectedEnd:
    """What odometry says of the end of a way whose ``residuals`` (3,) it saw, begun with ``look``."""
    here = end_by_look(residuals[-1], look, track, settings)
    way = odometry_covariance(residuals[0], look, map_settings)
    return expected_end(here.mean_m, here.covariance + way, settings.tolerance_m)


def end_by_look(residual: Array, look: Look, track: LocalTrack, settings: PositioningSettings) -> ExpectedEnd:
    """What ``look`` says of a tool that stays ``residual`` (3,) m off its goal."""
    return expected_end(residual, _look_covariance(look, track, settings), settings.tolerance_m)


def _uncorrected_backlash(x: Array, fitted: LocalErrorModel, settings: LocalErrorModelSettings) -> Array:
    """Covariance (3, 3) m² in B of what backlash leaves of a step ``x`` (3,) m that is driven in one go.

    The slew may come to rest on either side of the backlash that the legs have shown, here as at each end of
    the legs. What else such ends differ by is known as a whole alone. Two of three legs tell each turn of the
    model, and the way is longer than they are.
    """
    carried = float(np.linalg.norm(x)) / (math.sqrt(2.0) * settings.leg_m)
    across = 2.0 * fitted.slew_play * slew_lever(fitted.X_BT)
    slew = _OTHER_SIDE * (1.0 + carried**2) * np.outer(across, across)
    return np.asarray(slew + (carried * settings.leg_end_std_m) ** 2 * np.eye(3))


def _look_covariance(look: Look, track: LocalTrack, settings: PositioningSettings) -> Array:
    """Covariance (3, 3) m² of the error that is left where ``look`` measures none: of tool and object as they
    were seen, of the axis along which the clearance is kept, of where an arm that goes to and fro was just
    then, and of what is in doubt.

    Half of that way: a sine's standard deviation is 0.35 of it, and loose steel goes farther than its
    encoder. No motion ends any of that.
    """
    unsteady = swing_variance(track) * np.eye(3) + doubt_covariance(look, settings)
    return np.asarray(error_covariance(look, settings.clearance_m, settings) + unsteady)


def swing_variance(track: LocalTrack) -> float:
    """Variance m² of where a tool is that went to and fro by ``residual_motion`` at the track's end."""
    return (0.5 * track.residual_motion) ** 2


def odometry_covariance(d: Array, look: Look, settings: LocalErrorModelSettings) -> Array:
    """Covariance (3, 3) m² of a way ``d`` (3,) as odometry measures it.

    ``odometry_scale_std`` is of a camera whose offset is found; by one that is not, odometry's lengths are
    off as the look's distance is.
    """
    scale = settings.odometry_scale_std
    if look.offset is not None and look.offset.std_x_px > _FOUND_PX:
        scale = math.hypot(scale, math.sqrt(look.cov_CO[2, 2]) / abs(look.X_CO[2, 3]))
    variance = settings.odometry_std_m**2 + (scale * float(np.linalg.norm(d))) ** 2
    return np.asarray(variance * np.eye(3))
