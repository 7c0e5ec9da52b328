"""Look-then-move: drive the tool to the object by what a look says, in the axes a local calibration gives.

Mäkinen et al. 2023, (20)-(22). Every look measures again and uses the same calibration; between looks the arm
moves by its own joint control. Each look says how large the error is, how well it is known and whether it is
inside the tolerance; each move says beforehand how far off it is expected to end.
"""

import math
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from protocol.errors import MeasurementFailed
from vision_pc.config.programs import PositioningSettings
from vision_pc.core.calibration.local_calibration import LocalCalibration
from vision_pc.core.ports import Arm, Eyes, Report
from vision_pc.core.positioning.doubt import DoubtOf, carried, doubt_of, object_of, tool_doubt
from vision_pc.core.positioning.expected_end import ExpectedEnd, expected_end
from vision_pc.core.se3 import Array, transform
from vision_pc.core.types import Contradiction, Look

_SIGMAS_95 = 1.96
_IMPROVEMENT = 0.8  # a further input must bring the error below this share of the last, or it is no use


class LookVerdict(NamedTuple):
    """One look against the tolerance.

    ``error_m`` (3,) = p_CO − p_CM − [0, 0, b] in camera axes, ``covariance`` (3, 3) m² its own.
    ``inside``: |e_x| and |e_y| within ``tolerance_m``; ``certain``: so also at every point of the 95 %
    intervals (or at none).
    """

    error_m: Array
    covariance: Array
    tolerance_m: float
    clearance_m: float
    inside: bool
    certain: bool

    @property
    def std_m(self) -> Array:
        """Standard deviations (3,) of the error along the axes of C."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


class Step(NamedTuple):
    """One input: the step p_lc (3,) in B, its reference, and the error in C expected at the end."""

    p_lc: Array
    X_BT_ref: Array
    expected: ExpectedEnd


class Ended(StrEnum):
    """Why no further input followed: inside the aim, no use, the inputs are used up, the machine could not
    bring what odometry saw outside the tolerance inside it, the tool stood nearer than drives end, or the
    last look contradicts where odometry saw the tool, or where the last step was predicted to end: the object
    has moved, or one of the two is wrong.
    """

    REACHED = "reached"
    NOT_IMPROVING = "not_improving"
    INPUT_LIMIT = "input_limit"
    NOT_RESOLVED = "not_resolved"
    NEAR_ENOUGH = "near_enough"
    CONTRADICTED = "contradicted"


class PositioningResult(NamedTuple):
    """Looks and steps in order, a look before the first step and after every one; ``contradiction``: what
    the last look contradicts.
    """

    looks: tuple[LookVerdict, ...]
    steps: tuple[Step, ...]
    ended: Ended
    contradiction: Contradiction | None = None

    @property
    def final(self) -> LookVerdict:
        """The verdict of the last look."""
        return self.looks[-1]


async def look_then_move(
    arm: Arm, eyes: Eyes, report: Report, settings: PositioningSettings, calibration: LocalCalibration
) -> PositioningResult:
    """Looks and inputs until the error is inside ``aim_m``, stops improving, or the inputs are used up.

    A calibration that is off makes a first step end elsewhere, and the second look mends it: the last look
    alone is asked whether it contradicts the step before it.
    Raises MeasurementFailed when a look fails or a step exceeds its limit (nothing moves then); errors of
    arm and eyes pass through. Source: Mäkinen et al. 2023, (20)-(22).
    """
    looks: list[LookVerdict] = []
    steps: list[Step] = []
    ended = Ended.INPUT_LIMIT
    report(0.0, "looking")
    for number in range(settings.inputs + 1):
        look = await eyes.look()
        looks.append(judge(look, settings))
        report((number + 0.3) / (settings.inputs + 0.3), f"look {number + 1}: {_in_words(looks[-1])}")
        if reached(looks[-1], settings):
            ended = Ended.REACHED
            break
        if number > 1 and not _improves(looks):
            ended = Ended.NOT_IMPROVING
            break
        if number == settings.inputs:
            break
        before = look
        steps.append(step(look, settings, calibration))
        await arm.move_to(steps[-1].X_BT_ref, duration_s=settings.duration_s)
    doubt = _doubt(before, steps[-1].p_lc, look, settings, calibration) if steps else None
    if doubt is not None:
        ended = Ended.CONTRADICTED
    report(1.0, f"{ended.replace('_', ' ')}: {_in_words(looks[-1])}{in_words(doubt)}")
    return PositioningResult(tuple(looks), tuple(steps), ended, doubt)


def in_words(doubt: Contradiction | None) -> str:
    """What a report says after its error; nothing without a doubt."""
    return "" if doubt is None else f"; {doubt}"


def _doubt(
    first: Look, p_lc: Array, last: Look, settings: PositioningSettings, calibration: LocalCalibration
) -> Contradiction | None:
    """What the ``last`` look contradicts, after a step ``p_lc`` (3,) in B from where ``first`` was taken.

    The arm keeps the tool's orientation as far as it keeps straight lines: by ``strain_std``.
    """
    R_BC = calibration.rotation_at(first.X_BT)
    motion = transform(np.eye(3), -R_BC.T @ p_lc)
    moved = _motion_covariance(first, p_lc, settings, calibration)
    attitude = settings.strain_std * float(np.linalg.norm(p_lc))
    here = carried(object_of(first), motion, moved, attitude**2)
    return tool_doubt(first, last) or doubt_of(DoubtOf.OBJECT, here, object_of(last), last.time_ns)


def positioning_error(look: Look, clearance_m: float) -> Array:
    """The error (3,) that a look shows in camera axes: what is left of (21)."""
    error: Array = look.X_CO[:3, 3] - look.X_CM[:3, 3] - np.array([0.0, 0.0, clearance_m])
    return error


def error_covariance(look: Look, depth_m: float, settings: PositioningSettings) -> Array:
    """Covariance (3, 3) m² in C of the error between tool and object that are ``depth_m`` apart along z_C.

    That of both as ``look`` sees them, and of the camera's axis: a principal point that is off turns all
    directions alike, and so shows a difference of depth as one across. More frames do not average that out.
    """
    aside = (settings.axis_std_rad * depth_m) ** 2 * np.diag([1.0, 1.0, 0.0])
    return np.asarray(look.cov_CM[:3, :3] + look.cov_CO[:3, :3] + aside)


def step(look: Look, settings: PositioningSettings, calibration: LocalCalibration) -> Step:
    """The input that this look asks for.

    Raises MeasurementFailed (``measurement.step_too_large``) when it is longer than ``step_limit_m``.
    """
    c_delta = positioning_error(look, settings.clearance_m)  # (21)
    R_BC = calibration.rotation_at(look.X_BT)
    p_lc = R_BC @ c_delta  # (20), R_BC = R_fm R_cfa
    length = float(np.linalg.norm(p_lc))
    if not length <= settings.step_limit_m:
        raise MeasurementFailed(
            "measurement.step_too_large",
            f"look-then-move: step {length:.3f} m, limit {settings.step_limit_m:g} m",
        )
    X_BT_ref = transform(look.X_BT[:3, :3], look.X_BT[:3, 3] + p_lc)  # (22)
    in_camera = _motion_covariance(look, p_lc, settings, calibration)
    in_camera += error_covariance(look, settings.clearance_m, settings) + doubt_covariance(look, settings)
    return Step(p_lc, X_BT_ref, expected_end(np.zeros(3), in_camera, settings.tolerance_m))


def _motion_covariance(
    look: Look, p_lc: Array, settings: PositioningSettings, calibration: LocalCalibration
) -> Array:
    """Covariance (3, 3) m² in C of where a step ``p_lc`` (3,) in B ends."""
    R_BC = calibration.rotation_at(look.X_BT)
    in_base = calibration.goal_covariance(p_lc) + settings.servo_std_m**2 * np.eye(3)
    return np.asarray(R_BC.T @ in_base @ R_BC + np.diag((settings.strain_std * R_BC.T @ p_lc) ** 2))


def judge(look: Look, settings: PositioningSettings) -> LookVerdict:
    """A look's error against the tolerance in x and y, with its uncertainty."""
    error = positioning_error(look, settings.clearance_m)
    covariance = error_covariance(look, float(error[2]) + settings.clearance_m, settings)
    across, spread = np.abs(error[:2]), _SIGMAS_95 * np.sqrt(np.diag(covariance)[:2])
    inside = bool(np.all(across <= settings.tolerance_m))
    certain = bool(
        np.all(across + spread <= settings.tolerance_m) or np.any(across - spread > settings.tolerance_m)
    )
    return LookVerdict(error, covariance, settings.tolerance_m, settings.clearance_m, inside, certain)


def doubt_covariance(look: Look, settings: PositioningSettings) -> Array:
    """Covariance (3, 3) m² of what is in doubt; zeros where nothing is."""
    variance = 0.0 if look.doubt is None else look.doubt.variance_m2(settings.tolerance_m)
    return variance * np.eye(3)


def reached(verdict: LookVerdict, settings: PositioningSettings) -> bool:
    """Whether no further input is worth its risk: x, y inside ``aim_m`` and depth inside ``depth_aim_m``."""
    across, depth = np.abs(verdict.error_m[:2]), abs(float(verdict.error_m[2]))
    return bool(np.all(across <= settings.aim_m)) and depth <= settings.depth_aim_m


def _improves(looks: list[LookVerdict]) -> bool:
    last, before = (math.hypot(*verdict.error_m[:2]) for verdict in (looks[-1], looks[-2]))
    return last < _IMPROVEMENT * before


def _in_words(verdict: LookVerdict) -> str:
    x, y, z = 1e3 * verdict.error_m
    where = "inside" if verdict.inside else "outside"
    return f"error {x:+.1f} {y:+.1f} {z:+.1f} mm, {where} {1e3 * verdict.tolerance_m:g} mm"
