"""Cases 301…: sequence, age and clocks (clause 5)."""

from conformance.case import case
from conformance.peer import RATION_MS, Peer
from conformance.reference.datagram_drops import dropped
from conformance.reference.framing import refused, stop, used_next
from conformance.reference.handshake import granted
from conformance.reference.sessions import SLACK_MS
from conformance.wire import MS, SEQUENCES, Failed, Unsupported, require
from protocol.datagram_layout import FLAG_ECHO_VALID
from protocol.faults import Reason
from protocol.reference_messages import Acknowledgement, Bye, Heartbeat, HeartbeatReply


@case(301, "5.2", "the same datagram a hundred times has one answer, however late the others come", opens=50)
def duplicates(peer: Peer) -> None:
    request = stop(peer)
    data = peer.send(request)
    for _ in range(49):
        peer.send_raw(data)
    peer.answer_to(request.command_id, "the first of a hundred")
    refused(peer, [data] * 50, "a hundred duplicates")


@case(302, "5.2", "a late datagram is not used", opens=50)
def late(peer: Peer) -> None:
    held = peer.encoded(stop(peer))
    used_next(peer, "the datagram after it")
    refused(peer, [held], "a late datagram")


@case(307, "5.1", "the number wraps")
def wraps(peer: Peer) -> None:
    peer.open(sequence=SEQUENCES - 4)
    for _ in range(8):
        used_next(peer, f"sequence {(peer.sequence + 1) % peer.sequences} at the wrap")


@case(308, "1.9", "a late datagram from before the wrap is not used")
def late_over_the_wrap(peer: Peer) -> None:
    peer.open(sequence=SEQUENCES - 3)
    late(peer)


@case(309, "5.1", "any start of the count is taken")
def any_start(peer: Peer) -> None:
    for start in (0, 1, 2**31 - 1, 2**31, SEQUENCES - 1):
        peer.open(sequence=start)
        used_next(peer, f"a session that starts at {start}")
        peer.leave()


@case(310, "5.2", "lost datagrams are counted in STATE, and a late one is taken off")
def losses_counted(peer: Peer) -> None:
    for start in (1000, SEQUENCES - 6):
        peer.open(period_ms=20, sequence=start)
        before = peer.state()
        held = [peer.encoded(stop(peer)) for _ in range(10)]
        peer.alive("after a gap")
        peer.require_counted(before, f"a gap of 10 in a session from {start} on", lost=10)
        for came, late in enumerate((held[1], held[8]), 1):
            peer.send_raw(late)
            peer.alive("after a late one")
            peer.require_counted(before, f"{came} of 10 came late", lost=10 - came, dropped=came)


@case(312, "5.7", "the echo, where there is one, is the newest number received", opens=50)
def echoed(peer: Peer) -> None:
    peer.drain()
    for _ in range(5):
        held = peer.encoded(stop(peer))  # it comes late
        newest = peer.sequence + 1
        peer.heartbeat()
        peer.send_raw(held)
        got = [d for d in peer.collect(30, beating=False) if d.header.flags & FLAG_ECHO_VALID]
        replied = [at for at, d in enumerate(got) if isinstance(d.message, HeartbeatReply)]
        for datagram in got[replied[0] :] if replied else ():
            require(datagram.header.echo_sequence == newest, "the echo is not the newest number")


@case(313, "5.3", "a datagram older than the link timeout is not used although it comes in order", opens=50)
def stale(peer: Peer) -> None:
    peer.alive("a fresh datagram")
    stale_request = peer.encoded(stop(peer), sent_ns=peer.now_ns - (peer.timeout_ms + 30) * MS)
    refused(peer, [stale_request], "a stale request")


@case(
    329, "5.3", "a stale datagram has no answer at all, and begins no session: that in use goes on", opens=50
)
def stale_is_nothing(peer: Peer) -> None:
    peer.alive("a fresh datagram")
    session, another = peer.session, granted(peer)
    peer.collect(RATION_MS)
    for number in (session, another):
        peer.send(stop(peer), session=number, sent_ns=peer.now_ns - (peer.timeout_ms + 30) * MS)
        answers = Acknowledgement | Bye
        peer.require_came([], peer.grace_ms, "a stale request was answered", of=answers, beating=True)
        peer.alive("after a stale datagram, beside a grant")


@case(314, "5.3", "a backlog of two seconds is not used, but for what is fresh in it", opens=50)
def backlog(peer: Peer) -> None:
    peer.alive("a fresh datagram")
    now_ns = peer.now_ns
    for age_ms in range(2000, peer.timeout_ms + 30, -17):
        peer.send(stop(peer), sent_ns=now_ns - age_ms * MS)
    newest = stop(peer)
    peer.send(newest)
    answers = peer.answers("a backlog")
    require([a.command_id for a in answers] == [newest.command_id], f"{len(answers)} of a backlog were used")


@case(315, "5.4", "stale datagrams do not keep the session alive", opens=50)
def stale_does_not_live(peer: Peer) -> None:
    peer.alive("a fresh datagram")
    begin_ns = peer.now_ns
    for _ in peer.within(peer.timeout_ms + 150):
        peer.send(Heartbeat(1), sent_ns=begin_ns - 1000 * MS)
        peer.require_came([], 20, "a stale heartbeat was answered", of=HeartbeatReply)
    peer.collect(60, beating=False)
    peer.send(stop(peer))
    peer.require_came([], 60, "the session lived on stale heartbeats", of=Acknowledgement)
    peer.session = 0


@case(317, "5.5", "HEARTBEAT is answered at once with its own time and two times in order", opens=50)
def heartbeat(peer: Peer) -> None:
    before = 0
    for _ in range(10):
        reply = peer.alive("HEARTBEAT")
        require(reply.received_ns <= reply.replied_ns, "replied before it received")
        require(reply.received_ns >= before, "the controller's clock ran backwards")
        before = reply.replied_ns
        peer.collect(5)


@case(318, "5.5", "the intervals of twenty echoes have an offset in common", opens=50)
def one_offset(peer: Peer) -> None:
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


WINDOW = 64
WORD = 1 << 16
FLOOD_MS = 4000
BURST = 32


@case(320, "8", "63 behind the newest number a late one is taken off the losses, 64 behind it is not")
def window(peer: Peer) -> None:
    peer.open(period_ms=20, sequence=1000)
    require_window(peer, ((WINDOW - 1, 1), (WINDOW, 0), (WINDOW + 1, 0), (2, 1), (1, 1)))


def require_window(peer: Peer, rows: tuple[tuple[int, int], ...]) -> None:
    """Behind a gap of 99 send one so far ``behind``: it is dropped, and so many are taken off the losses."""
    before = peer.state()
    for behind, taken_off in rows:
        peer.sequence += 99
        peer.alive("behind a gap of 99")
        late = peer.encoded(stop(peer), sequence=peer.sequence - behind)
        refused(peer, [late], f"a request {behind} behind")
        before = peer.require_counted(before, f"{behind} behind", lost=99 - taken_off, dropped=1)


@case(321, "5.2", "a late datagram is taken off the losses once, and a duplicate never", opens=20)
def taken_off_once(peer: Peer) -> None:
    before = peer.state()
    held = [peer.encoded(stop(peer)) for _ in range(5)]
    newest = peer.send(Heartbeat(1))
    old = peer.encoded(stop(peer), sequence=(peer.sequence - 300) % peer.sequences)
    refused(peer, (held[2], held[2], held[2], newest, newest, old), "late datagrams and duplicates")
    peer.require_counted(before, "5 were skipped, one of them came", lost=4, dropped=6)


@case(322, "8", "a leap is no loss, is counted as dropped, and moves nothing", opens=20)
def leaps_count(peer: Peer) -> None:
    before = peer.state()
    for _ in range(3):
        peer.send(stop(peer), sequence=(peer.sequence + WORD + 1) % peer.sequences)
    used_next(peer, "the next number after leaps")
    peer.require_counted(before, "three leaps", lost=0, dropped=3)


@case(323, "5.2", "a gap is counted exactly: of 1, of 2, of 63, 64, 65 and of 65535", opens=20)
def exact_gaps(peer: Peer) -> None:
    before = peer.state()
    for gap in (0, 1, 2, WINDOW - 1, WINDOW, WINDOW + 1, WORD - 1):
        peer.sequence += gap
        peer.alive(f"behind a gap of {gap}")
        before = peer.require_counted(before, f"a gap of {gap}", lost=gap)


@case(324, "3.5", "whatever is dropped is counted as dropped, and not as lost", opens=20)
def drops_are_counted(peer: Peer) -> None:
    other = peer.second()
    before = peer.state()
    for what, source, data in dropped(peer, other):
        peer.send_beside(source, data)
        peer.collect(10)
        before = peer.require_counted(before, f"a datagram {what}", lost=0, dropped=1)


@case(325, "5.3", "a stale datagram came: it moves the number, and what it skipped is lost", opens=20)
def stale_came(peer: Peer) -> None:
    peer.alive("a fresh datagram")
    before = peer.state()
    held = peer.encoded(stop(peer))
    peer.send(stop(peer), sent_ns=peer.now_ns - 5 * peer.timeout_ms * MS)
    refused(peer, [held], "a late datagram behind a stale one")
    peer.require_counted(before, "one was skipped, and came late", lost=0, dropped=2)


@case(326, "5.4", f"a datagram counts as heard when it left, not when it is read (slack {SLACK_MS} ms)")
def heard_when_it_left(peer: Peer) -> None:
    timeout_ms = peer.open().link_timeout_ms
    peer.collect(20)
    begin_ns = peer.heartbeat()
    peer.collect(0.95 * timeout_ms - (peer.now_ns - begin_ns) / MS, beating=False)
    peer.send(Heartbeat(1), sent_ns=begin_ns + int(0.05 * timeout_ms * MS))  # 0.9 of the timeout under way
    peer.expect_bye(Reason.LINK_TIMEOUT, "silence behind a heartbeat that was late", 2 * timeout_ms)
    waited_ms = (peer.now_ns - begin_ns) / MS
    require(waited_ms > timeout_ms - 1, f"after {waited_ms:.0f} ms, announced {timeout_ms}")
    note = f"it ended {waited_ms:.0f} ms after the first heartbeat; the second left 0.05 timeouts later"
    require(waited_ms < 1.05 * timeout_ms + SLACK_MS, note)


@case(327, "5.3", "the least transit is kept for 10 to 20 s: after 8 s still, after 21 not (takes 25 s)")
def base_of_age(peer: Peer) -> None:
    timeout_ms = peer.open(period_ms=1000).link_timeout_ms
    peer.collect(3000)
    peer.alive("a fresh datagram")
    begin_ns, later_ns = peer.now_ns, int(0.6 * timeout_ms * MS)
    peer.set_back(later_ns)  # every datagram from now on seems to be that long under way
    try:
        peer.alive("0.6 of the link timeout under way")
    except Failed as why:
        raise Unsupported("max_age_ms is below 0.6 of the link timeout") from why
    begin_ns -= later_ns
    for at_ms, fresh in ((8500, False), (21_000, True)):
        peer.collect(at_ms - (peer.now_ns - begin_ns) / MS)
        request = stop(peer)
        peer.send(request, sent_ns=peer.now_ns - later_ns)
        peer.send(Heartbeat(1))  # a sign of life right behind it
        answered = bool(peer.answers(f"{at_ms} ms after the clock went back"))
        require(answered == fresh, f"{at_ms} ms after the fastest datagram its transit was"
                f" {'kept' if fresh else 'forgotten'}")  # fmt: skip


@case(328, "5.1", "the controller's own numbers rise one by one for 65537 datagrams, or for 4 s", opens=1000)
def own_number(peer: Peer) -> None:
    first = newest = None
    for _ in peer.within(FLOOD_MS):
        for _ in range(BURST):
            peer.heartbeat()
        replies = 0
        while replies < BURST and (datagram := peer.receive(200, beating=False)) is not None:
            replies += isinstance(datagram.message, HeartbeatReply)
            number = datagram.header.sequence
            first = number if first is None else first
            step = 1 if newest is None else (number - newest) % peer.sequences
            require(step == 1, f"a step of {step} from {newest}")
            newest = number
        peer.transcript.clear()
        if first is not None and newest is not None and (newest - first) % peer.sequences > WORD:
            return
