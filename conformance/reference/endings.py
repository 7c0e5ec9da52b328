"""Cases 529 and 534…539: what the arm does when a session ends, by silence, BYE or a restart (7.5)."""

from collections.abc import Callable, Iterable
from functools import partial

from conformance.case import case
from conformance.peer import Peer
from conformance.reference.handshake import granted
from conformance.reference.motion import (
    CENTRED,
    STEP_M,
    disabled,
    expect_reason,
    moved,
    moving,
    reach,
    reference_reason,
    require_latched,
    require_reason,
    require_shown,
    standby,
)
from conformance.wire import MS, Failed, require
from protocol.faults import CommandCode, FaultCode, GroupState, Reason
from protocol.reference_messages import (
    FLAG_EMERGENCY_LATCHED,
    Acknowledgement,
    Command,
    Message,
    ReferencePose,
    Request,
    State,
)

# From the end of a session in motion to centred valves: more than any ramp.
RAMPED_MS = 3000


def come_back(peer: Peer, after: str) -> list[GroupState]:
    """Opens another session at once; the group's states from then on, until it has come to rest."""
    peer.open(period_ms=20)
    seen: list[GroupState] = []
    for state in peer.states(RAMPED_MS, f"STATE after {after}"):
        seen.append(state.group_state)
        require(state.group_state is not GroupState.MOVING, f"it goes on moving after {after}")
        if state.group_state is GroupState.DISABLED or state.valves == (0.0,) * 6:
            return seen
    raise Failed(f"after {after} the group is {seen[-1].name}, its valves are not centred")


def require_dropped(peer: Peer, after: str) -> None:
    """Require a group that is DISABLED without a fault."""
    state = reach(peer, GroupState.DISABLED, f"after {after}", RAMPED_MS)
    require_shown(state, f"after {after}", fault=FaultCode.NONE)
    require_reason(peer, CommandCode.RESET, Reason.NOT_IN_ERROR, f"after {after}")


def _end_in_motion(end: Callable[[Peer], object], after: str, peer: Peer) -> None:
    moving(peer)
    end(peer)
    come_back(peer, after)
    require_latched(peer, after)


def _end_in_standby(end: Callable[[Peer], object], after: str, peer: Peer) -> None:
    standby(peer)
    end(peer)
    peer.open(period_ms=20)
    require_dropped(peer, after)


for _number, _ended, _end, _after, _title in (
    (529, _end_in_motion, lambda peer: peer.collect(peer.timeout_ms + 1500, beating=False), "a lost link",
     "a lost link in motion stops the arm; nothing resumes by itself"),
    (534, _end_in_motion, Peer.leave, "BYE in motion",
     "BYE in motion stops the arm and latches; the next session finds it so"),
    (535, _end_in_motion, Peer.drain, "a restart in motion",
     "a restart in place in motion stops the arm: what was asked for is not the new session's"),
    (537, _end_in_standby, Peer.leave, "BYE in STANDBY",
     "BYE in STANDBY drops the enable without a fault"),
    (538, _end_in_standby, Peer.drain, "a restart in STANDBY",
     "a restart in place in STANDBY drops the enable without a fault"),
):  # fmt: skip
    case(_number, "7.5", _title, motion=True)(partial(_ended, _end, _after))


@case(
    536, "4.5", "a HELLO of the client's address that begins no session does not stop a motion", motion=True
)
def hello_in_motion(peer: Peer) -> None:
    moving(peer)
    for _ in range(3):
        granted(peer)
        peer.collect(50)
    moves, sound = GroupState.MOVING, FaultCode.NONE
    require_shown(peer.state(), "after HELLO alone", group_state=moves, fault=sound)
    require_reason(peer, CommandCode.STOP, Reason.ACCEPTED, "MOVING")
    reach(peer, GroupState.STANDBY, "after STOP")


@case(
    539,
    "7.5",
    "BYE while STOPPING: the ramp is finished, and the enable dropped without a fault",
    motion=True,
)
def bye_while_stopping(peer: Peer) -> None:
    moving(peer)
    peer.collect(1500)  # to its pace: from there the ramp takes longest
    require_reason(peer, CommandCode.STOP, Reason.ACCEPTED, "MOVING")
    peer.leave()
    seen = come_back(peer, "BYE while STOPPING")
    others = set(seen) - {GroupState.STOPPING, GroupState.DISABLED}
    require(not others, f"it was {', '.join(state.name for state in others)} after BYE while STOPPING")
    require_dropped(peer, "BYE while STOPPING")


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


def _latched_state(peer: Peer, behind: str) -> State:
    """The first STATE with the emergency latched, after EMERGENCY_STOP was sent and repeated."""
    request = Command(peer.new_id(), CommandCode.EMERGENCY_STOP)
    for _ in peer.within(LATCHED_MS):
        peer.send(request)
        for datagram in peer.collect(REPEAT_MS):
            state = datagram.message
            if isinstance(state, State) and state.flags & FLAG_EMERGENCY_LATCHED:
                return state
    raise Failed(f"EMERGENCY_STOP behind {behind} did nothing within {LATCHED_MS} ms")


def _answers_until(peer: Peer, request: Request, within_ms: float) -> list[Acknowledgement]:
    """All acknowledgements, in order, until that of ``request``, which is sent and repeated."""
    answers: list[Acknowledgement] = []
    for _ in peer.within(within_ms):
        peer.send(request)
        answers += [d.message for d in peer.collect(REPEAT_MS) if isinstance(d.message, Acknowledgement)]
        if any(answer.command_id == request.command_id for answer in answers):
            return answers
    raise Failed(f"{type(request).__name__} was not answered within {within_ms:g} ms")


@case(415, "6.12", f"EMERGENCY_STOP behind {FLOOD} requests takes effect within {LATCHED_MS} ms")
def behind_requests(peer: Peer) -> None:
    disabled(peer)
    _flood(peer, _resets(peer))
    _latched_state(peer, f"{FLOOD} requests")


@case(416, "6.13", "what waits when a stop comes is not judged after it, but answered with OVERTAKEN")
def overtaken_by_a_stop(peer: Peer) -> None:
    disabled(peer)
    _flood(peer, _resets(peer, 500))
    stop = Command(peer.new_id(), CommandCode.DISABLE)
    answers = _answers_until(peer, stop, 2000)
    answers += peer.answers("after the stop")
    after = [a.command_id for a in answers].index(stop.command_id)
    late = [a for a in answers[after:] if a.command_id < stop.command_id and a.reason is not Reason.OVERTAKEN]
    require(not late, f"{len(late)} requests from before the stop were judged after it")
    for answer in answers:
        if answer.reason is Reason.OVERTAKEN:
            right = answer.value == answer.command_id and answer.limit > answer.value
            require(right, f"OVERTAKEN says {answer.value:g} and {answer.limit:g}")


@case(417, "6.14", f"behind {FLOOD} requests the newest is answered within {WAITING} scans and 200 ms")
def bounded(peer: Peer) -> None:
    cycle_ns = peer.open(period_ms=50).cycle_ns
    _flood(peer, _resets(peer))
    _answers_until(peer, Command(peer.new_id(), CommandCode.RESET), WAITING * cycle_ns / MS + 200)


@case(418, "6.12", f"EMERGENCY_STOP behind {FLOOD} heartbeats takes effect within {LATCHED_MS} ms")
def behind_heartbeats(peer: Peer) -> None:
    disabled(peer)
    for _ in range(FLOOD):
        peer.heartbeat()
    _latched_state(peer, f"{FLOOD} heartbeats")


@case(533, "6.12", "EMERGENCY_STOP while STOPPING, behind 20 references, centres the valves", motion=True)
def while_stopping(peer: Peer) -> None:
    here = standby(peer).X_BT_cmd
    expect_reason(reference_reason(peer, moved(here, dz=STEP_M), 2.0), Reason.ACCEPTED, "a motion")
    reach(peer, GroupState.MOVING, "after a reference")
    require_reason(peer, CommandCode.STOP, Reason.ACCEPTED, "MOVING")
    _flood(peer, (ReferencePose(peer.new_id(), here, 0.0) for _ in range(20)))
    state = _latched_state(peer, "references, while stopping,")
    require_shown(state, "while stopping", valves=CENTRED, group_state=GroupState.ERROR_STOP)
