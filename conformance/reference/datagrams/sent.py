"""Cases 130…: what the controller sends, field by field (clauses 1.7, 1.8, 3.1, 3.4, 4.2, 4.4 and 9.1)."""

import itertools

from conformance.case import reference
from conformance.peer import RATION_MS, Peer
from conformance.reference.framing import MAJOR, SPARE, stop
from conformance.wire import ANSWER_MS, MS, require
from protocol.datagram import Datagram, decode
from protocol.datagram_layout import (
    FLAG_AUTHENTICATED,
    FLAG_ECHO_VALID,
    HEADER_BYTES,
    PAYLOADS,
    Kind,
    offsets,
)
from protocol.faults import Reason
from protocol.reference_messages import Bye, Heartbeat, HeartbeatReply, Hello, Welcome

case = reference.case
KIND, FLAGS = 6, 8
SESSIONS = 8
# Two of a few dozen sound session numbers are nearer to one another once in 10^8 runs.
LEAST_BITS = 8


def every_kind(peer: Peer) -> list[bytes]:
    """The datagrams of a session in which the controller sends one of each kind that it knows here."""
    peer.open(period_ms=0)
    request = stop(peer)
    peer.ask(request, "STOP")
    peer.alive("HEARTBEAT")
    peer.collect(50)
    session = peer.session
    peer.leave()
    peer.collect(RATION_MS, beating=False)
    peer.send(request, session=session)
    peer.expect_bye(Reason.UNKNOWN_SESSION, "a request after BYE")
    came = [line.data for line in peer.transcript if line.direction == "receive"]
    kinds = {data[KIND] for data in came}
    wanted = {Kind.WELCOME, Kind.HEARTBEAT_REPLY, Kind.ACKNOWLEDGEMENT, Kind.STATE, Kind.BYE}
    require(wanted <= kinds, f"kinds {sorted(kinds)} came, wanted {sorted(wanted)}")
    return came


@case(130, "1.8", "spare and padding bytes are sent as zero, in every kind of datagram")
def clean(peer: Peer) -> None:
    for data in every_kind(peer):
        kind = Kind(data[KIND])
        require(data[SPARE] == 0, f"{kind.name}: spare byte {data[SPARE]:#x}")
        fields = PAYLOADS[kind]
        for field, offset in zip(fields, offsets(fields), strict=True):
            if field.code == "x":
                at = HEADER_BYTES + offset
                padding = data[at : at + field.size]
                require(not any(padding), f"{kind.name}: padding {padding.hex()} at byte {at}")


@case(131, "9.1", "no flag is sent that the negotiated minor version does not have")
def known_flags(peer: Peer) -> None:
    known = FLAG_ECHO_VALID | (FLAG_AUTHENTICATED if peer.link_key else 0)
    for data in every_kind(peer):
        flags = int.from_bytes(data[FLAGS : FLAGS + 2], "little")
        require(flags & ~known == 0, f"{Kind(data[KIND]).name}: flags {flags:#06x}")


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


@case(134, "5.1", "WELCOME has the controller's first number in the session")
def first_number(peer: Peer) -> None:
    peer.open()
    datagrams = [d for d in _received(peer) if d.header.session == peer.session]
    numbers = [d.header.sequence for d in datagrams]
    steps = {(b - a) % peer.sequences for a, b in itertools.pairwise(numbers)}
    require(isinstance(datagrams[0].message, Welcome), "something came before WELCOME")
    require(steps == {1}, f"steps of {sorted(steps)} from WELCOME on")


@case(135, "4.2", "what WELCOME says of the controller is the same in every session")
def same_controller(peer: Peer) -> None:
    seen = []
    for _ in range(3):
        welcome = peer.open()
        seen.append(welcome._replace(client_nonce=0))
        peer.leave()
    require(len(set(seen)) == 1, f"{seen[0]}, then {seen[-1]}")


@case(136, "4.2", "the capabilities granted are those that both can use, for every offer")
def both_can(peer: Peer) -> None:
    can = peer.open(capabilities=3).capabilities
    peer.leave()
    for offered in (0, 1, 2, 3, 2, 1, 0):
        granted = peer.open(capabilities=offered).capabilities
        wanted = can & (offered | peer.required)
        require(granted == wanted, f"{granted:#x} of {offered:#x}: the controller can {can:#x}")
        peer.leave()


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


def _received(peer: Peer) -> list[Datagram]:
    return [decode(line.data) for line in peer.transcript if line.direction == "receive"]
