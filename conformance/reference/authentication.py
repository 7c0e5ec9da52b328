"""Cases 701…: authentication (clause 11). Without a key they are unsupported, but for the last."""

from functools import partial

from conformance.case import reference
from conformance.parts import OptionalPart
from conformance.peer import RATION_MS, Peer
from conformance.reference.framing import FLAGS, refused, stop, used
from conformance.reference.handshake import SLACK_MS, granted
from conformance.wire import MS, SEQUENCES, Failed, Unsupported, require, resealed, with_bit_flipped
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

case = partial(reference.case, needs=OptionalPart.AUTHENTICATION)
CRC = range(CRC_OFFSET, CRC_OFFSET + CRC_BYTES)
OTHER_KEY = LinkKey(b"a key that no controller may have")


def opened(peer: Peer, **settings: int) -> Welcome:
    """Opens an authenticated session."""
    return peer.open(**settings)


def signed(peer: Peer, message: Message, key: DirectionKey | None, **header: int) -> bytes:
    """``message`` under the next number of the session, signed with any key, or not at all."""
    peer.sequence += 1
    fields = {"session": peer.session, "sequence": peer.sequence, "sent_ns": peer.now_ns} | header
    if key is None:
        fields["sequence"] %= SEQUENCES
    return encode(message, Header(**fields, minor=peer.minor), key)


def greeted(peer: Peer, key: DirectionKey | None, reason: Reason, what: str) -> None:
    """A HELLO signed with ``key`` is refused with ``reason`` and opens nothing."""
    opened(peer)
    peer.leave()
    peer.collect(RATION_MS, beating=False)
    peer.send_raw(signed(peer, Hello(peer.nonce(), peer.required | 1, 0, 50), key, session=0))
    got = [d.message for d in peer.collect(100, beating=False) if isinstance(d.message, Bye | Welcome)]
    require(got == [Bye(reason)], f"{what}: came {got}, wanted BYE {reason.name}")


@case(701, "11.2", "HELLO that is not signed is refused with NOT_AUTHENTICATED")
def unsigned_hello(peer: Peer) -> None:
    greeted(peer, None, Reason.NOT_AUTHENTICATED, "an unsigned HELLO")


@case(702, "11.2", "HELLO that is signed with another key is refused with UNKNOWN_KEY")
def hello_of_another_key(peer: Peer) -> None:
    greeted(peer, OTHER_KEY.of_hello(), Reason.UNKNOWN_KEY, "a HELLO of another key")


@case(703, "11.2", "HELLO with a wrong tag is refused with BAD_TAG")
def hello_with_bad_tag(peer: Peer) -> None:
    opened(peer)
    session_key = peer.keys_of(peer.session).sends
    greeted(peer, session_key, Reason.BAD_TAG, "a HELLO signed with a session's key")


@case(704, "11.5", "a tag of which any single bit is wrong is refused")
def flipped_tag(peer: Peer) -> None:
    opened(peer)
    data = peer.encoded(stop(peer))
    bits = range(8 * (len(data) - TAG_BYTES), 8 * len(data))
    refused(peer, [resealed(with_bit_flipped(data, bit)) for bit in bits], "a tag with a flipped bit")


@case(705, "11.5", "a datagram of which any single bit was changed behind its signature is refused")
def flipped_content(peer: Peer) -> None:
    opened(peer)
    data = peer.encoded(stop(peer))
    bits = range(8 * (len(data) - TAG_BYTES))
    bent = [resealed(with_bit_flipped(data, bit)) for bit in bits if bit // 8 not in CRC]
    refused(peer, bent, "a changed bit, its CRC made right")


@case(706, "11.2", "requests that are not signed are not used in an authenticated session")
def unsigned_request(peer: Peer) -> None:
    opened(peer)
    refused(peer, [signed(peer, stop(peer), None) for _ in range(3)], "an unsigned request")


@case(707, "11.6", "a datagram signed with the controller's own key is refused: nothing can be reflected")
def reflected(peer: Peer) -> None:
    opened(peer)
    key = peer.keys_of(peer.session).receives
    refused(peer, [signed(peer, stop(peer), key) for _ in range(3)], "a request under the controller's key")


@case(708, "11.6", "a datagram signed with the key of HELLO, or of another secret, is refused")
def other_keys(peer: Peer) -> None:
    welcome = opened(peer)
    assert peer.link_key is not None
    stranger = OTHER_KEY.of_client(welcome.client_nonce, peer.session, welcome.boot_id).sends
    keys = (peer.link_key.of_hello(), stranger)
    refused(peer, [signed(peer, stop(peer), key) for key in keys], "a request under another key")


@case(709, "11.7", "an exact replay is not used, neither at once nor behind later datagrams")
def replayed(peer: Peer) -> None:
    opened(peer)
    request = stop(peer)
    data = peer.encoded(request)
    used(peer, data, request.command_id, "the request itself")
    refused(peer, [data] * 3, "its replay")
    for _ in range(5):
        peer.alive("between the replays")
    refused(peer, [data] * 3, "its replay behind later datagrams")


@case(711, "11.7", "numbers have 64 bits: one that is new modulo 2^32 alone is not used")
def extended(peer: Peer) -> None:
    opened(peer, sequence=SEQUENCES - 4)
    key = peer.keys_of(peer.session).sends
    for _ in range(8):
        request = stop(peer)
        used(peer, peer.encoded(request), request.command_id, "a request at 2^32")
    newest = peer.sequence
    require(newest > SEQUENCES, "2^32 was not reached")
    wrapped = encode(
        stop(peer), Header(peer.session, newest + 1 - SEQUENCES, peer.now_ns, minor=peer.minor), key
    )
    refused(peer, [wrapped], "a number 2^32 behind the next one")


@case(713, "11.8", "a datagram that is not under the keys of WELCOME does not begin the session")
def unsigned_beginning(peer: Peer) -> None:
    opened(peer)
    in_use = peer.session
    session = granted(peer)
    assert peer.link_key is not None
    for key in (None, peer.link_key.of_hello(), peer.keys_of(session).receives, peer.keys_of(in_use).sends):
        peer.send_raw(signed(peer, stop(peer), key, session=session))
        got = [d.message for d in peer.collect(30) if not isinstance(d.message, HeartbeatReply | State)]
        require(not got, f"came {got}")
    peer.ask(stop(peer), "the session in use, after forged beginnings of another")


@case(715, "11.10", "forged datagrams do not keep the session alive")
def forged_is_not_life(peer: Peer) -> None:
    timeout_ms = opened(peer).link_timeout_ms
    peer.alive("before the forgeries")
    begin_ns, key = peer.now_ns, peer.keys_of(peer.session).receives
    while peer.now_ns < begin_ns + (timeout_ms + 1000) * MS:
        now_ns = peer.now_ns
        peer.send_raw(signed(peer, Heartbeat(now_ns), key, sent_ns=now_ns))
        for datagram in peer.collect(10, beating=False):
            require(not isinstance(datagram.message, HeartbeatReply), "a forged heartbeat was answered")
            if datagram.message == Bye(Reason.LINK_TIMEOUT):
                waited_ms = (peer.now_ns - begin_ns) / MS
                require(waited_ms < timeout_ms + SLACK_MS, f"the session ended only after {waited_ms:.0f} ms")
                peer.session = 0
                return
    raise Failed("the session lived on forged heartbeats")


@case(716, "11.10", "forged datagrams move neither the count nor the age")
def forged_moves_nothing(peer: Peer) -> None:
    opened(peer)
    key = peer.keys_of(peer.session).receives
    for ahead, shift_ms in ((1000, 0), (60_000, 0), (1, 10**7), (2, -1000)):
        header = {"sequence": peer.sequence + ahead, "sent_ns": peer.now_ns + shift_ms * MS}
        before = peer.sequence
        forged = signed(peer, stop(peer), key, **header)
        peer.sequence = before
        refused(peer, [forged], "a forged datagram")
        request = stop(peer)
        used(peer, peer.encoded(request), request.command_id, "the next number after a forged one")


@case(717, "11.10", "refused datagrams are counted in STATE as dropped, and not as lost")
def forged_is_counted(peer: Peer) -> None:
    opened(peer, period_ms=20)
    before = peer.state()
    for key in (None, peer.keys_of(peer.session).receives, OTHER_KEY.of_hello()):
        sequence = peer.sequence
        peer.send_raw(signed(peer, stop(peer), key))
        peer.sequence = sequence
    peer.alive("after three forgeries")
    after = peer.state()
    require(after.references_dropped - before.references_dropped == 3, "3 forgeries were not counted as 3")
    require(after.references_lost == before.references_lost, "forgeries count as losses")


@case(718, "11.9", "every datagram of the controller in the session is signed, to the last BYE")
def all_signed(peer: Peer) -> None:
    timeout_ms = opened(peer, period_ms=0).link_timeout_ms
    peer.ask(stop(peer), "a request")
    peer.collect(300)
    got = [d.message for d in peer.collect(timeout_ms + 3 * SLACK_MS, beating=False)]
    require(Bye(Reason.LINK_TIMEOUT) in got, "no BYE at the end of the session")
    peer.session = 0


@case(719, "11.9", "BYE that is not signed does not end the session")
def unsigned_bye(peer: Peer) -> None:
    opened(peer)
    assert peer.link_key is not None
    for key in (None, peer.link_key.of_hello(), peer.keys_of(peer.session).receives):
        sequence = peer.sequence
        peer.send_raw(signed(peer, Bye(Reason.SHUTDOWN), key))
        peer.sequence = sequence
        peer.alive("after a BYE that is not the client's")


@case(720, "11.3", "the flag without a trailer, and a trailer without the flag, are dropped")
def flag_and_trailer(peer: Peer) -> None:
    opened(peer)
    data = peer.encoded(stop(peer))
    bare = resealed(data[:-TRAILER_BYTES])
    unflagged = bytearray(data)
    unflagged[FLAGS + 1] = 0
    refused(peer, [bare, resealed(bytes(unflagged))], "a flag without its trailer")


@case(721, "11.7", "a late datagram is no replay: it is not used, and taken off the losses once")
def late_is_no_replay(peer: Peer) -> None:
    opened(peer, period_ms=20)
    before = peer.state()
    held = [peer.encoded(stop(peer)) for _ in range(3)]
    peer.alive("after a gap of 3")
    for _ in range(3):
        peer.send_raw(held[1])
    require(not peer.answers("a late datagram"), "a late datagram was used")
    lost = peer.state().references_lost - before.references_lost
    require(lost == 2, f"{lost} count as lost, wanted 2: one of 3 came late, its replays do not count")


@reference.case(
    722,
    "11.2",
    "a controller without a key refuses a signed HELLO with KEY_NOT_CONFIGURED",
    needs=OptionalPart.KEY_REFUSAL,
)
def no_key_there(peer: Peer) -> None:
    peer.open()
    peer.leave()
    peer.collect(RATION_MS, beating=False)
    peer.send_raw(signed(peer, Hello(peer.nonce(), 5, 0, 50), OTHER_KEY.of_hello(), session=0))
    got = [d.message for d in peer.collect(100, beating=False) if isinstance(d.message, Bye | Welcome)]
    if not got:
        raise Unsupported("a signed HELLO is dropped: clause 11 is not known there", OptionalPart.KEY_REFUSAL)
    require(got == [Bye(Reason.KEY_NOT_CONFIGURED)], f"came {got}")
