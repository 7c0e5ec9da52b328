"""Controllers whose limits and times of motions and streams are off, or that follow references otherwise.

Clauses 6.6 to 6.9, 7.4 and 12. Where a limit is off its refusals still name the shipped one: a controller
with a narrower limit that it names is a sound one.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from controller.core.group_states import TRANSITIONS, Stimulus
from controller.core.inbox import Inbox
from controller.core.settings import ScanSettings
from controller.core.trajectories.motion import holding
from protocol.axes_group import Mode
from protocol.faults import CommandCode, Reason
from protocol.reference_messages import (
    Acknowledgement,
    Command,
    ReferencePath,
    ReferencePose,
    Request,
    State,
    StreamedPose,
    StreamRefused,
)
from protocol.session_events import ServerEvent, StreamedPoseReceived
from tests.conformance.controllers import ControllerUnderTest, settings
from tests.conformance.mutant_report import BrokenController
from tests.conformance.mutants.breaking import reworked

Make = Callable[[], ControllerUnderTest]


class OfOtherSettings(ControllerUnderTest):
    """Runs with other settings; refusals for ``reason`` name ``limit`` instead of the limit in use."""

    def __init__(
        self, configured: Callable[[], ScanSettings], named: dict[Reason, Callable[[float], float]]
    ) -> None:
        self._other = configured
        self._named = named
        super().__init__()

    def configured(self) -> ScanSettings:
        return self._other()

    def answered(self, acknowledgement: Acknowledgement) -> list[Acknowledgement]:
        name = self._named.get(acknowledgement.reason)
        if name is None:
            return [acknowledgement]
        return [acknowledgement._replace(limit=name(acknowledgement.limit))]

    def outgoing(self, data: bytes) -> list[bytes]:
        def renamed(refused: StreamRefused) -> StreamRefused:
            name = self._named.get(refused.reason)
            return refused if name is None else refused._replace(limit=name(refused.limit))

        return [reworked(data, StreamRefused, renamed)]


def _other(override: str, **named: Callable[[float], float]) -> Make:
    names = {Reason[reason]: limit for reason, limit in named.items()}
    return partial(OfOtherSettings, partial(settings, f"controller.{override}"), names)


def _always(limit: float) -> Callable[[float], float]:
    return lambda _: limit


def _one_of(*pairs: tuple[float, float]) -> Callable[[float], float]:
    """Names the second of a pair for the first, and others as they are."""
    return lambda limit: next((said for used, said in pairs if math.isclose(used, limit)), limit)


def _times() -> Iterator[BrokenController]:
    for silence_ms in (50, 70, 120, 200, 900):
        make = _other(f"streaming.silence_ms={silence_ms}")
        yield BrokenController(f"silence_ms of {silence_ms}", "12.8", make, case=572)
    for ramp_ms, case in ((2.0, 572), (72, 573)):
        yield BrokenController(
            f"ramp_ms of {ramp_ms}", "12.8", _other(f"streaming.ramp_ms={ramp_ms}"), case=case
        )
    for first_ms in (500, 2000, 5000):
        make = _other(f"streaming.first_reference_ms={first_ms}")
        yield BrokenController(f"first_reference_ms of {first_ms}", "12.8", make, case=574)
    unseen = "to slow down 12 ms early costs a hundredth of a millimetre"
    yield BrokenController("ramp_ms of 24", "12.8", _other("streaming.ramp_ms=24"), unseen=unseen)
    for recovery_ms in (200, 1000):
        make = _other(f"streaming.recovery_ms={recovery_ms}")
        yield BrokenController(f"recovery_ms of {recovery_ms}", "12.8", make, case=575)
    unseen = "back at full pace sooner: what is bounded is how late"
    yield BrokenController("recovery_ms of 50", "12.8", _other("streaming.recovery_ms=50"), unseen=unseen)


def _stream_limits() -> Iterator[BrokenController]:
    degree = math.pi / 180.0
    for factor in (0.5, 0.9, 1.1, 2.0):
        far = _one_of((0.5 * factor, 0.5))
        make = _other(f"streaming.distance_m={0.5 * factor}", TOO_FAR=far)
        yield BrokenController(f"distance of {factor:g} of its limit", "12.4", make, case=581)
        turn = _one_of((30.0 * factor * degree, 30.0 * degree))
        make = _other(f"streaming.turn_deg={30.0 * factor}", TOO_FAR=turn)
        yield BrokenController(f"angle of {factor:g} of its limit", "12.4", make, case=582)
        make = _other(f"streaming.max_age_ms={250.0 * factor}", STALE=_always(0.25))
        yield BrokenController(f"age of {factor:g} of its limit", "12.6", make, case=584)
        for axes in ("speed_m_s=0.25", "turn_speed_deg_s=12.0"):
            name, _, value = axes.partition("=")
            make = _other(f"streaming.{name}={float(value) * factor}", TOO_FAST=lambda x, f=factor: x / f)
            yield BrokenController(f"stream {name} of {factor:g} of its limit", "12.4", make, case=583)
    for what in ("distance_m=5.0", "turn_deg=90.0", "max_age_ms=4000.0", "speed_m_s=1.0"):
        case = {"distance_m": 581, "turn_deg": 582, "max_age_ms": 584, "speed_m_s": 583}[
            what.partition("=")[0]
        ]
        yield BrokenController(
            f"streaming {what}, and names it", "12.4", _other(f"streaming.{what}"), case=case
        )
    for what in ("acceleration_m_s2=0.7", "acceleration_m_s2=3.0", "jerk_m_s3=6.0", "jerk_m_s3=100.0"):
        yield BrokenController(f"streaming {what}", "12.7", _other(f"streaming.{what}"), case=579)


def _lower_floor(metres: float) -> ScanSettings:
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


def _motion_limits() -> Iterator[BrokenController]:
    sound = settings()
    least, most, first = (
        sound.motion.duration_min,
        sound.motion.duration_max,
        sound.motion.first_point_distance,
    )
    for factor in (0.5, 0.9, 1.1, 2.0):
        for key, limit in (("duration_min_s", least), ("duration_max_s", most)):
            make = _other(f"motion.{key}={limit * factor}", BAD_DURATION=_one_of((limit * factor, limit)))
            yield BrokenController(f"{key} of {factor:g} of its limit", "6.7", make, case=561)
            yield BrokenController(f"{key} of {factor:g} of its limit, paths", "6.8", make, case=562)
        make = _other(f"motion.first_point_distance_m={first * factor}", TOO_FAR=_always(first))
        yield BrokenController(f"first pose of {factor:g} of its limit", "6.9", make, case=564)
        for key, limit in (("speed_m_s", 0.25), ("acceleration_m_s2", 0.25)):
            bounds = _one_of((limit * factor, limit))
            make = _other(f"motion.{key}={limit * factor}", TOO_FAST=bounds)
            unseen = "60 mm are too short a way to reach it" if key == "speed_m_s" else ""
            yield BrokenController(
                f"{key} of {factor:g} of its limit", "6.9", make, unseen=unseen, case=0 if unseen else 563
            )
    for factor in (0.5, 2.0):
        make = _other(f"motion.singular_value_min={0.05 * factor}", SINGULAR=_always(0.05))
        yield BrokenController(f"singular value of {factor:g} of its limit", "6.9", make, case=567)
    for metres in (-0.3, -0.05, 0.05, 0.3):
        floor = float(sound.planning.workspace.box[2, 0])
        make = partial(
            OfOtherSettings, partial(_lower_floor, metres), {Reason.OUTSIDE_WORKSPACE: _always(floor)}
        )
        yield BrokenController(f"workspace off by {metres:g} m", "6.9", make, case=565)
    for radians in (-0.2, -0.03, 0.03, 0.2):
        bounds = sound.planning.planned_range[:, 5]
        named = _one_of(
            *((float(b + s * radians), float(b)) for b, s in zip(bounds, (-1.0, 1.0), strict=True))
        )
        make = partial(OfOtherSettings, partial(_wider_joint, radians), {Reason.JOINT_LIMIT: named})
        yield BrokenController(f"joint range off by {radians:g} rad", "6.9", make, case=566)


class OtherRequests(ControllerUnderTest):
    """Takes references for other ones."""

    def __init__(self, other: Callable[[Any], Any], kind: type) -> None:
        super().__init__()
        self._other, self._kind = other, kind

    def judge(self, request: Request) -> Request:
        return self._other(request) if isinstance(request, self._kind) else request


def _given(factor: float, pose: ReferencePose) -> ReferencePose:
    usable = 0.0 < pose.duration_s < 100.0
    return pose._replace(duration_s=pose.duration_s * factor) if usable else pose


def _leisurely(pose: ReferencePose) -> ReferencePose:
    return pose._replace(duration_s=3.0) if pose.duration_s == 0.0 else pose


def _path(segment: float, dwell: float, path: ReferencePath) -> ReferencePath:
    return path._replace(segment_s=path.segment_s * segment, dwell_s=path.dwell_s * dwell)


def _straight_to_the_last(path: ReferencePath) -> ReferencePath:
    return path._replace(waypoints=path.waypoints[-1:])


def _backwards(path: ReferencePath) -> ReferencePath:
    return path._replace(waypoints=path.waypoints[::-1])


class RestsBetween(ControllerUnderTest):
    """Begins a new motion, or ends one, at rest: the speed has a step."""

    def __init__(self, at: Callable[[Request], bool]) -> None:
        super().__init__()
        self._at = at

    def judge(self, request: Request) -> Request:
        motion = self.bench.state.motion
        if self._at(request) and motion.path is not None:
            held = holding(motion.desired.p, motion.desired.quaternion, motion.motion_id)
            self.bench.state = self.bench.state._replace(motion=held)
        return request


def _refers(request: Request) -> bool:
    return isinstance(request, ReferencePose)


def _says(code: CommandCode, request: Request) -> bool:
    return isinstance(request, Command) and request.code is code


class RefusalsStop(ControllerUnderTest):
    """Ends the motion that is followed when a reference is refused."""

    def answered(self, acknowledgement: Acknowledgement) -> list[Acknowledgement]:
        if acknowledgement.reason in (Reason.NOT_FINITE, Reason.TOO_FAR):
            motion = self.bench.state.motion
            held = holding(motion.desired.p, motion.desired.quaternion, motion.motion_id)
            self.bench.state = self.bench.state._replace(motion=held)
        return [acknowledgement]


class _Late(Inbox):
    """Keeps EMERGENCY_STOP for some scans."""

    scans = 12

    def __init__(self) -> None:
        super().__init__()
        self._kept: list[tuple[int, Request]] = []

    def take(self, link_alive: bool) -> tuple[tuple[Request, ...], bool]:
        taken, alive = super().take(link_alive)
        late = [r for r in taken if _says(CommandCode.EMERGENCY_STOP, r)]
        self._kept = [(left - 1, each) for left, each in self._kept] + [(self.scans, each) for each in late]
        due = [each for left, each in self._kept if left <= 0]
        self._kept = [(left, each) for left, each in self._kept if left > 0]
        return (*(each for each in taken if each not in late), *due), alive


class LateEmergency(ControllerUnderTest):
    """Takes 60 ms to an emergency stop."""

    def make_inbox(self) -> Inbox:
        return _Late()


class EmergencyRamps(ControllerUnderTest):
    """Goes on driving the valves for 100 ms after an emergency stop."""

    since, before = 0, (0.0,) * 6

    def shown(self, state: State) -> State:
        self.since = self.since + 1 if self.bench.state.mode is Mode.EMERGENCY else 0
        if not self.since:
            self.before = state.valves
        return state._replace(valves=self.before) if 0 < self.since < 20 else state


def _motions() -> Iterator[BrokenController]:
    for factor in (0.5, 0.9, 1.1, 2.0):
        make: Make = partial(OtherRequests, partial(_given, factor), ReferencePose)
        yield BrokenController(f"a motion takes {factor:g} of its time", "6.7", make, case=558)
    make = partial(OtherRequests, _leisurely, ReferencePose)
    yield BrokenController("a time of 0 is 3 s", "6.7", make, case=559)
    for segment, dwell in ((2.0, 1.0), (0.7, 1.0), (1.0, 2.0), (1.0, 0.5), (1.0, 0.0)):
        make = partial(OtherRequests, partial(_path, segment, dwell), ReferencePath)
        yield BrokenController(f"segments of {segment:g}, dwells of {dwell:g}", "6.8", make, case=557)
    for other in (_straight_to_the_last, _backwards):
        name = f"a path goes{other.__name__.replace('_', ' ')}"
        yield BrokenController(name, "6.8", partial(OtherRequests, other, ReferencePath), case=532)
    yield BrokenController("a new motion begins at rest", "6.9", partial(RestsBetween, _refers), case=560)
    for code in (CommandCode.STOP, CommandCode.DISABLE):
        make = partial(RestsBetween, partial(_says, code))
        yield BrokenController(
            f"{code.name} ends at once", "7.3", make, case=570 if code is CommandCode.STOP else 569
        )
    for broken, clause, case in (
        (RefusalsStop, "6.9", 568),
        (LateEmergency, "7.4", 571),
        (EmergencyRamps, "7.4", 571),
    ):
        yield BrokenController(broken.__name__, clause, broken, case=case)


class OtherReferences(ControllerUnderTest):
    """Takes streamed references for other ones."""

    def __init__(self, other: Callable[[StreamedPoseReceived], StreamedPoseReceived]) -> None:
        super().__init__()
        self._other = other

    def judge_streamed(self, arrival: StreamedPoseReceived) -> StreamedPoseReceived:
        return self._other(arrival)


def _twisted(linear: float, angular: float, arrival: StreamedPoseReceived) -> StreamedPoseReceived:
    vx, vy, vz, wx, wy, wz = arrival.message.twist_ref
    if max(map(abs, arrival.message.twist_ref)) > 0.1:
        return arrival
    twist = (vx * linear, vy * linear, vz * linear, wx * angular, wy * angular, wz * angular)
    return arrival._replace(message=arrival.message._replace(twist_ref=twist))


def _shuffled(arrival: StreamedPoseReceived) -> StreamedPoseReceived:
    vx, vy, vz, wx, wy, wz = arrival.message.twist_ref
    return arrival._replace(message=arrival.message._replace(twist_ref=(vz, vx, vy, wz, wx, wy)))


def _of_now(arrival: StreamedPoseReceived) -> StreamedPoseReceived:
    return arrival._replace(measured_ns=max(arrival.measured_ns, arrival.left_ns))


class JudgesInAnotherOrder(ControllerUnderTest):
    """Refuses for ``second`` what should be refused for ``first``, when it breaks both rules."""

    def __init__(self, first: Reason, second: Reason) -> None:
        super().__init__()
        self._first, self._second = first, second
        self._last: StreamedPose | None = None

    def judge_streamed(self, arrival: StreamedPoseReceived) -> StreamedPoseReceived:
        self._last = arrival.message
        return arrival

    def outgoing(self, data: bytes) -> list[bytes]:
        def swapped(refused: StreamRefused) -> StreamRefused:
            both = refused.reason is self._first and self._breaks()
            return refused._replace(reason=self._second) if both else refused

        return [reworked(data, StreamRefused, swapped)]

    def _breaks(self) -> bool:
        message, stream = self._last, self.bench.state.stream
        assert message is not None
        pose = message.X_BT_ref
        rules = {
            Reason.OVERTAKEN: stream is not None and message.number == stream.number,
            Reason.STALE: self._clock_ns() - message.time_ns > 10**9,
            Reason.NOT_FINITE: not pose.is_finite(),
            Reason.NOT_UNIT_QUATERNION: abs(pose.quaternion_norm() - 1.0) > 1e-3,
            Reason.TOO_FAST: max(map(abs, message.twist_ref)) > 1.0,
            Reason.TOO_FAR: abs(pose.p_m[2]) > 50.0,
        }
        return rules[self._second]


ORDER = (
    Reason.NOT_STREAMING,
    Reason.OVERTAKEN,
    Reason.STALE,
    Reason.NOT_FINITE,
    Reason.NOT_UNIT_QUATERNION,
    Reason.TOO_FAST,
    Reason.TOO_FAR,
)


class RefusedTakesItsNumber(ControllerUnderTest):
    """Counts a refused reference as the newest."""

    number = 0

    def judge_streamed(self, arrival: StreamedPoseReceived) -> StreamedPoseReceived:
        self.number = arrival.message.number
        return arrival

    def _scan(self) -> None:
        super()._scan()
        stream = self.bench.state.stream
        if stream is not None and self.number:
            self.bench.state = self.bench.state._replace(stream=stream._replace(number=self.number))


class RefusedIsFresh(ControllerUnderTest):
    """Takes a reference that it refuses for a sign of life."""

    came = False

    def judge_streamed(self, arrival: StreamedPoseReceived) -> StreamedPoseReceived:
        self.came = True
        return arrival

    def _scan(self) -> None:
        stream = self.bench.state.stream
        if stream is not None and self.came:
            fresh = stream._replace(fresh_ns=self._clock_ns())
            self.bench.state = self.bench.state._replace(stream=fresh)
        self.came = False
        super()._scan()


class AnswersTheSuperseded(ControllerUnderTest):
    """Refuses those of a burst that it does not judge."""

    waits: StreamedPose | None = None

    def judge_streamed(self, arrival: StreamedPoseReceived) -> StreamedPoseReceived:
        if self.waits is not None:
            refused = StreamRefused(self.waits.stream_id, self.waits.number, Reason.OVERTAKEN, 0.0, 0.0)
            self.server.refuse_streamed(refused, self._clock_ns())
        self.waits = arrival.message
        return arrival

    def _scan(self) -> None:
        super()._scan()
        self.waits = None


class _KeepsTheFirst(Inbox):
    def put(self, events: list[ServerEvent]) -> list[Acknowledgement]:
        first = self._streamed
        refused = super().put(events)
        if first is not None and self._streamed is not None:
            self._streamed = first
        came = [each for each in events if isinstance(each, StreamedPoseReceived)]
        if first is None and came and self._streamed is not None:
            self._streamed = came[0]
        return refused


class FollowsTheOldest(ControllerUnderTest):
    """Of a burst follows the first."""

    def make_inbox(self) -> Inbox:
        return _KeepsTheFirst()


class WantsEveryNumber(ControllerUnderTest):
    """Refuses a number that is not the next one."""

    def judge_streamed(self, arrival: StreamedPoseReceived) -> StreamedPoseReceived:
        stream = self.bench.state.stream
        if stream is None or stream.goal is None or (arrival.message.number - stream.number) % 2**32 < 9:
            return arrival
        return arrival._replace(message=arrival.message._replace(number=stream.number))


class EndsWhereItIs(ControllerUnderTest):
    """END_STREAM stops, instead of going on to the newest reference."""

    def _scan(self) -> None:
        before = self.bench.state.mode
        super()._scan()
        state = self.bench.state
        if before is Mode.STREAMING and state.mode is Mode.MOVING:
            held = holding(state.motion.desired.p, state.motion.desired.quaternion, state.motion.motion_id)
            self.bench.state = state._replace(motion=held._replace(done=True))


class GoesOnWithTheTwist(ControllerUnderTest):
    """After END_STREAM goes on to where the reference would be half a second later."""

    def judge(self, request: Request) -> Request:
        stream = self.bench.state.stream
        if _says(CommandCode.END_STREAM, request) and stream is not None and stream.goal is not None:
            goal = stream.goal._replace(p=stream.goal.p + 0.5 * self.bench.state.motion.desired.v)
            self.bench.state = self.bench.state._replace(stream=stream._replace(goal=goal))
        return request


class IsNotDoneWithoutReference(ControllerUnderTest):
    """A stream that is ended without a reference is never done."""

    empty = False

    def judge(self, request: Request) -> Request:
        stream = self.bench.state.stream
        if _says(CommandCode.END_STREAM, request):
            self.empty = stream is None or stream.goal is None
        return request

    def shown(self, state: State) -> State:
        return state._replace(motion_done=state.motion_done and not self.empty)


class LosesTheStreamAtOnce(ControllerUnderTest):
    """The end of a session ends a stream without its fault."""

    def _scan(self) -> None:
        cell = Mode.STREAMING, Stimulus.UNATTENDED
        right = TRANSITIONS[cell]
        TRANSITIONS[cell] = right._replace(mode=Mode.DISABLING)
        try:
            super()._scan()
        finally:
            TRANSITIONS[cell] = right


class IsKeptAlive(ControllerUnderTest):
    """Takes the end of a session for no reason to stop a stream."""

    def _scan(self) -> None:
        stream = self.bench.state.stream
        if stream is not None and not stream.attended:
            fresh = stream._replace(fresh_ns=self._clock_ns())
            self.bench.state = self.bench.state._replace(stream=fresh)
        super()._scan()


def _streams() -> Iterator[BrokenController]:
    for linear, angular in ((0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (0.5, 1.0), (-1.0, 1.0), (1.0, -1.0)):
        make: Make = partial(OtherReferences, partial(_twisted, linear, angular))
        yield BrokenController(f"a twist of {linear:g} and {angular:g}", "12.7", make, case=577)
    for other, clause, case in ((_shuffled, "12.7", 577), (_of_now, "12.7", 578), (_of_now, "12.6", 584)):
        name = f"a reference that is{other.__name__.replace('_', ' ')}"
        yield BrokenController(name, clause, partial(OtherReferences, other), case=case)
    for first, second in pairwise(ORDER):
        make = partial(JudgesInAnotherOrder, first, second)
        yield BrokenController(f"{second.name} before {first.name}", "12.4", make, case=580)
    for broken, clause, case in (
        (RefusedTakesItsNumber, "12.4", 589),
        (RefusedIsFresh, "12.4", 553),
        (AnswersTheSuperseded, "12.3", 586),
        (FollowsTheOldest, "12.3", 586),
        (WantsEveryNumber, "12.5", 585),
        (EndsWhereItIs, "12.10", 555),
        (GoesOnWithTheTwist, "12.10", 588),
        (IsNotDoneWithoutReference, "12.10", 587),
        (LosesTheStreamAtOnce, "12.9", 576),
        (IsKeptAlive, "12.9", 576),
    ):
        yield BrokenController(broken.__name__, clause, broken, case=case)


MUTANTS = (*_times(), *_stream_limits(), *_motion_limits(), *_motions(), *_streams())
