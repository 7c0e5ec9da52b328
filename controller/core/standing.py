"""The arm at the end of a motion: it comes to rest, is parked, and tells of both."""

import numpy as np

from controller.core.kinematics.rotations import Array
from controller.core.kinematics.triples import norm
from controller.core.scan_types import MOVES, ScanEvent, ScanState, Standing
from controller.core.servo.coming_to_rest import may_stay, rested_here, restless
from controller.core.servo.flanks import flanks_followed, stays_within
from controller.core.servo.parking import at_rest, park_step, parked_here
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
from controller.core.servo.servo_step import ServoInput
from controller.core.settings import ScanSettings
from nominal_arm.description import JOINT_NAMES
from protocol.axes_group import Mode

_STILL_ASTRAY = 0.8  # of the alarm's limit: nearer, a parked tool that was astray no longer is


def stood(
    settings: ScanSettings, state: ScanState, given: ServoInput, out: Array, events: list[ScanEvent]
) -> ScanState:
    """``state`` with parking in place of the joint law in ``out`` while the arm stands; tells of changes."""
    assert settings.parking is not None
    if state.motion.path is not None or state.mode is not Mode.STANDBY:
        if state.standing.parked:
            events.append(ScanEvent("unparked", state.mode.name, 0.0, 0.0))
        parking = state.parking.copy() if state.standing == MOVES else parking_ended(state.parking)
        flanks_followed(parking, state.watch.q_meas, settings.parking.dt_s)
        return state._replace(parking=parking, standing=MOVES)
    parking = state.parking.copy()
    flanks_followed(parking, state.watch.q_meas, settings.parking.dt_s)
    park_step(settings.servo, settings.parking, given, state.watch.turned, out, parking)
    since_s = state.standing.since_s + settings.parking.dt_s
    rests, parking = _rested(settings.parking, state.standing.rests, since_s, parking, events)
    parked = state.standing.parked or (rests and at_rest(parking))
    if parked and not state.standing.parked:
        parking = parked_here(parking)
    away = norm(state.tool.J_BT[:3] @ off_place(parking))
    limit = settings.parking_alarm * (_STILL_ASTRAY if state.standing.astray else 1.0)
    astray = parked and away > limit
    if parked and not state.standing.parked:
        events.append(ScanEvent("parked", "VALVES_SHUT", away, settings.parking_alarm))
    for joint in np.flatnonzero((parking[PHASE] == KEPT) & (state.parking[PHASE] != KEPT)):
        held = 2.0 * parking[BAND, joint] / settings.parking.rest[joint]
        cause = f"{JOINT_NAMES[joint].upper()}_IS_KEPT_BY_AN_OPENING"
        events.append(ScanEvent("leaking", cause, abs(float(parking[DRIFT, joint])), float(held)))
    if astray and not state.standing.astray:
        events.append(ScanEvent("astray", "PARKED_TOOL_LEFT_ITS_PLACE", away, settings.parking_alarm))
    return state._replace(parking=parking, standing=Standing(since_s, rests, parked, astray))


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
