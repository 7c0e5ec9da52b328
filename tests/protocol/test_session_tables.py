"""Every row of the published state tables, played on the sessions."""

from collections.abc import Callable

import pytest

from conformance.wire import with_number
from protocol.authentication import LinkKey
from protocol.client_session import ReferenceClient
from protocol.datagram import Header, decode, encode
from protocol.faults import CommandCode, Reason
from protocol.reference_messages import (
    Acknowledgement,
    Bye,
    Command,
    Heartbeat,
    Hello,
    Message,
    ReferencePose,
    State,
    Welcome,
)
from protocol.server_session import ReferenceServer
from protocol.session_events import RequestReceived
from tests.protocol.sample_messages import MESSAGES, POSE
from tests.protocol.wire import ARM, MS, TIMEOUT_MS, a_server
from tests.support.pages import SessionRow, session_rows

WELCOME = next(m for m in MESSAGES if isinstance(m, Welcome))
STATE = next(m for m in MESSAGES if isinstance(m, State))
ENABLE = Command(5, CommandCode.ENABLE)
T0 = 10**9
OF_MAJOR_2 = with_number(encode(Hello(2, 1, 0, 20), Header(0, 1, T0)), 4, "B", 2)


def spoken(data: bytes) -> str:
    """A sent datagram in the words of the tables."""
    message = decode(data).message
    name = {"HeartbeatReply": "HEARTBEAT_REPLY"}.get(type(message).__name__, type(message).__name__.upper())
    if isinstance(message, Bye) or (isinstance(message, Acknowledgement) and message.reason):
        return f"{name} {message.reason.name}"
    return name


class ServerBench:
    """A server, with a key or without one, in the state that a row starts from."""

    def __init__(self, state: str, secret: LinkKey | None = None) -> None:
        self.server: ReferenceServer = a_server(key=secret)
        self.secret = secret
        self.now_ns, self.sequence, self.session = T0, 100, 0
        self.key = secret.of_hello() if secret else None
        if state == "OPEN":
            self.greet(1)
            self.give(Heartbeat(self.now_ns))
            self.server.outgoing()
        self.begun = self.server.session

    def greet(self, nonce: int) -> None:
        """HELLO; what follows is of the session that its WELCOME names, under its keys."""
        self.key = self.secret.of_hello() if self.secret else None
        self.give(Hello(nonce, 1, 0, 20), session=0)
        ((data, _),) = self.server.outgoing()
        header, welcome = decode(data)
        assert isinstance(welcome, Welcome)
        self.session = header.session
        if self.secret:
            self.key = self.secret.of_client(nonce, header.session, welcome.boot_id).sends

    def give(
        self, message: Message, session: int | None = None, source: str = "a", sent_ns: int | None = None
    ) -> bytes:
        """Hands over one datagram; it takes the next number."""
        self.sequence += 1
        header = Header(
            self.session if session is None else session,
            self.sequence,
            self.now_ns if sent_ns is None else sent_ns,
        )
        data = encode(message, header, self.key)
        self.give_bytes(data, source)
        return data

    def give_bytes(self, data: bytes, source: str = "a") -> None:
        self.executed = [
            event.message
            for event in self.server.receive(data, source, self.now_ns)
            if isinstance(event, RequestReceived)
        ]

    def decide(self) -> None:
        self.server.acknowledge(Acknowledgement(5, Reason.ACCEPTED, 0.0, 0.0), self.now_ns)

    def outcome(self) -> tuple[str, str]:
        """Next state and what was sent, in the words of the tables."""
        sent = " and ".join(spoken(data) for data, _ in self.server.outgoing()) or "–"
        if self.server.session is None:
            return "CLOSED", sent
        renewed = self.begun not in (None, self.server.session)
        return "OPEN, new session" if renewed else "OPEN", sent


def ended_once(bench: ServerBench) -> None:
    confirmed(bench)
    bench.server.close(bench.now_ns)
    bench.server.outgoing()
    bench.give(Hello(3, 1, 0, 20), session=0)


def confirmed(bench: ServerBench) -> None:
    bench.greet(3)
    bench.give(Heartbeat(bench.now_ns))


def confirmed_late(bench: ServerBench) -> None:
    bench.greet(3)
    bench.now_ns += TIMEOUT_MS * MS + 1
    bench.give(Heartbeat(bench.now_ns))


def published_unconfirmed(bench: ServerBench) -> None:
    bench.greet(3)
    bench.now_ns += TIMEOUT_MS * MS // 2
    bench.server.publish(STATE, bench.now_ns)


def greeted_twice(bench: ServerBench) -> None:
    bench.greet(3)
    session = bench.session
    bench.greet(3)
    assert bench.session == session
    bench.give(Hello(3, 1, 0, 20), session=0)


def decided_after_asking(bench: ServerBench) -> None:
    bench.give(ENABLE)
    assert bench.outcome() == ("OPEN", "–")
    assert bench.executed == [ENABLE]
    bench.decide()


def asked_again(bench: ServerBench) -> None:
    decided_after_asking(bench)
    bench.server.outgoing()
    bench.give(ENABLE)
    assert bench.executed == []


def asked_twice_undecided(bench: ServerBench) -> None:
    bench.give(ENABLE)
    bench.give(ENABLE)
    assert bench.executed == []


def asked_otherwise(bench: ServerBench) -> None:
    decided_after_asking(bench)
    bench.server.outgoing()
    bench.give(ENABLE._replace(code=CommandCode.DISABLE))
    assert bench.executed == []


def overtaken(bench: ServerBench) -> None:
    decided_after_asking(bench)
    bench.server.outgoing()
    bench.give(ENABLE._replace(command_id=4))
    assert bench.executed == []


def not_to_be_used(bench: ServerBench) -> None:
    bench.sequence += 1
    for sequence, sent_ns in [(110, T0), (110, T0), (109, T0), (111, T0 - 400 * MS)]:
        bench.server.receive(encode(ENABLE, Header(bench.session, sequence, sent_ns)), "a", bench.now_ns)
    tally = bench.server.statistics
    assert (tally.duplicated, tally.reordered, tally.stale) == (1, 1, 1)


def silent(bench: ServerBench) -> None:
    bench.now_ns += TIMEOUT_MS * MS
    bench.server.tick(bench.now_ns)
    assert bench.outcome() == ("OPEN", "–")
    bench.now_ns += 1
    bench.server.tick(bench.now_ns)


SERVER_PLAYS: dict[tuple[str, str], Callable[[ServerBench], object]] = {
    ("CLOSED", "HELLO, nonce not used before, arm_hash 0 or its own"): lambda b: b.give(Hello(2, 1, ARM, 20)),
    ("CLOSED", "first datagram in the session of the newest WELCOME: HEARTBEAT"): confirmed,
    ("CLOSED", "the same, later than link_timeout_ms"): confirmed_late,
    ("CLOSED", "state period has passed since WELCOME"): published_unconfirmed,
    ("CLOSED", "HELLO, same source, same nonce"): greeted_twice,
    ("CLOSED", "HELLO, arm_hash of another arm"): lambda b: b.give(Hello(2, 1, ARM + 1, 20)),
    ("CLOSED", "HELLO, nonce of an earlier session"): ended_once,
    ("CLOSED", "datagram of another major version"): lambda b: b.give_bytes(OF_MAJOR_2),
    ("CLOSED", "BYE"): lambda b: b.give(Bye(Reason.SHUTDOWN), session=9),
    ("CLOSED", "any other datagram"): lambda b: b.give(ENABLE, session=9),
    ("OPEN", "HELLO, same source, same nonce"): lambda b: b.give(Hello(1, 1, 0, 20), session=0),
    ("OPEN", "HELLO, same source, new nonce, sent later"): lambda b: b.give(
        Hello(2, 1, 0, 20), session=0, sent_ns=T0 + 1
    ),
    ("OPEN", "HELLO, same source, new nonce, sent earlier"): lambda b: b.give(
        Hello(2, 1, 0, 20), session=0, sent_ns=T0 - 1
    ),
    ("OPEN", "first datagram in the session of that WELCOME: HEARTBEAT"): confirmed,
    ("OPEN", "HELLO, arm_hash of another arm"): lambda b: b.give(Hello(2, 1, ARM + 1, 20), session=0),
    ("OPEN", "datagram of another major version"): lambda b: b.give_bytes(OF_MAJOR_2),
    ("OPEN", "HELLO, another source"): lambda b: b.give(Hello(2, 1, 0, 20), session=0, source="b"),
    ("OPEN", "HEARTBEAT"): lambda b: b.give(Heartbeat(T0)),
    ("OPEN", "request, id above all before"): decided_after_asking,
    ("OPEN", "request again, decided"): asked_again,
    ("OPEN", "request again, not yet decided"): asked_twice_undecided,
    ("OPEN", "request, id used, content differs"): asked_otherwise,
    ("OPEN", "request, id below the newest and not executed"): overtaken,
    ("OPEN", "state period has passed"): lambda b: b.server.publish(STATE, b.now_ns),
    ("OPEN", "duplicate, late or stale datagram"): not_to_be_used,
    ("OPEN", "datagram of this session from another source"): lambda b: b.give(ENABLE, source="b"),
    ("OPEN", "datagram of another session, not BYE"): lambda b: b.give(ENABLE, session=9),
    ("OPEN", "BYE"): lambda b: b.give(Bye(Reason.SHUTDOWN)),
    ("OPEN", "silence for more than link_timeout_ms"): silent,
    ("OPEN", "the controller ends"): lambda b: b.server.close(b.now_ns),
}

# What the tables say in words where a datagram's name alone would say too little.
SERVER_WORDS = {
    "ACKNOWLEDGEMENT after the decision": "ACKNOWLEDGEMENT",
    "the same ACKNOWLEDGEMENT": "ACKNOWLEDGEMENT",
    "the same WELCOME": "WELCOME",
}


@pytest.mark.parametrize("row", session_rows("server states"), ids=lambda row: f"{row.state}: {row.event}")
def test_the_server_does_as_its_table_says(row: SessionRow) -> None:
    bench = ServerBench(row.state)
    SERVER_PLAYS[row.state, row.event](bench)
    assert bench.outcome() == (row.then, SERVER_WORDS.get(row.sends, row.sends))


class ClientBench:
    """A client in the state that a row starts from."""

    def __init__(self, state: str) -> None:
        self.client = ReferenceClient(7)
        self.now_ns = T0
        self.hellos: list[Hello] = []
        if state != "CLOSED":
            self.client.connect(self.now_ns)
            self.hellos += self.sent(Hello)
        if state == "CONNECTED":
            self.welcome(self.hellos[0].client_nonce)

    def sent(self, kind: type) -> list:
        return [
            m for data in self.client.outgoing(self.now_ns) if isinstance(m := decode(data).message, kind)
        ]

    def welcome(self, nonce: int) -> None:
        welcome = WELCOME._replace(client_nonce=nonce)
        self.client.receive(encode(welcome, Header(77, 1, T0)), self.now_ns)

    def give(self, message: Message, session: int) -> None:
        self.client.receive(encode(message, Header(session, 2, T0)), self.now_ns)

    def wait(self, ms: float) -> None:
        self.now_ns += int(ms * MS)
        self.client.tick(self.now_ns)

    def outcome(self) -> tuple[str, str]:
        messages = [decode(data).message for data in self.client.outgoing(self.now_ns)]
        sent = " and ".join(
            f"BYE {m.reason.name}" if isinstance(m, Bye) else type(m).__name__.upper() for m in messages
        )
        if self.client.connected:
            return "CONNECTED", sent or "–"
        return "CLOSED" if self.client.next_deadline_ns() is None else "CONNECTING", sent or "–"


def eleventh_hello(bench: ClientBench) -> None:
    for _ in range(9):
        bench.wait(100)
        bench.hellos += bench.sent(Hello)
    assert len({hello.client_nonce for hello in bench.hellos}) == 1
    bench.wait(100)
    (hello,) = bench.sent(Hello)
    assert hello.client_nonce != bench.hellos[0].client_nonce
    bench.client.connect(bench.now_ns)


def second_hello(bench: ClientBench) -> None:
    bench.wait(99.9)
    assert bench.sent(Hello) == []
    bench.wait(0.1)
    (hello,) = bench.sent(Hello)
    assert hello == bench.hellos[0]
    bench.wait(100)


def welcomed(bench: ClientBench) -> None:
    bench.welcome(bench.hellos[0].client_nonce)
    bench.client.tick(bench.now_ns)


def heartbeat(bench: ClientBench) -> None:
    bench.wait(0)
    assert len(bench.sent(Heartbeat)) == 1
    bench.wait(9.9)
    assert bench.sent(Heartbeat) == []
    bench.wait(0.1)


def resent(bench: ClientBench) -> None:
    asked = bench.client.submit(ReferencePose(0, POSE, 0.0), bench.now_ns)
    bench.wait(19.9)
    bench.client.outgoing()
    bench.wait(0.1)
    (again,) = bench.sent(ReferencePose)
    assert again.command_id == asked
    bench.wait(20)


def acknowledged(bench: ClientBench) -> None:
    asked = bench.client.submit(ReferencePose(0, POSE, 0.0), bench.now_ns)
    bench.client.outgoing()
    bench.give(Acknowledgement(asked, Reason.ACCEPTED, 0.0, 0.0), 77)
    bench.client.tick(bench.now_ns + 1)
    bench.client.outgoing()
    bench.now_ns += 5 * MS
    bench.client.tick(bench.now_ns)


def deaf(bench: ClientBench) -> None:
    bench.wait(TIMEOUT_MS)
    bench.client.outgoing()
    assert bench.client.connected
    bench.wait(0.1)


CLIENT_PLAYS: dict[tuple[str, str], Callable[[ClientBench], object]] = {
    ("CLOSED", "asked to connect"): lambda b: b.client.connect(b.now_ns),
    ("CLOSED", "any datagram"): lambda b: b.give(STATE, 77),
    ("CONNECTING", "HELLO period has passed"): second_hello,
    ("CONNECTING", "HELLO period has passed after the tenth HELLO"): eleventh_hello,
    ("CONNECTING", "WELCOME with its nonce"): welcomed,
    ("CONNECTING", "WELCOME with another nonce"): lambda b: b.welcome(b.hellos[0].client_nonce + 1),
    ("CONNECTING", "BYE SESSION_OCCUPIED"): lambda b: b.give(Bye(Reason.SESSION_OCCUPIED), 0),
    ("CONNECTING", "BYE with any other reason"): lambda b: b.give(Bye(Reason.WRONG_ARM), 0),
    ("CONNECTED", "heartbeat period has passed"): heartbeat,
    ("CONNECTED", "request not answered within the resend time"): resent,
    ("CONNECTED", "ACKNOWLEDGEMENT of an open request"): acknowledged,
    ("CONNECTED", "BYE of the session"): lambda b: b.give(Bye(Reason.SHUTDOWN), 77),
    ("CONNECTED", "silence for more than link_timeout_ms"): deaf,
    ("CONNECTED", "asked to disconnect"): lambda b: b.client.disconnect(b.now_ns),
}
CLIENT_WORDS = {
    "HELLO, same nonce": "HELLO",
    "HELLO, new nonce": "HELLO",
    "the request, same id": "HEARTBEAT and REFERENCEPOSE",
}


@pytest.mark.parametrize("row", session_rows("client states"), ids=lambda row: f"{row.state}: {row.event}")
def test_the_client_does_as_its_table_says(row: SessionRow) -> None:
    bench = ClientBench(row.state)
    CLIENT_PLAYS[row.state, row.event](bench)
    assert bench.outcome() == (row.then, CLIENT_WORDS.get(row.sends, row.sends))
