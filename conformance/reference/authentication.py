"""Cases 701…: authentication (clause 11). Without a key they are unsupported, but for the last."""

from collections.abc import Callable
from functools import partial

from conformance.case import case
from conformance.parts import OptionalPart
from conformance.peer import RATION_MS, Peer
from conformance.reference.framing import FLAGS, all_refused, refused, stop, used, used_next
from conformance.reference.handshake import granted
from conformance.reference.sessions import SLACK_MS, dies_of_silence
from conformance.wire import MS, SEQUENCES, Unsupported, require, resealed, with_bit_flipped
from protocol.authentication import DirectionKey, LinkKey
from protocol.datagram import Header, encode
from protocol.datagram_layout import CRC_BYTES, CRC_OFFSET, TAG_BYTES, TRAILER_BYTES
from protocol.faults import Reason
from protocol.reference_messages import (
    Bye,
    Heartbeat,
    HeartbeatReply,
    Hello,
    Message,
    State,
    Welcome,
)

key_case = partial(case, needs=OptionalPart.AUTHENTICATION)
CRC = range(CRC_OFFSET, CRC_OFFSET + CRC_BYTES)
OTHER_KEY = LinkKey(b"a key that no controller may have")


def signed(peer: Peer, message: Message, key: DirectionKey | None, **header: int) -> bytes:
    """``message`` under the next number of the session, signed with any key, or not at all."""
    peer.sequence += 1
    fields = {"session": peer.session, "sequence": peer.sequence, "sent_ns": peer.now_ns} | header
    if key is None:
        fields["sequence"] %= SEQUENCES
    return encode(message, Header(**fields, minor=peer.minor), key)


def greeted(key_of: Callable[[Peer], DirectionKey | None], reason: Reason, what: str, peer: Peer) -> None:
    """A HELLO signed with a key is refused with ``reason`` and opens nothing."""
    key = key_of(peer)
    peer.leave()
    peer.collect(RATION_MS, beating=False)
    peer.send_raw(signed(peer, Hello(peer.nonce(), peer.required | 1, 0, 50), key, session=0))
    peer.require_came([Bye(reason)], 100, what, of=Bye | Welcome)


def _of_another_secret(peer: Peer) -> DirectionKey:
    """The key of this session, had it been opened under another secret."""
    return OTHER_KEY.of_client(peer.welcome.client_nonce, peer.session, peer.welcome.boot_id).sends


# fmt: off - one case a row
for _number, _title, _key, _reason in (
    (
        701,
        "HELLO that is not signed is refused with NOT_AUTHENTICATED",
        lambda _: None,
        Reason.NOT_AUTHENTICATED,
    ),
    (
        702,
        "HELLO that is signed with another key is refused with UNKNOWN_KEY",
        lambda _: OTHER_KEY.of_hello(),
        Reason.UNKNOWN_KEY,
    ),
    (
        703,
        "HELLO with a wrong tag is refused with BAD_TAG",
        lambda peer: peer.keys_of(peer.session).sends,
        Reason.BAD_TAG,
    ),
):
    key_case(_number, "11.2", _title, opens=50)(partial(greeted, _key, _reason, _title))
all_refused(
    (
        (
            704,
            "11.5",
            "a tag of which any single bit is wrong is refused",
            lambda _, data: (
                resealed(with_bit_flipped(data, bit))
                for bit in range(8 * (len(data) - TAG_BYTES), 8 * len(data))
            ),
        ),
        (
            705,
            "11.5",
            "a datagram of which any single bit was changed behind its signature is refused",
            lambda _, data: (
                resealed(with_bit_flipped(data, bit))
                for bit in range(8 * (len(data) - TAG_BYTES))
                if bit // 8 not in CRC
            ),
        ),
        (
            706,
            "11.2",
            "requests that are not signed are not used in an authenticated session",
            lambda peer, _: [signed(peer, stop(peer), None) for _ in range(3)],
        ),
        (
            707,
            "11.6",
            "a datagram signed with the controller's own key is refused: nothing can be reflected",
            lambda peer, _: [signed(peer, stop(peer), peer.keys_of(peer.session).receives) for _ in range(3)],
        ),
        (
            708,
            "11.6",
            "a datagram signed with the key of HELLO, or of another secret, is refused",
            lambda peer, _: [
                signed(peer, stop(peer), key) for key in (peer.hello_key, _of_another_secret(peer))
            ],
        ),
        (
            720,
            "11.3",
            "the flag without a trailer, and a trailer without the flag, are dropped",
            lambda _, data: [
                resealed(data[:-TRAILER_BYTES]),
                resealed(data[: FLAGS + 1] + b"\0" + data[FLAGS + 2 :]),
            ],
        ),
    ),
    key_case,
)
# fmt: on


@key_case(709, "11.7", "an exact replay is not used, neither at once nor behind later datagrams", opens=50)
def replayed(peer: Peer) -> None:
    request = stop(peer)
    data = peer.encoded(request)
    used(peer, data, request.command_id, "the request itself")
    refused(peer, [data] * 3, "its replay")
    for _ in range(5):
        peer.alive("between the replays")
    refused(peer, [data] * 3, "its replay behind later datagrams")


@key_case(711, "11.7", "numbers have 64 bits: one that is new modulo 2^32 alone is not used")
def extended(peer: Peer) -> None:
    peer.open(sequence=SEQUENCES - 4)
    key = peer.keys_of(peer.session).sends
    for _ in range(8):
        used_next(peer, "a request at 2^32")
    newest = peer.sequence
    require(newest > SEQUENCES, "2^32 was not reached")
    wrapped = encode(
        stop(peer), Header(peer.session, newest + 1 - SEQUENCES, peer.now_ns, minor=peer.minor), key
    )
    refused(peer, [wrapped], "a number 2^32 behind the next one")


@key_case(
    713, "11.8", "a datagram that is not under the keys of WELCOME does not begin the session", opens=50
)
def unsigned_beginning(peer: Peer) -> None:
    in_use = peer.session
    session = granted(peer)
    for key in (None, peer.hello_key, peer.keys_of(session).receives, peer.keys_of(in_use).sends):
        peer.send_raw(signed(peer, stop(peer), key, session=session))
        peer.require_came([], 30, "a forged beginning", but=HeartbeatReply | State, beating=True)
    peer.ask(stop(peer), "the session in use, after forged beginnings of another")


@key_case(715, "11.10", "forged datagrams do not keep the session alive", opens=50)
def forged_is_not_life(peer: Peer) -> None:
    peer.alive("before the forgeries")
    key = peer.keys_of(peer.session).receives

    def forge(_: float) -> None:
        peer.send_raw(signed(peer, Heartbeat(peer.now_ns), key))

    dies_of_silence(peer, "forged heartbeats", forge)


@key_case(716, "11.10", "forged datagrams move neither the count nor the age", opens=50)
def forged_moves_nothing(peer: Peer) -> None:
    key = peer.keys_of(peer.session).receives
    for ahead, shift_ms in ((1000, 0), (60_000, 0), (1, 10**7), (2, -1000)):
        header = {"sequence": peer.sequence + ahead, "sent_ns": peer.now_ns + shift_ms * MS}
        peer.send_beside(peer, partial(signed, peer, stop(peer), key, **header))
        refused(peer, [], "a forged datagram")
        used_next(peer, "the next number after a forged one")


@key_case(717, "11.10", "refused datagrams are counted in STATE as dropped, and not as lost", opens=20)
def forged_is_counted(peer: Peer) -> None:
    before = peer.state()
    for key in (None, peer.keys_of(peer.session).receives, OTHER_KEY.of_hello()):
        peer.send_beside(peer, partial(signed, peer, stop(peer), key))
    peer.alive("after three forgeries")
    peer.require_counted(before, "3 forgeries", lost=0, dropped=3)


@key_case(718, "11.9", "every datagram of the controller in the session is signed, to the last BYE")
def all_signed(peer: Peer) -> None:
    timeout_ms = peer.open(period_ms=0).link_timeout_ms
    peer.ask(stop(peer), "a request")
    peer.collect(300)
    got = [d.message for d in peer.collect(timeout_ms + 3 * SLACK_MS, beating=False)]
    require(Bye(Reason.LINK_TIMEOUT) in got, "no BYE at the end of the session")
    peer.session = 0


@key_case(719, "11.9", "BYE that is not signed does not end the session", opens=50)
def unsigned_bye(peer: Peer) -> None:
    for key in (None, peer.hello_key, peer.keys_of(peer.session).receives):
        peer.send_beside(peer, partial(signed, peer, Bye(Reason.SHUTDOWN), key))
        peer.alive("after a BYE that is not the client's")


@key_case(
    721, "11.7", "a late datagram is no replay: it is not used, and taken off the losses once", opens=20
)
def late_is_no_replay(peer: Peer) -> None:
    before = peer.state()
    held = [peer.encoded(stop(peer)) for _ in range(3)]
    peer.alive("after a gap of 3")
    refused(peer, [held[1]] * 3, "a late datagram")
    peer.require_counted(before, "one of 3 came late, its replays do not count", lost=2)


@case(
    722,
    "11.2",
    "a controller without a key refuses a signed HELLO with KEY_NOT_CONFIGURED",
    needs=OptionalPart.KEY_REFUSAL,
    opens=50,
)
def no_key_there(peer: Peer) -> None:
    peer.leave()
    peer.collect(RATION_MS, beating=False)
    peer.send_raw(signed(peer, Hello(peer.nonce(), 5, 0, 50), OTHER_KEY.of_hello(), session=0))
    got = [d.message for d in peer.collect(100, beating=False) if isinstance(d.message, Bye | Welcome)]
    if not got:
        raise Unsupported("a signed HELLO is dropped: clause 11 is not known there", OptionalPart.KEY_REFUSAL)
    require(got == [Bye(Reason.KEY_NOT_CONFIGURED)], f"came {got}")
