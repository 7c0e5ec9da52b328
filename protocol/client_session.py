"""The vision PC's end of the reference link, without input or output: datagrams and times in, events out."""

from dataclasses import replace
from enum import Enum

from protocol.authentication import LinkKey
from protocol.channel import Channel, LinkStatistics, is_newer
from protocol.client_handshake import ClientHandshake, Credentials
from protocol.clock_offset import HeartbeatTracker, OffsetEstimate
from protocol.command_ledger import OpenRequests
from protocol.datagram import Datagram, Header, decode, encode
from protocol.errors import DatagramRefused, LinkLost, RequestRefused
from protocol.faults import Reason
from protocol.reference_messages import (
    ANY_ARM,
    DEFAULT_OFFER,
    Acknowledgement,
    Bye,
    Command,
    Heartbeat,
    HeartbeatReply,
    Message,
    Request,
    State,
    StreamedPose,
    StreamRefused,
    Welcome,
    needed_capability,
)
from protocol.session_events import (
    AcknowledgementReceived,
    ClientEvent,
    Connected,
    ConnectionDelayed,
    DatagramDropped,
    SessionLost,
    StateReceived,
    StreamRefusedReceived,
)

NS_PER_MS = 1_000_000
RESEND_CYCLES = 4
MIN_RESEND_NS = 20 * NS_PER_MS


class _Phase(Enum):
    CLOSED = "closed"
    CONNECTING = "connecting"
    CONNECTED = "connected"


class ReferenceClient:
    """One session at a time. The shell gives every call its monotonic time and sends ``outgoing``.

    ``nonce`` is a random 64-bit number, new for every run of the program. A lost link is reported, never
    reopened on its own: call ``connect`` again. Requests are sent again under their id until answered.
    With a ``key`` only a session in which every datagram is authenticated is opened.
    """

    def __init__(
        self,
        nonce: int,
        arm_hash: int = ANY_ARM,
        state_period_ms: int = 20,
        capabilities: int = DEFAULT_OFFER,
        first_sequence: int = 1,
        key: LinkKey | None = None,
    ) -> None:
        self._phase = _Phase.CLOSED
        self._handshake = ClientHandshake(nonce, arm_hash, state_period_ms, capabilities, first_sequence, key)
        self._requests = OpenRequests(nonce)
        self._channel = self._handshake.channel
        self._welcome: Welcome | None = None
        self._echoes: HeartbeatTracker | None = None
        self._outbox: list[tuple[Message, Channel, int]] = []
        self._tally = LinkStatistics()

    @property
    def connected(self) -> bool:
        """Whether a session is open."""
        return self._phase is _Phase.CONNECTED

    @property
    def authenticated(self) -> bool:
        """Whether a session is open in which every datagram is signed."""
        return self.connected and self._channel.keys is not None

    @property
    def welcome(self) -> Welcome | None:
        """What the controller granted in the open session."""
        return self._welcome

    @property
    def statistics(self) -> LinkStatistics:
        """A copy of the counters."""
        return replace(self._tally)

    @property
    def clock(self) -> OffsetEstimate | None:
        """Offset of the controller's clock, its bound and the last round trip; None before the first echo."""
        return self._echoes.estimate() if self._echoes else None

    @property
    def clock_offset_ns(self) -> int | None:
        """Controller's clock minus the local one."""
        estimate = self.clock
        return estimate.offset_ns if estimate else None

    @property
    def credentials(self) -> Credentials | None:
        """What who speaks beside this end has to know of the open session."""
        if self._welcome is None:
            return None
        channel, welcome = self._channel, self._welcome
        return Credentials(channel.session, channel.minor, welcome.client_nonce, welcome.boot_id)

    @property
    def next_numbers(self) -> tuple[int, int]:
        """The number of the next datagram, and the id of the next request."""
        return self._channel.next_sequence, self._requests.next_id

    def take_over(self, request: Request, next_sequence: int, now_ns: int) -> None:
        """Waits for the answer to a request that was sent beside this end; its numbers go on behind it."""
        if is_newer(next_sequence, self._channel.next_sequence):
            self._channel.next_sequence = next_sequence
        self._requests.enter(request, now_ns)

    def connect(self, now_ns: int) -> None:
        """Starts the handshake; ``tick`` repeats it until the controller answers.

        A session that is still open is given up, and its unanswered requests with it.
        """
        self._requests.give_up()
        self._welcome = None
        self._phase = _Phase.CONNECTING
        self._handshake.begin(self._channel.next_sequence)
        self._say_hello(now_ns)

    def submit(self, request: Request, now_ns: int) -> int:
        """The id under which ``request`` is sent; the one it carries is replaced.

        Raises protocol.errors.LinkLost (``link.not_connected``), RequestRefused (``refused.not_negotiated``:
        the controller does not do that; ``refused.not_encodable``).
        """
        if self._welcome is None or not self.connected:
            raise LinkLost("link.not_connected", "no session with the controller is open")
        if needed_capability(request) & ~self._welcome.capabilities:
            what = request.code.name if isinstance(request, Command) else type(request).__name__
            raise RequestRefused("refused.not_negotiated", f"this controller takes no {what}")
        numbered = self._requests.numbered(request)
        encode(numbered, Header(0, 0, now_ns))  # refuses what cannot be sent before it uses an id up
        self._requests.enter(numbered, now_ns)
        self._send(numbered, now_ns)
        return numbered.command_id

    def stream(self, reference: StreamedPose, now_ns: int) -> None:
        """Sends a streamed reference, once. Raises LinkLost and RequestRefused as ``submit`` does."""
        if self._welcome is None or not self.connected:
            raise LinkLost("link.not_connected", "no session with the controller is open")
        encode(reference, Header(0, 0, now_ns))
        self._send(reference, now_ns)

    def disconnect(self, now_ns: int, reason: Reason = Reason.SHUTDOWN) -> list[ClientEvent]:
        """Ends the session, if there is one, and tells the controller why."""
        if self._phase is _Phase.CLOSED:
            return []
        if self.connected:
            self._send(Bye(reason), now_ns)
        return [self._end_session(reason)]

    def tick(self, now_ns: int) -> list[ClientEvent]:
        """Repeats HELLO, sends heartbeats and unanswered requests when due, and notices a silent controller.

        Read the socket empty first: what waits there is not yet heard.
        """
        if self._phase is _Phase.CONNECTING and now_ns >= self._handshake.due_ns:
            self._say_hello(now_ns)
        if self._echoes is None or not self.connected:
            return []
        if now_ns > self._silent_at_ns():
            self._send(Bye(Reason.LINK_TIMEOUT), now_ns)
            return [self._end_session(Reason.LINK_TIMEOUT)]
        if now_ns >= self._echoes.due_ns:
            self._echoes.schedule_next(now_ns)
            self._send(Heartbeat(now_ns), now_ns)
        for request in self._requests.due(now_ns, self._resend_ns()):
            self._send(request, now_ns)
        return []

    def next_deadline_ns(self) -> int | None:
        """When ``tick`` has something to do next; None while closed."""
        if self._phase is _Phase.CLOSED:
            return None
        if self._echoes is None or not self.connected:
            return self._handshake.due_ns
        resends = self._requests.due_ns(self._resend_ns())
        return min(self._echoes.due_ns, self._silent_at_ns() + 1, *resends)

    def receive(self, data: bytes, now_ns: int) -> list[ClientEvent]:
        """Events of one datagram from the controller, read at ``now_ns``."""
        try:
            datagram = decode(data)
        except DatagramRefused as error:
            return [self._tally.drop(error.cause, str(error))]
        if self._phase is _Phase.CONNECTING and datagram.header.session != self._channel.session:
            return self._answered_hello(datagram, data, now_ns)
        if self._phase is _Phase.CONNECTING and isinstance(datagram.message, Bye):
            return self._refuse(datagram.message.reason, datagram.header, data)
        if not self.connected or datagram.header.session != self._channel.session:
            return [self._foreign("session.unknown", f"session {datagram.header.session:x}")]
        forged = self._channel.unauthentic(data, datagram.header, self._tally)
        return [forged] if forged else self._in_session(datagram, now_ns)

    def outgoing(self, now_ns: int | None = None) -> list[bytes]:
        """Datagrams to be sent now, in order; stamped ``now_ns``, else when they were queued."""
        datagrams: list[bytes] = []
        for message, channel, queued_ns in self._outbox:
            sent_ns = queued_ns if now_ns is None else now_ns
            if isinstance(message, Heartbeat):
                message = Heartbeat(sent_ns)
                if self._echoes:
                    self._echoes.sent(sent_ns)
            datagrams.append(channel.encoded(message, sent_ns))
        self._outbox.clear()
        return datagrams

    def _say_hello(self, now_ns: int) -> None:
        hello = self._handshake.hello(now_ns)
        self._channel = self._handshake.channel
        self._send(hello, now_ns)

    def _answered_hello(self, datagram: Datagram, data: bytes, now_ns: int) -> list[ClientEvent]:
        header, welcome = datagram
        answer = self._handshake.answered(header, welcome, data, self._tally)
        if isinstance(answer, DatagramDropped):
            return [answer]
        if isinstance(answer, Reason):
            return [self._end_session(answer)]
        assert isinstance(welcome, Welcome)
        self._channel = answer
        self._channel.hear(header, now_ns, None, self._tally)
        self._welcome = welcome
        self._echoes = HeartbeatTracker(self._timeout_ns(), now_ns)
        self._phase = _Phase.CONNECTED
        return [Connected(header.session, welcome)]

    def _refuse(self, reason: Reason, header: Header, data: bytes) -> list[ClientEvent]:
        # A refusal cannot be signed: there is no session. Who demands signatures takes it for a hint alone.
        forged = self._channel.unauthentic(data, header, self._tally)
        if forged:
            return [forged, ConnectionDelayed(reason)]
        if reason is Reason.SESSION_OCCUPIED:
            return [ConnectionDelayed(reason)]
        return [self._end_session(reason)]

    def _in_session(self, datagram: Datagram, now_ns: int) -> list[ClientEvent]:
        header, message = datagram
        if isinstance(message, Bye):
            return [self._end_session(message.reason)]
        if header.minor != self._channel.minor:
            return [self._foreign("session.wrong_minor", f"minor {header.minor}: not the negotiated one")]
        if not isinstance(message, Welcome | HeartbeatReply | Acknowledgement | State | StreamRefused):
            return [self._foreign("session.wrong_direction", f"{type(message).__name__} from a controller")]
        max_age_ns = self._timeout_ns() if isinstance(message, State) else None
        dropped = self._channel.hear(header, now_ns, max_age_ns, self._tally)
        if dropped is None and isinstance(message, HeartbeatReply) and self._echoes:
            dropped = self._echoes.returned(message, now_ns)
            self._tally.echoes_refused += dropped is not None
        if dropped is not None:
            return [dropped]
        if isinstance(message, State):
            return [StateReceived(message)]
        if isinstance(message, StreamRefused):
            return [StreamRefusedReceived(message)]
        if isinstance(message, Acknowledgement) and self._requests.settle(message.command_id):
            return [AcknowledgementReceived(message)]
        return []

    def _end_session(self, reason: Reason) -> SessionLost:
        self._welcome = None
        self._phase = _Phase.CLOSED
        return SessionLost(reason, self._requests.give_up())

    def _foreign(self, cause: str, detail: str) -> DatagramDropped:
        return self._tally.drop(cause, detail)

    def _send(self, message: Message, now_ns: int) -> None:
        self._outbox.append((message, self._channel, now_ns))

    def _timeout_ns(self) -> int:
        assert self._welcome is not None
        return self._welcome.link_timeout_ms * NS_PER_MS

    def _silent_at_ns(self) -> int:
        assert self._channel.heard_ns is not None
        return self._channel.heard_ns + self._timeout_ns()

    def _resend_ns(self) -> int:
        assert self._welcome is not None
        return max(MIN_RESEND_NS, RESEND_CYCLES * self._welcome.cycle_ns)
