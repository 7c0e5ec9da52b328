"""Every row of the published table of a controller with a key, played on the session."""

from collections.abc import Callable

import pytest

from conformance.wire import resealed, with_bit_flipped
from protocol.authentication import DirectionKey, LinkKey
from protocol.datagram import Header, encode
from protocol.datagram_layout import HEADER_BYTES
from protocol.faults import Reason
from protocol.reference_messages import Bye, Heartbeat, Hello, Message
from tests.protocol.test_session_tables import ServerBench, confirmed
from tests.protocol.wire import ARM
from tests.support.pages import SessionRow, session_rows

KEY, OTHER = LinkKey(bytes(range(32))), LinkKey(bytes(32))
ROWS = session_rows("key states")


def given(bench: ServerBench, message: Message, key: DirectionKey | None, session: int = 0) -> None:
    """Hands over ``message`` under another key."""
    bench.key = key
    bench.give(message, session)


def greeted(key: DirectionKey | None) -> Callable[[ServerBench], None]:
    return lambda bench: given(bench, Hello(9, 7, ARM, 20), key)


def wrong_tag(bench: ServerBench) -> None:
    data = encode(Hello(9, 7, ARM, 20), Header(0, 999, bench.now_ns), KEY.of_hello())
    bench.give_bytes(resealed(with_bit_flipped(data, 8 * HEADER_BYTES)))


def forged(bench: ServerBench) -> None:
    for key in (None, OTHER.of_client(1, bench.session, 1).sends, KEY.of_hello()):
        given(bench, Heartbeat(bench.now_ns), key, bench.session)


def replayed(bench: ServerBench) -> None:
    old = bench.give(Heartbeat(bench.now_ns))
    bench.server.outgoing()
    bench.give_bytes(old)
    bench.sequence += 100
    bench.give(Heartbeat(bench.now_ns))
    bench.server.outgoing()
    bench.give_bytes(old)


EVENTS: dict[str, Callable[[ServerBench], None]] = {
    "HELLO, signed": greeted(KEY.of_hello()),
    "HELLO, not signed": greeted(None),
    "HELLO, signed with another key": greeted(OTHER.of_hello()),
    "HELLO, with a wrong tag": wrong_tag,
    "first HEARTBEAT under the keys of WELCOME": confirmed,
    "datagram not signed, of another key or with a wrong tag": forged,
    "replay, or number behind the window": replayed,
    "BYE not signed": lambda bench: given(bench, Bye(Reason.SHUTDOWN), None, bench.session),
}


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row.state}-{row.event}")
def test_a_controller_with_a_key_does_what_the_table_says(row: SessionRow) -> None:
    bench = ServerBench(row.state, KEY)
    EVENTS[row.event](bench)
    assert bench.outcome() == (row.then, row.sends)


def test_every_row_is_played() -> None:
    assert {row.event for row in ROWS} == set(EVENTS)
