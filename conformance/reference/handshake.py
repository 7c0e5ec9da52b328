"""Cases 231…239: a session begins with the client's first datagram in it (clauses 4.2, 4.4, 4.5 and 4.11)."""

from conformance.case import case
from conformance.peer import RATION_MS, Peer
from conformance.reference.framing import MAJOR, stop
from conformance.reference.sessions import SLACK_MS, silent
from conformance.wire import ANSWER_MS, MS, Failed, require
from protocol.faults import Reason
from protocol.reference_messages import Acknowledgement, Bye, HeartbeatReply, Hello, State, Welcome

# Answers to one datagram of a stranger: no more bytes than this many times what he sent.
AMPLIFICATION = 3


def granted(peer: Peer, *, nonce: int | None = None, period_ms: int = 50, capabilities: int = 1) -> int:
    """The number of the session that a new HELLO is granted; nothing is sent in it yet."""
    hello = Hello(nonce or peer.nonce(), peer.required | capabilities, 0, period_ms)
    peer.send(hello, session=0, minor=0)
    for (session, *_), message in peer.arriving(ANSWER_MS, beating=False):
        if isinstance(message, Welcome) and message.client_nonce == hello.client_nonce:
            peer.welcome = message
            return session
    raise Failed(f"no WELCOME within {ANSWER_MS} ms")


def beaten(peer: Peer, session: int) -> list[object]:
    """What comes in answer to a heartbeat in ``session``, STATE left out."""
    peer.heartbeat(session)
    return [d.message for d in peer.collect(RATION_MS, beating=False) if not isinstance(d.message, State)]


def require_begun(peer: Peer, session: int, why: str) -> None:
    """Require that a heartbeat in ``session`` is answered, which makes it the peer's."""
    got = beaten(peer, session)
    require(any(isinstance(m, HeartbeatReply) for m in got), f"{why}: a heartbeat was answered {got}")
    peer.session = session


def require_none(peer: Peer, session: int, why: str) -> None:
    """Require that ``session`` is none: a heartbeat in it is told UNKNOWN_SESSION."""
    peer.collect(RATION_MS, beating=False)
    got = beaten(peer, session)
    require(got == [Bye(Reason.UNKNOWN_SESSION)], f"{why}: a heartbeat was answered {got}")


@case(231, "4.2", "a session begins with the client's first datagram in it: before it WELCOME alone is sent")
def nothing_but_welcome(peer: Peer) -> None:
    nonce = peer.nonce()
    session = granted(peer, nonce=nonce, period_ms=0)
    # Shorter than any link timeout that lets four heartbeats be lost: the grant is still good.
    peer.require_came([], 100, "before the first datagram of the session")
    require(granted(peer, nonce=nonce, period_ms=0) == session, "HELLO again was granted another session")
    require_begun(peer, session, "the first heartbeat")
    states = [d for d in peer.collect(100) if isinstance(d.message, State)]
    require(bool(states), "no STATE in the session that has begun")


@case(
    232,
    "4.5",
    "a HELLO with the client's address and another nonce does not disturb the session in use",
    opens=20,
)
def forged_hello(peer: Peer) -> None:
    in_use = peer.session
    for _ in range(5):
        granted(peer, period_ms=0)
    others = {d.header.session for d in peer.collect(100)} - {in_use}
    require(not others, f"datagrams of {len(others)} sessions that nobody began")
    peer.ask(stop(peer), "a request of the session in use")
    peer.alive("the session in use")


@case(
    233,
    "4.5",
    "after a restart in place the old session ends with the first datagram in the new one",
    opens=50,
)
def restart_is_confirmed(peer: Peer) -> None:
    old = peer.session
    new = granted(peer)
    peer.ask(stop(peer), "a request of the old session, before the new one begins")
    require_begun(peer, new, "the new session")
    request = stop(peer)
    peer.send(request, session=old)
    got = [d.message for d in peer.collect(RATION_MS)]
    require(Bye(Reason.UNKNOWN_SESSION) in got, f"a request of the old session was answered {got}")


@case(235, "8", "a grant is good for link_timeout_ms, and then forgotten")
def grant_forgotten(peer: Peer) -> None:
    session = granted(peer)
    peer.collect(peer.timeout_ms * 0.6, beating=False)
    require_begun(peer, session, "after 0.6 of the link timeout")
    peer.leave()
    session = granted(peer)
    peer.collect(peer.timeout_ms + SLACK_MS, beating=False)
    require_none(peer, session, f"{SLACK_MS} ms after the link timeout")


@case(236, "4.2", "a request may be the first datagram in a session")
def request_begins(peer: Peer) -> None:
    session = granted(peer)
    peer.session = session
    peer.ask(stop(peer), "a request as the first datagram of its session")
    peer.alive("a session that began with a request")


@case(237, "4.11", "before it has proved to hear, a source is sent at most three times the bytes it sent")
def no_amplifier(peer: Peer) -> None:
    nonce = peer.nonce()
    again = [peer.encoded(_hello(peer, nonce), session=0) for _ in range(20)]
    others = [peer.encoded(_hello(peer, peer.nonce()), session=0) for _ in range(20)]
    strays = [peer.encoded(stop(peer), session=0x1234 + n) for n in range(20)]
    versions = [peer.with_number(data, MAJOR, "B", 9) for data in strays]
    noise = [data[:40] for data in strays]
    floods = {"HELLO": again[:1], "HELLO again": again[1:], "HELLO, new nonces": others}
    floods |= {"strays": strays, "another major version": versions, "headers": noise}
    for what, datagrams in floods.items():
        begin = len(peer.transcript)
        for data in datagrams:
            peer.send_raw(data)
            peer.receive(5.0, beating=False)
        peer.collect(300, beating=False)
        sent, came = (
            sum(len(line.data) for line in peer.transcript[begin:] if line.direction == direction)
            for direction in ("send", "receive")
        )
        require(came <= AMPLIFICATION * sent, f"{what}: {came} bytes came for {sent}")


@case(239, "4.9", "other major versions, and HELLO for another arm, do not end the session of their source")
def refusals_end_nothing(peer: Peer) -> None:
    welcome = peer.open()
    peer.collect(RATION_MS)
    peer.send_raw(peer.with_number(peer.encoded(stop(peer)), MAJOR, "B", 9))
    peer.expect_bye(Reason.INCOMPATIBLE_VERSION, "a datagram of another major version, in a session")
    peer.alive("after a datagram of another major version")
    peer.collect(RATION_MS)
    another_arm = _hello(peer, peer.nonce())._replace(arm_hash=welcome.arm_hash ^ 1 or 2)
    peer.send(another_arm, session=0)
    peer.expect_bye(Reason.WRONG_ARM, "HELLO for another arm, from the connected source")
    peer.alive("after HELLO for another arm")
    peer.ask(stop(peer), "a request of the session")


def _hello(peer: Peer, nonce: int) -> Hello:
    return Hello(nonce, peer.required | 1, 0, 0)


def require_ended(peer: Peer, session: int, why: str) -> None:
    """Require that a request of ``session`` is told UNKNOWN_SESSION."""
    peer.session = 0
    peer.collect(RATION_MS, beating=False)
    peer.send(stop(peer), session=session)
    peer.expect_bye(Reason.UNKNOWN_SESSION, why)


@case(221, "4.9", "BYE ends the session at once, whatever its reason")
def bye(peer: Peer) -> None:
    for reason in (Reason.ACCEPTED, *(reason for reason in Reason if reason >= Reason.INCOMPATIBLE_VERSION)):
        peer.open()
        session = peer.session
        peer.leave(reason)
        require_ended(peer, session, f"a request after BYE {reason.name}")


@case(222, "4.4", "BYE is never answered")
def bye_unanswered(peer: Peer) -> None:
    peer.collect(RATION_MS, beating=False)
    peer.send(Bye(Reason.UNKNOWN_SESSION), session=0x1234)
    silent(peer, 100)
    peer.open()
    peer.leave()
    silent(peer, 100)


@case(224, "5.4", "silence ends the session: BYE LINK_TIMEOUT, neither early nor late")
def timeout(peer: Peer) -> None:
    timeout_ms = peer.open().link_timeout_ms
    last_ns = peer.heartbeat()
    peer.expect_bye(Reason.LINK_TIMEOUT, "silence", timeout_ms + 1000)
    waited_ms = (peer.now_ns - last_ns) / MS
    require(waited_ms > timeout_ms - 1, f"after {waited_ms:.1f} ms of silence, announced {timeout_ms}")
    require(waited_ms < timeout_ms + SLACK_MS, f"only after {waited_ms:.1f} ms, announced {timeout_ms}")


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
    for _ in peer.within(2 * timeout_ms):
        peer.send(stop(peer))
        got = peer.collect(timeout_ms / 5, beating=False)
        require(not any(isinstance(d.message, Bye) for d in got), "the session ended")


@case(228, "2.3", "a controller without a session sends nothing", opens=50)
def quiet(peer: Peer) -> None:
    peer.collect(100)
    peer.leave()
    peer.collect(30, beating=False)
    silent(peer, 300, but=Hello)


@case(229, "4.2", "the minor version of the handshake is in every datagram of the controller", opens=0)
def minor_everywhere(peer: Peer) -> None:
    peer.send(stop(peer))
    got = peer.collect(100)
    require(bool(got), "nothing came")
    require({d.header.minor for d in got} == {peer.minor}, "another minor version than the negotiated one")
    require({d.header.session for d in got} == {peer.session}, "another session's number")
