"""Controllers that move otherwise than they were asked to, and whose limits and times of motions are off.

Clauses 6.7 to 6.9, 7.3, 7.4 and 12. Where a limit is off its refusals still name the shipped one: a
controller with a narrower limit that it names is a sound one.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from controller.core.inbox import Inbox
from controller.core.settings import ScanSettings
from controller.core.trajectories.motion import holding
from protocol.axes_group import Mode
from protocol.faults import CommandCode, Reason
from protocol.reference_messages import (
    Acknowledgement,
    ReferencePath,
    ReferencePose,
    Request,
    State,
    StreamRefused,
)
from tests.conformance.controllers import settings
from tests.conformance.mutator import BrokenController, Make, hooked, reworked, says, takes

Named = Callable[[float], float]


def _given(factor: float, pose: ReferencePose) -> ReferencePose:
    return pose._replace(duration_s=pose.duration_s * factor) if 0.0 < pose.duration_s < 100.0 else pose


def _path(segment: float, dwell: float, path: ReferencePath) -> ReferencePath:
    return path._replace(segment_s=path.segment_s * segment, dwell_s=path.dwell_s * dwell)


def _hold(self: Any) -> None:
    desired, number = self.bench.state.motion.desired, self.bench.state.motion.motion_id
    self.bench.state = self.bench.state._replace(motion=holding(desired.p, desired.quaternion, number))


def _rests_at(at: Callable[[Request], bool]) -> Make:
    """Begins a new motion, or ends one, at rest: the speed has a step."""

    def judge(self: Any, request: Request) -> Request:
        if at(request) and self.bench.state.motion.path is not None:
            _hold(self)
        return request

    return hooked(judge=judge)


def _refusals_stop(self: Any, acknowledgement: Acknowledgement) -> list[Acknowledgement]:
    if acknowledgement.reason in (Reason.NOT_FINITE, Reason.TOO_FAR):
        _hold(self)
    return [acknowledgement]


class _Late(Inbox):
    """Keeps EMERGENCY_STOP for some scans."""

    scans = 12

    def __init__(self) -> None:
        super().__init__()
        self._kept: list[tuple[int, Request]] = []

    def take(self, link_alive: bool) -> tuple[tuple[Request, ...], bool]:
        taken, alive = super().take(link_alive)
        late = [r for r in taken if says(CommandCode.EMERGENCY_STOP, r)]
        self._kept = [(left - 1, each) for left, each in self._kept] + [(self.scans, each) for each in late]
        due = [each for left, each in self._kept if left <= 0]
        self._kept = [(left, each) for left, each in self._kept if left > 0]
        return (*(each for each in taken if each not in late), *due), alive


def _emergency_ramps(self: Any, state: State) -> State:
    """Goes on driving the valves for 100 ms after an emergency stop."""
    self.since = self.since + 1 if self.bench.state.mode is Mode.EMERGENCY else 0
    if not self.since:
        self.before = state.valves
    return state._replace(valves=self.before) if 0 < self.since < 20 else state


def _configured(configured: Callable[[], ScanSettings], named: dict[Reason, Named]) -> Make:
    """Runs with other settings; refusals for a reason in ``named`` name another limit than the one in use."""

    def renamed(refused: Any) -> Any:
        name = named.get(refused.reason)
        return refused if name is None else refused._replace(limit=name(refused.limit))

    return hooked(
        configured=lambda _: configured(),
        answered=lambda _, answer: [renamed(answer)],
        outgoing=lambda _, data: [reworked(data, StreamRefused, renamed)],
    )


def reconfigured(configured: Callable[[], ScanSettings], **named: Named) -> Make:
    """Runs with other settings; refusals for a reason name another limit than the one in use."""
    return _configured(configured, {Reason[reason]: limit for reason, limit in named.items()})


def other_settings(override: str, **named: Named) -> Make:
    """The same, of one override of the controller's."""
    return reconfigured(partial(settings, f"controller.{override}"), **named)


def named_always(limit: float) -> Named:
    """Names one limit, whatever it is."""
    return lambda _: limit


def named_one_of(*pairs: tuple[float, float]) -> Named:
    """Names the second of a pair for the first, and others as they are."""
    return lambda limit: next((said for used, said in pairs if math.isclose(used, limit)), limit)


def _motions() -> Iterator[tuple[str, str, int, Make]]:
    for factor in (0.5, 0.9, 1.1, 2.0):
        make = takes(ReferencePose, partial(_given, factor))
        yield f"a motion takes {factor:g} of its time", "6.7", 558, make
    leisurely = takes(ReferencePose, lambda pose: pose._replace(duration_s=pose.duration_s or 3.0))
    yield "a time of 0 is 3 s", "6.7", 559, leisurely
    for segment, dwell in ((2.0, 1.0), (0.7, 1.0), (1.0, 2.0), (1.0, 0.5), (1.0, 0.0)):
        make = takes(ReferencePath, partial(_path, segment, dwell))
        yield f"segments of {segment:g}, dwells of {dwell:g}", "6.8", 557, make
    for name, part in (("straight to the last", slice(-1, None)), ("backwards", slice(None, None, -1))):
        make = takes(ReferencePath, lambda path, part=part: path._replace(waypoints=path.waypoints[part]))
        yield f"a path goes {name}", "6.8", 532, make
    refers = _rests_at(lambda request: isinstance(request, ReferencePose))
    yield "a new motion begins at rest", "6.9", 560, refers
    for code, case in ((CommandCode.STOP, 570), (CommandCode.DISABLE, 569)):
        yield f"{code.name} ends at once", "7.3", case, _rests_at(partial(says, code))
    yield "refusals stop", "6.9", 568, hooked(answered=_refusals_stop)
    yield "takes 60 ms to an emergency stop", "7.4", 571, hooked(make_inbox=lambda _: _Late())
    yield "an emergency stop ramps", "7.4", 571, hooked(since=0, before=(0.0,) * 6, shown=_emergency_ramps)


def _times() -> Iterator[tuple[str, str, int, Make]]:
    for key, values in (
        ("silence_ms", ((50, 572), (70, 572), (120, 572), (200, 572), (900, 572))),
        ("ramp_ms", ((2.0, 572), (72, 573))),
        ("first_reference_ms", ((500, 574), (2000, 574), (5000, 574))),
        ("recovery_ms", ((200, 575), (1000, 575))),
    ):
        for value, case in values:
            yield f"{key} of {value}", "12.8", case, other_settings(f"streaming.{key}={value}")


def _stream_limits() -> Iterator[tuple[str, str, int, Make]]:
    degree = math.pi / 180.0
    for factor in (0.5, 0.9, 1.1, 2.0):
        far, turn = named_one_of((0.5 * factor, 0.5)), named_one_of((30.0 * factor * degree, 30.0 * degree))
        for what, clause, case, make in (
            ("distance", "12.4", 581, other_settings(f"streaming.distance_m={0.5 * factor}", TOO_FAR=far)),
            ("angle", "12.4", 582, other_settings(f"streaming.turn_deg={30.0 * factor}", TOO_FAR=turn)),
            (
                "age",
                "12.6",
                584,
                other_settings(f"streaming.max_age_ms={250.0 * factor}", STALE=named_always(0.25)),
            ),
        ):
            yield f"{what} of {factor:g} of its limit", clause, case, make
        for name, value in (("speed_m_s", 0.25), ("turn_speed_deg_s", 12.0)):
            make = other_settings(f"streaming.{name}={value * factor}", TOO_FAST=lambda x, f=factor: x / f)
            yield f"stream {name} of {factor:g} of its limit", "12.4", 583, make
    cases = {"distance_m=5.0": 581, "turn_deg=90.0": 582, "max_age_ms=4000.0": 584, "speed_m_s=1.0": 583}
    for what, case in cases.items():
        yield f"streaming {what}, and names it", "12.4", case, other_settings(f"streaming.{what}")
    for what in ("acceleration_m_s2=0.7", "acceleration_m_s2=3.0", "jerk_m_s3=6.0", "jerk_m_s3=100.0"):
        yield f"streaming {what}", "12.7", 579, other_settings(f"streaming.{what}")


def lower_floor(metres: float) -> ScanSettings:
    sound = settings()
    box = sound.planning.workspace.box.copy()
    box[2, 0] += metres
    space = sound.planning.workspace._replace(box=box)
    return replace(sound, planning=sound.planning._replace(workspace=space))


def _wider_joint(radians: float) -> ScanSettings:
    sound = settings()
    bounds = np.array(sound.planning.planned_range)
    bounds[:, 5] += (-radians, radians)
    return replace(sound, planning=sound.planning._replace(planned_range=bounds))


def _motion_limits() -> Iterator[tuple[str, str, int, Make]]:
    sound = settings()
    motion, first = sound.motion, sound.motion.first_point_distance
    for factor in (0.5, 0.9, 1.1, 2.0):
        for key, limit in (("duration_min_s", motion.duration_min), ("duration_max_s", motion.duration_max)):
            make = other_settings(
                f"motion.{key}={limit * factor}", BAD_DURATION=named_one_of((limit * factor, limit))
            )
            yield f"{key} of {factor:g} of its limit", "6.7", 561, make
            yield f"{key} of {factor:g} of its limit, paths", "6.8", 562, make
        make = other_settings(f"motion.first_point_distance_m={first * factor}", TOO_FAR=named_always(first))
        yield f"first pose of {factor:g} of its limit", "6.9", 564, make
        for key, case in (("acceleration_m_s2", 563),):
            make = other_settings(
                f"motion.{key}={0.25 * factor}", TOO_FAST=named_one_of((0.25 * factor, 0.25))
            )
            yield f"{key} of {factor:g} of its limit", "6.9", case, make
    for factor in (0.5, 2.0):
        make = other_settings(f"motion.singular_value_min={0.05 * factor}", SINGULAR=named_always(0.05))
        yield f"singular value of {factor:g} of its limit", "6.9", 567, make
    for metres in (-0.3, -0.05, 0.05, 0.3):
        floor = named_always(float(sound.planning.workspace.box[2, 0]))
        make = _configured(partial(lower_floor, metres), {Reason.OUTSIDE_WORKSPACE: floor})
        yield f"workspace off by {metres:g} m", "6.9", 565, make
    for radians in (-0.2, -0.03, 0.03, 0.2):
        low, high = map(float, sound.planning.planned_range[:, 5])
        named = named_one_of((low - radians, low), (high + radians, high))
        make = _configured(partial(_wider_joint, radians), {Reason.JOINT_LIMIT: named})
        yield f"joint range off by {radians:g} rad", "6.9", 566, make


MUTANTS = tuple(
    BrokenController(name, clause, make, case=case)
    for name, clause, case, make in (*_motions(), *_times(), *_stream_limits(), *_motion_limits())
)
