"""Controllers that follow streams otherwise.

Clause 12.
"""

from collections.abc import Callable, Iterator
from functools import partial
from itertools import pairwise

from controller.core.group_states import TRANSITIONS, Stimulus
from controller.core.inbox import Inbox
from controller.core.trajectories.motion import holding
from protocol.axes_group import Mode
from protocol.faults import CommandCode, Reason
from protocol.reference_messages import (
    Acknowledgement,
    Request,
    State,
    StreamedPose,
    StreamRefused,
)
from protocol.session_events import ServerEvent, StreamedPoseReceived
from tests.conformance.controllers import ControllerUnderTest
from tests.conformance.mutant_report import BrokenController
from tests.conformance.mutants.breaking import reworked, says

Make = Callable[[], ControllerUnderTest]


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
        if says(CommandCode.END_STREAM, request) and stream is not None and stream.goal is not None:
            goal = stream.goal._replace(p=stream.goal.p + 0.5 * self.bench.state.motion.desired.v)
            self.bench.state = self.bench.state._replace(stream=stream._replace(goal=goal))
        return request


class IsNotDoneWithoutReference(ControllerUnderTest):
    """A stream that is ended without a reference is never done."""

    empty = False

    def judge(self, request: Request) -> Request:
        stream = self.bench.state.stream
        if says(CommandCode.END_STREAM, request):
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


MUTANTS = (*_streams(),)
