"""Cases 320…: the window of numbers, age and its base, and long counts (clauses 5 and 8)."""

from conformance.case import reference
from conformance.peer import Peer
from conformance.reference.datagram_drops import dropped
from conformance.reference.framing import stop
from conformance.reference.handshake import SLACK_MS
from conformance.reference.order import used
from conformance.wire import MS, Failed, Unsupported, require
from protocol.faults import Reason
from protocol.reference_messages import Bye, Heartbeat, HeartbeatReply

case = reference.case
WINDOW = 64
WORD = 1 << 16
FLOOD_MS = 4000
BURST = 32


def tallies(peer: Peer) -> tuple[int, int]:
    """What STATE counts as lost and as dropped."""
    state = peer.state()
    return state.references_lost, state.references_dropped


@case(320, "8", "63 behind the newest number a late one is taken off the losses, 64 behind it is not")
def window(peer: Peer) -> None:
    peer.open(period_ms=20, sequence=1000)
    lost, _ = tallies(peer)
    for behind, taken_off in ((WINDOW - 1, 1), (WINDOW, 0), (WINDOW + 1, 0), (2, 1), (1, 1)):
        first = peer.sequence + 1
        peer.sequence += 99
        peer.alive("behind a gap of 99")
        peer.send(stop(peer), sequence=peer.sequence - behind)
        require(peer.sequence - behind >= first, "the tester's gap is too small")
        require(not peer.answers(f"a request {behind} behind"), f"a request {behind} behind was used")
        now_lost, _ = tallies(peer)
        require(now_lost - lost == 99 - taken_off, f"{behind} behind: {now_lost - lost} lost of a gap of 99")
        lost = now_lost


@case(321, "5.2", "a late datagram is taken off the losses once, and a duplicate never")
def taken_off_once(peer: Peer) -> None:
    peer.open(period_ms=20)
    lost, gone = tallies(peer)
    held = [peer.encoded(stop(peer)) for _ in range(5)]
    newest = peer.send(Heartbeat(1))
    old = peer.encoded(stop(peer), sequence=(peer.sequence - 300) % peer.sequences)
    for data in (held[2], held[2], held[2], newest, newest, old):
        peer.send_raw(data)
    require(not peer.answers("late datagrams and duplicates"), "one was used")
    now_lost, now_gone = tallies(peer)
    require(now_lost - lost == 4, f"{now_lost - lost} lost: 5 were skipped, one of them came")
    require(now_gone - gone == 6, f"{now_gone - gone} dropped of 6")


@case(322, "8", "a leap is no loss, is counted as dropped, and moves nothing")
def leaps_count(peer: Peer) -> None:
    peer.open(period_ms=20)
    lost, gone = tallies(peer)
    for _ in range(3):
        peer.send(stop(peer), sequence=(peer.sequence + WORD + 1) % peer.sequences)
    used(peer, "the next number after leaps")
    now_lost, now_gone = tallies(peer)
    require(
        (now_lost - lost, now_gone - gone) == (0, 3), f"{now_lost - lost} lost, {now_gone - gone} dropped"
    )


@case(323, "5.2", "a gap is counted exactly: of 1, of 2, of 63, 64, 65 and of 65535")
def exact_gaps(peer: Peer) -> None:
    peer.open(period_ms=20)
    lost, _ = tallies(peer)
    for gap in (0, 1, 2, WINDOW - 1, WINDOW, WINDOW + 1, WORD - 1):
        peer.sequence += gap
        peer.alive(f"behind a gap of {gap}")
        now_lost, _ = tallies(peer)
        require(now_lost - lost == gap, f"a gap of {gap} was counted as {now_lost - lost}")
        lost = now_lost


@case(324, "3.5", "whatever is dropped is counted as dropped, and not as lost")
def drops_are_counted(peer: Peer) -> None:
    peer.open(period_ms=20)
    other = peer.second()
    lost, gone = tallies(peer)
    for what, source, data in dropped(peer, other):
        sequence = peer.sequence
        source.send_raw(data())
        peer.sequence = sequence
        peer.collect(10)
        now_lost, now_gone = tallies(peer)
        require(now_gone - gone == 1, f"a datagram {what} was counted as {now_gone - gone} dropped")
        require(now_lost == lost, f"a datagram {what} counts as lost")
        gone = now_gone


@case(325, "5.3", "a stale datagram came: it moves the number, and what it skipped is lost")
def stale_came(peer: Peer) -> None:
    peer.open(period_ms=20)
    peer.alive("a fresh datagram")
    lost, gone = tallies(peer)
    held = peer.encoded(stop(peer))
    peer.send(stop(peer), sent_ns=peer.now_ns - 5 * peer.timeout_ms * MS)
    peer.send_raw(held)
    require(not peer.answers("a late datagram behind a stale one"), "it was used")
    now_lost, now_gone = tallies(peer)
    require(now_lost == lost, f"{now_lost - lost} lost: one was skipped, and came late")
    require(now_gone - gone == 2, f"{now_gone - gone} dropped of 2")


@case(326, "5.4", f"a datagram counts as heard when it left, not when it is read (slack {SLACK_MS} ms)")
def heard_when_it_left(peer: Peer) -> None:
    timeout_ms = peer.open().link_timeout_ms
    peer.collect(20)
    begin_ns = peer.now_ns
    peer.send(Heartbeat(begin_ns), sent_ns=begin_ns)
    peer.collect(0.95 * timeout_ms - (peer.now_ns - begin_ns) / MS, beating=False)
    peer.send(Heartbeat(1), sent_ns=begin_ns + int(0.05 * timeout_ms * MS))  # 0.9 of the timeout under way
    until_ns = begin_ns + 3 * timeout_ms * MS
    while peer.now_ns < until_ns:
        datagram = peer.receive(20, beating=False)
        if datagram and datagram.message == Bye(Reason.LINK_TIMEOUT):
            peer.session = 0
            waited_ms = (peer.now_ns - begin_ns) / MS
            require(waited_ms > timeout_ms - 1, f"after {waited_ms:.0f} ms, announced {timeout_ms}")
            require(
                waited_ms < 1.05 * timeout_ms + SLACK_MS,
                f"it ended {waited_ms:.0f} ms after the first heartbeat; the second left 0.05 timeouts later",
            )
            return
    raise Failed(f"no BYE {3 * timeout_ms} ms after the last heartbeat but one")


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


@case(328, "5.1", "the controller's own numbers rise one by one for 65537 datagrams, or for 4 s")
def own_number(peer: Peer) -> None:
    peer.open(period_ms=1000)
    first = newest = None
    until_ns = peer.now_ns + FLOOD_MS * MS
    while peer.now_ns < until_ns:
        for _ in range(BURST):
            now_ns = peer.now_ns
            peer.send(Heartbeat(now_ns), sent_ns=now_ns)
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
