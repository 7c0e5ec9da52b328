"""The arm at the end of a motion: it comes to rest, is parked, and tells of both."""

import numpy as np

from controller.core.kinematics.rotations import Array
from controller.core.kinematics.triples import norm
from controller.core.scan_types import MOVES, ScanEvent, ScanState, Standing
from controller.core.servo.coming_to_rest import at_rest, may_stay, parked_here, rested_here, restless
from controller.core.servo.flanks import stays_within
from controller.core.servo.parking_state import (
    BAND,
    CALM,
    DRIFT,
    KEPT,
    PHASE,
    ParkingLaw,
    off_place,
    parking_ended,
)
from controller.core.settings import ScanSettings
from nominal_arm.description import JOINT_NAMES
from protocol.axes_group import Mode

_STILL_ASTRAY = 0.8  # of the alarm's limit: nearer, a parked tool that was astray no longer is


def stands_now(state: ScanState) -> bool:
    """Whether the arm has no motion to make: it comes to rest, or is parked."""
    return state.motion.path is None and state.mode is Mode.STANDBY


def parking_before(state: ScanState) -> Array:
    """A copy of how far the joints are parked, for this scan to go on from: at a motion's start none is."""
    if stands_now(state) or state.standing == MOVES:
        return state.parking.copy()
    return parking_ended(state.parking)


def stood(settings: ScanSettings, state: ScanState, parking: Array, events: list[ScanEvent]) -> ScanState:
    """``state`` with ``parking`` as ``drive_step`` left it; tells of changes."""
    if not stands_now(state):
        if state.standing.parked:
            events.append(ScanEvent("unparked", state.mode.name, 0.0, 0.0))
        return state._replace(parking=parking, standing=MOVES)
    law, before = _law(settings), state.standing
    since_s = before.since_s + law.dt_s
    rests, parking = _rested(law, before.rests, since_s, parking, events)
    parked = before.parked or (rests and at_rest(parking))
    if parked and not before.parked:
        parking = parked_here(law, parking)
    away = norm(state.tool.J_BT[:3] @ off_place(parking)) if parked else 0.0
    astray = away > settings.parking_alarm * (_STILL_ASTRAY if before.astray else 1.0)
    if parked and not before.parked:
        events.append(ScanEvent("parked", "VALVES_SHUT", away, settings.parking_alarm))
    _kept_told(law, state.parking, parking, events)
    if astray and not before.astray:
        events.append(ScanEvent("astray", "PARKED_TOOL_LEFT_ITS_PLACE", away, settings.parking_alarm))
    return state._replace(parking=parking, standing=Standing(since_s, rests, parked, astray))


def _law(settings: ScanSettings) -> ParkingLaw:
    assert settings.parking is not None
    return settings.parking


def _kept_told(law: ParkingLaw, before: Array, parking: Array, events: list[ScanEvent]) -> None:
    """Tell which joints are kept by an opening since this scan."""
    phases, were = parking[PHASE].tolist(), before[PHASE].tolist()
    if phases == were:
        return
    for joint in range(6):
        if phases[joint] == KEPT != were[joint]:
            held = 2.0 * parking[BAND, joint] / law.rest[joint]
            cause = f"{JOINT_NAMES[joint].upper()}_IS_KEPT_BY_AN_OPENING"
            events.append(ScanEvent("leaking", cause, abs(float(parking[DRIFT, joint])), float(held)))


def rests_settled(settings: ScanSettings, state: ScanState, left: Array) -> bool:
    """Whether an arm that rests, ``left`` (6,) rad off, stays so: in the tolerance, or by its play."""
    if settings.parking is None or not state.standing.rests:
        return False
    return stays_within(settings.parking, state.parking, left, settings.servo.tolerance)


def _rested(
    law: ParkingLaw, rests: bool, since_s: float, parking: Array, events: list[ScanEvent]
) -> tuple[bool, Array]:
    """Whether the arm rests ``since_s`` after its motion, and ``parking`` then.

    A joint that does not come to rest in time is told, with how long it has been calm: the tool may go on.
    """
    if rests:
        return True, parking
    moving = np.flatnonzero(restless(law, parking))
    if len(moving) == 0:
        return True, rested_here(parking)
    if since_s < law.stays or not may_stay(law, parking):
        return False, parking
    events += [
        ScanEvent("restless", JOINT_NAMES[joint].upper(), float(parking[CALM, joint]), law.calm)
        for joint in moving
    ]
    return True, rested_here(parking)
