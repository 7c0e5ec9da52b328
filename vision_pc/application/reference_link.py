"""The vision PC's end of the reference link, awaitable: the service and lockstep run this same class.

Requests are awaited until the controller's acknowledgement; a refusal is raised with the controller's reason.
The newest states are kept, on the controller's clock, so that the tool's pose at a picture's capture time can
be interpolated through the link's clock offset. Datagrams are carried by a transport and time is a clock's:
nothing here opens a socket or waits anywhere else.
"""

import re
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import NamedTuple

from protocol.client_session import ReferenceClient
from protocol.errors import LinkLost, RequestRefused
from protocol.faults import CommandCode, FaultCode, Reason, refusal
from protocol.reference_messages import (
    CAPABILITY_VALVE_TRIALS,
    FLAG_PLANT_LINK_OK,
    Acknowledgement,
    Command,
    Request,
    State,
    StreamedPose,
    StreamRefused,
)
from protocol.session_events import (
    AcknowledgementReceived,
    ClientEvent,
    Connected,
    ConnectionDelayed,
    SessionLost,
    StateReceived,
    StreamRefusedReceived,
)
from vision_pc.application.ports import Clock
from vision_pc.application.state_history import keep, pose_at
from vision_pc.core.se3 import Array, from_pose

_WAIT_FOR_STATE_S = 1.0
_ACKNOWLEDGEMENT_S = 2.0
_RECONNECT_NS = 500_000_000
_SAME_RAD, _MARGIN_RAD = 1e-4, 0.02
_EXPLAINED = {Reason.WRONG_ARM: "it drives another arm than arm.yaml says (compare with longreach arm check)"}


class Submitted(NamedTuple):
    """A request was handed to the session, under an id of its own."""

    command_id: int
    request: Request


class Streamed(NamedTuple):
    """A reference of an open stream was handed to the session."""

    reference: StreamedPose


Journal = Callable[[Submitted | Streamed | ClientEvent], None]
"""Is told everything that happens on the link, for logs and recordings."""


class ReferenceLink:
    """One link to the controller; it reconnects on its own from ``connect`` until ``disconnect``.

    ``session`` is the protocol's. ``flush`` sends what the link has to send; its next deadline may have
    changed as well. ``peer`` names the controller in messages. ``listeners`` are told all that happens,
    ``journal`` first. ``heard_at_s``: when the newest state came, s since 1970. ``home``: X_BT where the arm
    stood when the machine was first heard. ``ranges``: of the joints (rad), if the arm that the controller
    must drive is known: a refusal then names the joint.
    """

    def __init__(
        self, session: ReferenceClient, clock: Clock, flush: Callable[[], None], journal: Journal, peer: str
    ) -> None:
        self.session = session
        self._clock = clock
        self._flush = flush
        self.listeners: list[Journal] = [journal]
        self._peer = peer
        self._states: deque[State] = deque()
        self._received = 0
        self._received_ns = 0
        self.heard_at_s = 0.0
        self._losses = 0
        self._answers: dict[int, Acknowledgement | LinkLost | None] = {}
        self.home: Array | None = None
        self.ranges: Mapping[str, tuple[float, float]] = {}
        self._refusal: StreamRefused | None = None
        self._lost_reason: Reason | None = None
        self._reconnect_ns: int | None = None

    # The transport's side.
    def connect(self) -> None:
        """Begin to connect; does not wait for the controller."""
        self._reconnect_ns = None
        self.session.connect(self._clock.now_ns)
        self._flush()

    def disconnect(self) -> None:
        """End the session, and tell the controller; the link stays closed."""
        for event in self.session.disconnect(self._clock.now_ns):
            self._handle(event)
        self._reconnect_ns = self._lost_reason = None
        self._flush()

    def receive(self, data: bytes) -> None:
        """Handle one datagram from the controller."""
        for event in self.session.receive(data, self._clock.now_ns):
            self._handle(event)

    def tick(self) -> None:
        """Do what is due: heartbeats, requests once more, a silent controller, a lost session once more."""
        now_ns = self._clock.now_ns
        if self._reconnect_ns is not None and now_ns >= self._reconnect_ns:
            self._reconnect_ns = None
            self.session.connect(now_ns)
        for event in self.session.tick(now_ns):
            self._handle(event)

    def outgoing(self, now_ns: int) -> list[bytes]:
        """Datagrams to be sent now, in order, stamped ``now_ns``."""
        return self.session.outgoing(now_ns)

    def next_deadline_ns(self) -> int | None:
        """When ``tick`` has something to do next; None while closed."""
        return self.session.next_deadline_ns() or self._reconnect_ns

    # What is known.
    @property
    def connected(self) -> bool:
        """Return True if a session is open, a state has come in it, and the controller's clock is known."""
        return self.session.connected and bool(self._states) and self.session.clock is not None

    @property
    def hears_plant(self) -> bool:
        """Return True if it is connected, and the newest state says that the controller hears the plant."""
        return self.connected and bool(self.state.flags & FLAG_PLANT_LINK_OK)

    @property
    def tries_valves(self) -> bool:
        """Return True if ENABLE begins a trial of the valves: the controller of this session says so."""
        granted = self.session.welcome
        return bool(granted and granted.capabilities & CAPABILITY_VALVE_TRIALS)

    @property
    def state(self) -> State:
        """The newest state. Raises LinkLost when there is no session."""
        if not self.connected:
            raise self.not_connected()
        return self._states[-1]

    @property
    def state_age_ns(self) -> int:
        """Time since the newest state was received."""
        return self._clock.now_ns - self._received_ns

    @property
    def now_ns(self) -> int:
        """The time on our clock."""
        return self._clock.now_ns

    def local_time_ns(self, controller_ns: int) -> int:
        """A time of the controller's clock on ours."""
        return controller_ns - (self.session.clock_offset_ns or 0)

    def not_connected(self) -> LinkLost:
        """The error that says why there is no session."""
        if self._lost_reason is None:
            return LinkLost("link.not_connected", f"{self._peer} does not answer")
        reason = self._lost_reason.name.lower()
        words = _EXPLAINED.get(self._lost_reason, reason.replace("_", " "))
        return LinkLost(f"link.{reason}", f"{self._peer}: {words}")

    # Programs wait here.
    async def next_state(self) -> State:
        """The next state to come. Raises LinkLost when the session is lost first, or none comes in time."""
        received, losses, within_s = self._received, self._losses, self._patience_s(_WAIT_FOR_STATE_S)
        if not await self._clock.until(lambda: self._received > received or self._losses > losses, within_s):
            raise LinkLost("link.silent", f"no state from the controller within {within_s:g} s")
        return self.state

    async def pose_at(self, local_ns: int) -> Array:
        """X_BT (4, 4) at ``local_ns`` of our clock, interpolated; waits for the state after it.

        Raises LinkLost when the time is older than what is kept, falls into a gap, or no newer state comes.
        """
        if self.session.clock_offset_ns is None:
            raise LinkLost("link.no_clock", "the controller's clock is not known yet")
        wanted_ns = local_ns + self.session.clock_offset_ns
        while not self._states or self._states[-1].time_ns < wanted_ns:
            await self.next_state()
        return pose_at(self._states, wanted_ns)

    async def command(self, code: CommandCode) -> Acknowledgement:
        """The acknowledgement of a command; asking for what already is so counts as accepted.

        Raises RequestRefused with the controller's reason, or LinkLost.
        """
        return await self.request(Command(0, code))

    async def request(self, request: Request) -> Acknowledgement:
        """The acknowledgement of any request. Raises RequestRefused or LinkLost."""
        acknowledgement = await self.answer(self.submit(request))
        already = isinstance(request, Command) and acknowledgement.reason is Reason.ALREADY_DONE
        if acknowledgement.reason is not Reason.ACCEPTED and not already:
            what = _words(request.code.name if isinstance(request, Command) else type(request).__name__)
            raise self.refused(what, acknowledgement.reason, acknowledgement.value, acknowledgement.limit)
        return acknowledgement

    def refused(self, what: str, reason: Reason, value: float, limit: float) -> RequestRefused:
        """The error of a refused ``what``; at a joint's limit with the joints that end there, or just beyond:
        controllers keep a margin; with the fault that is latched, once a state has told it.
        """
        if reason is Reason.ERROR_LATCHED and self.connected and self.state.fault is not FaultCode.NONE:
            return refusal(what, reason, value, limit, f"by {_words(self.state.fault.name)}")
        ends = self.ranges.items() if reason is Reason.JOINT_LIMIT else ()
        left = {name: limit - lower if value < limit else upper - limit for name, (lower, upper) in ends}
        named = [name for name, margin in left.items() if -_SAME_RAD < margin < _MARGIN_RAD]
        return refusal(what, reason, value, limit, f"of {' or '.join(named)}" if named else "")

    def submit(self, request: Request) -> int:
        """Send a request. Return the id under which ``answer`` finds its acknowledgement.

        Raises LinkLost, or RequestRefused when this controller does not take such a request.
        """
        try:
            command_id = self.session.submit(request, self._clock.now_ns)
        except LinkLost as error:
            raise self.not_connected() from error
        self._answers[command_id] = None
        self._tell(Submitted(command_id, request))
        self._flush()
        return command_id

    def take_over(self, request: Request, next_sequence: int) -> None:
        """Have a request answered that was sent beside this link, in its session; numbers go on behind it."""
        self.session.take_over(request, next_sequence, self._clock.now_ns)
        self._tell(Submitted(request.command_id, request))
        self._flush()

    async def answer(self, command_id: int) -> Acknowledgement:
        """The acknowledgement of a submitted request, also one that refuses it. Raises LinkLost when none
        comes in time.
        """
        within_s = self._patience_s(_ACKNOWLEDGEMENT_S)
        try:
            await self._clock.until(lambda: self._answers[command_id] is not None, within_s)
        finally:
            answer = self._answers.pop(command_id)
        if answer is None:
            raise LinkLost("link.unanswered", f"no acknowledgement within {within_s:g} s")
        if isinstance(answer, LinkLost):
            raise answer
        return answer

    def stream(self, reference: StreamedPose) -> None:
        """Send a streamed reference, once. Raises LinkLost, RequestRefused when it cannot be encoded."""
        try:
            self.session.stream(reference, self._clock.now_ns)
        except LinkLost as error:
            raise self.not_connected() from error
        self._tell(Streamed(reference))
        self._flush()

    def refusal_of(self, stream_id: int) -> StreamRefused | None:
        """The first refusal of a reference of this stream."""
        refused = self._refusal
        return refused if refused is not None and refused.stream_id == stream_id else None

    def _patience_s(self, least_s: float) -> float:
        """``least_s``, or longer where the controller allows longer silences: it ends the session then."""
        welcome = self.session.welcome
        return least_s if welcome is None else max(least_s, 1e-3 * welcome.link_timeout_ms)

    def _handle(self, event: ClientEvent) -> None:
        if isinstance(event, StateReceived):
            keep(self._states, event.state)
            if self.home is None:
                self.home = from_pose(event.state.X_BT)
            self._received += 1
            self._received_ns = self._clock.now_ns
            self.heard_at_s = time.time()
        elif isinstance(event, AcknowledgementReceived):
            if event.acknowledgement.command_id in self._answers:
                self._answers[event.acknowledgement.command_id] = event.acknowledgement
        elif isinstance(event, StreamRefusedReceived):
            self._refusal = self.refusal_of(event.refusal.stream_id) or event.refusal
        elif isinstance(event, Connected):
            self._lost_reason = None
        elif isinstance(event, SessionLost):
            self._session_lost(event)
        elif isinstance(event, ConnectionDelayed):
            self._lost_reason = event.reason
        self._tell(event)
        self._clock.wake()

    def _tell(self, event: Submitted | Streamed | ClientEvent) -> None:
        for listener in self.listeners:
            listener(event)

    def _session_lost(self, event: SessionLost) -> None:
        self._lost_reason = event.reason
        self._losses += 1
        self._states.clear()
        self._reconnect_ns = self._clock.now_ns + _RECONNECT_NS
        for command_id, answer in self._answers.items():
            self._answers[command_id] = self.not_connected() if answer is None else answer


def _words(name: str) -> str:
    """``EMERGENCY_STOP`` and ``ReferencePose`` as people write them."""
    return re.sub(r"_|(?<=[a-z])(?=[A-Z])", " ", name).lower()
