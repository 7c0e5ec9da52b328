"""Cases 141…, 242…: the order of the checks, and what they tell apart (clauses 3 to 5)."""

from collections.abc import Iterator, Sequence

from conformance.case import case
from conformance.parts import OptionalPart
from conformance.peer import RATION_MS, Peer
from conformance.reference.authentication import signed
from conformance.reference.framing import COMMAND_BYTES, FLAGS, KIND, MAJOR, flags_of, stop
from conformance.reference.handshake import require_ended
from conformance.reference.sessions import hello, welcomes
from conformance.wire import MS, Unsupported, require, resealed, with_bit_flipped
from protocol.datagram_layout import HEADER_BYTES, MAX_DATAGRAM_BYTES
from protocol.faults import Reason
from protocol.pose import IDENTITY
from protocol.reference_messages import (
    CAPABILITY_STREAMING,
    Bye,
    HeartbeatReply,
    Hello,
    Message,
    State,
    StreamedPose,
    Welcome,
)

MAGIC_BIT = 5


@case(
    142,
    "3.2",
    "STREAMED_POSE with a bit flipped in any of its bytes is dropped",
    needs=OptionalPart.STREAMING,
)
def flipped_stream(peer: Peer) -> None:
    welcome = peer.open(capabilities=CAPABILITY_STREAMING)
    if not welcome.capabilities & CAPABILITY_STREAMING:
        raise Unsupported("streaming is not offered")
    data = peer.encoded(StreamedPose(peer.new_id(), 1, peer.now_ns, IDENTITY))
    for bit in range(0, 8 * len(data), 5):
        peer.send_raw(with_bit_flipped(data, bit))
    # A flipped bit of the major version is answered, whatever the CRC (3.5).
    but = HeartbeatReply | State | Bye
    peer.require_came([], peer.grace_ms, "a flipped bit", but=but, beating=True)
    peer.alive("after streamed poses with flipped bits")


@case(143, "3.5", "another major version is told so whatever its length field and CRC, if its magic is right")
def major_first(peer: Peer) -> None:
    data = peer.with_number(peer.encoded(Hello(peer.nonce(), 1, 0, 50), session=0), MAJOR, "B", 9)
    magic = resealed(with_bit_flipped(data, MAGIC_BIT))
    longest = resealed(data.ljust(MAX_DATAGRAM_BYTES, b"\0"))
    for what, bent, answered in (
        ("a wrong CRC", with_bit_flipped(data, 8 * len(data) - 1), True),
        ("a wrong length", data + b"\0", True),
        ("a header alone", data[:HEADER_BYTES], True),
        (f"{MAX_DATAGRAM_BYTES} bytes", longest, True),
        (f"{MAX_DATAGRAM_BYTES + 1} bytes", resealed(longest + b"\0"), False),
        (f"{HEADER_BYTES - 1} bytes", data[: HEADER_BYTES - 1], False),
        ("a wrong magic", magic, False),
    ):
        peer.collect(RATION_MS, beating=False)
        peer.send_raw(bent)
        expected, wait_ms = ([Bye(Reason.INCOMPATIBLE_VERSION)], RATION_MS) if answered else ([], 40)
        peer.require_came(expected, wait_ms, f"another major version and {what}")


@case(144, "3.5", "what is no datagram is not answered, though its session is not known either")
def form_before_session(peer: Peer) -> None:
    peer.collect(RATION_MS, beating=False)
    data = peer.encoded(stop(peer), session=0x1234)
    for what, bent in (
        ("a wrong magic", peer.resealed(with_bit_flipped(data, MAGIC_BIT))),
        ("a wrong length", resealed(data + b"\0")),
        ("a wrong CRC", with_bit_flipped(data, 8 * len(data) - 1)),
        ("a critical flag", peer.with_number(data, FLAGS, "H", flags_of(data) | 1 << 15)),
        ("an unknown kind", peer.with_number(data, KIND, "B", 200)),
        ("another kind's length", peer.with_payload_of(data, COMMAND_BYTES + 8)),
        ("a command id of 0", peer.with_number(data, HEADER_BYTES, "Q", 0)),
    ):
        peer.send_raw(bent)
        peer.require_came([], 20, f"{what}, of an unknown session")
    peer.send(stop(peer), session=0x1234)
    peer.expect_bye(Reason.UNKNOWN_SESSION, "a sound request of an unknown session")


@case(145, "3.5", "HELLO with any single bit flipped opens nothing, nor one too long, too short or flagged")
def bent_hello(peer: Peer) -> None:
    data = peer.encoded(Hello(peer.nonce(), 1 | peer.required, 0, 50), session=0)
    bent = [with_bit_flipped(data, bit) for bit in range(8 * len(data))]
    bent += [data[:n] for n in range(HEADER_BYTES, len(data))]
    bent += [peer.with_payload_of(data, n) for n in (0, 24, 31, 33, 40)]
    bent += [peer.with_number(data, FLAGS, "H", flags_of(data) | 1 << bit) for bit in range(9, 16)]
    for each in bent:
        peer.send_raw(each)
    require(not welcomes(peer), "a bent HELLO was welcome")


@case(242, "4.1", "the hash of the arm is compared in all its 64 bits")
def every_bit_of_the_arm(peer: Peer) -> None:
    right = peer.open().arm_hash
    peer.leave()
    peer.collect(RATION_MS, beating=False)
    for bit in range(64):
        other = right ^ 1 << bit
        if other:
            peer.send(Hello(peer.nonce(), 1 | peer.required, other, 50), session=0)
    got = [d.message for d in peer.collect(100, beating=False)]
    require(not any(isinstance(m, Welcome) for m in got), "the hash of another arm was welcome")
    require(Bye(Reason.WRONG_ARM) in got, f"came {got}")


def require_greeted(peer: Peer, what: str, source: Peer, data: bytes, wanted: Sequence[Message]) -> None:
    """Require these answers to a HELLO from ``source``, beside the session of ``peer``."""
    peer.collect(RATION_MS)
    source.drain()
    source.send_raw(data)
    source.require_came(wanted, 40, what, of=Bye | Welcome)


@case(243, "3.5", "HELLO is judged in order: in a session, replayed, another arm, another source")
def hello_in_order(peer: Peer) -> None:
    nonce = peer.nonce()
    wrong = peer.open(nonce=nonce).arm_hash ^ 1 or 2
    peer.reopen()
    other = peer.second()

    in_use, fresh = peer.session, peer.nonce
    for what, source, session, number, arm_hash, wanted in (
        ("in a session, another arm", peer, in_use, fresh(), wrong, []),
        ("in a session, another source", other, in_use, fresh(), 0, []),
        ("replayed, another arm", peer, 0, nonce, wrong, []),
        ("replayed, another source", other, 0, nonce, 0, []),
        ("another arm and source", other, 0, fresh(), wrong, [Bye(Reason.WRONG_ARM)]),
        ("another source", other, 0, fresh(), 0, [Bye(Reason.SESSION_OCCUPIED)]),
    ):
        message = Hello(number, 1 | peer.required, arm_hash, 50)
        data = signed(source, message, peer.hello_key, session=session)
        require_greeted(peer, what, source, data, wanted)
    peer.alive("after these")


@case(244, "4.4", "BYE ends the session though it is late, came before, leaps or is old")
def bye_is_not_checked(peer: Peer) -> None:
    for what, behind, age_ms in (
        ("late", 5, 0),
        ("again", 0, 0),
        ("leaping", -100_000, 0),
        ("old", -1, 5000),
    ):
        peer.open(sequence=200_000)
        peer.alive("before BYE")
        session, arrived = peer.session, peer.sequence
        peer.send(Bye(Reason.SHUTDOWN), sequence=arrived - behind, sent_ns=peer.now_ns - age_ms * MS)
        require_ended(peer, session, f"a request after a BYE that was {what}")


@case(245, "4.4", "BYE of another session, port or version ends nothing", opens=50)
def bye_of_others(peer: Peer) -> None:
    other = peer.second()
    for what, source, header in (
        ("session", peer, {"session": peer.session ^ 1}),
        ("session, the 0", peer, {"session": 0}),
        ("port", other, {}),
        ("minor version", peer, {"minor": peer.minor + 1}),
    ):
        source.send_raw(peer.encoded(Bye(Reason.SHUTDOWN), **header))
        peer.alive(f"after a BYE of another {what}")


def sessions_of(peer: Peer, count: int) -> Iterator[Welcome]:
    """Open and leave so many sessions: the WELCOME of each, while it is open."""
    for _ in range(count):
        yield peer.open()
        peer.leave()


@case(246, "8", "the nonces of the last 64 sessions open nothing")
def nonces_remembered(peer: Peer) -> None:
    nonces = [welcome.client_nonce for welcome in sessions_of(peer, 64)]
    for nonce in (nonces[0], nonces[1], nonces[-1]):
        hello(peer, nonce)
    require(not welcomes(peer), "the nonce of one of the last 64 sessions was welcome")
