"""The whole rig at a glance, as one document: what a console shows, gathered for all consoles at once."""

import math
from collections.abc import Mapping
from typing import Any

from foundation.incidents import ServiceIncident
from nominal_arm.dimensions import DhLink, skeleton
from protocol.errors import LinkLost
from protocol.faults import FAULT_TEXTS, FaultCode, GroupState
from protocol.reference_messages import FLAG_PLANT_LINK_OK, State
from vision_pc.application.application import VisionApplication
from vision_pc.application.console.alarms import CRASHED, HIGH, URGENT, AlarmList, Condition, alarm_json
from vision_pc.application.console.overlay import overlay
from vision_pc.application.reference_link import ReferenceLink
from vision_pc.application.results import JSON, calibration_json, look_json, pose_json

_ALARMS_SHOWN = 20
_ANEW = "the machine was started anew: local calibration and targets are void"


def session_state(link: ReferenceLink) -> tuple[State | None, LinkLost | None]:
    """The controller's newest state, or why there is none."""
    try:
        return link.state, None
    except LinkLost as error:
        return None, error


_BACK_S = 0.5  # no service is back sooner; what was on its way has come by then


def lasting(application: VisionApplication) -> list[ServiceIncident]:
    """The crashes that are not over, the newest of each service: nothing was heard of it since.

    Of a controller a state is heard, of a plant a picture; other crashes are over when they are told.
    """
    heard_s = {
        "controller": application.controller.heard_at_s,
        "plant": application.camera.status().heard_at_s,
    }
    return list(
        {
            incident.service: incident
            for incident in application.incidents()
            if heard_s.get(incident.service.partition("_")[0], math.inf) < incident.at_s + _BACK_S
        }.values()
    )


class Overview:
    """Makes the documents of one rig, and remembers alarms.

    ``anew_at``: when the machine has begun anew (s since 1970); what was found out before is void.
    """

    def __init__(self, links: tuple[DhLink, ...]) -> None:
        self.alarms = AlarmList()
        self._links = links
        self.anew_at: float | None = None
        self._times_anew = 0
        self._noted: set[ServiceIncident] = set()

    def note(self, now_s: float, rig: VisionApplication) -> None:
        """Take note of what is wrong at ``now_s``."""
        self.alarms.update(now_s, conditions(rig))
        if rig.times_anew != self._times_anew:
            self._times_anew, self.anew_at = rig.times_anew, now_s
            self.alarms.happened(now_s, "machine.begun_anew", _ANEW)
        incidents, present = rig.incidents(), lasting(rig)
        for incident in incidents:
            if incident not in self._noted and incident not in present:
                self.alarms.happened(incident.at_s, incident.cause, incident.detail, HIGH)
        self._noted = set(incidents)

    def document(self, rig: VisionApplication, predicted: JSON | None) -> JSON:
        """The rig as it is now; never raises, for it is asked when something is wrong.

        ``predicted``: that of the newest motion, where it still holds.
        """
        calibration = None
        if rig.calibration is not None:
            whole = calibration_json(rig.calibration)
            calibration = {name: whole[name] for name in ("method", "rotation_std_deg", "R_BC", "samples")}
        link, view, judged_by = rig.controller, rig.camera.seen(), rig.positioning
        (state, trouble), clock = session_state(rig.controller), link.session.clock
        clearance_m, tolerance_m = judged_by.clearance_m, judged_by.tolerance_m
        return {
            "link": {
                "age_ms": None if state is None else link.state_age_ns / 1e6,
                "round_trip_us": None if clock is None else clock.round_trip_ns / 1e3,
                "trouble": None if trouble is None else (trouble.cause, str(trouble)),
                "authenticated": link.session.authenticated,
                "tries_valves": link.tries_valves,
                "lost": link.session.statistics.lost,
            },
            "camera": rig.camera.status()._asdict(),
            "recording": rig.log.healthy,
            "skeleton": self._points(state),
            "home": None if link.home is None else pose_json(link.home),
            "look": None if rig.newest_look is None else look_json(rig.newest_look),
            "calibration": calibration,
            "tracked": rig.track is not None,
            "anew_at": self.anew_at,
            "tolerance_mm": 1e3 * tolerance_m,
            "overlay": None if view is None else overlay(view, clearance_m, tolerance_m, predicted),
            "alarms": [alarm_json(alarm) for alarm in self.alarms.rows[:_ALARMS_SHOWN]],
        }

    def _points(self, state: State | None) -> list[list[float]]:
        if state is None or not self._links:
            return []
        return [[round(float(v), 3) for v in point] for point in skeleton(self._links, state.q_meas)]


def conditions(rig: VisionApplication) -> dict[str, Condition]:
    """What is wrong now, by cause."""
    found: dict[str, Condition] = {}
    if crashed := lasting(rig):
        found[CRASHED] = Condition(URGENT, "; ".join(one.detail for one in crashed), crashed[-1].at_s)
    (state, trouble), camera, doubt = session_state(rig.controller), rig.camera.status(), rig.doubts.doubt
    if trouble is not None:
        found[trouble.cause] = Condition(URGENT, str(trouble))
    if state is not None and (
        state.group_state is GroupState.ERROR_STOP or state.fault is not FaultCode.NONE
    ):
        found[f"fault.{state.fault.name.lower()}"] = Condition(URGENT, FAULT_TEXTS[state.fault])
    if state is not None and not state.flags & FLAG_PLANT_LINK_OK:
        found["link.plant_silent"] = Condition(URGENT, "the controller does not hear the plant")
    if camera.trouble is not None:
        found[camera.trouble] = Condition(
            HIGH, "no picture yet" if camera.age_ms is None else "no fresh picture"
        )
    if doubt is not None:
        found["measurement.in_doubt"] = Condition(HIGH, str(doubt))
    if not rig.log.healthy:
        found["recording.unwritable"] = Condition(HIGH, "events cannot be recorded")
    return found


def predicted_by(kind: str, result: Mapping[str, Any] | None) -> JSON | None:
    """What a finished operation told of where its drive would end, None where it told nothing."""
    if kind != "look-then-move" or result is None:
        return None
    steps = result.get("steps") or []
    predicted: JSON | None = result.get("seen") or (steps[-1]["expected"] if steps else None)
    return predicted
