"""Cases 723…: trailer, window and order of the checks in authenticated sessions (clause 11)."""

from conformance.bytes_of import resealed, with_bit_flipped
from conformance.peer import RATION_MS, Peer
from conformance.reference.authentication import OTHER_KEY, case, opened, signed
from conformance.reference.datagrams.clocks import WINDOW, tallies
from conformance.reference.framing import refused, stop
from conformance.reference.handshake import granted, require_begun
from conformance.wire import require
from protocol.authentication import DirectionKey
from protocol.datagram import Header, encode
from protocol.datagram_layout import HEADER_BYTES, TAG_BYTES, TRAILER_BYTES
from protocol.faults import Reason
from protocol.reference_messages import Bye, Heartbeat, Hello, State, Welcome

KEY_ID = slice(-TRAILER_BYTES + 4, -TAG_BYTES)


@case(723, "11.7", "63 behind the newest number a late one is taken off the losses, 64 behind it is not")
def window(peer: Peer) -> None:
    opened(peer, period_ms=20)
    lost, gone = tallies(peer)
    for behind, taken_off in ((WINDOW - 1, 1), (WINDOW, 0), (WINDOW + 1, 0), (1, 1)):
        peer.sequence += 99
        peer.alive("behind a gap of 99")
        peer.send(stop(peer), sequence=peer.sequence - behind)
        require(not peer.answers(f"a request {behind} behind"), f"a request {behind} behind was used")
        now_lost, now_gone = tallies(peer)
        require(now_lost - lost == 99 - taken_off, f"{behind} behind: {now_lost - lost} lost of a gap of 99")
        require(now_gone - gone == 1, f"{behind} behind: {now_gone - gone} dropped")
        lost, gone = now_lost, now_gone


@case(724, "11.4", "a wrong key_id under a right tag is refused: UNKNOWN_KEY to HELLO, no answer to others")
def wrong_key_id(peer: Peer) -> None:
    opened(peer)
    data = peer.encoded(stop(peer))
    for bit in range(32):
        at = len(data) - TRAILER_BYTES + 4
        refused(peer, [peer.resealed(with_bit_flipped(data, 8 * at + bit))], "another key_id")
    peer.leave()
    peer.collect(RATION_MS, beating=False)
    data = peer.encoded(Hello(peer.nonce(), peer.required | 1, 0, 50), session=0)
    flipped = with_bit_flipped(data, 8 * (len(data) - TRAILER_BYTES + 4) + 31)
    peer.send_raw(peer.resealed(flipped))
    got = [d.message for d in peer.collect(100, beating=False) if isinstance(d.message, Bye | Welcome)]
    require(got == [Bye(Reason.UNKNOWN_KEY)], f"HELLO with another key_id: came {got}")


@case(725, "11.2", "HELLO is judged in order: form, key, tag, and only then session, nonce, arm and source")
def key_before_all_else(peer: Peer) -> None:
    nonce = peer.nonce()
    wrong = opened(peer, nonce=nonce).arm_hash ^ 1 or 2
    peer.leave()
    opened(peer)
    other = peer.second()
    session_key = peer.keys_of(peer.session).sends

    def asked(what: str, source: Peer, data: bytes, wanted: list[Bye]) -> None:
        peer.collect(RATION_MS)
        source.drain()
        source.send_raw(data)
        got = [d.message for d in source.collect(40, beating=False)]
        got = [m for m in got if isinstance(m, Bye | Welcome)]
        require(got == wanted, f"{what}: came {got}, wanted {wanted}")

    def hello(key: DirectionKey | None, arm_hash: int = 0, session: int = 0, number: int = 0) -> bytes:
        message = Hello(number or peer.nonce(), peer.required | 1, arm_hash, 50)
        return signed(peer, message, key, session=session)

    for key, reason in (
        (None, Reason.NOT_AUTHENTICATED),
        (OTHER_KEY.of_hello(), Reason.UNKNOWN_KEY),
        (session_key, Reason.BAD_TAG),
    ):
        told = [Bye(reason)]
        asked(f"{reason.name}, in a session", peer, hello(key, session=peer.session), told)
        asked(f"{reason.name}, replayed", peer, hello(key, number=nonce), told)
        asked(f"{reason.name}, another arm", peer, hello(key, wrong), told)
        asked(f"{reason.name}, another source", other, hello(key), told)
    formless = peer.with_number(hello(None), HEADER_BYTES, "Q", 0)
    asked("a nonce of 0, not signed", peer, resealed(formless[: HEADER_BYTES + 32]), [])
    peer.alive("after these")


@case(726, "11.10", "an unsigned, replayed or forged datagram moves neither count, age nor losses")
def nothing_moves(peer: Peer) -> None:
    opened(peer, period_ms=20)
    peer.alive("before")
    assert peer.link_key is not None
    replay = peer.send(Heartbeat(1))
    lost, gone = tallies(peer)
    keys = (None, peer.link_key.of_hello(), OTHER_KEY.of_hello(), peer.keys_of(peer.session).receives)
    for n, key in enumerate(keys):
        before = peer.sequence
        peer.sequence += 1000
        peer.send_raw(signed(peer, Heartbeat(1), key, sent_ns=peer.now_ns + 10**10))
        peer.sequence = before
        peer.send_raw(replay)
        peer.alive(f"after forgery {n}")
    now_lost, now_gone = tallies(peer)
    require(now_lost == lost, f"{now_lost - lost} count as lost")
    require(now_gone - gone == 2 * len(keys), f"{now_gone - gone} dropped of {2 * len(keys)}")


@case(727, "11.7", "HELLO's number is the client's first: what is skipped behind it counts as lost")
def first_number(peer: Peer) -> None:
    opened(peer, period_ms=20)
    lost, _ = tallies(peer)
    peer.leave()
    peer.sequence = 2**40 + 7
    session = granted(peer, period_ms=20)
    peer.sequence += 3
    require_begun(peer, session, "behind a gap of 3")
    now_lost, _ = tallies(peer)
    require(now_lost - lost == 3, f"{now_lost - lost} lost of a gap of 3")


@case(728, "11.7", "a number whose upper half alone is newer is a leap, and not used")
def upper_half(peer: Peer) -> None:
    opened(peer)
    key = peer.keys_of(peer.session).sends
    number = peer.sequence + 2**32 + 1
    data = encode(stop(peer), Header(peer.session, number, peer.now_ns, minor=peer.minor), key)
    refused(peer, [data], "a number 2^32 ahead")
    peer.ask(stop(peer), "the next number")


@case(729, "11.3", "payload_bytes does not count the trailer: with it counted, a datagram is dropped")
def trailer_is_not_payload(peer: Peer) -> None:
    opened(peer)
    data = peer.encoded(stop(peer))
    counted = peer.with_number(data, 10, "H", len(data) - HEADER_BYTES)
    short = peer.with_number(data[:-1], 10, "H", len(data) - HEADER_BYTES - TRAILER_BYTES)
    refused(peer, [counted, short], "a length that counts the trailer, or a trailer cut short")


@case(730, "11.9", "BYE to those without a session is not signed, and is no BYE of a session")
def hints_are_unsigned(peer: Peer) -> None:
    opened(peer, period_ms=20)
    other = peer.second()
    peer.collect(RATION_MS)
    other.send(Hello(other.nonce(), peer.required | 1, 0, 50), session=0)
    datagram = other.receive(200, beating=False)
    require(datagram is not None, "no answer to a second client")
    assert datagram is not None
    require(datagram.message == Bye(Reason.SESSION_OCCUPIED), f"came {datagram.message}")
    require(not datagram.header.flags & 1 << 8, "BYE to a stranger is signed")
    require(datagram.header.session == 0, "BYE to a stranger names a session")
    states = [d for d in peer.collect(100) if isinstance(d.message, State)]
    require(bool(states), "the session suffered")
