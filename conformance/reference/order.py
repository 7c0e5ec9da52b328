"""Cases 301…: sequence, age and clocks (clause 5)."""

import itertools

from conformance.case import reference
from conformance.peer import RATION_MS, Peer
from conformance.reference.framing import stop
from conformance.reference.handshake import granted
from conformance.wire import MS, SEQUENCES, require
from protocol.faults import Reason
from protocol.reference_messages import Acknowledgement, Bye, Heartbeat, HeartbeatReply, State

case = reference.case
FLAG_ECHO_VALID = 1


def ignored(peer: Peer, what: str, sequence: int, sent_ns: int | None = None) -> None:
    """A STOP of this sequence number is not answered, and the session lives on."""
    peer.send(stop(peer), sequence=sequence, sent_ns=sent_ns)
    require(not peer.answers(what), f"{what} was used")


def used(peer: Peer, what: str, sequence: int | None = None, sent_ns: int | None = None) -> None:
    """A STOP of this sequence number is answered."""
    request = stop(peer)
    peer.send(request, sequence=sequence, sent_ns=sent_ns)
    answer = peer.answer_to(request.command_id, what)
    require(answer.reason is Reason.ACCEPTED, f"{what}: answered {answer.reason.name}")


@case(301, "5.2", "the same datagram a hundred times has one answer, however late the others come")
def duplicates(peer: Peer) -> None:
    peer.open()
    request = stop(peer)
    data = peer.send(request)
    for _ in range(49):
        peer.send_raw(data)
    peer.answer_to(request.command_id, "the first of a hundred")
    for _ in range(50):
        peer.send_raw(data)
    require(not peer.answers("a hundred duplicates"), "a duplicate was answered")


@case(302, "5.2", "a late datagram is not used")
def late(peer: Peer) -> None:
    peer.open()
    held = peer.encoded(stop(peer))
    used(peer, "the datagram after it")
    peer.send_raw(held)
    require(not peer.answers("a late datagram"), "a datagram older than the newest was used")


@case(303, "5.2", "a datagram from long before is not used")
def old(peer: Peer) -> None:
    peer.open(sequence=100_000)
    ignored(peer, "a number 5000 behind", peer.sequence - 5000)


@case(304, "5.2", "a number that starts again within the session is not used")
def started_again(peer: Peer) -> None:
    peer.open(sequence=100_000)
    for number in (0, 1, 2):
        ignored(peer, f"sequence {number} again", number)


@case(305, "8", "a leap beyond the greatest gap is not used and does not move the count")
def leap(peer: Peer) -> None:
    peer.open()
    for ahead in (65_537, 2**20, 2**31 - 1):
        ignored(peer, f"a leap of {ahead}", (peer.sequence + ahead) % peer.sequences)
    used(peer, "the next number after a leap")


@case(306, "8", "the greatest gap is used")
def greatest_gap(peer: Peer) -> None:
    peer.open()
    peer.sequence += 65_535
    used(peer, "65535 numbers skipped")


@case(307, "5.1", "the number wraps")
def wraps(peer: Peer) -> None:
    peer.open(sequence=SEQUENCES - 4)
    for _ in range(8):
        used(peer, f"sequence {(peer.sequence + 1) % peer.sequences} at the wrap")


@case(308, "1.9", "a late datagram from before the wrap is not used")
def late_over_the_wrap(peer: Peer) -> None:
    peer.open(sequence=SEQUENCES - 3)
    held = peer.encoded(stop(peer))
    for _ in range(4):
        used(peer, "a datagram at the wrap")
    peer.send_raw(held)
    require(not peer.answers("a late datagram from before the wrap"), "it was used")


@case(309, "5.1", "any start of the count is taken")
def any_start(peer: Peer) -> None:
    for start in (0, 1, 2**31 - 1, 2**31, SEQUENCES - 1):
        peer.open(sequence=start)
        used(peer, f"a session that starts at {start}")
        peer.leave()


@case(310, "5.2", "lost datagrams are counted in STATE, and a late one is taken off")
def losses_counted(peer: Peer) -> None:
    for start in (1000, SEQUENCES - 6):
        peer.open(period_ms=20, sequence=start)
        before = peer.state()
        held = [peer.encoded(stop(peer)) for _ in range(10)]
        peer.alive("after a gap")
        lost = peer.state().references_lost - before.references_lost
        require(lost == 10, f"a gap of 10 in a session from {start} on was counted as {lost}")
        for came, late in enumerate((held[1], held[8]), 1):
            peer.send_raw(late)
            peer.alive("after a late one")
            after = peer.state()
            dropped = after.references_dropped - before.references_dropped
            require(after.references_lost - before.references_lost == lost - came, "it still counts as lost")
            require(dropped == came, "it does not count as dropped")


@case(311, "5.1", "the controller numbers its datagrams one by one")
def numbered(peer: Peer) -> None:
    peer.open(period_ms=0)
    peer.drain()
    sequences = []
    for _ in range(5):
        peer.send(stop(peer))
        sequences += [d.header.sequence for d in peer.collect(40)]
    steps = {(b - a) % peer.sequences for a, b in itertools.pairwise(sequences)}
    require(steps == {1}, f"steps of {sorted(steps)} between {len(sequences)} datagrams")


@case(312, "5.7", "the echo, where there is one, is the newest number received")
def echoed(peer: Peer) -> None:
    peer.open()
    peer.drain()
    for _ in range(5):
        now_ns = peer.now_ns
        held = peer.encoded(stop(peer))  # it comes late
        newest = peer.sequence + 1
        peer.send(Heartbeat(now_ns), sent_ns=now_ns)
        peer.send_raw(held)
        got = [d for d in peer.collect(30, beating=False) if d.header.flags & FLAG_ECHO_VALID]
        replied = [at for at, d in enumerate(got) if isinstance(d.message, HeartbeatReply)]
        for datagram in got[replied[0] :] if replied else ():
            require(datagram.header.echo_sequence == newest, "the echo is not the newest number")


@case(313, "5.3", "a datagram older than the link timeout is not used although it comes in order")
def stale(peer: Peer) -> None:
    peer.open()
    peer.alive("a fresh datagram")
    peer.send(stop(peer), sent_ns=peer.now_ns - (peer.timeout_ms + 30) * MS)
    require(not peer.answers("a stale request"), "a stale request was used")


@case(329, "5.3", "a stale datagram has no answer at all, and begins no session: that in use goes on")
def stale_is_nothing(peer: Peer) -> None:
    peer.open()
    peer.alive("a fresh datagram")
    session, another = peer.session, granted(peer)
    peer.collect(RATION_MS)
    for number in (session, another):
        peer.send(stop(peer), session=number, sent_ns=peer.now_ns - (peer.timeout_ms + 30) * MS)
        came = [
            d.message for d in peer.collect(peer.grace_ms) if isinstance(d.message, Acknowledgement | Bye)
        ]
        require(not came, f"a stale request was answered: {came}")
        peer.alive("after a stale datagram, beside a grant")


@case(314, "5.3", "a backlog of two seconds is not used, but for what is fresh in it")
def backlog(peer: Peer) -> None:
    peer.open()
    peer.alive("a fresh datagram")
    now_ns = peer.now_ns
    for age_ms in range(2000, peer.timeout_ms + 30, -17):
        peer.send(stop(peer), sent_ns=now_ns - age_ms * MS)
    newest = stop(peer)
    peer.send(newest)
    answers = peer.answers("a backlog")
    require([a.command_id for a in answers] == [newest.command_id], f"{len(answers)} of a backlog were used")


@case(315, "5.4", "stale datagrams do not keep the session alive")
def stale_does_not_live(peer: Peer) -> None:
    peer.open()
    peer.alive("a fresh datagram")
    begin_ns = peer.now_ns
    while peer.now_ns - begin_ns < (peer.timeout_ms + 150) * MS:
        peer.send(Heartbeat(1), sent_ns=begin_ns - 1000 * MS)
        for datagram in peer.collect(20, beating=False):
            require(not isinstance(datagram.message, HeartbeatReply), "a stale heartbeat was answered")
    peer.collect(60, beating=False)
    peer.send(stop(peer))
    require(
        not any(isinstance(d.message, Acknowledgement) for d in peer.collect(60, beating=False)),
        "the session lived on stale heartbeats",
    )
    peer.session = 0


@case(316, "5.3", "the client's clock may differ by hours, from session to session")
def other_clock(peer: Peer) -> None:
    for hours in (0.0, 1.0, -1.0, 1000.0):
        peer.shift_ns = 0
        if peer.now_ns + hours * 3600e9 < 0:
            continue  # a clock does not show less than nothing
        peer.shift_ns = int(hours * 3600e9)
        peer.open()
        used(peer, f"a clock {hours:g} h off")
        peer.leave()


@case(317, "5.5", "HEARTBEAT is answered at once with its own time and two times in order")
def heartbeat(peer: Peer) -> None:
    peer.open()
    before = 0
    for _ in range(10):
        reply = peer.alive("HEARTBEAT")
        require(reply.received_ns <= reply.replied_ns, "replied before it received")
        require(reply.received_ns >= before, "the controller's clock ran backwards")
        before = reply.replied_ns
        peer.collect(5)


@case(318, "5.5", "the intervals of twenty echoes have an offset in common")
def one_offset(peer: Peer) -> None:
    peer.open()
    low, high = -(2**63), 2**63
    for _ in range(20):
        begin_ns = peer.now_ns
        reply = peer.alive("HEARTBEAT")
        end_ns = peer.now_ns
        require(
            reply.replied_ns - reply.received_ns <= end_ns - begin_ns, "longer in the controller than away"
        )
        low = max(low, reply.replied_ns - end_ns)
        high = min(high, reply.received_ns - reply.sent_ns)
        peer.collect(10)
    require(low <= high + 20_000, f"no offset fits all echoes: they miss by {(low - high) / 1000:.0f} µs")


@case(319, "1.7", "header time, heartbeat time and STATE time are one monotonic clock")
def one_clock(peer: Peer) -> None:
    peer.open(period_ms=10)
    peer.drain()
    last = 0
    for _ in range(5):
        now_ns = peer.now_ns
        peer.send(Heartbeat(now_ns), sent_ns=now_ns)
        for datagram in peer.collect(40, beating=False):
            require(datagram.header.sent_ns >= last, "the controller's sent_ns ran backwards")
            last = datagram.header.sent_ns
            if isinstance(datagram.message, HeartbeatReply):
                reply = datagram.message
                require(abs(reply.replied_ns - last) < 5 * MS, "replied_ns and sent_ns are of two clocks")
            if isinstance(datagram.message, State):
                age_ms = (last - datagram.message.time_ns) / MS
                require(-1 <= age_ms < 250, f"STATE is {age_ms:.1f} ms older than its header says")
