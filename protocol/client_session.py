"""The vision PC's end of the reference link, without input or output: datagrams and times in, events out."""

from dataclasses import dataclass, replace
from enum import Enum

from protocol.authentication import ChannelKeys, LinkKey
from protocol.channel import Channel, LinkStatistics, unauthentic
from protocol.clock_offset import OffsetEstimate
from protocol.datagram import Datagram, Header, decode, encode
from protocol.datagram_layout import VERSION_MINOR
from protocol.echo_clock import EchoClock
from protocol.errors import DatagramRefused, RequestRefused
from protocol.errors import LinkLost as LinkLostError
from protocol.faults import Reason
from protocol.reference_messages import (
    CAPABILITY_AUTHENTICATION,
    CAPABILITY_PATHS,
    CAPABILITY_STREAMING,
    Acknowledgement,
    Bye,
    Command,
    Heartbeat,
    HeartbeatReply,
    Hello,
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
    LinkLost,
    StateReceived,
    StreamRefusedReceived,
)

NS_PER_MS = 1_000_000
HELLO_PERIOD_NS = 100 * NS_PER_MS
HELLOS_PER_NONCE = 10
RESEND_CYCLES = 4
MIN_RESEND_NS = 20 * NS_PER_MS
# Ids of two runs of a client must differ: the controller's STATE may still name a motion of the run before.
# 21 bits of the nonce above a 32-bit count keep the id below 2^53, where every JSON reader holds it exactly.
_RUN_BITS = 21
_COUNT_BITS = 32


class _Phase(Enum):
    CLOSED = "closed"
    CONNECTING = "connecting"
    CONNECTED = "connected"


@dataclass(slots=True)
class _Unanswered:
    request: Request
    sent_ns: int


class ReferenceClient:
    """One session at a time. The shell gives every call its monotonic time and sends ``outgoing``.

    ``nonce`` is a random 64-bit number, new for every run of the program. A lost link is reported, never
    reopened on its own: call ``connect`` again. Requests are sent again under their id until answered.
    With a ``key`` only a session in which every datagram is authenticated is opened.
    """

    def __init__(
        self,
        nonce: int,
        arm_hash: int = 0,
        state_period_ms: int = 20,
        capabilities: int = CAPABILITY_PATHS | CAPABILITY_STREAMING,
        first_sequence: int = 1,
        key: LinkKey | None = None,
    ) -> None:
        self._key = key
        self._nonce = nonce % 2**64 or 1
        self._arm_hash = arm_hash
        self._state_period_ms = state_period_ms
        self._capabilities = capabilities | (CAPABILITY_AUTHENTICATION if key else 0)
        self._next_id = ((nonce % 2**_RUN_BITS) << _COUNT_BITS) + 1
        self._phase = _Phase.CLOSED
        self._channel = self._greeting_channel(first_sequence)
        self._welcome: Welcome | None = None
        self._echoes: EchoClock | None = None
        self._unanswered: dict[int, _Unanswered] = {}
        self._hellos_sent = 0
        self._next_hello_ns = 0
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
    def clock_uncertainty_ns(self) -> int | None:
        """Bound on the error of ``clock_offset_ns``."""
        estimate = self.clock
        return estimate.uncertainty_ns if estimate else None

    def connect(self, now_ns: int) -> None:
        """Starts the handshake; ``tick`` repeats it until the controller answers.

        A session that is still open is given up, and its unanswered requests with it.
        """
        self._unanswered.clear()
        self._phase = _Phase.CONNECTING
        self._hellos_sent = 0
        self._begin_attempt()
        self._say_hello(now_ns)

    def submit(self, request: Request, now_ns: int) -> int:
        """The id under which ``request`` is sent; the one it carries is replaced.

        Raises protocol.errors.LinkLost (``link.not_connected``), RequestRefused (``refused.not_negotiated``:
        the controller does not do that; ``refused.not_encodable``).
        """
        if self._welcome is None or not self.connected:
            raise LinkLostError("link.not_connected", "no session with the controller is open")
        if needed_capability(request) & ~self._welcome.capabilities:
            what = request.code.name if isinstance(request, Command) else type(request).__name__
            raise RequestRefused("refused.not_negotiated", f"this controller takes no {what}")
        numbered = request._replace(command_id=self._next_id)
        encode(numbered, Header(0, 0, now_ns))  # refuses what cannot be sent before it gets an id
        self._next_id += 1
        self._unanswered[numbered.command_id] = _Unanswered(numbered, now_ns)
        self._send(numbered, now_ns)
        return numbered.command_id

    def stream(self, reference: StreamedPose, now_ns: int) -> None:
        """Sends a streamed reference, once. Raises LinkLost and RequestRefused as ``submit`` does."""
        if self._welcome is None or not self.connected:
            raise LinkLostError("link.not_connected", "no session with the controller is open")
        encode(reference, Header(0, 0, now_ns))
        self._send(reference, now_ns)

    def disconnect(self, now_ns: int, reason: Reason = Reason.SHUTDOWN) -> list[ClientEvent]:
        """Ends the session, if there is one, and tells the controller why."""
        if self._phase is _Phase.CLOSED:
            return []
        if self.connected:
            self._send(Bye(reason), now_ns)
        return [self._lost(reason)]

    def tick(self, now_ns: int) -> list[ClientEvent]:
        """Repeats HELLO, sends heartbeats and unanswered requests when due, and notices a silent controller.

        Read the socket empty first: what waits there is not yet heard.
        """
        if self._phase is _Phase.CONNECTING and now_ns >= self._next_hello_ns:
            self._say_hello(now_ns)
        if self._echoes is None or not self.connected:
            return []
        if now_ns > self._silent_at_ns():
            self._send(Bye(Reason.LINK_TIMEOUT), now_ns)
            return [self._lost(Reason.LINK_TIMEOUT)]
        if now_ns >= self._echoes.due_ns:
            self._echoes.schedule_next(now_ns)
            self._send(Heartbeat(now_ns), now_ns)
        for unanswered in self._unanswered.values():
            if now_ns - unanswered.sent_ns >= self._resend_ns():
                unanswered.sent_ns = now_ns
                self._send(unanswered.request, now_ns)
        return []

    def next_deadline_ns(self) -> int | None:
        """When ``tick`` has something to do next; None while closed."""
        if self._phase is _Phase.CLOSED:
            return None
        if self._echoes is None or not self.connected:
            return self._next_hello_ns
        resends = [unanswered.sent_ns + self._resend_ns() for unanswered in self._unanswered.values()]
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
            return self._refused(datagram.message.reason, datagram.header, data)
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
            datagrams.append(channel.sealed(message, sent_ns))
        self._outbox.clear()
        return datagrams

    def _begin_attempt(self) -> None:
        self._nonce = (self._nonce + 1) % 2**64 or 1
        self._channel = self._greeting_channel(self._channel.next_sequence)
        self._welcome = None

    def _greeting_channel(self, next_sequence: int) -> Channel:
        keys = ChannelKeys(self._key.of_hello(), self._key.of_hello()) if self._key else None
        return Channel(0, VERSION_MINOR, next_sequence, keys)

    def _say_hello(self, now_ns: int) -> None:
        # A session that the controller opened and gave up again unheard has used its nonce up.
        if self._hellos_sent and self._hellos_sent % HELLOS_PER_NONCE == 0:
            self._begin_attempt()
        self._hellos_sent += 1
        self._next_hello_ns = now_ns + HELLO_PERIOD_NS
        self._send(Hello(self._nonce, self._capabilities, self._arm_hash, self._state_period_ms), now_ns)

    def _answered_hello(self, datagram: Datagram, data: bytes, now_ns: int) -> list[ClientEvent]:
        header, welcome = datagram
        if not isinstance(welcome, Welcome) or welcome.client_nonce != self._nonce:
            return [self._foreign("session.unknown", f"session {header.session:x} while connecting")]
        keys = None
        if self._key:
            keys = self._key.of_client(self._nonce, header.session, welcome.boot_id)
        forged = unauthentic(data, header, keys.receives if keys else None, self._tally)
        if forged:
            return [forged]
        if header.minor > VERSION_MINOR:
            return [self._lost(Reason.INCOMPATIBLE_VERSION)]
        if self._arm_hash not in (0, welcome.arm_hash):
            return [self._lost(Reason.WRONG_ARM)]
        self._channel = Channel(header.session, header.minor, self._channel.next_sequence, keys)
        self._channel.hear(header, now_ns, None, self._tally)
        self._welcome = welcome
        self._echoes = EchoClock(self._timeout_ns(), now_ns)
        self._phase = _Phase.CONNECTED
        return [Connected(header.session, welcome)]

    def _refused(self, reason: Reason, header: Header, data: bytes) -> list[ClientEvent]:
        # A refusal cannot be signed: there is no session. Who demands signatures takes it for a hint alone.
        forged = self._channel.unauthentic(data, header, self._tally)
        if forged:
            return [forged, ConnectionDelayed(reason)]
        if reason is Reason.SESSION_OCCUPIED:
            return [ConnectionDelayed(reason)]
        return [self._lost(reason)]

    def _in_session(self, datagram: Datagram, now_ns: int) -> list[ClientEvent]:
        header, message = datagram
        if isinstance(message, Bye):
            return [self._lost(message.reason)]
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
        if isinstance(message, Acknowledgement) and message.command_id in self._unanswered:
            del self._unanswered[message.command_id]
            return [AcknowledgementReceived(message)]
        return []

    def _lost(self, reason: Reason) -> LinkLost:
        unanswered = tuple(self._unanswered)
        self._unanswered.clear()
        self._welcome = None
        self._phase = _Phase.CLOSED
        return LinkLost(reason, unanswered)

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
