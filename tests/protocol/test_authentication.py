"""Authentication: keys after their standard, tags over every byte, sessions that refuse what is forged."""

import hashlib
import hmac
from typing import Any

import pytest

from conformance.bytes_of import resealed
from protocol.authentication import DirectionKey, LinkKey, fault_of
from protocol.channel import MAX_GAP_DATAGRAMS, WINDOW_DATAGRAMS, Arrival, SequenceWindow
from protocol.client_session import ReferenceClient
from protocol.datagram import Header, decode, encode
from protocol.datagram_layout import HEADER_BYTES, TRAILER_BYTES
from protocol.errors import DatagramRefused
from protocol.faults import CommandCode, Reason
from protocol.reference_messages import (
    CAPABILITY_AUTHENTICATION,
    Bye,
    Command,
    Heartbeat,
    Hello,
    Message,
    Welcome,
)
from protocol.session_events import (
    Connected,
    ConnectionDelayed,
    DatagramDropped,
    SessionClosed,
    SessionLost,
    SessionOpened,
)
from tests.protocol.wire import ARM, MS, TIMEOUT_MS, Wire, a_server, kind_of
from tools.sample_messages import HEADER, MESSAGES

SECRET = bytes(range(32))
KEY = LinkKey(SECRET)
OTHER = LinkKey(bytes(32))
STOP = Command(1, CommandCode.STOP)


def a_wire(client: LinkKey | None = KEY, server: LinkKey | None = KEY, **wire: Any) -> Wire:
    return Wire(server=a_server(key=server), client=ReferenceClient(7, key=client), **wire)


def causes(events: list[Any]) -> list[str]:
    return [event.cause for event in events if isinstance(event, DatagramDropped)]


def session_keys(wire: Wire) -> Any:
    """The client's keys of the open session, as an attacker who knew the secret would derive them."""
    welcome = wire.client.welcome
    assert welcome is not None
    return KEY.of_client(welcome.client_nonce, wire.server.session, welcome.boot_id)


class TestKeys:
    def test_derivation_is_the_counter_mode_of_sp_800_108(self) -> None:
        """Against the formula spelt out with another implementation of HMAC (RFC 2104 by hand)."""

        def rfc2104(key: bytes, text: bytes) -> bytes:
            padded = key.ljust(64, b"\0")
            inner = hashlib.sha256(bytes(b ^ 0x36 for b in padded) + text).digest()
            return hashlib.sha256(bytes(b ^ 0x5C for b in padded) + inner).digest()

        nonce, session, boot = 0x0102030405060708, 0x1112131415161718, 0x2122232425262728
        context = b"".join(n.to_bytes(8, "little") for n in (nonce, session, boot))
        keys = KEY.of_client(nonce, session, boot)
        for label, key in ((b"LRLK 1 client", keys.sends), (b"LRLK 1 controller", keys.receives)):
            secret = rfc2104(SECRET, b"\0\0\0\1" + label + b"\0" + context + b"\0\0\1\0")
            data = bytes(range(64))
            assert key.tag(data) == rfc2104(secret, data[:12] + data[16:])[:16]
        assert KEY.key_id == int.from_bytes(rfc2104(SECRET, b"\0\0\0\1LRLK 1 key id\0\0\0\1\0")[:4], "little")

    def test_hmac_is_that_of_rfc_4231(self) -> None:
        """Test case 2 of RFC 4231; the tag leaves bytes 12…15 out, so the text is laid around them."""
        text = b"what do ya want for nothing?"
        tag = DirectionKey(b"Jefe", 0).tag(text[:12] + b"CRC!" + text[12:])
        assert tag.hex() == "5bdcc146bf60754e6a042426089575c7"

    def test_every_session_and_direction_has_its_own(self) -> None:
        data = bytes(64)
        tags = [KEY.of_hello().tag(data)]
        for numbers in ((1, 2, 3), (4, 2, 3), (1, 4, 3), (1, 2, 4), (2, 1, 3)):
            tags += [key.tag(data) for key in KEY.of_client(*numbers)]
        tags += [key.tag(data) for key in OTHER.of_client(1, 2, 3)]
        assert len(set(tags)) == len(tags)
        client, controller = KEY.of_client(1, 2, 3), KEY.of_controller(1, 2, 3)
        assert client.sends.tag(data) == controller.receives.tag(data)
        assert client.receives.tag(data) == controller.sends.tag(data)

    def test_a_short_secret_is_refused(self) -> None:
        with pytest.raises(ValueError, match="31 bytes"):
            LinkKey(bytes(31))


class TestTag:
    @pytest.mark.parametrize("message", MESSAGES, ids=lambda m: type(m).__name__)
    def test_signed_datagrams_carry_the_message_and_a_64_bit_number(self, message: Message) -> None:
        key = KEY.of_hello()
        header = HEADER._replace(sequence=0x0123_4567_89AB_CDEF)
        data = encode(message, header, key)
        assert len(data) == len(encode(message, HEADER)) + TRAILER_BYTES
        got = decode(data)
        assert got.message == message
        assert got.header.sequence == header.sequence
        assert data[HEADER_BYTES:-TRAILER_BYTES] == encode(message, HEADER)[HEADER_BYTES:]
        assert fault_of(data, got.header.flags, key) is None
        assert data[-24:-20] == bytes.fromhex("67452301")
        assert data[-20:-16] == KEY.key_id.to_bytes(4, "little")
        secret = hmac.digest(SECRET, b"\0\0\0\1LRLK 1 hello\0\0\0\1\0", "sha256")
        assert data[-16:] == hmac.digest(secret, data[:12] + data[16:-16], "sha256")[:16]

    def test_no_bit_can_be_changed(self) -> None:
        """With the CRC made right each time, so that nothing but the tag stands in the way."""
        key = KEY.of_hello()
        data = encode(STOP, HEADER, key)
        for bit in range(8 * len(data)):
            bent = bytearray(data)
            bent[bit // 8] ^= 1 << bit % 8
            encoded = resealed(bytes(bent))
            if encoded == data:  # the bit was one of the CRC's
                continue
            try:
                flags = decode(encoded).header.flags
            except DatagramRefused:
                continue
            fault = fault_of(encoded, flags, key)
            assert fault in ("authentication.bad_tag", "authentication.unknown_key"), bit

    def test_a_truncated_guess_is_not_enough(self) -> None:
        key = KEY.of_hello()
        data = encode(STOP, HEADER, key)
        for right in range(16):
            tag = data[-16 : -16 + right] + bytes(b ^ 0xFF for b in data[right - 16 :])
            bent = resealed(data[:-16] + tag)
            assert fault_of(bent, decode(bent).header.flags, key) == "authentication.bad_tag"

    def test_each_refusal_has_its_own_cause(self) -> None:
        plain, signed = encode(STOP, HEADER), encode(STOP, HEADER, KEY.of_hello())
        flags = decode(signed).header.flags
        assert fault_of(plain, 0, None) is None
        assert fault_of(plain, 0, KEY.of_hello()) == "authentication.missing"
        assert fault_of(signed, flags, None) == "authentication.no_key"
        assert fault_of(signed, flags, OTHER.of_hello()) == "authentication.unknown_key"
        assert fault_of(signed, flags, KEY.of_client(1, 2, 3).sends) == "authentication.bad_tag"


class TestWindow:
    def test_numbers_of_64_bits_do_not_wrap_at_32(self) -> None:
        window = SequenceWindow(2**32 - 2, 2**64)
        assert window.arrive(2**32 - 1) == (Arrival.NEW, 0)
        assert window.arrive(2**32 + 1) == (Arrival.NEW, 1)
        assert window.arrive(2**32) == (Arrival.LATE, 0)
        assert window.arrive(2**32) == (Arrival.DUPLICATE, 0)
        assert window.arrive(1) == (Arrival.OLD, 0)  # modulo 2^32 it would be the next
        assert window.arrive(2**33) == (Arrival.JUMP, 0)
        assert window.newest == 2**32 + 1

    def test_against_a_set_of_all_numbers_seen(self) -> None:
        """A shuffled, repeated stream: each number is used at most once, whatever the order."""
        window, seen = SequenceWindow(2**40, 2**64), {2**40}
        newest, x = 2**40, 12345
        for _ in range(5000):
            x = (1103515245 * x + 12345) % 2**31
            number = newest + (x >> 8) % 160 - 120
            if number < 2**40:
                continue
            arrival, _ = window.arrive(number)
            if number > newest:
                assert arrival is Arrival.NEW
            elif newest - number >= WINDOW_DATAGRAMS:
                assert arrival is Arrival.OLD
            else:
                assert arrival is (Arrival.DUPLICATE if number in seen else Arrival.LATE)
            if arrival in (Arrival.NEW, Arrival.LATE):
                seen.add(number)
            newest = max(newest, number)
        assert MAX_GAP_DATAGRAMS > 40


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

    def test_hello_with_a_bad_tag_is_told_so(self) -> None:
        server = a_server(key=KEY)
        data = encode(Hello(5, 7, ARM, 20), Header(0, 1, 0), KEY.of_client(1, 2, 3).sends)
        assert causes(server.receive(data, "a", 0)) == ["authentication.bad_tag"]
        ((answer, _),) = server.outgoing()
        assert decode(answer).message == Bye(Reason.BAD_TAG)
        assert server.statistics.bad_tag == 1

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
            assert causes(client.receive(encode(welcome, header, key), 1)) == [cause]
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

    def test_forged_datagrams_change_nothing_and_are_not_life(self) -> None:
        """A stream of forgeries in the client's name: counted, not executed; the session dies of silence."""
        wire = a_wire().connect().run(50)
        session, keys = wire.server.session, session_keys(wire)
        wire.loses = lambda direction, data: direction == "up"
        wire.run(2)  # what was on its way arrives
        before = wire.server.statistics
        forged = 0
        while wire.server.session is not None:
            forged += 1
            number = decode(wire.sent_up[-1]).header.sequence + forged
            header = Header(session, number, wire.now_ns)
            for key in (None, KEY.of_hello(), keys.receives, OTHER.of_client(8, session, 3).sends):
                wire.give_server(encode(Heartbeat(wire.now_ns), header, key))
                wire.give_server(encode(STOP, header, key))
                wire.give_server(encode(Bye(Reason.SHUTDOWN), header, key))
            wire.step()
            assert forged < 2 * TIMEOUT_MS
        after = wire.server.statistics
        assert wire.requests() == []
        assert isinstance(wire.server_events[-1], SessionClosed | DatagramDropped)
        closed = [event for event in wire.server_events if isinstance(event, SessionClosed)]
        assert [event.reason for event in closed] == [Reason.LINK_TIMEOUT]
        assert forged * wire.step_ns / MS == pytest.approx(TIMEOUT_MS, abs=40)
        assert (after.received, after.lost) == (before.received, before.lost)
        assert after.not_authenticated - before.not_authenticated in (3 * forged, 3 * forged - 3)
        assert after.bad_tag > before.bad_tag
        assert after.unknown_key > before.unknown_key

    def test_replays_are_refused_each_with_its_cause_and_late_ones_are_no_replay(self) -> None:
        held: list[bytes] = []
        wire = a_wire(loses=lambda direction, data: bool(held) and data in held).connect().run(60)
        recorded = list(wire.sent_up)
        requests = len(wire.requests())
        assert {cause for data in recorded[1:] for cause in causes(wire.give_server(data))} <= {
            "authentication.replayed",
            "sequence.reordered",
        }
        replayed = wire.server.statistics.replayed
        assert replayed >= len(recorded) - 2
        wire.run(TIMEOUT_MS * 16)  # more than a window of heartbeats
        assert causes(wire.give_server(recorded[3])) == ["authentication.too_old"]
        assert wire.server.statistics.too_old == 1
        assert len(wire.requests()) == requests
        assert wire.client.connected

    def test_a_late_datagram_is_taken_off_the_losses_and_a_replay_is_not(self) -> None:
        wire = a_wire().connect().run(60)
        wire.loses = lambda direction, data: direction == "up"
        number = decode(wire.sent_up[-1]).header.sequence
        wire.run(2)
        keys, session = session_keys(wire), wire.server.session

        def beat(ahead: int) -> list[Any]:
            header = Header(session, number + ahead, wire.now_ns)
            data = encode(Heartbeat(wire.now_ns), header, keys.sends)
            return wire.server.receive(data, "vision", wire.server_ns)

        lost = wire.server.statistics.lost
        assert beat(3) == []
        assert wire.server.statistics.lost == lost + 2
        assert causes(beat(1)) == ["sequence.reordered"]
        assert wire.server.statistics.lost == lost + 1
        assert causes(beat(1)) == ["authentication.replayed"]
        assert causes(beat(3)) == ["authentication.replayed"]
        assert wire.server.statistics.lost == lost + 1
        assert causes(beat(3 + MAX_GAP_DATAGRAMS + 1)) == ["sequence.jump"]
        assert beat(4) == []

    def test_nothing_of_an_earlier_session_is_used(self) -> None:
        wire = a_wire().connect().run(100)
        wire.client.submit(STOP, wire.now_ns)
        wire.run(20)
        recorded = list(wire.sent_up)
        wire.client.disconnect(wire.now_ns)
        wire.run(10)
        wire.connect().run(100)
        requests, session = len(wire.requests()), wire.server.session
        for data in recorded:
            wire.give_server(data)
            bent = bytearray(data)  # with the new session's number written over the old one
            bent[16:24] = session.to_bytes(8, "little")
            assert causes(wire.give_server(resealed(bytes(bent))))
        assert wire.server.session == session
        assert len(wire.requests()) == requests
        assert wire.run(50).client.connected

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

    def test_a_recorded_hello_does_not_end_the_session_in_use(self) -> None:
        wire = a_wire()
        recorded = []
        for _ in range(70):  # more sessions than nonces are remembered
            wire.connect()
            recorded.append(next(data for data in reversed(wire.sent_up) if kind_of(data) == "Hello"))
            wire.client.disconnect(wire.now_ns)
            wire.run(2)
        wire.connect().run(50)
        session = wire.server.session
        later = wire.server.receive(recorded[0], "vision", wire.server_ns)
        assert wire.server.session == session
        assert not any(isinstance(event, SessionOpened | SessionClosed) for event in later)
        wire.run(TIMEOUT_MS + 50)
        assert wire.server.session == session
        assert wire.client.connected

    def test_a_client_that_restarts_gets_its_session_once_it_has_shown_its_key(self) -> None:
        wire = a_wire().connect().run(50)
        old = wire.server.session
        wire.client = ReferenceClient(99, key=KEY)
        wire.connect().run(20)
        assert wire.server.session not in (None, old)
        ends = [event for event in wire.server_events if isinstance(event, SessionClosed)]
        assert ends == [SessionClosed(old, Reason.PEER_RESTARTED)]

    def test_a_grant_that_is_never_confirmed_is_forgotten(self) -> None:
        server = a_server(key=KEY)
        hello = encode(Hello(5, 7, ARM, 20), Header(0, 1, 0), KEY.of_hello())
        server.receive(hello, "a", 0)
        ((data, _),) = server.outgoing()
        session = decode(data).header.session
        late = (TIMEOUT_MS + 1) * MS
        beat = encode(Heartbeat(late), Header(session, 2, late), KEY.of_client(5, session, 0xB007).sends)
        assert causes(server.receive(beat, "a", late)) == ["session.unknown"]
        assert server.session is None

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

    def test_the_clock_and_age_are_not_moved_by_a_forged_datagram(self) -> None:
        wire = a_wire().connect().run(200)
        before, session = wire.client.clock, wire.server.session
        forged = encode(Heartbeat(0), Header(session, 10**6, 0), KEY.of_hello())
        wire.give_server(forged)
        wire.client.receive(forged, wire.now_ns)
        assert wire.client.clock == before
        assert wire.run(50).server.statistics.stale == 0

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
