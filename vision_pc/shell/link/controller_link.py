"""The reference link over UDP: the sans-IO client session on an asyncio endpoint, awaitable.

Requests are awaited until the controller's acknowledgement; a refusal is raised with the controller's reason.
The newest states are kept, on the controller's clock, so that the tool's pose at a picture's capture time can
be interpolated through the link's clock offset.
"""

import asyncio
import secrets
import time
from collections import deque
from collections.abc import Callable
from typing import Any, cast

from foundation.link_key import read_key
from protocol.channel import LinkStatistics
from protocol.client_session import ReferenceClient
from protocol.clock_offset import OffsetEstimate
from protocol.errors import LinkLost, RequestRefused
from protocol.faults import CommandCode, Reason
from protocol.reference_messages import Acknowledgement, Command, Request, State, StreamedPose, StreamRefused
from protocol.session_events import (
    AcknowledgementReceived,
    ClientEvent,
    Connected,
    ConnectionDelayed,
    StateReceived,
    StreamRefusedReceived,
)
from protocol.session_events import LinkLost as LinkLostEvent
from vision_pc.config.vision import LinkSettings
from vision_pc.core.se3 import Array, from_pose, interpolate
from vision_pc.shell.event_log import EventLog

_HISTORY_S = 30.0
_GAP_NS = 300_000_000  # states further apart than this are not interpolated between
_WAIT_FOR_STATE_S = 1.0
_RECONNECT_S = 0.5
_ACKNOWLEDGEMENT_S = 2.0
_LOG_DROPS_NS = 1_000_000_000  # at most one line a second, whatever the peer sends
Clock = Callable[[], int]


class ControllerLink(asyncio.DatagramProtocol):
    """One link to the controller at ``settings.host``; it reconnects on its own until ``close``."""

    def __init__(self, settings: LinkSettings, log: EventLog, clock: Clock = time.monotonic_ns) -> None:
        self._settings = settings
        self._log = log
        self._clock = clock
        self._session = ReferenceClient(
            secrets.randbits(64), 0, settings.state_period_ms, key=read_key(settings.link_key)
        )
        self._states: deque[State] = deque(maxlen=int(1e3 * _HISTORY_S / settings.state_period_ms))
        self._received_ns = 0
        self._new_state = asyncio.Event()
        self._answers: dict[int, asyncio.Future[Acknowledgement]] = {}
        self._refusal: StreamRefused | None = None
        self._transport: asyncio.DatagramTransport | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._lost_reason: Reason | None = None
        self._closing = False
        self._drop_logged_ns = 0

    async def start(self) -> None:
        """Opens the socket and begins to connect; does not wait for the controller.

        Raises LinkLost (``link.no_address``) when the host is not known.
        """
        address = (self._settings.host, self._settings.port)
        try:
            await asyncio.get_running_loop().create_datagram_endpoint(lambda: self, remote_addr=address)
        except OSError as error:
            raise LinkLost("link.no_address", f"controller at {address[0]}:{address[1]}: {error}") from error
        self._session.connect(self._clock())
        self._pump([])

    async def close(self) -> None:
        """Tells the controller and closes the socket."""
        self._closing = True
        self._pump(self._session.disconnect(self._clock()))
        if self._timer is not None:
            self._timer.cancel()
        if self._transport is not None:
            self._transport.close()

    @property
    def connected(self) -> bool:
        """Whether a session is open and a state has come in it."""
        return self._session.connected and bool(self._states)

    @property
    def clock_offset(self) -> OffsetEstimate | None:
        """The controller's clock minus ours, with its bound."""
        return self._session.clock

    @property
    def authenticated(self) -> bool:
        """Whether a session is open in which every datagram is signed."""
        return self._session.authenticated

    @property
    def statistics(self) -> LinkStatistics:
        """Counters of the session."""
        return self._session.statistics

    @property
    def state(self) -> State:
        """The newest state. Raises LinkLost when there is no session."""
        if not self.connected:
            raise self._not_connected()
        return self._states[-1]

    @property
    def state_age_ns(self) -> int:
        """Since the newest state was received."""
        return self._clock() - self._received_ns

    def local_time_ns(self, controller_ns: int) -> int:
        """A time of the controller's clock on ours."""
        return controller_ns - (self._session.clock_offset_ns or 0)

    async def next_state(self) -> State:
        """The next state to come. Raises LinkLost when none comes in time."""
        self._new_state.clear()
        try:
            # Not wait_for: it swallows a cancellation that comes together with the state (Python < 3.12).
            async with asyncio.timeout(_WAIT_FOR_STATE_S):
                await self._new_state.wait()
        except TimeoutError as error:
            why = f"no state from the controller within {_WAIT_FOR_STATE_S:g} s"
            raise LinkLost("link.silent", why) from error
        return self.state

    async def pose_at(self, local_ns: int) -> Array:
        """X_BT (4×4) at ``local_ns`` of our clock, interpolated; waits for the state after it.

        Raises LinkLost when the time is older than what is kept, falls into a gap, or no newer state comes.
        """
        if self._session.clock_offset_ns is None:
            raise LinkLost("link.no_clock", "the controller's clock is not known yet")
        wanted = local_ns + self._session.clock_offset_ns
        while not self._states or self._states[-1].time_ns < wanted:
            await self.next_state()
        newer = self._states[-1]
        for older in reversed(self._states):
            if older.time_ns <= wanted:
                return pose_between(older, newer, wanted)
            newer = older
        raise LinkLost("link.state_too_old", "the pose asked for is older than the states that are kept")

    async def command(self, code: CommandCode) -> Acknowledgement:
        """The acknowledgement of a command; asking for what already is so counts as accepted.

        Raises RequestRefused with the controller's reason, or LinkLost.
        """
        return await self.request(Command(0, code))

    @property
    def now_ns(self) -> int:
        """The time on our clock."""
        return self._clock()

    def stream(self, reference: StreamedPose) -> None:
        """Sends a streamed reference, once. Raises LinkLost, RequestRefused when it cannot be encoded."""
        try:
            self._session.stream(reference, self._clock())
        except LinkLost as error:
            raise self._not_connected() from error
        self._pump([])

    def refusal_of(self, stream_id: int) -> StreamRefused | None:
        """The first refusal of a reference of this stream."""
        refusal = self._refusal
        return refusal if refusal is not None and refusal.stream_id == stream_id else None

    async def request(self, request: Request) -> Acknowledgement:
        """The acknowledgement of any request. Raises RequestRefused or LinkLost."""
        try:
            command_id = self._session.submit(request, self._clock())
        except LinkLost as error:
            raise self._not_connected() from error
        answer: asyncio.Future[Acknowledgement] = asyncio.get_running_loop().create_future()
        self._answers[command_id] = answer
        self._pump([])
        try:
            async with asyncio.timeout(_ACKNOWLEDGEMENT_S):
                acknowledgement = await answer
        except TimeoutError as error:
            why = f"no acknowledgement within {_ACKNOWLEDGEMENT_S:g} s"
            raise LinkLost("link.unanswered", why) from error
        finally:
            self._answers.pop(command_id, None)
        self._log.write("acknowledged", request=type(request).__name__, **_spoken(acknowledgement))
        already = isinstance(request, Command) and acknowledgement.reason is Reason.ALREADY_DONE
        if acknowledgement.reason is not Reason.ACCEPTED and not already:
            raise refusal(request, acknowledgement)
        return acknowledgement

    # asyncio's side
    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.DatagramTransport, transport)  # uvloop's is of no class of asyncio's

    def datagram_received(self, data: bytes, addr: Any) -> None:
        self._pump(self._session.receive(data, self._clock()))

    def error_received(self, exc: Exception) -> None:
        """Nobody listens there (yet): the session's own timeouts deal with it."""

    def _pump(self, events: list[ClientEvent]) -> None:
        """Handles ``events``, sends what the session wants sent, and sets the timer for its next deadline."""
        for event in events:
            self._handle(event)
        now_ns = self._clock()
        if self._transport is not None and not self._transport.is_closing():
            for datagram in self._session.outgoing(now_ns):
                self._transport.sendto(datagram)
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        deadline_ns = self._session.next_deadline_ns()
        if deadline_ns is not None:
            delay_s = max((deadline_ns - now_ns) / 1e9, 0.0)
            self._timer = asyncio.get_running_loop().call_later(delay_s, self._tick)

    def _tick(self) -> None:
        self._timer = None
        self._pump(self._session.tick(self._clock()))

    def _handle(self, event: ClientEvent) -> None:
        if isinstance(event, StateReceived):
            self._states.append(event.state)
            self._received_ns = self._clock()
            self._new_state.set()
        elif isinstance(event, AcknowledgementReceived):
            answer = self._answers.get(event.acknowledgement.command_id)
            if answer is not None and not answer.done():
                answer.set_result(event.acknowledgement)
        elif isinstance(event, StreamRefusedReceived):
            if self.refusal_of(event.refusal.stream_id) is None:
                self._refusal = event.refusal
                self._log.write("stream_refused", **_refused(event.refusal))
        elif isinstance(event, Connected):
            self._lost_reason = None
            self._log.write("link_connected", session=f"{event.session:x}", cycle_ns=event.welcome.cycle_ns)
        elif isinstance(event, LinkLostEvent):
            self._lost(event)
        elif isinstance(event, ConnectionDelayed):
            self._lost_reason = event.reason
        elif self._clock() - self._drop_logged_ns > _LOG_DROPS_NS:
            self._drop_logged_ns = self._clock()
            self._log.write("datagram_dropped", cause=event.cause, detail=event.detail)

    def _lost(self, event: LinkLostEvent) -> None:
        self._lost_reason = event.reason
        self._states.clear()
        self._log.write("link_lost", reason=event.reason.name.lower(), unanswered=len(event.unanswered))
        for answer in self._answers.values():
            if not answer.done():
                answer.set_exception(self._not_connected())
        if not self._closing:
            asyncio.get_running_loop().call_later(_RECONNECT_S, self._reconnect)

    def _reconnect(self) -> None:
        if not self._closing:
            self._session.connect(self._clock())
            self._pump([])

    def _not_connected(self) -> LinkLost:
        address = f"{self._settings.host}:{self._settings.port}"
        if self._lost_reason is None:
            return LinkLost("link.not_connected", f"controller at {address} does not answer")
        reason = self._lost_reason.name.lower()
        return LinkLost(f"link.{reason}", f"controller at {address}: {reason.replace('_', ' ')}")


def refusal(request: Request, answer: Acknowledgement) -> RequestRefused:
    """The exception for a refusing acknowledgement; its cause is ``refused.`` and the controller's reason."""
    reason = answer.reason.name.lower()
    what = request.code.name.lower() if isinstance(request, Command) else type(request).__name__
    numbers = f": {answer.value:g}, limit {answer.limit:g}" if answer.value or answer.limit else ""
    return RequestRefused(f"refused.{reason}", f"{what} refused: {reason.replace('_', ' ')}{numbers}")


def _spoken(answer: Acknowledgement) -> dict[str, Any]:
    return {"command_id": answer.command_id, "reason": answer.reason.name.lower(), "value": answer.value}


def _refused(refusal: StreamRefused) -> dict[str, Any]:
    return {"number": refusal.number, "reason": refusal.reason.name.lower(), "value": refusal.value}


def pose_between(older: State, newer: State, wanted_ns: int) -> Array:
    """X_BT (4×4) at ``wanted_ns`` of the controller's clock, interpolated. Raises LinkLost across a gap."""
    span = newer.time_ns - older.time_ns
    if span > _GAP_NS:
        why = f"states {span / 1e6:.0f} ms apart, limit {_GAP_NS / 1e6:.0f} ms"
        raise LinkLost("link.state_gap", why)
    fraction = (wanted_ns - older.time_ns) / span if span else 0.0
    return interpolate(from_pose(older.X_BT), from_pose(newer.X_BT), fraction)
