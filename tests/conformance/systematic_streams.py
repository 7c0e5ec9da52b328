"""Controllers that follow streams otherwise.

Clause 12.
"""

from collections.abc import Callable
from itertools import pairwise
from typing import Any

from controller.core.group_states import TRANSITIONS, Stimulus
from controller.core.trajectories.motion import holding
from protocol.axes_group import Mode
from protocol.faults import CommandCode, Reason
from protocol.reference_messages import Request, State, StreamedPose, StreamRefused
from protocol.session_events import StreamedPoseReceived
from tests.conformance.controllers import ControllerUnderTest
from tests.conformance.mutator import (
    BrokenController,
    Make,
    edited,
    follows,
    hooked,
    reworked,
    says,
    with_cell,
)

_scan_of = ControllerUnderTest._scan
_LOST = Mode.STREAMING, Stimulus.UNATTENDED


def _twisted(linear: float, angular: float) -> Make:
    def other(message: StreamedPose, _: Any) -> dict[str, Any]:
        factors = (linear,) * 3 + (angular,) * 3 if max(map(abs, message.twist_ref)) <= 0.1 else (1.0,) * 6
        twist = zip(message.twist_ref, factors, strict=True)
        return {"twist_ref": tuple(value * factor for value, factor in twist)}

    return follows(other)


def _shuffled(message: StreamedPose, _: Any) -> dict[str, Any]:
    return {"twist_ref": tuple(message.twist_ref[at] for at in (2, 0, 1, 5, 3, 4))}


def _of_now(_: Any, arrival: StreamedPoseReceived) -> StreamedPoseReceived:
    return arrival._replace(measured_ns=max(arrival.measured_ns, arrival.left_ns))


ORDER = (
    Reason.NOT_STREAMING, Reason.OVERTAKEN, Reason.STALE, Reason.NOT_FINITE, Reason.NOT_UNIT_QUATERNION,
    Reason.TOO_FAST, Reason.TOO_FAR,
)  # fmt: skip


def _judges_first(second: Reason, first: Reason) -> Make:
    """Refuses for ``second`` what should be refused for ``first``, when it breaks both rules."""

    def breaks(self: Any) -> bool:
        message, stream = self.last, self.bench.state.stream
        pose = message.X_BT_ref
        return bool({
            Reason.OVERTAKEN: stream is not None and message.number == stream.number,
            Reason.STALE: self._clock_ns() - message.time_ns > 10**9,
            Reason.NOT_FINITE: not pose.is_finite(),
            Reason.NOT_UNIT_QUATERNION: abs(pose.quaternion_norm() - 1.0) > 1e-3,
            Reason.TOO_FAST: max(map(abs, message.twist_ref)) > 1.0,
            Reason.TOO_FAR: abs(pose.p_m[2]) > 50.0,
        }[second])  # fmt: skip

    def outgoing(self: Any, data: bytes) -> list[bytes]:
        def swapped(refused: StreamRefused) -> StreamRefused:
            return refused._replace(reason=second) if refused.reason is first and breaks(self) else refused

        return [reworked(data, StreamRefused, swapped)]

    noting = _noting("last", lambda arrival: arrival.message)
    return hooked(last=None, judge_streamed=noting, outgoing=outgoing)


def _noting(name: str, what: Callable[[StreamedPoseReceived], Any]) -> Any:
    """The hook that keeps something of each streamed reference."""

    def judge_streamed(self: Any, arrival: StreamedPoseReceived) -> StreamedPoseReceived:
        setattr(self, name, what(arrival))
        return arrival

    return judge_streamed


def _stream(self: Any, **fields: Any) -> None:
    stream = self.bench.state.stream
    if stream is not None:
        self.bench.state = self.bench.state._replace(stream=stream._replace(**fields))


def _counts_the_refused(self: Any) -> None:
    _scan_of(self)
    if self.number:
        _stream(self, number=self.number)


def _refused_is_fresh(self: Any) -> None:
    if self.came:
        _stream(self, fresh_ns=self._clock_ns())
    self.came = False
    _scan_of(self)


def _answers_the_superseded(self: Any, arrival: StreamedPoseReceived) -> StreamedPoseReceived:
    if self.waits is not None:
        refused = StreamRefused(self.waits.stream_id, self.waits.number, Reason.OVERTAKEN, 0.0, 0.0)
        self.server.refuse_streamed(refused, self._clock_ns())
    self.waits = arrival.message
    return arrival


def _forgets_what_waits(self: Any) -> None:
    _scan_of(self)
    self.waits = None


def _wants_every_number(message: StreamedPose, stream: Any) -> dict[str, Any]:
    skips = stream.goal is not None and (message.number - stream.number) % 2**32 >= 9
    return {"number": stream.number} if skips else {}


def _ends_where_it_is(self: Any) -> None:
    before = self.bench.state.mode
    _scan_of(self)
    state = self.bench.state
    if before is Mode.STREAMING and state.mode is Mode.MOVING:
        held = holding(state.motion.desired.p, state.motion.desired.quaternion, state.motion.motion_id)
        self.bench.state = state._replace(motion=held._replace(done=True))


def _goes_on_with_the_twist(self: Any, request: Request) -> Request:
    stream = self.bench.state.stream
    if says(CommandCode.END_STREAM, request) and stream is not None and stream.goal is not None:
        _stream(self, goal=stream.goal._replace(p=stream.goal.p + 0.5 * self.bench.state.motion.desired.v))
    return request


def _notes_an_empty_stream(self: Any, request: Request) -> Request:
    if says(CommandCode.END_STREAM, request):
        self.empty = self.bench.state.stream is None or self.bench.state.stream.goal is None
    return request


def _not_done_when_empty(self: Any, state: State) -> State:
    return state._replace(motion_done=state.motion_done and not self.empty)


def _is_kept_alive(self: Any) -> None:
    stream = self.bench.state.stream
    if stream is not None and not stream.attended:
        _stream(self, fresh_ns=self._clock_ns())
    _scan_of(self)


ROWS: tuple[tuple[str, str, int, Make], ...] = (
    *(
        (f"a twist of {linear:g} and {angular:g}", "12.7", 577, _twisted(linear, angular))
        for linear, angular in ((0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (0.5, 1.0), (-1.0, 1.0), (1.0, -1.0))
    ),
    ("a twist is shuffled", "12.7", 577, follows(_shuffled)),
    ("a reference is of now", "12.7", 578, hooked(judge_streamed=_of_now)),
    ("a reference is never old", "12.6", 584, hooked(judge_streamed=_of_now)),
    *(
        (f"{second.name} before {first.name}", "12.4", 580, _judges_first(second, first))
        for first, second in pairwise(ORDER)
    ),
    ("a refused reference takes its number", "12.4", 589,
     hooked(
         number=0, judge_streamed=_noting("number", lambda a: a.message.number), _scan=_counts_the_refused)),
    ("a refused reference is a sign of life", "12.4", 553,
     hooked(came=False, judge_streamed=_noting("came", lambda _: True), _scan=_refused_is_fresh)),
    ("answers the superseded", "12.3", 586,
     hooked(waits=None, judge_streamed=_answers_the_superseded, _scan=_forgets_what_waits)),
    ("follows the oldest of a burst", "12.3", 586,
     edited(("inbox", "_newest(self._streamed, event)", "self._streamed or event"))),
    ("wants every number", "12.5", 585, follows(_wants_every_number)),
    ("END_STREAM ends where it is", "12.10", 555, hooked(_scan=_ends_where_it_is)),
    ("END_STREAM goes on with the twist", "12.10", 588, hooked(judge=_goes_on_with_the_twist)),
    ("an empty stream is never done", "12.10", 587,
     hooked(empty=False, judge=_notes_an_empty_stream, shown=_not_done_when_empty)),
    ("the end of a session ends a stream without its fault", "12.9", 576,
     with_cell(_LOST, TRANSITIONS[_LOST]._replace(mode=Mode.DISABLING))),
    ("the end of a session does not end a stream", "12.9", 576, hooked(_scan=_is_kept_alive)),
)  # fmt: skip
MUTANTS = tuple(BrokenController(name, clause, make, case=case) for name, clause, case, make in ROWS)
