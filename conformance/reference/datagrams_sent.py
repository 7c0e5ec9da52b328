"""Cases 130… and 891…: what the controller sends, field by field, and what holds of all that comes."""

import itertools
from functools import partial

from conformance.case import case
from conformance.noted import Always
from conformance.parts import OptionalPart
from conformance.peer import RATION_MS, Peer
from conformance.reference.arm_transitions import entered
from conformance.reference.authentication import OTHER_KEY, key_case, signed
from conformance.reference.datagram_refusals import require_greeted, sessions_of
from conformance.reference.framing import MAJOR, refused, stop
from conformance.reference.handshake import granted, require_begun
from conformance.reference.order import WINDOW, require_window
from conformance.wire import ANSWER_MS, MS, known, require, resealed, with_bit_flipped
from protocol.authentication import DirectionKey
from protocol.axes_group import Mode
from protocol.datagram import Header, encode
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
        header, message = known(stranger.receive(ANSWER_MS, beating=False), f"{what}: no answer")
        require(isinstance(message, Bye), f"{what}: {message}")
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
    seen = [welcome._replace(client_nonce=0) for welcome in sessions_of(peer, 3)]
    require(len(set(seen)) == 1, f"{seen[0]}, then {seen[-1]}")


@case(137, "4.2", f"the numbers of {SESSIONS} sessions cannot be told from one another")
def unguessable(peer: Peer) -> None:
    numbers = [peer.session for _ in sessions_of(peer, SESSIONS)]
    for a, b in itertools.combinations(numbers, 2):
        differ = (a ^ b).bit_count()
        require(differ >= LEAST_BITS, f"sessions {a:016x} and {b:016x} differ in {differ} bits")
    steps = [(b - a) % 2**64 for a, b in itertools.pairwise(numbers)]
    require(len(set(steps)) == len(steps), "one step leads from session to session")


@case(
    138,
    "1.7",
    "heartbeats, headers and STATE are of one clock: their least transits agree within 1 ms",
    opens=0,
)
def one_clock(peer: Peer) -> None:
    peer.drain()
    least: dict[str, int] = {}

    def note(what: str, transit_ns: int) -> None:
        least[what] = min(transit_ns, least.get(what, transit_ns))

    for _ in range(40):
        now_ns = read_ns = peer.heartbeat()
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


@key_case(
    723,
    "11.7",
    "63 behind the newest number a late one is taken off the losses, 64 behind it is not",
    opens=20,
)
def window(peer: Peer) -> None:
    require_window(peer, ((WINDOW - 1, 1), (WINDOW, 0), (WINDOW + 1, 0), (1, 1)))


@key_case(
    724,
    "11.4",
    "a wrong key_id under a right tag is refused: UNKNOWN_KEY to HELLO, no answer to others",
    opens=50,
)
def wrong_key_id(peer: Peer) -> None:
    data = peer.encoded(stop(peer))
    for bit in range(32):
        at = len(data) - TRAILER_BYTES + 4
        refused(peer, [peer.resealed(with_bit_flipped(data, 8 * at + bit))], "another key_id")
    peer.leave()
    peer.collect(RATION_MS, beating=False)
    data = peer.encoded(Hello(peer.nonce(), peer.required | 1, 0, 50), session=0)
    flipped = with_bit_flipped(data, 8 * (len(data) - TRAILER_BYTES + 4) + 31)
    peer.send_raw(peer.resealed(flipped))
    peer.require_came([Bye(Reason.UNKNOWN_KEY)], 100, "HELLO with another key_id", of=Bye | Welcome)


@key_case(
    725, "11.2", "HELLO is judged in order: form, key, tag, and only then session, nonce, arm and source"
)
def key_before_all_else(peer: Peer) -> None:
    nonce = peer.nonce()
    wrong = peer.open(nonce=nonce).arm_hash ^ 1 or 2
    peer.reopen()
    other = peer.second()
    session_key = peer.keys_of(peer.session).sends

    def hello(key: DirectionKey | None, arm_hash: int = 0, session: int = 0, number: int = 0) -> bytes:
        message = Hello(number or peer.nonce(), peer.required | 1, arm_hash, 50)
        return signed(peer, message, key, session=session)

    for key, reason in (
        (None, Reason.NOT_AUTHENTICATED),
        (OTHER_KEY.of_hello(), Reason.UNKNOWN_KEY),
        (session_key, Reason.BAD_TAG),
    ):
        for what, source, how in (
            ("in a session", peer, {"session": peer.session}),
            ("replayed", peer, {"number": nonce}),
            ("another arm", peer, {"arm_hash": wrong}),
            ("another source", other, {}),
        ):
            require_greeted(peer, f"{reason.name}, {what}", source, hello(key, **how), [Bye(reason)])
    formless = peer.with_number(hello(None), HEADER_BYTES, "Q", 0)
    require_greeted(peer, "a nonce of 0, not signed", peer, resealed(formless[: HEADER_BYTES + 32]), [])
    peer.alive("after these")


@key_case(
    726, "11.10", "an unsigned, replayed or forged datagram moves neither count, age nor losses", opens=20
)
def nothing_moves(peer: Peer) -> None:
    peer.alive("before")
    replay = peer.send(Heartbeat(1))
    counted = peer.state()
    keys = (None, peer.hello_key, OTHER_KEY.of_hello(), peer.keys_of(peer.session).receives)
    for n, key in enumerate(keys):
        before = peer.sequence
        peer.sequence += 1000
        peer.send_raw(signed(peer, Heartbeat(1), key, sent_ns=peer.now_ns + 10**10))
        peer.sequence = before
        peer.send_raw(replay)
        peer.alive(f"after forgery {n}")
    peer.require_counted(counted, "after forgeries and replays", lost=0, dropped=2 * len(keys))


@key_case(
    727, "11.7", "HELLO's number is the client's first: what is skipped behind it counts as lost", opens=20
)
def first_number_of_a_session(peer: Peer) -> None:
    before = peer.state()
    peer.leave()
    peer.sequence = 2**40 + 7
    session = granted(peer, period_ms=20)
    peer.sequence += 3
    require_begun(peer, session, "behind a gap of 3")
    peer.require_counted(before, "a gap of 3", lost=3)


@key_case(728, "11.7", "a number whose upper half alone is newer is a leap, and not used", opens=50)
def upper_half(peer: Peer) -> None:
    key = peer.keys_of(peer.session).sends
    number = peer.sequence + 2**32 + 1
    data = encode(stop(peer), Header(peer.session, number, peer.now_ns, minor=peer.minor), key)
    refused(peer, [data], "a number 2^32 ahead")
    peer.ask(stop(peer), "the next number")


@key_case(
    729, "11.3", "payload_bytes does not count the trailer: with it counted, a datagram is dropped", opens=50
)
def trailer_is_not_payload(peer: Peer) -> None:
    data = peer.encoded(stop(peer))
    counted = peer.with_number(data, 10, "H", len(data) - HEADER_BYTES)
    short = peer.with_number(data[:-1], 10, "H", len(data) - HEADER_BYTES - TRAILER_BYTES)
    refused(peer, [counted, short], "a length that counts the trailer, or a trailer cut short")


@key_case(730, "11.9", "BYE to those without a session is not signed, and is no BYE of a session", opens=20)
def hints_are_unsigned(peer: Peer) -> None:
    other = peer.second()
    peer.collect(RATION_MS)
    other.send(Hello(other.nonce(), peer.required | 1, 0, 50), session=0)
    header, message = known(other.receive(200, beating=False), "no answer to a second client")
    require(message == Bye(Reason.SESSION_OCCUPIED), f"came {message}")
    require(not header.flags & 1 << 8, "BYE to a stranger is signed")
    require(header.session == 0, "BYE to a stranger names a session")
    states = [d for d in peer.collect(100) if isinstance(d.message, State)]
    require(bool(states), "the session suffered")


WATCHED_MS, LONG_MS = 60.0, 700.0
AT_REST = (Mode.DISABLED, Mode.ERROR_HELD, Mode.EMERGENCY)


def tour(peer: Peer, modes: tuple[Mode, ...]) -> None:
    """Whatever a controller sends, in each of ``modes``."""
    for mode in modes:
        scene = entered(peer, mode)
        again = Hello(peer.welcome.client_nonce, 3 | peer.required, 0, 0)
        scene.stream.give(scene.here)
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


def never_breached(always: Always, peer: Peer) -> None:
    if not peer.noted.toured:
        tour(peer, AT_REST)
        peer.noted.toured = True
    require(always not in peer.noted.breaches, peer.noted.breaches.get(always, ""))


for _number, _always in enumerate(Always, 891):
    _clause, _says = _always.value
    case(_number, _clause, f"in all that comes {_says}")(partial(never_breached, _always))


@case(899, "7.7", "and the same in every mode", motion=True, needs=OptionalPart.STREAMING)
def in_every_mode(peer: Peer) -> None:
    tour(peer, tuple(Mode))
    require(not peer.noted.breaches, "; ".join(peer.noted.breaches.values()))
