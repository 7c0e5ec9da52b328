"""Cases 240…, 248…: what is dropped has no effect, whatever its kind and the cause (clauses 3.5 and 5.4)."""

from collections.abc import Callable, Iterator
from functools import partial
from itertools import chain, cycle

from conformance.case import case
from conformance.peer import RATION_MS, Peer
from conformance.reference.authentication import OTHER_KEY, signed
from conformance.reference.datagram_refusals import MAGIC_BIT
from conformance.reference.framing import FLAGS, KIND, MAJOR, flags_of, stop, used_next
from conformance.reference.handshake import granted, require_ended
from conformance.reference.sessions import SLACK_MS, dies_of_silence
from conformance.wire import MS, require, resealed, with_bit_flipped
from protocol.datagram_layout import HEADER_BYTES, MAX_DATAGRAM_BYTES, PAYLOADS, Kind, offsets, size_of
from protocol.faults import Reason
from protocol.pose import IDENTITY
from protocol.reference_messages import (
    CAPABILITY_STREAMING,
    Acknowledgement,
    Bye,
    Heartbeat,
    HeartbeatReply,
    Hello,
    Message,
    ReferencePath,
    ReferencePose,
    StreamedPose,
    StreamRefused,
    Welcome,
)

# The time in a heartbeat that shall not be answered.
MARK = 7
# Numbers left out, so that they can come late: fewer than the 64 within which late is told from old.
GAP = 60


def dropped(peer: Peer, other: Peer) -> list[tuple[str, Peer, Callable[[], bytes]]]:
    """Every way for a heartbeat to be dropped before its number counts: why, from where, and its bytes."""

    def beat(**header: int) -> bytes:
        return peer.encoded(Heartbeat(1), **header)

    def raw(offset: int, code: str, value: int) -> bytes:
        return peer.with_number(beat(), offset, code, value)

    hello = Hello(peer.nonce(), 1 | peer.required, 0, 50)
    another_arm = hello._replace(arm_hash=peer.welcome.arm_hash ^ 1 or 2)
    return [
        ("of session 0", peer, lambda: beat(session=0)),
        ("of another session", peer, lambda: beat(session=peer.session ^ 1 << 40)),
        ("from another port", other, beat),
        ("of another minor version", peer, lambda: beat(minor=peer.minor + 1)),
        ("of another major version", peer, lambda: raw(MAJOR, "B", 9)),
        ("with a critical flag", peer, lambda: raw(FLAGS, "H", 1 << 15 | flags_of(beat()))),
        ("of an unknown kind", peer, lambda: raw(KIND, "B", 200)),
        ("with a wrong CRC", peer, lambda: with_bit_flipped(beat(), 8 * HEADER_BYTES)),
        ("with a wrong magic", peer, lambda: peer.resealed(with_bit_flipped(beat(), MAGIC_BIT))),
        ("that is a byte longer than it says", peer, lambda: resealed(beat() + b"\0")),
        ("that is too long", peer, lambda: resealed(beat().ljust(MAX_DATAGRAM_BYTES + 1, b"\0"))),
        ("of another kind's length", peer, lambda: peer.with_payload_of(beat(), 16)),
        ("signed otherwise than the session", peer,
         lambda: signed(peer, Heartbeat(1), None if peer.link_key else OTHER_KEY.of_hello())),
        ("signed with another key", peer, lambda: signed(peer, Heartbeat(1), OTHER_KEY.of_hello())),
        ("that is too short", peer, lambda: beat()[: HEADER_BYTES - 1]),
        ("that a controller sends", peer, lambda: peer.encoded(HeartbeatReply(1, 2, 3))),
        ("that cannot be", peer, lambda: peer.with_number(peer.encoded(stop(peer)), HEADER_BYTES, "Q", 0)),
        ("that is HELLO for another arm", peer, lambda: peer.encoded(another_arm, session=0)),
        ("that is HELLO from another port", other, lambda: peer.encoded(hello, session=0)),
        ("that is HELLO in a session", peer, lambda: peer.encoded(Hello(peer.nonce(), 1, 0, 50))),
    ]  # fmt: skip


@case(
    240, "3.5", "what is dropped before its number is looked at moves neither the count nor the age", opens=50
)
def drops_move_nothing(peer: Peer) -> None:
    other = peer.second()
    peer.alive("before anything was dropped")
    for what, source, data in dropped(peer, other):
        before = peer.sequence
        peer.sequence += 1000
        peer.shift_ns += 10_000 * MS  # as if it had been under way for no time at all
        bent = data()
        peer.shift_ns -= 10_000 * MS
        peer.sequence = before
        source.send_raw(bent)
        peer.collect(10)
        used_next(peer, f"a request after a datagram {what}")


@case(241, "5.4", f"what is dropped is no sign of life and has no answer (slack {SLACK_MS} ms)", opens=20)
def drops_are_not_life(peer: Peer) -> None:
    other = peer.second()
    ways = cycle(dropped(peer, other))

    def send(_waited_ms: float) -> None:
        _, source, data = next(ways)
        peer.send_beside(source, data)

    dies_of_silence(peer, "datagrams that are to be dropped", send)
    other.require_came([], 1.0, "a heartbeat from another port was answered there", of=HeartbeatReply)


def messages_of_a_client(peer: Peer) -> list[Message]:
    """One of every kind that is answered when it is used."""
    can_stream = peer.open(capabilities=3).capabilities & CAPABILITY_STREAMING
    messages: list[Message] = [
        Heartbeat(MARK),
        stop(peer),
        ReferencePose(peer.new_id(), IDENTITY, 0.0),
        ReferencePath(peer.new_id(), (IDENTITY,), 0.0, 0.0),
    ]
    return messages + ([StreamedPose(peer.new_id(), 1, peer.now_ns, IDENTITY)] if can_stream else [])


def bent_in_form(peer: Peer, message: Message) -> Iterator[bytes]:
    """``message`` as no datagram, of another version, session or flags, each under the next number."""

    def data() -> bytes:
        return peer.encoded(message)

    size = size_of(PAYLOADS[Kind(data()[KIND])])
    yield with_bit_flipped(data(), 8 * HEADER_BYTES + 1)
    yield peer.resealed(with_bit_flipped(data(), MAGIC_BIT))
    yield peer.with_number(data(), MAJOR, "B", 9)
    yield peer.with_number(data(), FLAGS, "H", flags_of(data()) | 1 << 15)
    yield peer.with_payload_of(data(), size + 8)
    yield peer.with_payload_of(data(), size - 4)  # what is cut off is zero, also of a heartbeat with MARK
    if not isinstance(message, Heartbeat | Bye):
        yield peer.with_number(data(), HEADER_BYTES, "Q", 0)  # no id
    yield peer.encoded(message, session=peer.session ^ 1 << 40)
    yield peer.encoded(message, minor=peer.minor + 1)


def bent_in_order(peer: Peer, message: Message) -> Iterator[bytes]:
    """``message`` late, leaping, and too old. Begins with a heartbeat: nothing sent before it is newer."""
    peer.alive("before datagrams out of order")
    yield peer.encoded(message, sequence=(peer.sequence - 3) % peer.sequences)
    yield peer.encoded(message, sequence=(peer.sequence - 300) % peer.sequences)
    yield peer.encoded(message, sequence=(peer.sequence + 70_000) % peer.sequences)
    yield peer.encoded(message, sent_ns=peer.now_ns - 3 * peer.timeout_ms * MS)


def _is_use(message: object) -> bool:
    if isinstance(message, HeartbeatReply):
        return message.sent_ns == MARK
    return isinstance(message, Acknowledgement | StreamRefused)


@case(248, "3.5", "every kind of datagram that a client sends is dropped for the same causes")
def every_kind_alike(peer: Peer) -> None:
    messages = messages_of_a_client(peer)
    other = peer.second()
    for message in messages:
        name = type(message).__name__
        peer.alive("before")
        # One by one: heartbeats go out in between, and a number may not be late by that.
        for number, data in enumerate(chain(bent_in_form(peer, message), bent_in_order(peer, message))):
            peer.send_raw(data)
            used = [d.message for d in peer.collect(12) if _is_use(d.message)]
            require(not used, f"{name}, bent in way {number}, was used: {used}")
        other.send_raw(peer.encoded(message))
        used = [d.message for d in (*peer.collect(peer.grace_ms), *other.collect(1)) if _is_use(d.message)]
        require(not used, f"{name} from another port was used: {used}")
        peer.alive(f"after bent datagrams with {name}")


@case(249, "3.5", "BYE that is no datagram, or of another version, session or port, ends nothing", opens=50)
def bent_bye(peer: Peer) -> None:
    other = peer.second()
    unknown = peer.with_number(peer.encoded(Bye(Reason.SHUTDOWN)), HEADER_BYTES, "I", 9999)
    for data in chain(bent_in_form(peer, Bye(Reason.SHUTDOWN)), (unknown,)):
        peer.send_raw(data)
        peer.alive("after a bent BYE")
    other.send_raw(peer.encoded(Bye(Reason.SHUTDOWN)))
    peer.alive("after a BYE from another port")


@case(
    251,
    "3.5",
    "what is dropped begins no session: that in use goes on beside the one that is granted",
    opens=50,
)
def drops_begin_nothing(peer: Peer) -> None:
    other = peer.second()
    for what, source, data in dropped(peer, other):
        granted(peer)
        peer.send_beside(source, data)
        peer.collect(5)
        peer.alive(f"beside a grant, after a datagram {what}")


@case(252, "1.8", "padding that is not zero is ignored in every kind of datagram")
def dirty_padding(peer: Peer) -> None:
    for message in messages_of_a_client(peer):
        peer.send_raw(_with_dirty_padding(peer, peer.encoded(message)))
        used = [d.message for d in peer.collect(peer.grace_ms) if _is_use(d.message)]
        require(len(used) == 1, f"{type(message).__name__}, its padding not zero: came {used}")
    session = peer.session
    peer.send_raw(_with_dirty_padding(peer, peer.encoded(Bye(Reason.SHUTDOWN))))
    require_ended(peer, session, "a request after BYE, its padding not zero")
    peer.collect(RATION_MS, beating=False)
    greeting = peer.encoded(Hello(peer.nonce(), 1 | peer.required, 0, 50), session=0)
    peer.send_raw(_with_dirty_padding(peer, greeting))
    peer.expect(Welcome, "HELLO, its padding not zero", beating=False)


def _with_dirty_padding(peer: Peer, data: bytes) -> bytes:
    """``data`` with every byte of its padding set."""
    fields = PAYLOADS[Kind(data[KIND])]
    for field, offset in zip(fields, offsets(fields), strict=True):
        if field.code == "x":
            for n in range(field.size):
                data = peer.with_number(data, HEADER_BYTES + offset + n, "B", 0xA5)
    return data


def disordered(peer: Peer, late: int = 3) -> list[tuple[str, Callable[[int], bytes]]]:
    """Heartbeats that come in no order: why, and the bytes for a time of sending.

    There is a gap behind, and the number ``late`` behind the newest one is in it.
    """

    def beat(behind: int, sent_ns: int) -> bytes:
        number = (peer.sequence - behind) % peer.sequences
        return peer.encoded(Heartbeat(MARK), sequence=number, sent_ns=sent_ns)

    ways = {"came before": 0, "is late": late, "is old": 300, "leaps": -70_000}
    return [(f"that {what}", partial(beat, behind)) for what, behind in ways.items()]


@case(253, "5.2", f"what comes in no order moves no age, begins nothing, is no life (slack {SLACK_MS} ms)")
def disorder_is_nothing(peer: Peer) -> None:
    timeout_ms = peer.open(sequence=10_000).link_timeout_ms
    for what, data in disordered(peer):
        granted(peer)
        peer.sequence += 10
        peer.alive("behind a gap")
        peer.send_raw(data(peer.now_ns + 10_000 * MS))
        came = [d.message for d in peer.collect(10) if isinstance(d.message, Bye) or _is_use(d.message)]
        require(not came, f"a heartbeat {what} was answered: {came}")
        peer.ask(stop(peer), f"a request of the session in use, after a heartbeat {what}")
    peer.sequence += GAP

    def send(waited_ms: float) -> None:
        late = GAP - int(GAP * waited_ms / (timeout_ms + SLACK_MS))  # one after the other, each once late
        for _, data in disordered(peer, max(1, late)):
            peer.send_raw(data(peer.now_ns))

    dies_of_silence(peer, "datagrams that came in no order", send)


@case(
    255, "4.6", "HELLO of an earlier session, from the connected source, has no effect but that it is counted"
)
def replayed_beside_a_session(peer: Peer) -> None:
    nonce = peer.nonce()
    peer.open(nonce=nonce)
    peer.reopen(period_ms=20)
    message = Hello(nonce, 1 | peer.required, 0, 50)
    granted(peer)
    peer.alive("beside a grant")
    before, ahead = peer.state(), peer.sequence + 1000
    peer.send(message, session=0, sequence=ahead, sent_ns=peer.now_ns + 10_000 * MS)
    peer.alive("beside a grant, after a HELLO of an earlier session")
    peer.require_counted(before, "a HELLO of an earlier session", lost=0, dropped=1)
    dies_of_silence(peer, "a HELLO of an earlier one", lambda _: peer.send(message, session=0))
