"""The whole rig at a glance, as one document: what a console shows, gathered for all consoles at once."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.incidents import ServiceIncident
from nominal_arm.dimensions import DhLink, skeleton
from protocol.errors import LinkLost, RequestRefused
from protocol.faults import FAULT_TEXTS, FaultCode, GroupState
from protocol.reference_messages import FLAG_PLANT_LINK_OK, State
from vision_pc.application.application import VisionApplication
from vision_pc.application.console.alarms import HIGH, LOW, URGENT, AlarmList, Condition, alarm_json
from vision_pc.application.console.overlay import PredictedEllipse, overlay
from vision_pc.application.ports import CameraStatus, Seen
from vision_pc.application.results import JSON, JudgedLook, calibration_json, look_json, pose_json
from vision_pc.core.calibration.local_calibration import LocalCalibration
from vision_pc.core.se3 import Array

_ALARMS_SHOWN = 20
_ANEW = "the machine was started anew: local calibration and targets are void"


_MOVING_S = 0.5
_AT_REST_S = 2.5  # somebody may still walk into the picture
_MOVED_RAD = 2e-3  # a joint: more than valves leak in a second


class MeasuringPace:
    """Twice a second while the arm moves, seldom at rest, where nothing changes that joints tell of."""

    def __init__(self) -> None:
        self._last_s = -np.inf
        self._joints_rad: NDArray[np.float64] | None = None

    def due(self, now_s: float, joints_rad: NDArray[np.float64] | None) -> bool:
        """Whether to measure now; if so, that counts as done. ``joints_rad`` (n,) is None while unknown."""
        rests = (
            joints_rad is not None
            and self._joints_rad is not None
            and bool(np.all(np.abs(joints_rad - self._joints_rad) < _MOVED_RAD))
        )
        if now_s - self._last_s < (_AT_REST_S if rests else _MOVING_S):
            return False
        self._last_s, self._joints_rad = now_s, joints_rad
        return True


class Glimpse(NamedTuple):
    """All of the rig at one moment, as references: cheap to take where the link lives.

    ``trouble``: cause and detail while there is no session; ``state`` is None then.
    """

    state: State | None
    state_age_ms: float | None
    round_trip_us: float | None
    trouble: tuple[str, str] | None
    authenticated: bool
    tries_valves: bool
    datagrams_lost: int
    camera: CameraStatus
    recording: bool
    overload: str
    seen: Seen | None
    look: JudgedLook | None
    calibration: LocalCalibration | None
    tracked: bool
    clearance_m: float
    tolerance_m: float
    times_anew: int = 0
    home: Array | None = None
    incidents: Sequence[ServiceIncident] = ()


def glimpse(application: VisionApplication) -> Glimpse:
    """The rig as it is now; never raises, for it is asked when something is wrong."""
    link, state, trouble = application.controller, None, None
    try:
        state = link.state
    except LinkLost as error:
        trouble = error.cause, str(error)
    try:
        look = application.latest_look
    except RequestRefused:
        look = None
    clock, positioning = link.clock_offset, application.positioning
    return Glimpse(
        state,
        None if state is None else link.state_age_ns / 1e6,
        None if clock is None else clock.round_trip_ns / 1e3,
        trouble,
        link.authenticated,
        link.tries_valves,
        link.statistics.lost,
        application.camera.status(),
        application.log.healthy,
        application.overload(),
        application.camera.seen(),
        look,
        application.calibration,
        application.track is not None,
        positioning.clearance_m,
        positioning.tolerance_m,
        application.times_anew,
        link.home,
        application.incidents(),
    )


class Overview:
    """Turns glimpses into documents, and remembers alarms.

    ``anew_at``: when the machine has begun anew (s since 1970); what was found out before is void.
    """

    def __init__(self, links: tuple[DhLink, ...]) -> None:
        self.alarms = AlarmList()
        self._links = links
        self.anew_at: float | None = None
        self._times_anew = 0
        self._noted: set[ServiceIncident] = set()

    def note(self, now_s: float, seen: Glimpse) -> None:
        """Take note of what is wrong at ``now_s``."""
        self.alarms.update(now_s, conditions(seen))
        if seen.times_anew != self._times_anew:
            self._times_anew, self.anew_at = seen.times_anew, now_s
            self.alarms.happened(now_s, "machine.begun_anew", _ANEW)
        for incident in seen.incidents:
            if incident not in self._noted:
                self.alarms.happened(incident.at_s, incident.cause, incident.detail, HIGH)
        self._noted = set(seen.incidents)

    def document(self, seen: Glimpse, predicted: PredictedEllipse | None) -> JSON:
        """The document of one glimpse. ``predicted``: that of the newest motion, where it still holds."""
        calibration = None
        if seen.calibration is not None:
            whole = calibration_json(seen.calibration)
            calibration = {name: whole[name] for name in ("method", "rotation_std_deg", "R_BC", "samples")}
        view = seen.seen
        return {
            "link": {
                "age_ms": seen.state_age_ms,
                "round_trip_us": seen.round_trip_us,
                "trouble": seen.trouble,
                "authenticated": seen.authenticated,
                "tries_valves": seen.tries_valves,
                "lost": seen.datagrams_lost,
            },
            "camera": seen.camera._asdict(),
            "recording": seen.recording,
            "overload": seen.overload or None,
            "skeleton": self._points(seen.state),
            "home": None if seen.home is None else pose_json(seen.home),
            "look": None if seen.look is None else look_json(seen.look),
            "calibration": calibration,
            "tracked": seen.tracked,
            "anew_at": self.anew_at,
            "tolerance_mm": 1e3 * seen.tolerance_m,
            "overlay": None if view is None else overlay(view, seen.clearance_m, seen.tolerance_m, predicted),
            "alarms": [alarm_json(alarm, bool(seen.overload)) for alarm in self.alarms.rows[:_ALARMS_SHOWN]],
        }

    def _points(self, state: State | None) -> list[list[float]]:
        if state is None or not self._links:
            return []
        return [[round(float(v), 3) for v in point] for point in skeleton(self._links, state.q_meas)]


def conditions(seen: Glimpse) -> dict[str, Condition]:
    """What is wrong in a glimpse, by cause."""
    found: dict[str, Condition] = {}
    if seen.trouble is not None:
        found[seen.trouble[0]] = Condition(URGENT, seen.trouble[1])
    state = seen.state
    if state is not None and (
        state.group_state is GroupState.ERROR_STOP or state.fault is not FaultCode.NONE
    ):
        found[f"fault.{state.fault.name.lower()}"] = Condition(URGENT, FAULT_TEXTS[state.fault])
    if state is not None and not state.flags & FLAG_PLANT_LINK_OK:
        found["link.plant_silent"] = Condition(URGENT, "the controller does not hear the plant")
    if seen.camera.trouble is not None:
        age = "no picture yet" if seen.camera.age_ms is None else "no fresh picture"
        found[seen.camera.trouble] = Condition(HIGH, age)
    if not seen.recording:
        found["recording.unwritable"] = Condition(HIGH, "events cannot be recorded")
    if seen.overload:
        found["machine.overloaded"] = Condition(LOW, seen.overload)
    return found


def told_by(kind: str, result: Mapping[str, Any] | None) -> JSON | None:
    """What a finished operation told of where its drive would end, None where it told nothing."""
    if kind != "look-then-move" or result is None:
        return None
    steps = result.get("steps") or []
    predicted: JSON | None = result.get("seen") or (steps[-1]["expected"] if steps else None)
    return predicted


def ellipse_of(predicted: JSON | None) -> PredictedEllipse | None:
    """The ellipse of what was told."""
    if predicted is None:
        return None
    ellipse, mean = predicted["ellipse_95_mm"], predicted["mean_mm"]
    return PredictedEllipse(
        (1e-3 * mean["x"], 1e-3 * mean["y"]),
        1e-3 * ellipse["major"],
        1e-3 * ellipse["minor"],
        math.radians(ellipse["angle_deg"]),
    )
