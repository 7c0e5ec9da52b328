"""The arm at the end of a motion: it comes to rest, is parked, and reports both."""

import numpy as np

from controller.core.kinematics.rotations import norm
from controller.core.parking.joint import Joints, ParkingLaw, joints_in_motion, offsets_from_place
from controller.core.parking.rest import (
    arm_parked,
    arm_rested,
    is_parked,
    may_stop_here,
    unsettled_joints,
)
from controller.core.scan_types import MOVES, ScanEvent, ScanState, Standing
from controller.core.settings import ScanSettings
from nominal_arm.description import JOINT_NAMES
from protocol.axes_group import Mode

_STILL_ASTRAY = 0.8  # [D] of the alarm's limit: nearer, a parked tool that was astray no longer is


def stands_now(state: ScanState) -> bool:
    """Whether the arm has no motion to make: it comes to rest, or is parked."""
    return state.motion.path is None and state.mode is Mode.STANDBY


def parking_before(state: ScanState) -> Joints:
    """A copy of how far the joints are parked, for this scan to go on from: at a motion's start none is."""
    if stands_now(state) or state.standing == MOVES:
        return state.parking.copy()
    return joints_in_motion(state.parking)


def standing_after(
    settings: ScanSettings, state: ScanState, parking: Joints, events: list[ScanEvent]
) -> ScanState:
    """``state`` with ``parking`` as ``control_step`` left it; changes are added to ``events``."""
    if not stands_now(state):
        if state.standing.parked:
            events.append(ScanEvent("unparked", state.mode.name, 0.0, 0.0))
        return state._replace(parking=parking, standing=MOVES)
    law, before = _law(settings), state.standing
    since_s = before.since_s + law.dt_s
    rests, parking = _at_rest(law, before.rests, since_s, parking, events)
    parked = before.parked or (rests and is_parked(parking))
    if parked and not before.parked:
        parking = arm_parked(parking)
    away = norm(state.tool.J_BT[:3] @ offsets_from_place(parking)) if parked else 0.0
    astray = away > settings.parking_alarm * (_STILL_ASTRAY if before.astray else 1.0)
    if parked and not before.parked:
        events.append(ScanEvent("parked", "VALVES_SHUT", away, settings.parking_alarm))
    if astray and not before.astray:
        events.append(ScanEvent("astray", "PARKED_TOOL_LEFT_ITS_PLACE", away, settings.parking_alarm))
    return state._replace(parking=parking, standing=Standing(since_s, rests, parked, astray))


def _law(settings: ScanSettings) -> ParkingLaw:
    assert settings.parking is not None
    return settings.parking


def _at_rest(
    law: ParkingLaw, rests: bool, since_s: float, parking: Joints, events: list[ScanEvent]
) -> tuple[bool, Joints]:
    """Whether the arm rests ``since_s`` after its motion, and ``parking`` then.

    A joint that does not come to rest in time is reported with how long it has been calm.
    """
    if rests:
        return True, parking
    moving = np.flatnonzero(unsettled_joints(parking))
    if len(moving) == 0:
        return True, arm_rested(parking)
    if since_s < law.give_up or not may_stop_here(law, parking):
        return False, parking
    calm = parking["watch"]["calm"]
    events += [
        ScanEvent("restless", JOINT_NAMES[joint].upper(), float(calm[joint]), law.calm) for joint in moving
    ]
    return True, arm_rested(parking)
