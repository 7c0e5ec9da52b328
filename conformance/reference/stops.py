"""Cases 415…418 and 533: nothing that a client sends keeps its own stop waiting (6.12 to 6.14).

Times are judged on the tester's clock. A stop is repeated as in 6.3: the network may lose part of a flood.
"""

from collections.abc import Iterable

from conformance.case import reference
from conformance.peer import Peer
from conformance.reference.group import disabled, expect_reason, reach, reference_reason, wanted
from conformance.reference.motion import STEP_M, moved, standby
from conformance.wire import MS, require
from protocol.faults import CommandCode, GroupState, Reason
from protocol.reference_messages import (
    FLAG_EMERGENCY_LATCHED,
    Acknowledgement,
    Command,
    Heartbeat,
    Message,
    ReferencePose,
    Request,
    State,
)

case = reference.case
FLOOD = 2000
REPEAT_MS = 20.0
# A scan, a period of STATE and, most of it, the tester's reading of the answers to the flood.
LATCHED_MS = 200
WAITING = 64


def _flood(peer: Peer, messages: Iterable[Message]) -> None:
    for message in messages:
        peer.send(message)


def _resets(peer: Peer, count: int = FLOOD) -> Iterable[Command]:
    return (Command(peer.new_id(), CommandCode.RESET) for _ in range(count))


def _latched(peer: Peer, behind: str) -> State:
    """The first STATE with the emergency latched, after EMERGENCY_STOP was sent and repeated."""
    request = Command(peer.new_id(), CommandCode.EMERGENCY_STOP)
    until_ns = peer.now_ns + LATCHED_MS * MS
    while peer.now_ns < until_ns:
        peer.send(request)
        for datagram in peer.collect(REPEAT_MS):
            state = datagram.message
            if isinstance(state, State) and state.flags & FLAG_EMERGENCY_LATCHED:
                return state
    require(False, f"EMERGENCY_STOP behind {behind} did nothing within {LATCHED_MS} ms")
    raise AssertionError


def _answered(peer: Peer, request: Request, within_ms: float) -> list[Acknowledgement]:
    """All acknowledgements, in order, until that of ``request``, which is sent and repeated."""
    answers: list[Acknowledgement] = []
    until_ns = peer.now_ns + int(within_ms * MS)
    while peer.now_ns < until_ns:
        peer.send(request)
        answers += [d.message for d in peer.collect(REPEAT_MS) if isinstance(d.message, Acknowledgement)]
        if any(answer.command_id == request.command_id for answer in answers):
            return answers
    require(False, f"{type(request).__name__} was not answered within {within_ms:g} ms")
    return answers


@case(415, "6.12", f"EMERGENCY_STOP behind {FLOOD} requests takes effect within {LATCHED_MS} ms")
def behind_requests(peer: Peer) -> None:
    disabled(peer)
    _flood(peer, _resets(peer))
    _latched(peer, f"{FLOOD} requests")


@case(416, "6.13", "what waits when a stop comes is not judged after it, but answered with OVERTAKEN")
def overtaken_by_a_stop(peer: Peer) -> None:
    disabled(peer)
    _flood(peer, _resets(peer, 500))
    stop = Command(peer.new_id(), CommandCode.DISABLE)
    answers = _answered(peer, stop, 2000)
    answers += peer.answers("after the stop")
    after = [a.command_id for a in answers].index(stop.command_id)
    late = [a for a in answers[after:] if a.command_id < stop.command_id and a.reason is not Reason.OVERTAKEN]
    require(not late, f"{len(late)} requests from before the stop were judged after it")
    for answer in answers:
        if answer.reason is Reason.OVERTAKEN:
            said = answer.value == answer.command_id and answer.limit > answer.value
            require(said, f"OVERTAKEN says {answer.value:g} and {answer.limit:g}")


@case(417, "6.14", f"behind {FLOOD} requests the newest is answered within {WAITING} scans and 200 ms")
def bounded(peer: Peer) -> None:
    cycle_ns = peer.open(period_ms=50).cycle_ns
    _flood(peer, _resets(peer))
    _answered(peer, Command(peer.new_id(), CommandCode.RESET), WAITING * cycle_ns / MS + 200)


@case(418, "6.12", f"EMERGENCY_STOP behind {FLOOD} heartbeats takes effect within {LATCHED_MS} ms")
def behind_heartbeats(peer: Peer) -> None:
    disabled(peer)
    for _ in range(FLOOD):
        now_ns = peer.now_ns
        peer.send(Heartbeat(now_ns), sent_ns=now_ns)
    _latched(peer, f"{FLOOD} heartbeats")


@case(533, "6.12", "EMERGENCY_STOP while STOPPING, behind 20 references, centres the valves", motion=True)
def while_stopping(peer: Peer) -> None:
    here = standby(peer).X_BT_cmd
    expect_reason(reference_reason(peer, moved(here, dz=STEP_M), 2.0), Reason.ACCEPTED, "a motion")
    reach(peer, GroupState.MOVING, "after a reference")
    wanted(peer, CommandCode.STOP, Reason.ACCEPTED, "MOVING")
    _flood(peer, (ReferencePose(peer.new_id(), here, 0.0) for _ in range(20)))
    state = _latched(peer, "references, while stopping,")
    require(state.valves == (0.0,) * 6, f"valves {state.valves}")
    require(state.group_state is GroupState.ERROR_STOP, state.group_state.name)
