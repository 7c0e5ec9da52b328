"""Cases 501…: the axes group (clause 7). Those that need the arm enabled are marked as motion."""

import math

from conformance.case import reference
from conformance.peer import Peer
from conformance.wire import MS, Unsupported, require
from protocol.faults import CommandCode, FaultCode, GroupState, Reason
from protocol.pose import Pose
from protocol.reference_messages import (
    CAPABILITY_PATHS,
    FLAG_EMERGENCY_LATCHED,
    Acknowledgement,
    Command,
    ReferencePose,
    State,
)

case = reference.case
SETTLE_MS = 5000


def wanted(peer: Peer, code: CommandCode, reason: Reason, state: str) -> None:
    """``code`` is answered with ``reason``."""
    got = peer.command(code)
    require(got is reason, f"{code.name} in {state}: {got.name}, wanted {reason.name}")


def reach(peer: Peer, state: GroupState, why: str, wait_ms: float = SETTLE_MS) -> State:
    """The first STATE that shows ``state``."""
    until_ns = peer.now_ns + int(wait_ms * MS)
    while peer.now_ns < until_ns:
        seen = peer.state(why)
        if seen.group_state is state:
            return seen
    require(False, f"{why}: {seen.group_state.name}, wanted {state.name}")
    return seen


def disabled(peer: Peer, capabilities: int = CAPABILITY_PATHS, period_ms: int = 20) -> None:
    """Opens a session and brings the group to DISABLED. Raises Unsupported when it cannot be."""
    peer.open(period_ms=period_ms, capabilities=capabilities)
    state = peer.state()
    if state.flags & FLAG_EMERGENCY_LATCHED:
        peer.command(CommandCode.EMERGENCY_RELEASE)
    peer.command(CommandCode.DISABLE)
    until_ns = peer.now_ns + SETTLE_MS * MS
    while peer.now_ns < until_ns:
        state = peer.state()
        if state.group_state is GroupState.DISABLED:
            return
        if state.group_state is GroupState.ERROR_STOP:
            peer.command(CommandCode.RESET)
    raise Unsupported(f"the group stays in {state.group_state.name}, fault {state.fault.name}")


def reference_reason(peer: Peer, pose: Pose, duration_s: float = 0.0) -> Acknowledgement:
    """The answer to a reference pose."""
    return peer.ask(ReferencePose(peer.new_id(), pose, duration_s), "a reference")


def expect_reason(got: Acknowledgement, reason: Reason, what: str) -> None:
    """Raises Failed unless ``got`` says ``reason``."""
    require(got.reason is reason, f"{what}: {got.reason.name}, wanted {reason.name}")


@case(506, "6.10", "the group's state is judged before the content")
def state_first(peer: Peer) -> None:
    disabled(peer)
    nan = Pose((math.nan, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    expect_reason(reference_reason(peer, nan), Reason.DISABLED, "NaN in DISABLED")


@case(507, "7.4", "the emergency stop latches, with its flag and its fault")
def emergency(peer: Peer) -> None:
    disabled(peer)
    wanted(peer, CommandCode.EMERGENCY_STOP, Reason.ACCEPTED, "DISABLED")
    state = reach(peer, GroupState.ERROR_STOP, "after EMERGENCY_STOP")
    require(bool(state.flags & FLAG_EMERGENCY_LATCHED), "the flag is not set")
    require(state.fault is FaultCode.EMERGENCY_STOP, f"fault {state.fault.name}")
    peer.collect(200)
    require(bool(peer.state().flags & FLAG_EMERGENCY_LATCHED), "it is gone by itself")


@case(508, "7.4", "the emergency stop outlives the session")
def emergency_outlives(peer: Peer) -> None:
    disabled(peer)
    peer.command(CommandCode.EMERGENCY_STOP)
    peer.leave()
    peer.open(period_ms=20)
    require(bool(peer.state().flags & FLAG_EMERGENCY_LATCHED), "it was gone after a new session")
    wanted(peer, CommandCode.ENABLE, Reason.EMERGENCY_LATCHED, "emergency")


@case(509, "7.4", "the emergency stop is left by EMERGENCY_RELEASE, then RESET, and not otherwise")
def emergency_left(peer: Peer) -> None:
    disabled(peer)
    peer.command(CommandCode.EMERGENCY_STOP)
    wanted(peer, CommandCode.EMERGENCY_RELEASE, Reason.ACCEPTED, "emergency")
    state = peer.state()
    require(state.group_state is GroupState.ERROR_STOP, "EMERGENCY_RELEASE alone left the error")
    require(not state.flags & FLAG_EMERGENCY_LATCHED, "the flag is still set")
    wanted(peer, CommandCode.ENABLE, Reason.ERROR_LATCHED, "error")
    wanted(peer, CommandCode.RESET, Reason.ACCEPTED, "error")
    state = reach(peer, GroupState.DISABLED, "after RESET")
    require(state.fault is FaultCode.NONE, f"fault {state.fault.name} after RESET")


@case(510, "6.2", "a repeated EMERGENCY_STOP does not latch again what was released")
def emergency_once(peer: Peer) -> None:
    disabled(peer)
    request = Command(peer.new_id(), CommandCode.EMERGENCY_STOP)
    first = peer.ask(request, "EMERGENCY_STOP")
    peer.command(CommandCode.EMERGENCY_RELEASE)
    peer.command(CommandCode.RESET)
    require(peer.ask(request, "EMERGENCY_STOP again") == first, "another answer")
    require(peer.state().group_state is GroupState.DISABLED, "it was executed again")
