"""What the console shows of any moment of a recording: the same document as the vision PC's own."""

from typing import Any, NamedTuple

import numpy as np

from nominal_arm.dimensions import dh_links
from protocol.reference_messages import State
from testbed.recordings.console.timeline import Timeline
from testbed.reporting.console import plain
from vision_pc.application.console.advice import advice
from vision_pc.application.console.alarms import LOW, AlarmList
from vision_pc.application.console.overview import Glimpse, Overview, conditions, ellipse_of, told_by
from vision_pc.application.ports import CameraStatus, Seen
from vision_pc.application.results import JSON, JudgedLook
from vision_pc.core.perception.intrinsics import calibration
from vision_pc.core.positioning.look_then_move import judge
from vision_pc.core.types import FrameObservation, MarkerObservation
from vision_pc.shell.recording import vision_messages as own
from vision_pc.shell.recording.read_messages import look_of_message
from vision_pc.shell.rest.state_view import arm_json

_OPERATIONS_SHOWN = 8
_CALIBRATION = ("method", "rotation_std_deg", "R_BC", "samples")
_COUNTED = ("overruns", "lateness_p50_us", "lateness_p99_us", "lateness_max_us")
_UNKNOWN = np.full((4, 4), np.nan)


class ShownOperation(NamedTuple):
    """An operation from its first event to its last. Progress and notes between are not recorded."""

    number: str
    kind: str
    begun_ns: int
    ended_ns: int | None = None
    state: str = "running"
    result: Any = None
    cause: str | None = None
    detail: str = ""


class Moments:
    """The documents of a recording. Times are on vision's clock; those told are seconds since its first."""

    def __init__(self, timeline: Timeline) -> None:
        self._of = timeline
        config = timeline.recording.config
        self._positioning, self._tool_id = config.programs.positioning, config.markers.tool.id
        self._camera = calibration(config.camera)
        self._overview = Overview(dh_links(timeline.recording.arm))
        self.operations = _operations(timeline)
        self._changes = self._noted()
        if timeline.states.times_ns:
            self._overview.note(0.0, self._glimpse(timeline.states.times_ns[0]))

    def document(self, time_ns: int) -> JSON:
        """All that the console shows of ``time_ns`` but for the transport."""
        seen = self._glimpse(time_ns)
        begun = [each for each in self.operations if each.begun_ns <= time_ns]
        shown = [self._operation(each, time_ns) for each in begun[-_OPERATIONS_SHOWN:]]
        ended = {each.number: each for each in begun if _ended(each, time_ns)}
        moving = [each for each in begun if each.kind != "look"]
        told = told_by(moving[-1].kind, moving[-1].result) if moving and moving[-1].number in ended else None
        self._overview.alarms = self._alarms(time_ns)
        document = self._overview.document(seen, ellipse_of(told))
        document["calibration"] = _calibration(list(ended.values()))
        document["link"] |= {"authenticated": None, "lost": None, "age_ms": None}
        look_at = self._of.looks.count(time_ns)
        return document | {
            "time": self.seconds(time_ns),
            "state": None if seen.state is None else _state_json(seen.state),
            "operations": shown,
            "told": told,
            "looked_at": self.seconds(self._of.looks.times_ns[look_at - 1]) if look_at else None,
        }

    def result(self, number: str, time_ns: int) -> JSON | None:
        """An operation's result, once it has ended by ``time_ns``."""
        found = (each for each in self.operations if each.number == number and _ended(each, time_ns))
        return next(({"id": each.number, "result": each.result} for each in found), None)

    def seconds(self, time_ns: int) -> float:
        """A time as seconds since the recording's first."""
        return round(1e-9 * (time_ns - self._of.first_ns), 3)

    def _glimpse(self, time_ns: int) -> Glimpse:
        frame = self._of.frames.newest(time_ns)
        age_ms = None if frame is None else 1e-6 * (time_ns - frame.capture_ns)
        return Glimpse(
            state=self._of.state(time_ns),
            state_age_ms=None,
            round_trip_us=None,
            trouble=None,
            authenticated=False,
            tries_valves=False,
            datagrams_lost=0,
            camera=CameraStatus(True, age_ms, self._of.frames.count(time_ns), 0.0),
            recording=True,
            overload="",
            seen=self._seen(time_ns),
            look=self._look(time_ns),
            calibration=None,
            tracked=any(
                each.kind == "local-track" and each.state == "succeeded" and _ended(each, time_ns)
                for each in self.operations
            ),
            clearance_m=self._positioning.clearance_m,
            tolerance_m=self._positioning.tolerance_m,
        )

    def _look(self, time_ns: int) -> JudgedLook | None:
        data = self._of.looks.newest(time_ns)
        if data is None:
            return None
        look = look_of_message(own.LookMessage.FromString(data))
        return JudgedLook(look, judge(look, self._positioning))

    def _seen(self, time_ns: int) -> Seen | None:
        data = self._of.observations.newest(time_ns)
        if data is None:
            return None
        said = own.ObservationMessage.FromString(data)
        corners = np.reshape(said.corners_left_px, (-1, 4, 2))
        markers = tuple(
            MarkerObservation(
                number, np.nan, corners[index], None, _UNKNOWN, np.full((6, 6), np.nan), px, 0.0
            )
            for index, (number, px) in enumerate(zip(said.marker_ids, said.marker_residuals_px, strict=True))
        )
        X_CM, X_CO = (np.reshape(X, (4, 4)) if X else None for X in (said.X_CM, said.X_CO))
        observation = FrameObservation(
            said.capture_ns, said.frame_id, X_CM, None, None, X_CO, None, None, markers, {}, None,
            said.missing_tool or None, said.missing_object or None,
        )  # fmt: skip
        return Seen(observation, self._camera, self._tool_id)

    def _operation(self, each: ShownOperation, time_ns: int) -> JSON:
        over = _ended(each, time_ns)
        return {
            "id": each.number,
            "kind": each.kind,
            "state": each.state if over else "running",
            "progress": None,
            "note": each.detail if over else "running",
            "started_at": self.seconds(each.begun_ns),
            "ended_at": self.seconds(each.ended_ns) if over and each.ended_ns is not None else None,
            "cause": each.cause if over else None,
            "advice": advice(each.cause) if over and each.cause else None,
        }

    def _noted(self) -> list[tuple[int, Any]]:
        """When what is wrong changed: its conditions; and operations that failed."""
        found: list[tuple[int, Any]] = []
        known: Any = None
        for time_ns in self._of.states.times_ns:
            wrong = conditions(self._glimpse(time_ns)._replace(seen=None, look=None))
            if wrong != known:
                found.append((time_ns, wrong))
                known = wrong
        failed = [each for each in self.operations if each.state == "failed" and each.ended_ns is not None]
        found += [(each.ended_ns, each) for each in failed if each.ended_ns is not None]
        return sorted(found, key=lambda each: each[0])

    def _alarms(self, time_ns: int) -> AlarmList:
        alarms = AlarmList()
        for at_ns, what in self._changes:
            if at_ns > time_ns:
                break
            if isinstance(what, ShownOperation):
                told = f"{what.kind}: {what.detail}"
                alarms.happened(self.seconds(at_ns), what.cause or "unknown", told, LOW)
            else:
                alarms.update(self.seconds(at_ns), what)
        return alarms


def _ended(each: ShownOperation, time_ns: int) -> bool:
    return each.ended_ns is not None and each.ended_ns <= time_ns


def _calibration(ended: list[ShownOperation]) -> JSON | None:
    done = [
        each.result
        for each in ended
        if each.kind == "trajectory-matching" and each.state == "succeeded" and each.result
    ]
    return {name: done[-1].get(name) for name in _CALIBRATION} if done else None


def _state_json(state: State) -> JSON:
    """The state as the API shows it; what was not recorded is None."""
    shown = arm_json(state)
    shown["cycle"] |= dict.fromkeys(_COUNTED)
    shown |= {"references_lost": None, "references_dropped": None}
    made: JSON = plain(shown)
    return made


def _operations(timeline: Timeline) -> list[ShownOperation]:
    """All of them, by their events: those behind the API have ids, in lockstep they follow each other."""
    found: dict[str, ShownOperation] = {}
    newest = ""
    for time_ns, said in zip(timeline.events.times_ns, timeline.events.items, strict=True):
        name = said["event"]
        if name in ("operation_queued", "operation"):
            newest = str(said.get("id", len(found) + 1))
            found[newest] = ShownOperation(newest, said["kind"], time_ns)
        elif name in ("operation_ended", "operation_failed"):
            begun = found.get(str(said.get("id", newest)))
            if begun is not None:
                found[begun.number] = _over(begun, said, time_ns)
    return list(found.values())


def _over(begun: ShownOperation, said: dict[str, Any], time_ns: int) -> ShownOperation:
    problem = said.get("problem") or {}
    failed = said["event"] == "operation_failed"
    cause = said.get("cause") or problem.get("cause")
    return begun._replace(
        ended_ns=time_ns,
        state=said.get("state") or ("failed" if failed else "succeeded"),
        result=said.get("result"),
        cause=cause,
        detail=problem.get("detail") or cause or "",
    )
