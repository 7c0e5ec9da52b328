"""Cases 221…: keeping and ending a session (clauses 2.3, 4.4, 4.9, 5.4 and 8)."""

from conformance.case import reference
from conformance.peer import RATION_MS, Peer
from conformance.reference.framing import stop
from conformance.reference.sessions import silent
from conformance.wire import MS, Failed, Unsupported, require
from protocol.faults import Reason
from protocol.reference_messages import Acknowledgement, Bye, Heartbeat, Hello

case = reference.case
# What a busy machine may add to a deadline before it counts as missed.
SLACK_MS = 100


@case(221, "4.9", "BYE ends the session at once")
def bye(peer: Peer) -> None:
    peer.open()
    session = peer.session
    peer.leave()
    peer.collect(RATION_MS, beating=False)
    peer.send(stop(peer), session=session)
    peer.expect_bye(Reason.UNKNOWN_SESSION, "a request after BYE")


@case(222, "4.4", "BYE is never answered")
def bye_unanswered(peer: Peer) -> None:
    peer.collect(RATION_MS, beating=False)
    peer.send(Bye(Reason.UNKNOWN_SESSION), session=0x1234)
    silent(peer, 100)
    peer.open()
    peer.leave()
    silent(peer, 100)


@case(223, "8", "BYE to strangers is rationed")
def rationed(peer: Peer) -> None:
    begin_ns = peer.now_ns
    for _ in range(200):
        peer.send(stop(peer), session=0x1234)
        peer.receive(0.5, beating=False)
    answers = [d for d in peer.collect(60, beating=False) if isinstance(d.message, Bye)]
    sent = [line for line in peer.transcript if line.direction == "receive"]
    allowed = (peer.now_ns - begin_ns) // (50 * MS) + 2
    require(
        len(sent) <= allowed, f"{len(sent)} answers to 200 strays, allowed {allowed} ({len(answers)} late)"
    )


@case(224, "5.4", "silence ends the session: BYE LINK_TIMEOUT, neither early nor late")
def timeout(peer: Peer) -> None:
    timeout_ms = peer.open().link_timeout_ms
    last_ns = peer.now_ns
    peer.send(Heartbeat(last_ns), sent_ns=last_ns)
    until_ns = last_ns + (timeout_ms + 1000) * MS
    while peer.now_ns < until_ns:
        datagram = peer.receive(20, beating=False)
        if datagram and isinstance(datagram.message, Bye):
            waited_ms = (peer.now_ns - last_ns) / MS
            require(datagram.message.reason is Reason.LINK_TIMEOUT, f"BYE {datagram.message.reason.name}")
            require(
                waited_ms > timeout_ms - 1, f"after {waited_ms:.1f} ms of silence, announced {timeout_ms}"
            )
            require(
                waited_ms < timeout_ms + SLACK_MS, f"only after {waited_ms:.1f} ms, announced {timeout_ms}"
            )
            peer.session = 0
            return
    raise Failed(f"no BYE {1000 + timeout_ms} ms after the last heartbeat")


@case(225, "5.4", "a session that ended by silence is not resumed")
def not_resumed(peer: Peer) -> None:
    timeout_ms = peer.open().link_timeout_ms
    session = peer.session
    peer.collect(timeout_ms + 2 * SLACK_MS, beating=False)
    peer.send(stop(peer), session=session)
    got = [d.message for d in peer.collect(60, beating=False)]
    require(Bye(Reason.UNKNOWN_SESSION) in got, f"came {got}")
    require(not any(isinstance(m, Acknowledgement) for m in got), "the request was executed")
    peer.session = 0


@case(226, "8", "four heartbeats lost in a row are survived")
def four_lost(peer: Peer) -> None:
    timeout_ms = peer.open().link_timeout_ms
    peer.alive("before the loss")
    for _ in range(4):
        peer.sequence += 1
    peer.collect(timeout_ms * 0.97 - 5, beating=False)
    peer.alive("after four lost heartbeats")


@case(227, "5.4", "requests alone keep the session alive")
def requests_keep_alive(peer: Peer) -> None:
    timeout_ms = peer.open().link_timeout_ms
    begin_ns = peer.now_ns
    while peer.now_ns - begin_ns < 2 * timeout_ms * MS:
        peer.send(stop(peer))
        got = peer.collect(timeout_ms / 5, beating=False)
        require(not any(isinstance(d.message, Bye) for d in got), "the session ended")


@case(228, "2.3", "a controller without a session sends nothing")
def quiet(peer: Peer) -> None:
    peer.open()
    peer.collect(100)
    peer.leave()
    peer.collect(30, beating=False)
    silent(peer, 300, but=Hello)


@case(229, "4.2", "the minor version of the handshake is in every datagram of the controller")
def minor_everywhere(peer: Peer) -> None:
    peer.open(period_ms=0)
    peer.send(stop(peer))
    got = peer.collect(100)
    require(bool(got), "nothing came")
    require({d.header.minor for d in got} == {peer.minor}, "another minor version than the negotiated one")
    require({d.header.session for d in got} == {peer.session}, "another session's number")


@case(230, "4.1", "a nonce need not rise")
def any_nonce(peer: Peer) -> None:
    peer.open()
    peer.leave()
    lower = peer.nonce() >> 1
    peer.open(nonce=lower)
    if peer.welcome is None:
        raise Unsupported("no session")
    peer.alive("a session with a lower nonce")
