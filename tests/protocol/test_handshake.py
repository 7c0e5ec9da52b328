"""A session begins with the client's first datagram in it: what a HELLO alone can do, forged or not."""

from protocol.datagram import Header, decode, encode
from protocol.reference_messages import Hello
from tests.protocol.wire import BOOT, a_server

T0 = 10**12


def test_a_session_s_number_cannot_be_computed_from_what_was_ever_sent() -> None:
    """Else a HELLO from a forged address could be followed by the heartbeat that begins its session."""
    told = set[bytes]()
    for secret in (0, 1, 1 << 100):
        server = a_server(boot_id=BOOT | secret << 64)
        server.receive(encode(Hello(1, 3, 0, 0), Header(0, 1, T0)), "a", T0)
        ((welcome, _),) = server.outgoing(T0)
        assert decode(welcome).message.boot_id == BOOT
        told.add(welcome)
    assert len(told) == 3
