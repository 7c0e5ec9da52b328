"""What is told of the end of a corrected move: before it moves, and by odometry before the last look."""

import math
from typing import NamedTuple

import numpy as np

from vision_pc.config.programs import LocalErrorModelSettings, PositioningSettings
from vision_pc.core.calibration.arm_fields import boom_levers
from vision_pc.core.calibration.backlash import slew_lever
from vision_pc.core.calibration.local_error_model import LocalErrorModel, LocalTrack
from vision_pc.core.positioning.expected_end import ExpectedEnd, expected_end
from vision_pc.core.positioning.learned_servo import after_fine_corrections, servo_spread
from vision_pc.core.se3 import Array
from vision_pc.core.types import Look

_KEPT = 2.0 / 3.0  # of ``nudge_m``: width of the Gaussian that stands for its edge
_FOUND_PX = 0.2  # markers of known size tell the offset three times as well; holes and planes do not at all
_OTHER_FLANK = 0.25  # of motions end on the slew's other flank; [M] one of four, crane-real 8511 to 8514


class Wanted(NamedTuple):
    """A step ``x`` (3,) in B with the model's covariance, the share of it to be driven now, and how many
    drives there may be until the end, this one included.
    """

    x: Array
    covariance: Array
    share: float
    drives: int


def foreseen_end(
    look: Look,
    fitted: LocalErrorModel,
    track: LocalTrack,
    wanted: Wanted,
    settings: PositioningSettings,
    map_settings: LocalErrorModelSettings,
) -> ExpectedEnd:
    """The error expected at the end of all motions.

    When a correction follows, the model's error counts for the rest of the way alone. The end of a motion is
    then corrected until odometry finds it small, and odometry's own error counts for all of the way. Where
    drives adapt, joints have play: nothing corrects what it leaves of an open-loop step.
    """
    rest = 1.0 if wanted.share == 1.0 else (1.0 - wanted.share) ** 2
    spread = servo_spread(track, map_settings)
    in_base = rest * wanted.covariance + spread.variance * np.eye(3)
    if map_settings.adaptive.enabled and not settings.corrections:
        in_base += _uncorrected_play(wanted.x, fitted, map_settings)
    covariance = fitted.R.T @ in_base @ fitted.R
    if settings.corrections and map_settings.adaptive.enabled:
        across = 0.5 * float(np.trace(covariance[:2, :2]))
        kept = after_fine_corrections(across, map_settings.adaptive.nudge_m, wanted.drives)
        shrunk = np.diag([math.sqrt(kept / across)] * 2 + [1.0])
        covariance = shrunk @ covariance @ shrunk
    elif settings.corrections:
        covariance = _after_fine_corrections(covariance, settings.nudge_m, map_settings.servo_std_m)
    if settings.corrections or map_settings.adaptive.enabled:  # the model, too, goes by odometry's lengths
        covariance += _odometry_covariance(wanted.x, fitted.R.T, look, fitted.scale, track, map_settings)
    covariance += _looked_covariance(look, track, settings)
    return expected_end(np.zeros(3), covariance, settings.tolerance_m, spread.freedom)


def seen_end(
    residuals: list[Array],
    look: Look,
    fitted: LocalErrorModel,
    track: LocalTrack,
    settings: PositioningSettings,
    map_settings: LocalErrorModelSettings,
) -> ExpectedEnd:
    """What odometry says of the end of a way whose ``residuals`` (3,) it saw, begun with ``look``.

    ``fitted``: the model of its last drive, ``track`` with it.
    """
    here = looked_at_end(residuals[-1], look, track, settings)
    way = _odometry_covariance(residuals[0], np.eye(3), look, fitted.scale, track, map_settings)
    return expected_end(here.mean_m, here.covariance + way, settings.tolerance_m)


def looked_at_end(
    residual: Array, look: Look, track: LocalTrack, settings: PositioningSettings
) -> ExpectedEnd:
    """What ``look`` tells of a tool that stays ``residual`` (3,) m off its goal."""
    return expected_end(residual, _looked_covariance(look, track, settings), settings.tolerance_m)


def _uncorrected_play(x: Array, fitted: LocalErrorModel, settings: LocalErrorModelSettings) -> Array:
    """Covariance (3, 3) m² in B of what play leaves of a step ``x`` (3,) m that is driven in one go.

    The slew may come to rest on the other flank of the play that the legs have shown, here as at each end of
    the legs; lift and tilt stood there on either flank of theirs, half of what takes it up. What else such
    machines do there, loose steel that falls over, booms that bend otherwise than the model's, is known as a
    whole alone. Two of three legs tell each turn of the map, and the way is longer than they are.
    """
    carried = float(np.linalg.norm(x)) / (math.sqrt(2.0) * settings.leg_m)
    flank = 2.0 * fitted.slew_play * slew_lever(fitted.X_BT)
    booms = boom_levers(fitted.X_BT, fitted.dimensions)[:, 1:]
    at_leg = 0.5 * settings.adaptive.boom_take_up_rad * float(np.linalg.norm(booms))
    at_leg = math.hypot(at_leg, settings.adaptive.leg_end_std_m)
    slew = _OTHER_FLANK * (1.0 + carried**2) * np.outer(flank, flank)
    return np.asarray(slew + (carried * at_leg) ** 2 * np.eye(3))


def _after_fine_corrections(end_covariance: Array, nudge_m: float, servo_std_m: float) -> Array:
    """Covariance (3, 3), m², camera axes, of the error once corrections repeat until |x|, |y| < nudge_m.

    A truncated normal, approximated by a Gaussian. No finer than the joint servo's residual.
    """
    kept = np.diag([1.0, 1.0, 0.0]) / ((_KEPT * nudge_m) ** 2 + servo_std_m**2)
    return np.asarray(np.linalg.inv(np.linalg.inv(end_covariance) + kept), dtype=np.float64)


def _looked_covariance(look: Look, track: LocalTrack, settings: PositioningSettings) -> Array:
    """Covariance (3, 3) m² of the error that ``look`` tells: of tool and object as they were seen, of the
    axis along which the clearance is kept, and of where an arm that goes to and fro was just then.

    Half of that way: a sine's standard deviation is 0.35 of it, and loose steel goes farther than its
    encoder. No drive ends any of that.
    """
    aside = (settings.axis_std_rad * settings.clearance_m) ** 2 * np.diag([1.0, 1.0, 0.0])
    unrest = (0.5 * track.unrest) ** 2 * np.eye(3)
    return np.asarray(look.cov_CM[:3, :3] + look.cov_CO[:3, :3] + aside + unrest)


def _odometry_covariance(
    d: Array, R: Array, look: Look, lengths: float, track: LocalTrack, settings: LocalErrorModelSettings
) -> Array:
    """Covariance (3, 3) m² of a way ``R`` ``d`` (3,), camera axes, as odometry measures it.

    ``lengths``: by how much they differ from the arm's, relative. ``odometry_scale_std`` is of a camera whose
    offset is found; by one that is not, odometry's lengths are off as the look's distance is.
    """
    adaptive, scale = settings.adaptive, settings.odometry_scale_std
    if adaptive.enabled and look.offset is not None and look.offset.std_x_px > _FOUND_PX:
        scale = math.hypot(scale, math.sqrt(look.cov_CO[2, 2]) / abs(look.X_CO[2, 3]))
    if track.ruler is None and adaptive.enabled:
        scale = math.hypot(scale, adaptive.lens_share * max(abs(lengths) - adaptive.lens_from, 0.0))
    covariance: Array = (settings.odometry_std_m**2 + (scale * float(np.linalg.norm(d))) ** 2) * np.eye(3)
    return covariance if track.ruler is None else covariance + track.ruler.covariance(R @ d)
