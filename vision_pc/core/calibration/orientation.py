"""Orientation adjustment: turn the tool until its marker is parallel to the object (Mäkinen 2023, 3.1)."""

import math
from typing import NamedTuple

import numpy as np

from protocol.errors import MeasurementFailed
from vision_pc.config.programs import OrientationForm, OrientationSettings
from vision_pc.core.ports import Arm, Eyes, Report
from vision_pc.core.se3 import Array, angle_between, euler_xyz, nearest_rotation, transform
from vision_pc.core.types import Look

R_TM_NOMINAL = np.diag([1.0, -1.0, -1.0])
"""Tool marker in T as designed: x right, y up, z out of its face towards the camera."""


class OrientationResult(NamedTuple):
    """Euler XYZ error angles (3,) rad of O seen from M, one row a look: before, and after each input.

    ``references`` are the R_BT_ref that were commanded; ``tool_shift_m`` (inputs,) how far the tool marker
    moved against the object in C with each: little, since T and M share their origin.
    """

    errors: tuple[Array, ...]
    references: tuple[Array, ...]
    tool_shift_m: tuple[float, ...]


async def adjust_orientation(
    arm: Arm, eyes: Eyes, report: Report, settings: OrientationSettings
) -> OrientationResult:
    """The errors before and after turning the tool to the object's orientation, position held.

    Raises MeasurementFailed when the marker is not seen or the turn asked for exceeds ``limit_deg``; errors
    of arm and eyes pass through. Source: Mäkinen et al. 2023, (7) and (8).
    """
    report(0.0, "looking")
    look = await eyes.look()
    errors = [orientation_error(look)]
    references: list[Array] = []
    shifts: list[float] = []
    for repetition in range(settings.repetitions):
        R_BT_ref = reference_rotation(look, settings.form)
        _refuse_large_turn(look.X_BT[:3, :3], R_BT_ref, settings.limit_deg)
        report((repetition + 0.3) / settings.repetitions, f"turning the tool, input {repetition + 1}")
        await arm.move_to(transform(R_BT_ref, look.X_BT[:3, 3]))
        report((repetition + 0.8) / settings.repetitions, "looking again")
        before, look = look, await eyes.look()
        errors.append(orientation_error(look))
        references.append(R_BT_ref)
        shifts.append(_tool_shift(before, look))
    report(1.0, f"orientation error {np.rad2deg(np.linalg.norm(errors[-1])):.2f} deg")
    return OrientationResult(tuple(errors), tuple(references), tuple(shifts))


def reference_rotation(look: Look, form: OrientationForm) -> Array:
    """R_BT_ref (3×3) that brings the tool marker parallel to the object, from one look.

    ``paper``: (7) and (8) as printed, right when camera and tool axes are parallel. ``frame_true``: the
    same turn expressed at the marker, right for any camera mount.
    """
    R_CO, R_CM, R_BT = look.X_CO[:3, :3], look.X_CM[:3, :3], look.X_BT[:3, :3]
    if form == "paper":
        R_delta = R_CO @ R_CM.T  # (7) r_Δ = r_O r_T⁻¹
        return nearest_rotation(R_BT @ R_delta)  # (8) T_ref = B_T_T [R_Δ 0; 0 1]
    R_MO = R_CM.T @ R_CO
    return nearest_rotation(R_BT @ R_TM_NOMINAL @ R_MO @ R_TM_NOMINAL.T)


def orientation_error(look: Look) -> Array:
    """Euler XYZ angles (3,) rad of the rotation from M to O, zero when they are parallel."""
    return euler_xyz(look.X_CM[:3, :3].T @ look.X_CO[:3, :3])


def _refuse_large_turn(R_BT: Array, R_BT_ref: Array, limit_deg: float) -> None:
    turn_deg = math.degrees(angle_between(R_BT, R_BT_ref))
    if turn_deg > limit_deg:
        raise MeasurementFailed(
            "measurement.turn_too_large",
            f"orientation: a turn of {turn_deg:.1f} deg, limit {limit_deg:g} deg",
        )


def _tool_shift(before: Look, after: Look) -> float:
    """Change of the distance vector from M to O, seen in O's axes, metres."""
    shift = [look.X_CO[:3, :3].T @ (look.X_CM[:3, 3] - look.X_CO[:3, 3]) for look in (before, after)]
    return float(np.linalg.norm(shift[1] - shift[0]))
