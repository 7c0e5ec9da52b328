"""Cases 201…: opening, keeping and ending a session (clauses 2, 4 and 5.4)."""

from collections.abc import Callable

from conformance.case import case
from conformance.peer import RATION_MS, SESSION_MS, Peer
from conformance.reference.framing import refused, stop
from conformance.wire import ANSWER_MS, MS, Failed, known, require
from protocol.faults import Reason
from protocol.reference_messages import (
    Acknowledgement,
    Bye,
    HeartbeatReply,
    Hello,
    Message,
    State,
    Welcome,
)

# What a busy machine may add to a deadline before it counts as missed.
SLACK_MS = 100


def hello(peer: Peer, nonce: int, **header: int) -> bytes:
    """Sends HELLO for any arm."""
    return peer.send(Hello(nonce, 1, 0, 50), session=0, minor=0, **header)


def welcomes(peer: Peer, wait_ms: float = 100) -> list[Welcome]:
    """All WELCOMEs that come within ``wait_ms``."""
    return [d.message for d in peer.collect(wait_ms, beating=False) if isinstance(d.message, Welcome)]


def silent(peer: Peer, wait_ms: float, *, but: type[Message] = State) -> None:
    """Require that nothing comes but ``but``."""
    peer.require_came([], wait_ms, "unasked", but=but)


def dies_of_silence(peer: Peer, what: str, send: Callable[[float], object]) -> None:
    """Require BYE LINK_TIMEOUT in time after a last heartbeat, although ``send`` sends ``what`` meanwhile.

    ``send`` gets the ms since that heartbeat.
    """
    begin_ns = peer.heartbeat()
    while (waited_ms := (peer.now_ns - begin_ns) / MS) < peer.timeout_ms + SLACK_MS:
        send(waited_ms)
        for _, message in peer.arriving(4, beating=False):
            answered = isinstance(message, HeartbeatReply) and message.sent_ns != begin_ns
            answered |= isinstance(message, Welcome)
            require(not answered, f"it was answered: {what}")
            if message == Bye(Reason.LINK_TIMEOUT):
                peer.session = 0
                return
    raise Failed(f"the session lived on {what}")


@case(200, "4.9", "HELLO is answered with WELCOME")
def welcome_comes(peer: Peer) -> None:
    answer = peer.greeted(Hello(peer.nonce(), 1, 0, 50), SESSION_MS)
    came = f"BYE {answer.name}" if isinstance(answer, Reason) else "nothing"
    require(isinstance(answer, Welcome), f"HELLO is not answered with WELCOME: {came} came")


@case(201, "4.2", "WELCOME repeats the nonce, and numbers, times and hash are in range")
def handshake(peer: Peer) -> None:
    nonce = peer.nonce()
    welcome = peer.open(nonce=nonce)
    require(peer.session != 0, "the session's number is 0")
    require(welcome.client_nonce == nonce, "WELCOME has another nonce")
    require(welcome.boot_id != 0, "boot_id is 0")
    require(welcome.cycle_ns <= 100 * MS, f"cycle of {welcome.cycle_ns / MS:g} ms")


@case(207, "4.1", "the hash of this arm is welcome")
def right_arm(peer: Peer) -> None:
    right = peer.open().arm_hash
    peer.leave()
    require(peer.open(arm_hash=right).arm_hash == right, "the hash changed")


@case(211, "4.5", "a second client is refused with SESSION_OCCUPIED and the first does not notice", opens=50)
def second_client(peer: Peer) -> None:
    other = peer.second()
    peer.collect(RATION_MS)
    hello(other, other.nonce())
    other.expect_bye(Reason.SESSION_OCCUPIED, "HELLO of a second client")
    peer.alive("after a second client's HELLO")


@case(212, "4.5", "once the first client has left, the second is welcome", opens=50)
def second_after_first(peer: Peer) -> None:
    other = peer.second()
    peer.leave()
    other.open()
    other.alive("the second client's session")
    other.leave()


@case(213, "4.5", "a client that restarts at the same address gets a new session at once", opens=50)
def restart_in_place(peer: Peer) -> None:
    old = peer.session
    begin_ns = peer.now_ns
    peer.open()
    require(peer.session != old, "the old session's number was given again")
    require((peer.now_ns - begin_ns) / MS < peer.timeout_ms, "only after the link timeout")
    peer.alive("the new session")
    refused(peer, [peer.encoded(stop(peer), session=old)], "a request of the old session")


@case(214, "4.5", "a client that restarts at another address gets in after the link timeout")
def restart_elsewhere(peer: Peer) -> None:
    timeout_ms = peer.open().link_timeout_ms
    other = peer.second()
    begin_ns = peer.now_ns
    other.open()
    waited_ms = (peer.now_ns - begin_ns) / MS
    require(waited_ms > timeout_ms * 0.8 - SLACK_MS, f"after {waited_ms:.0f} ms: the first was still alive")
    require(waited_ms < timeout_ms + 3 * 200 + SLACK_MS, f"only after {waited_ms:.0f} ms")
    other.leave()


@case(215, "4.5", "a HELLO that was sent before the one in use does not end the session")
def delayed_hello(peer: Peer) -> None:
    before_ns = peer.now_ns
    peer.open()
    hello(peer, peer.nonce(), sent_ns=before_ns - MS)
    require(not welcomes(peer, 60), "a delayed HELLO opened a session")
    peer.alive("after a delayed HELLO")


@case(216, "4.4", "a request of a session that does not exist is told UNKNOWN_SESSION")
def unknown_session(peer: Peer) -> None:
    peer.collect(RATION_MS, beating=False)
    peer.send(stop(peer), session=0x1234)
    header, message = known(peer.receive(ANSWER_MS, beating=False), "nothing came")
    require(message == Bye(Reason.UNKNOWN_SESSION), f"came {message}")
    require(header.session == 0x1234, "BYE does not name the session that was asked for")


@case(218, "3.5", "a request of this session from another port is not used", opens=50)
def wrong_source(peer: Peer) -> None:
    other = peer.second()
    other.send_raw(peer.encoded(stop(peer)))
    other.require_came([], 60, "another source was answered", but=Bye)
    require(not peer.answers("a request from another port"), "another source's request was executed")


@case(220, "3.5", "messages that only a controller sends are dropped")
def wrong_direction(peer: Peer) -> None:
    welcome = peer.open()
    peer.send(welcome)
    peer.send(HeartbeatReply(1, 2, 3))
    peer.send(Acknowledgement(peer.new_id(), Reason.ACCEPTED, 0.0, 0.0))
    silent(peer, 60)
    peer.alive("after messages of the wrong direction")
