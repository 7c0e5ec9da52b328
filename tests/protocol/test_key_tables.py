"""Every row of the published table of a controller with a key, played on the session."""

from collections.abc import Callable

import pytest

from conformance.wire import resealed, with_bit_flipped
from protocol.authentication import DirectionKey, LinkKey
from protocol.datagram import Header, decode, encode
from protocol.datagram_layout import HEADER_BYTES
from protocol.faults import Reason
from protocol.reference_messages import Bye, Heartbeat, Hello, Message, Welcome
from tests.protocol.test_session_tables import T0, spoken
from tests.protocol.wire import ARM, a_server
from tools.tables import KEY_SERVER_ROWS, Row

KEY, OTHER = LinkKey(bytes(range(32))), LinkKey(bytes(32))


class Bench:
    """A controller with a key in the state that a row starts from."""

    def __init__(self, state: str) -> None:
        self.server = a_server(key=KEY)
        self.now_ns, self.sequence, self.nonce = T0, 100, 0
        self.session, self.key = 0, KEY.of_hello()
        if state == "OPEN":
            self.greet()
            self.beat()
            self.server.outgoing()

    def give(
        self, message: Message, key: DirectionKey | None, session: int, sequence: int | None = None
    ) -> bytes:
        """Hands over one datagram; it takes the next number."""
        self.sequence += 1
        number = self.sequence if sequence is None else sequence
        data = encode(message, Header(session, number, self.now_ns), key)
        self.server.receive(data, "a", self.now_ns)
        return data

    def hello(self, key: DirectionKey | None) -> None:
        self.nonce += 1
        self.give(Hello(self.nonce, 7, ARM, 20), key, 0)

    def greet(self) -> None:
        """HELLO, and the keys that its WELCOME grants."""
        self.hello(KEY.of_hello())
        ((data, _),) = self.server.outgoing()
        header, welcome = decode(data)
        assert isinstance(welcome, Welcome)
        self.session = header.session
        self.key = KEY.of_client(self.nonce, header.session, welcome.boot_id).sends

    def beat(self) -> bytes:
        return self.give(Heartbeat(self.now_ns), self.key, self.session)

    def outcome(self) -> tuple[str, str]:
        """Next state and what was sent, in the words of the tables."""
        sent = " and ".join(spoken(data) for data, _ in self.server.outgoing()) or "–"
        if self.server.session is None:
            return "CLOSED", sent
        return "OPEN", sent


def wrong_tag(bench: Bench) -> None:
    data = encode(Hello(9, 7, ARM, 20), Header(0, 999, bench.now_ns), KEY.of_hello())
    bench.server.receive(resealed(with_bit_flipped(data, 8 * HEADER_BYTES)), "a", bench.now_ns)


def confirmed(bench: Bench) -> None:
    bench.greet()
    bench.beat()


def forged(bench: Bench) -> None:
    for key in (None, OTHER.of_client(1, bench.session, 1).sends, KEY.of_hello()):
        bench.give(Heartbeat(bench.now_ns), key, bench.session)


def replayed(bench: Bench) -> None:
    old = bench.beat()
    bench.server.outgoing()
    bench.server.receive(old, "a", bench.now_ns)
    bench.sequence += 100
    bench.beat()
    bench.server.outgoing()
    bench.server.receive(old, "a", bench.now_ns)


EVENTS: dict[str, Callable[[Bench], None]] = {
    "HELLO, signed": lambda b: b.hello(KEY.of_hello()),
    "HELLO, not signed": lambda b: b.hello(None),
    "HELLO, signed with another key": lambda b: b.hello(OTHER.of_hello()),
    "HELLO, with a wrong tag": wrong_tag,
    "first HEARTBEAT under the keys of WELCOME": confirmed,
    "datagram not signed, of another key or with a wrong tag": forged,
    "replay, or number behind the window": replayed,
    "BYE not signed": lambda b: b.give(Bye(Reason.SHUTDOWN), None, b.session) and None,
}


@pytest.mark.parametrize("row", KEY_SERVER_ROWS, ids=lambda row: f"{row.state}-{row.event}")
def test_a_controller_with_a_key_does_what_the_table_says(row: Row) -> None:
    bench = Bench(row.state)
    EVENTS[row.event](bench)
    assert bench.outcome() == (row.then, row.sends)


def test_every_row_is_played() -> None:
    assert {row.event for row in KEY_SERVER_ROWS} == set(EVENTS)
