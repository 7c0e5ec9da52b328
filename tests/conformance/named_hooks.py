"""Controllers that a hook breaks: what lies behind the link, in the scan or in what it is shown."""

from collections import deque
from collections.abc import Callable
from typing import Any

from conformance.runner import reference_cases
from controller.core.requests import react_to_fault
from controller.core.supervision import Fault
from protocol.axes_group import Mode
from protocol.datagram_layout import Kind
from protocol.faults import CommandCode, FaultCode, Reason
from protocol.reference_messages import Acknowledgement, Command, ReferencePose, Request, State
from protocol.session_events import StreamedPoseReceived
from tests.conformance.controllers import ControllerUnderTest, settings
from tests.conformance.mutator import BrokenController, follows, hooked, says

KIND = 6


def _clears_the_emergency(self: Any, data: bytes) -> bytes:
    if data[KIND:7] == bytes([Kind.HELLO]):
        self.bench.step(Command(1, CommandCode.EMERGENCY_RELEASE))
        self.bench.step(Command(2, CommandCode.RESET))
    return data


def _release_is_enough(self: Any, request: Request) -> Request:
    if says(CommandCode.EMERGENCY_RELEASE, request):
        self.bench.step(request)
        return request._replace(code=CommandCode.RESET)
    return request


def _takes_nan_for_zero(self: Any, request: Request) -> Request:
    if not isinstance(request, ReferencePose):
        return request
    sane = request.X_BT_ref if request.X_BT_ref.is_finite() else self.bench.last.view.X_BT_cmd
    duration = request.duration_s if abs(request.duration_s) < 1e6 else 0.0
    return request._replace(X_BT_ref=sane, duration_s=duration)


def _deaf_while_stopping(self: Any, request: Request) -> Request:
    emergency = says(CommandCode.EMERGENCY_STOP, request) and self.bench.state.mode is Mode.STOPPING
    return Command(request.command_id, CommandCode.STOP) if emergency else request


def _notes_the_norm(self: Any, request: Request) -> Request:
    if isinstance(request, ReferencePose) and abs(request.X_BT_ref.quaternion_norm() - 1.0) < 1e-3:
        self.norm = request.X_BT_ref.quaternion_norm()
    return request


def _shows_the_norm(self: Any, state: State) -> State:
    bent = tuple(each * self.norm for each in state.X_BT_cmd.q_wxyz)
    return state._replace(X_BT_cmd=state.X_BT_cmd._replace(q_wxyz=bent))


def _last_finite(self: Any, arrival: StreamedPoseReceived) -> StreamedPoseReceived:
    if arrival.message.X_BT_ref.is_finite():
        self.good = arrival.message.X_BT_ref
    return arrival._replace(message=arrival.message._replace(X_BT_ref=self.good or arrival.message.X_BT_ref))


def _latches_in(mode: Mode) -> Callable[[Any], None]:
    def scan(self: Any) -> None:
        if self.inbox._last_words is not None and self.bench.state.mode is mode:
            lost = Fault(FaultCode.REFERENCE_LINK_LOST, 0.0, 0.0)
            self.bench.state, _ = react_to_fault(self.settings, self.bench.state, lost)
        ControllerUnderTest._scan(self)

    return scan


def _after_a_refusal(**fields: Callable[[int], Any]) -> Any:
    """Shows other fields for the rest of a ramp in which a request was refused; each gets its id."""

    def answered(self: Any, answer: Acknowledgement) -> list[Acknowledgement]:
        if answer.reason is not Reason.ACCEPTED and self.bench.state.mode is Mode.STOPPING:
            self.refused = answer.command_id
        return [answer]

    def shown(self: Any, state: State) -> State:
        if self.bench.state.mode is not Mode.STOPPING:
            self.refused = 0
        other = {name: field(self.refused) for name, field in fields.items()} if self.refused else {}
        return state._replace(**other)

    return hooked(refused=0, answered=answered, shown=shown)


class OneHeartbeatAScan(ControllerUnderTest):
    """Answers one heartbeat in a scan, and reads no further before it has."""

    def __init__(self) -> None:
        super().__init__()
        self._unread: deque[tuple[bytes, object]] = deque()
        self._beats = 1

    def _read(self) -> None:
        try:
            while True:
                self._unread.append(self._socket.recvfrom(65_535))
        except BlockingIOError:
            pass
        batch = []
        while self._unread:
            beats = self._unread[0][0][KIND : KIND + 1] == bytes([Kind.HEARTBEAT])
            if beats and not self._beats:
                break
            self._beats -= beats
            batch.append(self._unread.popleft())
        self._note(self.server.receive_batch(batch, self._clock_ns()))

    def _scan(self) -> None:
        self._beats = 1
        super()._scan()


_CLAUSES = {case.number: case.clause for case in reference_cases()}
MUTANTS = tuple(
    BrokenController(f"{name} ({case})", _CLAUSES[case], make, case=case)
    for name, cases, make in (
        ("HELLO clears the emergency", (508,), hooked(incoming=_clears_the_emergency)),
        ("EMERGENCY_RELEASE resets as well", (509,), hooked(judge=_release_is_enough)),
        ("takes NaN for zero", (521,), hooked(judge=_takes_nan_for_zero)),
        ("one heartbeat a scan", (418,), OneHeartbeatAScan),
        ("deaf while stopping", (533,), hooked(judge=_deaf_while_stopping)),
        ("does not normalise", (441,), hooked(norm=1.0, judge=_notes_the_norm, shown=_shows_the_norm)),
        ("waits for references", (572,),
         hooked(configured=lambda _: settings("controller.streaming.silence_ms=800"))),
        ("shows the motion that was refused", (840,), _after_a_refusal(motion_id=int)),
        ("shows a fault once it has refused", (840,),
         _after_a_refusal(fault=lambda _: FaultCode.REFERENCE_STALE)),
        ("takes NaN for the last reference", (546, 553), hooked(good=None, judge_streamed=_last_finite)),
        ("follows any stream", (554,),
         follows(lambda _, s: {"stream_id": s.stream_id})),
        ("takes older numbers", (585,),
         follows(lambda _, s: {"number": (s.number + 1) % 2**32})),
        ("shows another number", (550,), hooked(shown=lambda _, state: state._replace(stream_number=0))),
        ("latches for who leaves in STANDBY", (537, 538), hooked(_scan=_latches_in(Mode.STANDBY))),
        ("latches for who leaves while STOPPING", (539,), hooked(_scan=_latches_in(Mode.STOPPING))),
    )
    for case in cases
)  # fmt: skip
