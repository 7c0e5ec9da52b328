"""Authentication: sessions that refuse what is forged, replayed or unsigned."""

from typing import Any

import pytest

from protocol.authentication import LinkKey
from protocol.client_session import ReferenceClient
from protocol.datagram import Header, decode, encode
from protocol.faults import CommandCode, Reason
from protocol.reference_messages import (
    CAPABILITY_AUTHENTICATION,
    Bye,
    Command,
    Hello,
    Welcome,
)
from protocol.session_events import (
    Connected,
    ConnectionDelayed,
    SessionClosed,
    SessionLost,
    SessionOpened,
)
from tests.protocol.wire import ARM, MS, TIMEOUT_MS, Wire, a_server, dropped_causes, kind_of

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
    def test_both_ends_with_the_key_open_a_signed_session(self) -> None:
        wire = a_wire().connect().run(300)
        wire.client.submit(STOP, wire.now_ns)
        wire.run(20)
        assert wire.requests() == [STOP._replace(command_id=wire.requests()[0].command_id)]
        assert len(wire.sessions()) == 1
        assert wire.client.welcome.capabilities & CAPABILITY_AUTHENTICATION
        assert all(decode(data).header.flags & 0x100 for data in wire.sent_up)
        assert wire.client.statistics.dropped == wire.server.statistics.dropped == 0
        assert wire.client.clock is not None

    def test_without_a_key_nothing_is_signed_and_the_capability_is_not_granted(self) -> None:
        wire = a_wire(None, None).connect().run(50)
        assert not wire.client.welcome.capabilities & CAPABILITY_AUTHENTICATION
        assert not any(decode(data).header.flags & 0x100 for data in wire.sent_up)
        asking = Hello(5, 2**64 - 1, ARM, 20)
        server = a_server()
        server.receive(encode(asking, Header(0, 1, 0)), "a", 0)
        ((data, _),) = server.outgoing()
        assert not decode(data).message.capabilities & CAPABILITY_AUTHENTICATION

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

    def test_a_recorded_hello_opens_nothing_even_after_a_restart_of_the_controller(self) -> None:
        """Nonces are forgotten in a restart; without the confirmation the recording would open a session."""
        wire = a_wire().connect().run(100)
        recorded = list(wire.sent_up)
        restarted = a_server(key=KEY, boot_id=0xB008)
        events = [event for data in recorded for event in restarted.receive(data, "vision", wire.server_ns)]
        answers = [decode(data).message for data, _ in restarted.outgoing()]
        assert isinstance(answers[0], Welcome)
        assert restarted.session is None
        assert not restarted.link_alive(wire.server_ns)
        assert not any(isinstance(event, SessionOpened) for event in events)

    def test_a_client_that_restarts_gets_its_session_once_it_has_shown_its_key(self) -> None:
        wire = a_wire().connect().run(50)
        old = wire.server.session
        wire.client = ReferenceClient(99, key=KEY)
        wire.connect().run(20)
        assert wire.server.session not in (None, old)
        ends = [event for event in wire.server_events if isinstance(event, SessionClosed)]
        assert ends == [SessionClosed(old, Reason.PEER_RESTARTED)]

    def test_lost_confirmations_and_welcomes_are_made_up_for(self) -> None:
        for lost in range(1, 6):
            count = [0]

            def loses(direction: str, data: bytes, upto: int = lost, count: list[int] = count) -> bool:
                count[0] += 1
                return count[0] <= upto

            wire = a_wire(loses=loses)
            wire.client.connect(wire.now_ns)
            wire.run(900)
            assert wire.client.connected, lost
            assert wire.server.session is not None
            assert wire.server.link_alive(wire.server_ns)
            wire.client.submit(STOP, wire.now_ns)
            assert len(wire.run(30).requests()) == 1

    def test_a_repeated_request_is_the_same_under_another_tag(self) -> None:
        """Tag and number differ each time; the ledger must look at the payload alone."""
        lost = [True]
        wire = a_wire(
            loses=lambda way, data: way == "down" and lost[0] and kind_of(data) == "Acknowledgement"
        )
        wire.connect().run(50)
        wire.client.submit(STOP, wire.now_ns)
        wire.run(100)
        lost[0] = False
        wire.run(100)
        assert len(wire.requests()) == 1
        answers = [e.acknowledgement.reason for e in wire.client_events if hasattr(e, "acknowledgement")]
        assert answers == [Reason.ACCEPTED]
