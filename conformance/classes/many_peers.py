"""Cases of many peers, and of grants: who is answered, how often, and what a grant keeps (4.2 to 4.6, 8)."""

from collections.abc import Callable

from conformance.case import case
from conformance.peer import RATION_MS, Peer
from conformance.reference.framing import MAJOR, stop
from conformance.reference.handshake import granted, require_begun, require_none
from conformance.reference.sessions import SLACK_MS
from conformance.wire import require, with_bit_flipped
from protocol.faults import Reason
from protocol.pose import IDENTITY
from protocol.reference_messages import Bye, Hello, ReferencePath, State, Welcome

SOURCES, PERIOD_MS, COUNTED_MS = 6, 40, 400.0
Way = Callable[[Peer], bytes]


def _ways(peer: Peer, arm_hash: int, *, occupied: bool) -> dict[Reason, Way]:
    """How a source without a session is refused, by the reason that it is told."""

    def hello(source: Peer, arm: int) -> bytes:
        return source.encoded(Hello(peer.nonce(), 1 | peer.required, arm, 50), session=0)

    ways: dict[Reason, Way] = {
        Reason.UNKNOWN_SESSION: lambda source: source.encoded(stop(peer), session=peer.nonce()),
        Reason.WRONG_ARM: lambda source: hello(source, arm_hash ^ 1 or 2),
        Reason.INCOMPATIBLE_VERSION: lambda source: peer.with_number(hello(source, 0), MAJOR, "B", 9),
    }
    return ways | ({Reason.SESSION_OCCUPIED: lambda source: hello(source, 0)} if occupied else {})


def _reasons_sent(sources: list[Peer]) -> list[Reason]:
    """The reasons that come within 36 ms, less than what two refusals are apart."""
    came = [d.message for d in sources[0].collect(30, beating=False)]
    came += [d.message for source in sources[1:] for d in source.collect(1, beating=False)]
    return [m.reason for m in came if isinstance(m, Bye)]


@case(223, "8", "refusals are rationed together, of all reasons and sources, and come when one is due")
def rationed(peer: Peer) -> None:
    arm_hash = peer.open(period_ms=20).arm_hash
    sources = [peer.second() for _ in range(SOURCES)]
    for occupied in (True, False):
        ways = _ways(peer, arm_hash, occupied=occupied)
        mixed = [(source, way) for source in sources for way in ways.values()]
        bursts = [mixed, *([(source, way) for source in sources] for way in ways.values())]
        bursts += [[(sources[0], way) for way in ways.values()], [mixed[0]] * 9]
        for burst in bursts:
            peer.collect(RATION_MS)
            for source, way in burst:
                source.send_raw(way(source))
            reasons = _reasons_sent(sources)
            names = sorted(reason.name for reason in reasons)
            require(len(reasons) == 1, f"{len(burst)} refusals at once were answered with {names}")
        for reason, way in ways.items():
            for source in sources[:2]:
                peer.collect(RATION_MS)
                source.send_raw(way(source))
                reasons = _reasons_sent(sources)
                require(reasons == [reason], f"what is told {reason.name}, when it is due: {reasons}")
        if occupied:
            peer.alive("while strangers are refused")
            require(any(isinstance(d.message, State) for d in peer.collect(80)), "STATE stopped meanwhile")
            peer.leave()


@case(247, "4.4", "what is not answered takes no refusal from those who are", opens=50)
def unanswered(peer: Peer) -> None:
    other = peer.second()
    sound = peer.encoded(stop(peer))
    for what, source, data in (
        ("BYE of no session", other, other.encoded(Bye(Reason.SHUTDOWN), session=0x1234)),
        ("a wrong CRC", other, with_bit_flipped(sound, 8 * len(sound) - 1)),
        ("another port", other, sound),
        ("HELLO in a session", other, other.encoded(Hello(peer.nonce(), 1, 0, 50), session=0x99)),
        ("another minor version", peer, peer.encoded(stop(peer), minor=peer.minor + 1)),
    ):
        peer.collect(RATION_MS)
        other.drain()
        source.send_raw(data)
        other.send(stop(peer), session=0x1234)
        got = [d.message for d in other.collect(36, beating=False)]
        require(got == [Bye(Reason.UNKNOWN_SESSION)], f"a stray behind {what}: came {got}")


@case(234, "4.5", "the newest grant replaces the one before, of any source, and keeps nobody out")
def newest_grant(peer: Peer) -> None:
    sources = [peer, *(peer.second() for _ in range(SOURCES))]
    for replaced in range(SOURCES):
        sessions = [granted(source) for source in sources]
        require(len(set(sessions)) == len(sessions), "two nonces were granted the same session")
        require_none(sources[replaced], sessions[replaced], "a grant that was replaced")
        require_begun(sources[-1], sessions[-1], "the newest grant")
        sources[-1].leave()


def _greetings(peer: Peer, arm_hash: int) -> list[Hello]:
    """HELLO as it was, and with each other field otherwise."""
    first = Hello(1, 1 | peer.required, 0, PERIOD_MS)
    fields = {"capabilities": (peer.required, 3 | peer.required), "state_period_ms": (0, 1000)}
    fields["arm_hash"] = (arm_hash, arm_hash ^ 1 or 2)
    return [first, *(first._replace(**{name: value}) for name, values in fields.items() for value in values)]


@case(
    208,
    "4.6",
    "HELLO again has the same WELCOME, whatever else it asks for, and changes nothing",
)
def same_again(peer: Peer) -> None:
    arm_hash = peer.open().arm_hash
    peer.leave()
    for begun in (False, True):
        for other in _greetings(peer, arm_hash):
            again = other._replace(client_nonce=peer.nonce())
            session = granted(peer, nonce=again.client_nonce, period_ms=PERIOD_MS)
            first = peer.welcome
            if begun:
                require_begun(peer, session, "a grant")
            peer.drain()
            for _ in range(3):
                peer.send(again, session=0, minor=0)
            got = [d for d in peer.collect(40, beating=False) if isinstance(d.message, Welcome)]
            same = all(d.message == first and d.header.session == session for d in got)
            require(len(got) == 3 and same, f"{again} was answered with {[d.message for d in got]}")
            require_begun(peer, session, f"behind {again}")
            states = sum(isinstance(d.message, State) for d in peer.collect(COUNTED_MS))
            most = COUNTED_MS / max(first.state_period_ms, 1.0)
            require(0.5 * most - 1 <= states <= 1.1 * most + 1, f"{states} STATEs in 400 ms behind {again}")
            path = ReferencePath(peer.new_id(), (IDENTITY,), 0.0, 0.0)
            negotiated = peer.ask(path, "a path").reason is not Reason.NOT_NEGOTIATED
            require(negotiated == bool(first.capabilities & 1), f"capabilities changed by {again}")
            peer.leave()


@case(
    258,
    "4.2",
    "BYE takes a grant back, beside a session in use too; a stranger's does not",
)
def taken_back(peer: Peer) -> None:
    other = peer.second()
    for begun in (False, True):
        if begun:
            peer.open()
        for reason in (Reason.ACCEPTED, Reason.PEER_RESTARTED, Reason.LINK_TIMEOUT, Reason.SHUTDOWN):
            in_use, session = peer.session, granted(peer)
            peer.send(Bye(reason), session=session)
            require_none(peer, session, f"a grant behind BYE {reason.name}")
            peer.session = in_use
            if begun:
                peer.alive("the session in use, after BYE in a grant")
        session = granted(peer)
        other.send_raw(peer.encoded(Bye(Reason.SHUTDOWN), session=session))
        require_begun(peer, session, "a grant behind a stranger's BYE")
        peer.leave()


@case(259, "4.2", "a grant is forgotten link_timeout_ms after its first WELCOME, though HELLO comes again")
def not_prolonged(peer: Peer) -> None:
    nonce = peer.nonce()
    session = granted(peer, nonce=nonce)
    for _ in range(2):
        peer.collect(0.45 * peer.timeout_ms, beating=False)
        require(granted(peer, nonce=nonce) == session, "HELLO again was granted another session")
    peer.collect(0.1 * peer.timeout_ms + SLACK_MS, beating=False)
    require_none(peer, session, "a grant after the link timeout, HELLO repeated meanwhile")


@case(260, "4.5", "HELLO that is refused leaves the grant that stands as it is")
def refused_hello(peer: Peer) -> None:
    ended = peer.nonce()
    arm_hash = peer.open(nonce=ended).arm_hash
    peer.leave()
    for bad in (
        Hello(peer.nonce(), 1 | peer.required, arm_hash ^ 1 or 2, 50),
        Hello(ended, 1 | peer.required, 0, 50),
    ):
        session = granted(peer)
        peer.send(bad, session=0)
        peer.collect(20, beating=False)
        require_begun(peer, session, f"a grant behind {bad}")
        peer.leave()
