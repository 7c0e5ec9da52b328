"""Authentication: sessions that refuse what is forged, replayed or unsigned."""

from typing import Any

import pytest

from protocol.authentication import LinkKey
from protocol.client_session import ReferenceClient
from protocol.datagram import Header, decode, encode
from protocol.faults import CommandCode, Reason
from protocol.reference_messages import (
    Bye,
    Command,
    Welcome,
)
from protocol.session_events import (
    Connected,
    ConnectionDelayed,
    SessionLost,
    SessionOpened,
)
from tests.protocol.wire import ARM, MS, TIMEOUT_MS, Wire, a_server, dropped_causes

SECRET = bytes(range(32))
KEY = LinkKey(SECRET)
OTHER = LinkKey(bytes(32))
STOP = Command(1, CommandCode.STOP)


def a_wire(client: LinkKey | None = KEY, server: LinkKey | None = KEY, **wire: Any) -> Wire:
    return Wire(server=a_server(key=server), client=ReferenceClient(7, key=client), **wire)


def session_keys(wire: Wire) -> Any:
    """The client's keys of the open session, as an attacker who knew the secret would derive them."""
    welcome = wire.client.welcome
    assert welcome is not None
    return KEY.of_client(welcome.client_nonce, wire.server.session, welcome.boot_id)


class TestSessions:
    @pytest.mark.parametrize(
        ("client", "server", "reason", "counter"),
        [
            (None, KEY, Reason.NOT_AUTHENTICATED, "not_authenticated"),
            (KEY, None, Reason.KEY_NOT_CONFIGURED, "key_not_configured"),
            (OTHER, KEY, Reason.UNKNOWN_KEY, "unknown_key"),
        ],
    )
    def test_there_is_no_downgrade(
        self, client: LinkKey | None, server: LinkKey | None, reason: Reason, counter: str
    ) -> None:
        wire = a_wire(client, server)
        wire.client.connect(wire.now_ns)
        wire.run(450)
        assert not wire.client.connected
        assert wire.server.session is None
        assert not any(isinstance(event, SessionOpened) for event in wire.server_events)
        assert getattr(wire.server.statistics, counter) >= 1
        if client is None:
            assert wire.client_events == [SessionLost(reason, ())]
        else:  # it keeps asking, and says what it was told
            assert ConnectionDelayed(reason) in wire.client_events
            assert wire.client.statistics.not_authenticated >= 1
            assert wire.server.statistics.dropped >= 4

    @pytest.mark.parametrize("key", [None, KEY])
    def test_a_session_is_authenticated_while_it_is_open_and_signed(self, key: LinkKey | None) -> None:
        wire = a_wire(key, key)
        states = [wire.client.authenticated]
        wire.client.connect(wire.now_ns)
        wire.run(50)
        assert wire.client.connected
        states.append(wire.client.authenticated)
        wire.client.disconnect(wire.now_ns)
        states.append(wire.client.authenticated)
        assert states == [False, key is not None, False]

    def test_a_client_does_not_take_an_unsigned_or_forged_welcome(self) -> None:
        client = ReferenceClient(7, key=KEY)
        client.connect(0)
        (hello,) = client.outgoing()
        nonce = decode(hello).message.client_nonce
        welcome = Welcome(nonce, 1, ARM, 9, 5 * MS, TIMEOUT_MS, 20)
        header = Header(77, 1, 0)
        for key, cause in (
            (None, "authentication.missing"),
            (OTHER.of_controller(nonce, 77, 9).sends, "authentication.unknown_key"),
            (KEY.of_client(nonce, 77, 9).sends, "authentication.bad_tag"),  # of the other direction
            (KEY.of_controller(nonce, 78, 9).sends, "authentication.bad_tag"),  # of another session
            (KEY.of_controller(nonce, 77, 8).sends, "authentication.bad_tag"),  # of another boot
            (KEY.of_controller(nonce + 1, 77, 9).sends, "authentication.bad_tag"),  # of another HELLO
            (KEY.of_hello(), "authentication.bad_tag"),
        ):
            assert dropped_causes(client.receive(encode(welcome, header, key), 1)) == [cause]
            assert not client.connected
        right = encode(welcome, header, KEY.of_controller(nonce, 77, 9).sends)
        assert [type(event) for event in client.receive(right, 1)] == [Connected]

    def test_an_unsigned_bye_does_not_end_the_client_s_session_nor_its_attempt(self) -> None:
        wire = a_wire()
        wire.client.connect(wire.now_ns)
        hint = encode(Bye(Reason.WRONG_ARM), Header(0, 0, 0))
        assert wire.client.receive(hint, wire.now_ns)[1:] == [ConnectionDelayed(Reason.WRONG_ARM)]
        wire.connect().run(2)
        session = wire.server.session
        for key in (None, KEY.of_hello(), session_keys(wire).sends):
            forged = encode(Bye(Reason.SHUTDOWN), Header(session, 99, wire.now_ns), key)
            wire.client.receive(forged, wire.now_ns)
            assert wire.client.connected
