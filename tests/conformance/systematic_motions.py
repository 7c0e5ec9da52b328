"""Controllers that move otherwise than they were asked to.

Clauses 6.7 to 6.9, 7.3 and 7.4.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from controller.core.inbox import Inbox
from controller.core.trajectories.motion import holding
from protocol.axes_group import Mode
from protocol.faults import CommandCode, Reason
from protocol.reference_messages import (
    Acknowledgement,
    ReferencePath,
    ReferencePose,
    Request,
    State,
)
from tests.conformance.controllers import ControllerUnderTest
from tests.conformance.mutant_report import BrokenController
from tests.conformance.mutants.breaking import says

Make = Callable[[], ControllerUnderTest]


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
        late = [r for r in taken if says(CommandCode.EMERGENCY_STOP, r)]
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
        make = partial(RestsBetween, partial(says, code))
        yield BrokenController(
            f"{code.name} ends at once", "7.3", make, case=570 if code is CommandCode.STOP else 569
        )
    for broken, clause, case in (
        (RefusalsStop, "6.9", 568),
        (LateEmergency, "7.4", 571),
        (EmergencyRamps, "7.4", 571),
    ):
        yield BrokenController(broken.__name__, clause, broken, case=case)


MUTANTS = (*_motions(),)
