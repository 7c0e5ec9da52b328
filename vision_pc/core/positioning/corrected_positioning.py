"""Corrected positioning: one look at the object, most of the way open loop, then a correction by odometry.

The object is looked at once. The arm drives the greater part of the way, settles, and odometry measures
what it really did; the local error model, with that motion added, gives the rest. A calibration error then
multiplies the last tenth of the way instead of all of it. A look at the end is for the verdict alone.
"""

import math
from typing import NamedTuple

import numpy as np

from nominal_arm.dimensions import BoomDimensions
from protocol.errors import MeasurementFailed
from vision_pc.config.programs import LocalErrorModelSettings, PositioningSettings
from vision_pc.core.calibration.local_error_model import (
    LocalErrorModel,
    LocalTrack,
    extended,
    fit_error_model,
    solve_step,
    watched_path,
)
from vision_pc.core.ports import Arm, Eyes, Report
from vision_pc.core.positioning.doubt import DoubtOf, carried, doubt_of, object_of, tool_doubt
from vision_pc.core.positioning.expected_end import ExpectedEnd
from vision_pc.core.positioning.look_then_move import (
    Ended,
    LookVerdict,
    PositioningResult,
    Step,
    in_words,
    judge,
    positioning_error,
    reached,
)
from vision_pc.core.positioning.predicted_end import (
    PlannedStep,
    end_by_look,
    end_by_odometry,
    expected_residual,
    odometry_covariance,
    predicted_end,
    servo_spread,
    swing_variance,
    worth_correcting,
)
from vision_pc.core.se3 import Array, apply, local, transform
from vision_pc.core.types import Contradiction, Look

_FIRST_SHARE = 0.9  # [S] of the way, before the first correction
_DOUBTFUL = 0.5  # of the tolerance: what is predicted does not expect ends farther off
_STALE = 0.003  # m or rad: more than a settled arm creeps


class CorrectedResult(NamedTuple):
    """The result, the error in K axes that odometry measured before the last look, and the track so far.

    Without a step, ``seen`` is what the one look says.
    """

    positioning: PositioningResult
    seen: ExpectedEnd
    track: LocalTrack

    @property
    def measured_residual_m(self) -> Array:
        """The error (3,) m in K axes that odometry measured at the end."""
        return self.seen.mean_m

    @property
    def expected(self) -> ExpectedEnd:
        """What was predicted of the end before anything moved."""
        steps = self.positioning.steps
        return steps[0].expected if steps else self.seen


async def look_then_move_corrected(
    arm: Arm,
    eyes: Eyes,
    report: Report,
    settings: PositioningSettings,
    map_settings: LocalErrorModelSettings,
    dimensions: BoomDimensions,
    track: LocalTrack,
) -> CorrectedResult:
    """The result of one look, motions with corrections between them, and a look for the verdict.

    A tool that stands nearer to its goal than motions are expected to leave it stays there.
    ``track`` must end where the arm stands. Raises MeasurementFailed when the arm was moved since
    (``measurement.calibration_stale``), the step is too long, or odometry is lost; errors of arm and eyes
    pass through.
    """
    report(0.0, "looking")
    look = await eyes.look()
    _refuse_stale(track, look)
    p_CM = look.X_CM[:3, 3]
    goal_C = p_CM + positioning_error(look, settings.clearance_m)  # where the marker shall be
    steps: list[Step] = []
    residuals, X_KC = [goal_C - p_CM], np.eye(4)
    if _stands_near_enough(residuals[0], track, settings, map_settings):
        return _stayed(look, track, settings, report)
    parts = 2 if settings.corrections and np.linalg.norm(residuals[0]) > map_settings.near_m else 1
    while _needs_another_motion(residuals, parts, track, settings, map_settings):
        fitted = fit_error_model(track, p_CM, dimensions, map_settings)
        x, covariance = solve_step(fitted, residuals[-1])
        share = _FIRST_SHARE if len(steps) + 1 < parts else 1.0
        planned = PlannedStep(x, covariance, share, max(settings.corrections + 1 - len(steps), 1))
        steps.append(_step(look, fitted, track, planned, settings, map_settings))
        report(0.2 + 0.6 * min(len(steps) / (settings.corrections + 1), 1.0), _in_words(residuals[-1]))
        motion = await watched_path(arm, eyes, [steps[-1].X_BT_ref], dimensions, map_settings)
        X_KC = motion.X_KC[0] @ X_KC
        residuals.append(apply(X_KC, goal_C) - p_CM)
        if share == 1.0:
            motion = motion._replace(residuals=(fitted.R @ residuals[-1])[None])
        track = extended(track, motion)
    seen = end_by_odometry(residuals, look, track, settings, map_settings)
    report(0.9, f"looking; odometry says inside with probability {seen.inside:.2f}")
    last = await eyes.look()
    looks = judge(look, settings), judge(last, settings)
    doubt = _doubt(look, X_KC, last, track, len(steps), settings, map_settings)
    ended = _ended(looks[-1], seen, doubt, settings)
    report(1.0, _error_in_words(looks[-1]) + in_words(doubt))
    return CorrectedResult(PositioningResult(looks, tuple(steps), ended, doubt), seen, track)


def _doubt(
    first: Look,
    X_KC: Array,
    last: Look,
    track: LocalTrack,
    motions: int,
    settings: PositioningSettings,
    map_settings: LocalErrorModelSettings,
) -> Contradiction | None:
    """What the ``last`` look contradicts: by odometry the camera went from C, where ``first`` was taken, to
    K (X_KC, 4 by 4) in so many ``motions``. Its attitude is known as well as places at the object's distance.
    """
    d, distance_m = X_KC[:3, 3], abs(float(last.X_CO[2, 3]))
    motion = odometry_covariance(d, first, map_settings) + swing_variance(track) * np.eye(3)
    motion += (settings.axis_std_rad * d[2]) ** 2 * np.diag([1.0, 1.0, 0.0])  # as of ``error_covariance``
    attitude = map_settings.odometry_std_m / distance_m
    here = carried(object_of(first), X_KC, motion, motions * attitude**2)
    return tool_doubt(first, last) or doubt_of(DoubtOf.OBJECT, here, object_of(last), last.time_ns)


def _ended(
    verdict: LookVerdict, seen: ExpectedEnd, doubt: Contradiction | None, settings: PositioningSettings
) -> Ended:
    """Why nothing followed the last look, where odometry ``seen`` said what it did."""
    unresolved = np.abs(seen.mean_m[:2]).max() > settings.tolerance_m
    if doubt is not None and not unresolved:
        return Ended.CONTRADICTED
    if reached(verdict, settings):
        return Ended.REACHED
    return Ended.NOT_RESOLVED if unresolved else Ended.INPUT_LIMIT


def _stayed(look: Look, track: LocalTrack, settings: PositioningSettings, report: Report) -> CorrectedResult:
    """The result without a step: what ``look`` says of a tool that stays where it is."""
    verdict = judge(look, settings)
    report(1.0, f"{_error_in_words(verdict)}: nearer than motions end")
    ended = Ended.REACHED if reached(verdict, settings) else Ended.NEAR_ENOUGH
    seen = end_by_look(verdict.error_m, look, track, settings)
    return CorrectedResult(PositioningResult((verdict,), (), ended), seen, track)


def _stands_near_enough(
    residual: Array, track: LocalTrack, settings: PositioningSettings, map_settings: LocalErrorModelSettings
) -> bool:
    """Whether a look's ``residual`` (3,) is less than the motions that may follow are expected to leave.

    An open-loop step is one motion that was asked for.
    """
    if not settings.corrections or abs(residual[2]) > settings.depth_aim_m:
        return False
    variance = servo_spread(track, map_settings).variance
    enough = worth_correcting(variance, settings.nudge_m, settings.corrections + 1)
    return math.hypot(residual[0], residual[1]) <= enough


def _needs_another_motion(
    residuals: list[Array],
    parts: int,
    track: LocalTrack,
    settings: PositioningSettings,
    map_settings: LocalErrorModelSettings,
) -> bool:
    """Whether a further motion is due after the ``residuals`` (3,) before it, as odometry saw them.

    The first ``parts`` motions make up the whole way. Corrections follow while another one is worth it
    after what motions left in ``track``; while odometry sees the tool outside half of the tolerance there
    may be ``outside`` more of them, for ends that scatter widely may still come inside. An open-loop step
    is one motion.
    """
    motions = len(residuals) - 1
    if motions < parts:
        return True
    far_off = np.abs(residuals[-1][:2]).max() > _DOUBTFUL * settings.tolerance_m
    more = settings.outside if settings.corrections and far_off else 0
    allowed = settings.corrections + 1 + more - motions
    if allowed < 1:
        return False
    variance = servo_spread(track, map_settings).variance
    enough = worth_correcting(variance, settings.nudge_m, allowed)
    return math.hypot(residuals[-1][0], residuals[-1][1]) > enough


def _error_in_words(verdict: LookVerdict) -> str:
    return f"error {1e3 * verdict.error_m[0]:+.1f} {1e3 * verdict.error_m[1]:+.1f} mm"


def _in_words(residual: Array) -> str:
    return f"{1e3 * float(np.linalg.norm(residual)):.1f} mm to go"


def _step(
    look: Look,
    fitted: LocalErrorModel,
    track: LocalTrack,
    planned: PlannedStep,
    settings: PositioningSettings,
    map_settings: LocalErrorModelSettings,
) -> Step:
    """The step over its share, with the error expected at the end of all motions.

    Raises MeasurementFailed for a step too long, or a goal that is not known.
    """
    length = float(np.linalg.norm(planned.x))
    if not length <= settings.step_limit_m:
        raise MeasurementFailed(
            "measurement.step_too_large",
            f"corrected move: step {length:.3f} m, limit {settings.step_limit_m:g} m",
        )
    worst = math.sqrt(float(np.linalg.eigvalsh(planned.covariance)[-1]))
    if worst > map_settings.goal_std_limit_m:
        raise MeasurementFailed(
            "measurement.ill_conditioned",
            f"corrected move: the goal is known to {1e3 * worst:.1f} mm, "
            f"limit {1e3 * map_settings.goal_std_limit_m:g} mm",
        )
    X_BT = fitted.X_BT
    residual = expected_residual(track, fitted.dimensions, map_settings)
    X_BT_ref = transform(X_BT[:3, :3], X_BT[:3, 3] + planned.share * planned.x - residual)
    end = predicted_end(look, fitted, track, planned, settings, map_settings)
    return Step(planned.share * planned.x, X_BT_ref, end)


def _refuse_stale(track: LocalTrack, look: Look) -> None:
    moved = local(track.X_BT_now, look.X_BT)
    distance = float(np.linalg.norm(moved[:3]))
    if distance > _STALE or np.linalg.norm(moved[3:]) > _STALE:
        raise MeasurementFailed(
            "measurement.calibration_stale",
            f"corrected move: the arm stands {1e3 * distance:.1f} mm from where the track ended",
        )
