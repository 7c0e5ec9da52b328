"""Cases of long numbers: two that differ in any one bit are two, and a clock counts from any start (1.7)."""

from collections.abc import Callable

from conformance.case import case, stream_case
from conformance.noted import TABLED
from conformance.peer import Peer
from conformance.reference.arm_stream_times import AGE_SIDE_MS, LIMITS_FEED_MS, resting_stream
from conformance.reference.framing import stop, used_next
from conformance.reference.handshake import granted, require_begun
from conformance.reference.motion import disabled
from conformance.reference.streaming import NUMBERS
from conformance.wire import MS, known, require
from protocol.faults import CommandCode, Reason
from protocol.pose import IDENTITY
from protocol.reference_messages import (
    CAPABILITY_AUTHENTICATION,
    Bye,
    Command,
    Heartbeat,
    HeartbeatReply,
    ReferencePath,
    ReferencePose,
    Request,
)

WORD = 1 << 64
# Numbers that are drawn one after the other, spread so far that none is next to another's.
SPREAD = 0x9E3779B97F4A7C15
# A session may cross 2^BIT, in ns, wherever a number of fewer bits or with a sign would end.
CLOCK_BITS = (31, 32, 40, 48, 52, 53, 56, 60, 61, 62, 63)
HOUR_NS = 3_600_000 * MS
LEAST_ID = 129
FAR_NS = 2**63 + 2**40
BURST = 11


def flipped(number: int) -> list[int]:
    """The numbers that differ from ``number`` in one bit, but 0."""
    return [number ^ 1 << bit for bit in range(64) if number != 1 << bit]


@case(
    217, "3.5", "what is of session 0, or of one that differs in any one bit, is not used, nor BYE", opens=50
)
def sessions(peer: Peer) -> None:
    for session in (0, *flipped(peer.session)):
        peer.send(stop(peer), session=session)
        peer.send(Bye(Reason.SHUTDOWN), session=session)
        came = [d.message for d in peer.collect(2.0) if not isinstance(d.message, Bye)]
        require(not any(isinstance(m, Request) for m in came), f"came {came}")
    require(not peer.answers("requests of other sessions"), "a request of another session was answered")


@case(
    256,
    "4.6",
    "nonces that differ in any bit are two: of a session in use, of an ended one, of a grant",
)
def nonces(peer: Peer) -> None:
    ended, in_use = (peer.nonce() * SPREAD % WORD for _ in range(2))
    peer.open(nonce=ended)
    peer.reopen(nonce=in_use)
    seen = {peer.session}
    for bit, (near_ended, near_used) in enumerate(zip(flipped(ended), flipped(in_use), strict=True)):
        peer.alive("the session in use")
        fresh = peer.nonce() * SPREAD % WORD
        for nonce in (near_ended, near_used, fresh, fresh ^ 1 << bit):
            session = granted(peer, nonce=nonce)
            require(session not in seen, f"nonce {nonce:#x} was granted the session of another one")
            seen.add(session)
    peer.alive("after other nonces")


@case(136, "4.2", "each bit of the capabilities is granted alone, if both can use it; others are not")
def capabilities(peer: Peer) -> None:
    def of(offered: int) -> int:
        granted(peer, capabilities=offered & ~CAPABILITY_AUTHENTICATION | peer.required)
        return peer.welcome.capabilities

    can = of(WORD - 1)
    require(not can & ~TABLED, f"{can & ~TABLED:#x} is granted, which is in no table")
    for offered in (0, 3, *(1 << bit for bit in range(64))):
        expected = can & (offered & ~CAPABILITY_AUTHENTICATION | peer.required)
        require(of(offered) == expected, f"of {offered:#x} other bits than {expected:#x} are granted")


@case(434, "6.4", "ids that differ in any one bit are two, whatever the request, up to the greatest")
def ids(peer: Peer) -> None:
    kinds: tuple[Callable[[int], Request], ...] = (
        lambda number: Command(number, CommandCode.STOP),
        lambda number: ReferencePose(number, IDENTITY, 0.0),
        lambda number: ReferencePath(number, (IDENTITY,), 0.0, 0.0),
    )
    disabled(peer)
    for make in kinds:
        peer.reopen()  # it knows nothing of the ids before (4.7)
        first = peer.ask(make(LEAST_ID), "a low id")
        for bit in range(8, 64):
            got = peer.ask(make(LEAST_ID | 1 << bit), f"an id that is newer by bit {bit}")
            require(got[1:] == first[1:], f"an id that is newer by bit {bit}: {got.reason.name}")
        newest = 1 << 63 | LEAST_ID + 6  # none of those before is a power of two older
        peer.ask(make(newest), "the newest id")
        for bit in range(63):
            got = peer.ask(make(newest - (1 << bit)), f"an id that is 2^{bit} older")
            wanted = (Reason.OVERTAKEN, float(newest - (1 << bit)), float(newest))
            require(got[1:] == wanted, f"an id that is 2^{bit} older: {got}")


@case(257, "6.1", "motion_id names a motion with all bits of its id", motion=True)
def motion_ids(peer: Peer) -> None:
    disabled(peer)
    peer.reopen(period_ms=0)
    peer.ask(Command(1, CommandCode.ENABLE), "ENABLE with the lowest id")
    here = peer.state().X_BT_cmd
    for bit in (3, 8, 16, *range(29, 64)):
        number = 1 << bit | 5
        got = peer.ask(ReferencePose(number, here, 0.0), "a motion")
        named = peer.state().motion_id
        require(got.reason is not Reason.ACCEPTED or named == number, f"{named:#x} is named, not {number:#x}")


@case(
    422,
    "5.5",
    "heartbeats that come at once are answered each, with their own time in all its bits",
    opens=50,
)
def heartbeats(peer: Peer) -> None:
    times = [0, WORD - 1, *(1 << bit for bit in range(64))]
    for begin in range(0, len(times), BURST):
        peer.drain()
        sent_times = times[begin : begin + BURST]
        peer.send_at_once(map(Heartbeat, sent_times))
        got = peer.gather(HeartbeatReply, len(sent_times), beating=False)
        replies = [reply.sent_ns for reply in got]
        require(replies == sent_times, f"of {sent_times} came back {replies}")


@case(305, "8", "what leaps too far ahead, or lies behind by any power of two, is not used and moves nothing")
def leaps(peer: Peer) -> None:
    peer.open(sequence=100_000)
    bits = range(peer.sequences.bit_length() - 1)
    ahead = [2**16 + 1, *(1 << bit for bit in bits if bit > 16)]
    behind = [peer.sequence, peer.sequence - 1, *(1 << bit for bit in bits)]
    for far in (*ahead, *(-each for each in behind)):
        request = stop(peer)
        peer.send(request, sequence=(peer.sequence + far) % peer.sequences)
        came = [d.message for d in peer.collect(2.0)]
        require(not any(getattr(m, "command_id", 0) == request.command_id for m in came), f"{far} away: used")
    require(not peer.answers("leaps"), "a leap was used")
    used_next(peer, "the next number after leaps")


@case(316, "1.7", "the client's clock counts from any start: from 0, over powers of two, near its end")
def clocks(peer: Peer) -> None:
    for start_ns in (0, *(2**bit - 30 * MS for bit in CLOCK_BITS), WORD - HOUR_NS):
        peer.shift_ns += start_ns - peer.now_ns
        peer.open()
        used_next(peer, f"a clock at {start_ns:#x}", sent_ns=start_ns)
        peer.collect(30)
        used_next(peer, f"30 ms after {start_ns:#x}")
        if start_ns > HOUR_NS:
            peer.send(stop(peer), sent_ns=peer.now_ns - 5 * peer.timeout_ms * MS)
            require(not peer.answers("a stale one"), f"a stale one was used, by a clock at {start_ns:#x}")
        require_begun(peer, granted(peer), f"a restart in place, by a clock at {start_ns:#x}")
        peer.leave()


@stream_case(598, "12.4", "a stream is named by all bits of its id: another is NOT_STREAMING, and is named")
def streams(peer: Peer) -> None:
    stream, here = resting_stream(peer)
    for other in flipped(stream.stream_id):
        got = known(stream.verdict(here, stream_id=other), f"stream {other:#x} is followed")
        fields = (got.reason, got.stream_id, got.value, got.limit)
        wanted = (Reason.NOT_STREAMING, other, float(other), float(stream.stream_id))
        require(fields == wanted, f"stream {other:#x}: {got}")
        stream.feed(here, LIMITS_FEED_MS)


@stream_case(585, "12.5", "a number is newer by any power of two, and older by any: 2^31 is no longer newer")
def stream_numbers(peer: Peer) -> None:
    stream, here = resting_stream(peer)
    for bit in range(31):
        stream.number = (stream.number - 1 + (1 << bit)) % NUMBERS
        require(stream.verdict(here) is None, f"a leap of 2^{bit} is refused")
        newest = (stream.number - 1) % NUMBERS
        for back in (1 << bit, 0, NUMBERS // 2):
            stream.number = (newest + 1) % NUMBERS
            got = stream.verdict(here, number=(newest - back) % NUMBERS)
            good = got is not None and got.reason is Reason.OVERTAKEN and got.limit == newest
            require(good, f"{back} behind {newest}: {got}")
        stream.number = (newest + 1) % NUMBERS
        stream.feed(here, LIMITS_FEED_MS)


@stream_case(599, "12.6", "the measurement's time counts in all its bits, also over half a clock's range")
def measured(peer: Peer) -> None:
    peer.shift_ns += FAR_NS - peer.now_ns
    stream, here = resting_stream(peer)
    old = known(stream.verdict(here, time_ns=peer.now_ns - 2**62), "2^62 ns old, and followed")
    require(old.reason is Reason.STALE, f"2^62 ns old, and not STALE: {old}")
    for bit in range(63):
        age_ms = (1 << bit) / MS
        stream.feed(here, LIMITS_FEED_MS)
        got = stream.verdict(here, time_ns=peer.now_ns - (1 << bit))
        stale = got is not None and got.reason is Reason.STALE and got.value > old.limit
        near = abs(age_ms - 1e3 * old.limit) < AGE_SIDE_MS
        require(near or stale == (age_ms > 1e3 * old.limit), f"2^{bit} ns old: {got}")
        got = stream.verdict(here, time_ns=peer.now_ns + (1 << bit))
        require(got is None, f"2^{bit} ns ahead, which is of age 0 (12.6): {got}")
