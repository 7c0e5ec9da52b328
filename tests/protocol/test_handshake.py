"""A session begins with the client's first datagram in it: what a HELLO alone can do, forged or not."""

from collections import Counter

import pytest

from conformance.wire import with_number
from protocol.authentication import LinkKey
from protocol.datagram import Header, decode, encode
from protocol.datagram_layout import HEADER_BYTES
from protocol.faults import CommandCode, Reason
from protocol.reference_messages import Bye, Command, Heartbeat, Hello, State
from tests.protocol.sample_messages import MESSAGES
from tests.protocol.wire import ARM, BOOT, CYCLE_NS, MS, TIMEOUT_MS, a_server

STATE = next(m for m in MESSAGES if isinstance(m, State))
T0 = 10**12
KEY = LinkKey(bytes(range(32)))


def hello(nonce: int, sequence: int, *, key: LinkKey | None = None) -> bytes:
    """A HELLO that asks for STATE in every scan."""
    message = Hello(nonce, 7 if key else 3, 0, 0)
    return encode(message, Header(0, sequence, T0), key.of_hello() if key else None)


STRAY = encode(Command(5, CommandCode.STOP), Header(0x1234, 1, T0))
FLOODS = {
    "one HELLO": [hello(1, 1)],
    "one signed HELLO": [hello(1, 1, key=KEY)],
    "HELLO again and again": [hello(1, n) for n in range(1, 41)],
    "HELLO under new nonces": [hello(n, n) for n in range(1, 41)],
    "HELLO for another arm": [encode(Hello(1, 3, ARM + 1, 0), Header(0, 1, T0))] * 40,
    "strays": [STRAY] * 40,
    "the least that is answered": [STRAY[:HEADER_BYTES]] * 20
    + [with_number(STRAY[:HEADER_BYTES], 4, "B", 9)] * 20,
}


@pytest.mark.parametrize("flood", FLOODS)
def test_who_has_not_proved_to_hear_is_sent_at_most_three_times_what_he_sent(flood: str) -> None:
    datagrams = FLOODS[flood]
    server = a_server(key=KEY if "signed" in flood else None)
    to, now_ns = Counter[object](), T0
    for cycle in range(TIMEOUT_MS * MS // CYCLE_NS + 20):
        for data in datagrams if cycle == 0 else []:
            server.receive(data, "spoofed", now_ns)
        server.tick(now_ns)
        server.publish(STATE, now_ns)
        for data, source in server.outgoing(now_ns):
            to[source] += len(data)
        now_ns += CYCLE_NS
    assert set(to) <= {"spoofed"}
    assert to["spoofed"] <= 3 * sum(map(len, datagrams))
    assert to["spoofed"] or flood != "one HELLO"


def test_bye_withdraws_a_grant() -> None:
    server = a_server()
    server.receive(hello(1, 1), "a", T0)
    ((welcome, _),) = server.outgoing()
    session = decode(welcome).header.session
    assert server.receive(encode(Bye(Reason.SHUTDOWN), Header(session, 2, T0)), "a", T0) == []
    server.receive(encode(Heartbeat(T0), Header(session, 3, T0)), "a", T0)
    assert [decode(data).message for data, _ in server.outgoing()] == [Bye(Reason.UNKNOWN_SESSION)]


def test_a_session_s_number_cannot_be_computed_from_what_was_ever_sent() -> None:
    """Else a HELLO from a forged address could be followed by the heartbeat that begins its session."""
    told = set[bytes]()
    for secret in (0, 1, 1 << 100):
        server = a_server(boot_id=BOOT | secret << 64)
        server.receive(hello(1, 1), "a", T0)
        ((welcome, _),) = server.outgoing(T0)
        assert decode(welcome).message.boot_id == BOOT
        told.add(welcome)
    assert len(told) == 3
