"""Cases 130… and 891…: what the controller sends, field by field, and what holds of all that comes."""

import itertools

from conformance.case import reference
from conformance.noted import Always
from conformance.parts import OptionalPart
from conformance.peer import RATION_MS, Peer
from conformance.reference.arm_transitions import entered
from conformance.reference.authentication import OTHER_KEY, opened, signed
from conformance.reference.authentication import case as key_case
from conformance.reference.framing import MAJOR, refused, stop
from conformance.reference.handshake import granted, require_begun
from conformance.reference.order import WINDOW, tallies
from conformance.reference.streaming import Stream
from conformance.wire import ANSWER_MS, MS, require, resealed, with_bit_flipped
from protocol.authentication import DirectionKey
from protocol.axes_group import Mode
from protocol.datagram import Datagram, Header, decode, encode
from protocol.datagram_layout import (
    HEADER_BYTES,
    TRAILER_BYTES,
)
from protocol.faults import CommandCode, Reason
from protocol.reference_messages import (
    Bye,
    Command,
    Heartbeat,
    HeartbeatReply,
    Hello,
    ReferencePose,
    State,
    Welcome,
)

case = reference.case
KIND, FLAGS = 6, 8
SESSIONS = 8
# Two of a few dozen sound session numbers are nearer to one another once in 10^8 runs.
LEAST_BITS = 8


@case(132, "4.4", "BYE to those without a session: sequence 0, and session 0 or the one asked for")
def bye_header(peer: Peer) -> None:
    arm_hash = peer.open().arm_hash
    another_arm = Hello(peer.nonce(), 1 | peer.required, arm_hash ^ 1 or 2, 50)
    stranger = peer.second()
    versioned = peer.with_number(peer.encoded(another_arm, session=0), MAJOR, "B", 9)
    for what, data, session in (
        ("another arm", stranger.encoded(another_arm, session=0), 0),
        ("a session in use", stranger.encoded(another_arm._replace(arm_hash=0), session=0), 0),
        ("another major version", versioned, 0),
        ("an unknown session", stranger.encoded(stop(peer), session=0x1234), 0x1234),
    ):
        peer.collect(RATION_MS)
        stranger.send_raw(data)
        datagram = stranger.receive(ANSWER_MS, beating=False)
        require(datagram is not None, f"{what}: no answer")
        assert datagram is not None
        header = datagram.header
        require(isinstance(datagram.message, Bye), f"{what}: {datagram.message}")
        require(header.session == session, f"{what}: BYE in session {header.session:#x}")
        require(header.sequence == 0, f"{what}: BYE has sequence {header.sequence}")


@case(133, "5.1", "BYE that ends a session is in it, with the next number and the reason")
def last_word(peer: Peer) -> None:
    timeout_ms = peer.open(period_ms=0).link_timeout_ms
    got = peer.collect(timeout_ms + 300, beating=False)
    ends = [i for i, datagram in enumerate(got) if isinstance(datagram.message, Bye)]
    require(len(ends) == 1, f"{len(ends)} BYEs at the end of a session")
    last, before = got[ends[0]].header, got[ends[0] - 1].header
    require(last.session == peer.session, f"BYE in session {last.session:x}")
    require(last.sequence == (before.sequence + 1) % peer.sequences, "BYE has not the next number")
    require(got[ends[0]].message == Bye(Reason.LINK_TIMEOUT), f"{got[ends[0]].message}")
    require(not got[ends[0] + 1 :], f"{len(got) - ends[0] - 1} datagrams after BYE")
    peer.session = 0


@case(135, "4.2", "what WELCOME says of the controller is the same in every session")
def same_controller(peer: Peer) -> None:
    seen = []
    for _ in range(3):
        welcome = peer.open()
        seen.append(welcome._replace(client_nonce=0))
        peer.leave()
    require(len(set(seen)) == 1, f"{seen[0]}, then {seen[-1]}")


@case(137, "4.2", f"the numbers of {SESSIONS} sessions cannot be told from one another")
def unguessable(peer: Peer) -> None:
    numbers = []
    for _ in range(SESSIONS):
        peer.open()
        numbers.append(peer.session)
        peer.leave()
    for a, b in itertools.combinations(numbers, 2):
        differ = (a ^ b).bit_count()
        require(differ >= LEAST_BITS, f"sessions {a:016x} and {b:016x} differ in {differ} bits")
    steps = [(b - a) % 2**64 for a, b in itertools.pairwise(numbers)]
    require(len(set(steps)) == len(steps), "one step leads from session to session")


@case(138, "1.7", "heartbeats, headers and STATE are of one clock: their least transits agree within 1 ms")
def one_clock(peer: Peer) -> None:
    peer.open(period_ms=0)
    peer.drain()
    least: dict[str, int] = {}

    def note(what: str, transit_ns: int) -> None:
        least[what] = min(transit_ns, least.get(what, transit_ns))

    for _ in range(40):
        now_ns = read_ns = peer.now_ns
        peer.send(Heartbeat(now_ns), sent_ns=now_ns)
        while read_ns < now_ns + 15 * MS and (datagram := peer.receive(10, beating=False)) is not None:
            read_ns, sent_ns = peer.now_ns, datagram.header.sent_ns
            note(f"the header of {type(datagram.message).__name__}", read_ns - sent_ns)
            if isinstance(datagram.message, HeartbeatReply):
                note("replied_ns", read_ns - datagram.message.replied_ns)
                off_ms = (sent_ns - datagram.message.replied_ns) / MS
                require(abs(off_ms) < 1.0, f"replied_ns is {off_ms:.2f} ms before the header's time")
    for what, transit_ns in least.items():
        off_ms = (transit_ns - least["replied_ns"]) / MS
        require(abs(off_ms) < 1.0, f"{what} is {off_ms:.2f} ms off the clock of replied_ns")


def _receive_all(peer: Peer) -> list[Datagram]:
    return [decode(line.data) for line in peer.transcript if line.direction == "receive"]


@key_case(723, "11.7", "63 behind the newest number a late one is taken off the losses, 64 behind it is not")
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


@key_case(
    724, "11.4", "a wrong key_id under a right tag is refused: UNKNOWN_KEY to HELLO, no answer to others"
)
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


@key_case(
    725, "11.2", "HELLO is judged in order: form, key, tag, and only then session, nonce, arm and source"
)
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


@key_case(726, "11.10", "an unsigned, replayed or forged datagram moves neither count, age nor losses")
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


@key_case(727, "11.7", "HELLO's number is the client's first: what is skipped behind it counts as lost")
def first_number_of_a_session(peer: Peer) -> None:
    opened(peer, period_ms=20)
    lost, _ = tallies(peer)
    peer.leave()
    peer.sequence = 2**40 + 7
    session = granted(peer, period_ms=20)
    peer.sequence += 3
    require_begun(peer, session, "behind a gap of 3")
    now_lost, _ = tallies(peer)
    require(now_lost - lost == 3, f"{now_lost - lost} lost of a gap of 3")


@key_case(728, "11.7", "a number whose upper half alone is newer is a leap, and not used")
def upper_half(peer: Peer) -> None:
    opened(peer)
    key = peer.keys_of(peer.session).sends
    number = peer.sequence + 2**32 + 1
    data = encode(stop(peer), Header(peer.session, number, peer.now_ns, minor=peer.minor), key)
    refused(peer, [data], "a number 2^32 ahead")
    peer.ask(stop(peer), "the next number")


@key_case(729, "11.3", "payload_bytes does not count the trailer: with it counted, a datagram is dropped")
def trailer_is_not_payload(peer: Peer) -> None:
    opened(peer)
    data = peer.encoded(stop(peer))
    counted = peer.with_number(data, 10, "H", len(data) - HEADER_BYTES)
    short = peer.with_number(data[:-1], 10, "H", len(data) - HEADER_BYTES - TRAILER_BYTES)
    refused(peer, [counted, short], "a length that counts the trailer, or a trailer cut short")


@key_case(730, "11.9", "BYE to those without a session is not signed, and is no BYE of a session")
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


WATCHED_MS, LONG_MS = 60.0, 700.0
AT_REST = (Mode.DISABLED, Mode.ERROR_HELD, Mode.EMERGENCY)


def tour(peer: Peer, modes: tuple[Mode, ...]) -> None:
    """Whatever a controller sends, in each of ``modes``."""
    for mode in modes:
        scene = entered(peer, mode)
        assert peer.welcome is not None
        again = Hello(peer.welcome.client_nonce, 3 | peer.required, 0, 0)
        (scene.stream or Stream(peer, peer.new_id())).give(scene.here)
        peer.send(again, session=0)
        unknown = peer.encoded(stop(peer))
        peer.send_raw(peer.with_number(unknown, 48, "I", 99))
        peer.send(ReferencePose(peer.new_id(), scene.goal, -1.0))
        peer.send(Command(peer.new_id(), CommandCode.RESET if mode is Mode.STANDBY else CommandCode.ENABLE))
        peer.collect(LONG_MS if mode is Mode.DISABLED else WATCHED_MS)
        granted(peer)
        session = peer.session
        peer.leave()
        peer.collect(RATION_MS, beating=False)
        peer.send(Bye(Reason.SHUTDOWN), session=granted(peer))
        peer.send(stop(peer), session=session)
        peer.expect_bye(Reason.UNKNOWN_SESSION, "a request after BYE")


def _enter(number: int, always: Always) -> None:
    def run(peer: Peer) -> None:
        if not peer.noted.toured:
            tour(peer, AT_REST)
            peer.noted.toured = True
        require(always not in peer.noted.breaches, peer.noted.breaches.get(always, ""))

    clause, says = always.value
    case(number, clause, f"in all that comes {says}")(run)


for _number, _always in enumerate(Always, 891):
    _enter(_number, _always)


@case(899, "7.7", "and the same in every mode", motion=True, needs=OptionalPart.STREAMING)
def in_every_mode(peer: Peer) -> None:
    tour(peer, tuple(Mode))
    require(not peer.noted.breaches, "; ".join(peer.noted.breaches.values()))
