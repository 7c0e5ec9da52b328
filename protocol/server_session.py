"""The controller's end of the reference link, without input or output: datagrams and times in, events out."""

from collections import deque
from collections.abc import Iterable
from dataclasses import replace

from protocol.authentication import LinkKey
from protocol.channel import Channel, LinkStatistics, unauthentic
from protocol.datagram import Datagram, Header, content_of, decode
from protocol.datagram_layout import VERSION_MINOR
from protocol.errors import DatagramRefused
from protocol.faults import Reason
from protocol.reference_messages import (
    ANY_ARM,
    CAPABILITY_PATHS,
    CAPABILITY_STREAMING,
    Acknowledgement,
    Bye,
    Heartbeat,
    HeartbeatReply,
    Hello,
    Message,
    Request,
    State,
    StreamedPose,
    StreamRefused,
    UnusableRequest,
    needed_capability,
)
from protocol.session_events import (
    DatagramDropped,
    RequestReceived,
    ServerEvent,
    SessionClosed,
    SessionOpened,
    StreamedPoseReceived,
)
from protocol.session_factory import LinkSession, SessionFactory, Source

NS_PER_MS = 1_000_000
REFUSAL_INTERVAL_NS = 50 * NS_PER_MS
REMEMBERED_NONCES = 64
_REFUSALS = {
    "authentication.missing": Reason.NOT_AUTHENTICATED,
    "authentication.no_key": Reason.KEY_NOT_CONFIGURED,
    "authentication.unknown_key": Reason.UNKNOWN_KEY,
    "authentication.bad_tag": Reason.BAD_TAG,
}


class ReferenceServer:
    """One active peer at a time. The shell gives every call its monotonic time and sends ``outgoing``.

    ``boot_id``: random, of every start of the controller; its lowest 64 bits are told in WELCOME, what is
    above them is kept, so that nobody can compute the number of a session that was granted to another.
    ``link_timeout_ms`` of silence end the session. ``max_age_ms``: a datagram older than that when it is read
    is not used (default: the link timeout). With a ``key`` only authenticated sessions are granted.

    A session begins with the client's first datagram in it, not with HELLO, which could be recorded or come
    from a forged address: who has not read WELCOME ends nothing, and is sent nothing else.
    """

    def __init__(
        self,
        boot_id: int,
        arm_hash: int,
        cycle_ns: int,
        link_timeout_ms: int,
        max_age_ms: int | None = None,
        capabilities: int = CAPABILITY_PATHS | CAPABILITY_STREAMING,
        first_sequence: int = 1,
        key: LinkKey | None = None,
    ) -> None:
        self._factory = SessionFactory(
            boot_id, arm_hash, cycle_ns, link_timeout_ms, capabilities, first_sequence, key
        )
        self._key = key
        self._arm_hash = arm_hash
        self._cycle_ns = cycle_ns
        self._link_timeout_ms = link_timeout_ms
        self._max_age_ns = (link_timeout_ms if max_age_ms is None else max_age_ms) * NS_PER_MS
        self._session: LinkSession | None = None
        self._unconfirmed: LinkSession | None = None
        self._past_nonces: deque[int] = deque(maxlen=REMEMBERED_NONCES)
        self._outbox: list[tuple[Message, Channel, Source, int]] = []
        self._refused_at_ns: int | None = None
        self._tally = LinkStatistics()

    @property
    def statistics(self) -> LinkStatistics:
        """A copy of the counters."""
        return replace(self._tally)

    @property
    def session(self) -> int | None:
        """Number of the open session."""
        return self._session.channel.session if self._session else None

    def link_alive(self, now_ns: int) -> bool:
        """Whether a peer is connected and was heard within the link timeout."""
        heard_ns = self._session.channel.heard_ns if self._session else None
        return heard_ns is not None and now_ns - heard_ns <= self._link_timeout_ms * NS_PER_MS

    def tick(self, now_ns: int) -> list[ServerEvent]:
        """Ends a session that has been silent for too long; to be called every cycle."""
        unconfirmed = self._unconfirmed
        if unconfirmed and now_ns - unconfirmed.greeted_ns > self._link_timeout_ms * NS_PER_MS:
            self._unconfirmed = None
        if self._session is None:
            return []
        channel = self._session.channel
        if channel.heard_ns is not None:  # a clock that goes back must not keep a dead link alive for as long
            channel.heard_ns = min(channel.heard_ns, now_ns)
        if self.link_alive(now_ns):
            return []
        return [self._close(Reason.LINK_TIMEOUT, now_ns, tell_peer=True)]

    def receive(self, data: bytes, source: Source, now_ns: int) -> list[ServerEvent]:
        """Events of one datagram read from ``source`` at ``now_ns``."""
        events = self.tick(now_ns)
        try:
            datagram = decode(data)
        except DatagramRefused as error:
            if error.cause == "datagram.wrong_major":
                self._refuse(Reason.INCOMPATIBLE_VERSION, 0, source, now_ns)
            return [*events, self._tally.drop(error.cause, f"{error} from {source}")]
        if isinstance(datagram.message, Hello):
            key = self._key.of_hello() if self._key else None
            forged = unauthentic(data, datagram.header, key, self._tally)
            if forged:
                self._refuse(_REFUSALS[forged.cause], 0, source, now_ns)
                return [*events, forged]
            return events + self._greeted(datagram.header, datagram.message, source, now_ns)
        return events + self._in_session(datagram, data, source, now_ns)

    def receive_batch(self, datagrams: Iterable[tuple[bytes, Source]], now_ns: int) -> list[ServerEvent]:
        """Events of all datagrams that were waiting in the socket at ``now_ns``."""
        return [event for data, source in datagrams for event in self.receive(data, source, now_ns)]

    def acknowledge(self, acknowledgement: Acknowledgement, now_ns: int) -> None:
        """Answers a request that was handed over; without effect if its session has ended since."""
        if self._session and self._session.ledger.settle(acknowledgement):
            self._send(acknowledgement, now_ns)

    def refuse_streamed(self, refusal: StreamRefused, now_ns: int) -> None:
        """Tells the client of a streamed reference that is not followed; without effect outside a session."""
        if self._session:
            self._send(refusal, now_ns)

    def state_due(self, now_ns: int) -> bool:
        """Whether the period that the client asked for has passed, so that ``publish`` would send."""
        # Half a cycle of tolerance, lest jitter of the scan makes every other period a cycle longer.
        return self._session is not None and now_ns + self._cycle_ns // 2 >= self._session.next_state_ns

    def publish(self, state: State, now_ns: int) -> None:
        """Sends ``state`` if the period that the client asked for has passed; to be called every cycle."""
        session = self._session
        if session is None or not self.state_due(now_ns):
            return
        period_ns = session.welcome.state_period_ms * NS_PER_MS
        session.next_state_ns = max(session.next_state_ns + period_ns, now_ns)
        self._send(state, now_ns)

    def close(self, now_ns: int, reason: Reason = Reason.SHUTDOWN) -> list[ServerEvent]:
        """Ends the session, if there is one, and tells the peer why."""
        return [self._close(reason, now_ns, tell_peer=True)] if self._session else []

    def outgoing(self, now_ns: int | None = None) -> list[tuple[bytes, Source]]:
        """Datagrams to be sent now, in order, and where to; stamped ``now_ns``, else when queued."""
        datagrams: list[tuple[bytes, Source]] = []
        for message, channel, source, queued_ns in self._outbox:
            sent_ns = queued_ns if now_ns is None else now_ns
            if isinstance(message, HeartbeatReply):
                message = message._replace(replied_ns=sent_ns)
            datagrams.append((channel.encoded(message, sent_ns), source))
        self._outbox.clear()
        return datagrams

    def _greeted(self, header: Header, hello: Hello, source: Source, now_ns: int) -> list[ServerEvent]:
        session = self._session
        if header.session != 0:
            return [self._foreign("session.hello_in_session", f"HELLO in session {header.session:x}")]
        for each in (session, self._unconfirmed):
            if each and each.is_of(hello, source):
                dropped = each.channel.hear(header, now_ns, self._max_age_ns, self._tally)
                if dropped is None:
                    self._post(each, each.welcome, now_ns)
                return [dropped] if dropped else []
        delayed = session and source == session.source and header.sent_ns < session.hello_sent_ns
        if delayed or hello.client_nonce in self._past_nonces:
            return [self._foreign("session.hello_replayed", f"nonce {hello.client_nonce:x} from {source}")]
        if hello.arm_hash not in (ANY_ARM, self._arm_hash):
            self._refuse(Reason.WRONG_ARM, 0, source, now_ns)
            return [self._foreign("session.wrong_arm", f"arm {hello.arm_hash:x}: this is {self._arm_hash:x}")]
        if session and source != session.source:
            self._refuse(Reason.SESSION_OCCUPIED, 0, source, now_ns)
            return [self._foreign("session.occupied", f"HELLO from {source}: {session.source} is connected")]
        self._unconfirmed = self._granted(header, hello, source, now_ns)
        self._post(self._unconfirmed, self._unconfirmed.welcome, now_ns)
        return []

    def _confirmed(self, now_ns: int) -> list[ServerEvent]:
        """Makes the granted session the one in use, in the place of another one."""
        granted = self._unconfirmed
        assert granted is not None
        events: list[ServerEvent] = []
        if self._session:
            events.append(self._close(Reason.PEER_RESTARTED, now_ns, tell_peer=False))
        self._session, self._unconfirmed = granted, None
        return [*events, SessionOpened(granted.channel.session, granted.source)]

    def _granted(self, header: Header, hello: Hello, source: Source, now_ns: int) -> LinkSession:
        return self._factory.grant(header, hello, source, now_ns, self._tally)

    def _in_session(self, datagram: Datagram, data: bytes, source: Source, now_ns: int) -> list[ServerEvent]:
        header, message = datagram
        session = self._addressed(header.session)
        if session is None:
            if not isinstance(message, Bye):
                self._refuse(Reason.UNKNOWN_SESSION, header.session, source, now_ns)
            return [self._foreign("session.unknown", f"session {header.session:x} from {source}")]
        if source != session.source:
            return [self._foreign("session.wrong_source", f"{source}: {session.source} is connected")]
        forged = session.channel.unauthentic(data, header, self._tally)
        if forged:
            return [forged]
        if header.minor != session.channel.minor:
            return [self._foreign("session.wrong_minor", f"minor {header.minor}: not the negotiated one")]
        if isinstance(message, Bye):
            if session is self._unconfirmed:
                self._unconfirmed = None
                return []
            return [self._close(message.reason, now_ns, tell_peer=False)]
        if not isinstance(message, Heartbeat | StreamedPose | Request | UnusableRequest):
            return [self._foreign("session.wrong_direction", f"{type(message).__name__} from a client")]
        dropped = session.channel.hear(header, now_ns, self._max_age_ns, self._tally)
        if dropped is not None:
            return [dropped]
        events = self._confirmed(now_ns) if session is self._unconfirmed else []
        if isinstance(message, Heartbeat):
            self._send(HeartbeatReply(message.sent_ns, now_ns, now_ns), now_ns)
            return events
        if isinstance(message, StreamedPose):
            return events + self._streamed(session, header, message, now_ns)
        return events + self._requested(session, message, content_of(message), now_ns)

    def _addressed(self, number: int) -> LinkSession | None:
        sessions = (self._session, self._unconfirmed)
        return next((each for each in sessions if each and each.channel.session == number), None)

    def _streamed(
        self, session: LinkSession, header: Header, message: StreamedPose, now_ns: int
    ) -> list[ServerEvent]:
        if not session.welcome.capabilities & CAPABILITY_STREAMING:
            refusal = StreamRefused(message.stream_id, message.number, Reason.NOT_NEGOTIATED, 0.0, 0.0)
            self.refuse_streamed(refusal, now_ns)
            return []
        left_ns = now_ns - session.channel.age_ns
        before_sending_ns = max(header.sent_ns - message.time_ns, 0)
        return [StreamedPoseReceived(message, left_ns, left_ns - before_sending_ns)]

    def _requested(
        self,
        session: LinkSession,
        request: Request | UnusableRequest,
        content: bytes,
        now_ns: int,
    ) -> list[ServerEvent]:
        verdict = session.ledger.admit(request.command_id, content)
        if verdict.answer is not None:
            self._send(verdict.answer, now_ns)
        if not verdict.execute:
            return []
        if isinstance(request, UnusableRequest):
            self.acknowledge(Acknowledgement(*request), now_ns)
            return []
        if needed_capability(request) & ~session.welcome.capabilities:
            self.acknowledge(Acknowledgement(request.command_id, Reason.NOT_NEGOTIATED, 0.0, 0.0), now_ns)
            return []
        return [RequestReceived(request)]

    def _send(self, message: Message, now_ns: int) -> None:
        assert self._session is not None
        self._post(self._session, message, now_ns)

    def _post(self, session: LinkSession, message: Message, now_ns: int) -> None:
        self._outbox.append((message, session.channel, session.source, now_ns))

    def _refuse(self, reason: Reason, session: int, source: Source, now_ns: int) -> None:
        # A refusal outside a session answers anybody, so it is rationed.
        if self._refused_at_ns is not None and now_ns - self._refused_at_ns < REFUSAL_INTERVAL_NS:
            return
        self._refused_at_ns = now_ns
        self._outbox.append((Bye(reason), Channel(session, VERSION_MINOR, 0), source, now_ns))

    def _close(self, reason: Reason, now_ns: int, *, tell_peer: bool) -> SessionClosed:
        session = self._session
        assert session is not None
        if tell_peer:
            self._send(Bye(reason), now_ns)
        self._past_nonces.append(session.welcome.client_nonce)
        self._session = None
        return SessionClosed(session.channel.session, reason)

    def _foreign(self, cause: str, detail: str) -> DatagramDropped:
        return self._tally.drop(cause, detail)
