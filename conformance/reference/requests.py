"""Cases 401…: every request at most once, every answer exactly once (clause 6), and STATE (7.7)."""

from conformance.case import reference
from conformance.peer import Peer
from conformance.reference.framing import stop
from conformance.wire import MS, require
from protocol.faults import CommandCode, GroupState, Reason
from protocol.pose import IDENTITY
from protocol.reference_messages import (
    Command,
    ReferencePath,
    State,
)

case = reference.case
REMEMBERED = 256


@case(402, "6.3", "a repeated request is answered with the same acknowledgement")
def repeated(peer: Peer) -> None:
    peer.open()
    request = stop(peer)
    first = peer.ask(request, "the first time")
    for _ in range(5):
        require(peer.ask(request, "again") == first, "another acknowledgement")
    require(len(peer.answers("after repetitions")) == 0, "more answers than requests")


@case(403, "6.3", "a refusal is repeated as it was given, though the state has changed since")
def refusal_repeated(peer: Peer) -> None:
    peer.open()
    request = Command(peer.new_id(), CommandCode.RESET)
    first = peer.ask(request, "RESET")
    peer.ask(stop(peer), "STOP")
    require(peer.ask(request, "RESET again").reason is not Reason.OVERTAKEN, "forgotten at once")
    require(peer.ask(request, "RESET again") == first, "another acknowledgement")


@case(407, "8", "an answer is remembered for 256 requests, and an older id is still not executed")
def memory(peer: Peer) -> None:
    peer.open()
    first, second = stop(peer), stop(peer)
    peer.ask(first, "the first request")
    peer.ask(second, "the second request")
    for _ in range(REMEMBERED - 1):
        peer.ask(stop(peer), "one of many")
    require(peer.ask(second, "remembered").reason is Reason.ACCEPTED, "forgotten too early")
    got = peer.ask(first, "forgotten").reason
    require(got in (Reason.OVERTAKEN, Reason.ACCEPTED), f"answered {got.name}")


@case(408, "4.7", "a new session knows nothing of the ids of the one before")
def ids_start_again(peer: Peer) -> None:
    peer.open()
    high = stop(peer)
    peer.ask(high, "the first session")
    peer.leave()
    peer.open()
    low = high._replace(command_id=high.command_id - 5)
    require(peer.ask(low, "a lower id").reason is Reason.ACCEPTED, "refused for an id of another session")


@case(411, "7.7", "STATE comes at the rate that was asked for")
def rates(peer: Peer) -> None:
    for period_ms, span in ((0, 500.0), (20, 2000.0), (100, 1500.0)):
        welcome = peer.open(period_ms=period_ms)
        period = max(welcome.state_period_ms, welcome.cycle_ns / MS)  # as granted (4.2)
        peer.collect(50)
        halves = [sum(isinstance(d.message, State) for d in peer.collect(span / 2.0)) for _ in range(2)]
        for got in halves:  # one scan in ten may be late, and one STATE at either end
            asked = span / 2.0 / period
            said = f"{got} in {span / 2.0:g} ms at a period of {period:g} ms"
            require(0.9 * asked - 2 <= got <= 1.05 * asked + 2, said)
        peer.leave()


@case(414, "7.5", "a session begins without motion")
def begins_at_rest(peer: Peer) -> None:
    peer.open(period_ms=20)
    state = peer.state()
    require(state.group_state is not GroupState.MOVING, "the arm moves although nothing was asked")


COMMAND_PADDING, PATH_PADDING, FIRST_UNUSED = 52, 52, 56 + 56
# Of so many pairs of references a scan may come between the two of one or another.
PAIRS, PARTED = 6, 2


@case(419, "6.5", "padding and unused waypoints do not make a repetition another request")
def padding_repeated(peer: Peer) -> None:
    peer.open()
    requests: list[tuple[Command | ReferencePath, list[int]]] = [
        (stop(peer), [COMMAND_PADDING]),
        (ReferencePath(peer.new_id(), (IDENTITY,), 0.0, 0.0), [PATH_PADDING, FIRST_UNUSED]),
    ]
    for request, places in requests:
        first = peer.ask(request, "the request itself")
        for place in places:
            peer.send_raw(peer.with_number(peer.encoded(request), place, "I", 0xA5A5A5A5))
            again = peer.answer_to(request.command_id, "its repetition")
            said = f"{again.reason.name}, before {first.reason.name}"
            require(again == first, f"with rubbish at byte {place}: {said}")
