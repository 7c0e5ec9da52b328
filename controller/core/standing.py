"""The arm at the end of a motion: whether it is settled, and what is logged when it no longer is."""

import numpy as np

from controller.core.kinematics.rotations import Array, norm
from controller.core.parking.joint import Joints, joints_in_motion
from controller.core.scan_types import ScanEvent, ScanState
from controller.core.servo.servo_step import ERROR, HELD, STOOD
from controller.core.servo.settling import MOVING, Settling
from controller.core.settings import ScanSettings
from nominal_arm.description import JOINT_NAMES
from protocol.axes_group import Mode

# Of the tolerance at the tool's distance: so far a settled tool may go on by its encoders; play before
# them hides as much again.
MOVED = 0.5  # [D]


def stands_now(state: ScanState) -> bool:
    """Whether the arm has no motion to make."""
    return state.motion.path is None and state.mode is Mode.STANDBY


def is_settled(settings: ScanSettings, state: ScanState) -> bool:
    """Whether every joint has stood still inside the tolerance for long enough, and is inside it now."""
    return state.mode is Mode.STANDBY and state.settled_s >= settings.settled.time


def rest_before(state: ScanState) -> tuple[Settling, Joints]:
    """Of how far the arm has come to rest, what this scan goes on from: a motion begins anew."""
    if stands_now(state):
        return state.settling, state.parking.copy()
    return MOVING, joints_in_motion()


def rest_after(
    settings: ScanSettings, state: ScanState, stands: bool, out: Array, events: list[ScanEvent]
) -> ScanState:
    """``state`` after a step of the servo that filled ``out`` and found whether all joints stand still.

    Once settled only where joints and tool are counts; who leaves its place is added to ``events``.
    """
    settled, errors, p = is_settled(settings, state), np.abs(out[ERROR]), state.tool.p_BT
    furthest, tolerance = int(errors.argmax()), settings.servo.tolerance
    moved, allowed = norm(p - state.settled_at), MOVED * tolerance * norm(p)
    inside, stays = errors[furthest] <= tolerance, not settled or moved <= allowed
    if settled and stands_now(state) and not inside:
        cause = JOINT_NAMES[furthest].upper()
        events.append(ScanEvent("unsettled", cause, float(errors[furthest]), tolerance))
    elif settled and stands_now(state) and not stays:
        events.append(ScanEvent("unsettled", "TOOL", moved, allowed))
    rests = stands_now(state) and inside and stays and (stands or settled)
    return state._replace(
        settling=Settling(out[HELD], out[ERROR], out[STOOD]),
        settled_s=state.settled_s + settings.cycle_s if rests else 0.0,
        settled_at=state.settled_at if settled else p,
    )
