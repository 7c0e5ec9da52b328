"""Cases 534…539: what the arm does when a session ends, by BYE or by a restart of its client (7.5)."""

import math

from conformance.case import reference
from conformance.peer import Peer
from conformance.reference.group import expect_reason, reach, reference_reason, wanted
from conformance.reference.handshake import granted
from conformance.reference.motion import DRIFT_M, STEP_M, moved, standby
from conformance.wire import MS, require
from protocol.faults import CommandCode, FaultCode, GroupState, Reason, Severity
from protocol.reference_messages import State

case = reference.case
# From the end of a session in motion to centred valves: more than any ramp.
RAMPED_MS = 3000


def moving(peer: Peer) -> State:
    """A session with a motion of 20 mm in 5 s under way; its STATE."""
    here = standby(peer).X_BT_cmd
    expect_reason(reference_reason(peer, moved(here, dz=STEP_M), 5.0), Reason.ACCEPTED, "a motion")
    return reach(peer, GroupState.MOVING, "after a reference")


def come_back(peer: Peer, after: str) -> list[GroupState]:
    """Opens another session at once; the group's states from then on, until it has come to rest."""
    peer.session = 0
    peer.open(period_ms=20)
    seen: list[GroupState] = []
    until_ns = peer.now_ns + RAMPED_MS * MS
    while peer.now_ns < until_ns:
        state = peer.state(f"STATE after {after}")
        seen.append(state.group_state)
        require(state.group_state is not GroupState.MOVING, f"it goes on moving after {after}")
        if state.group_state is GroupState.DISABLED or state.valves == (0.0,) * 6:
            return seen
    require(False, f"after {after} the group is {seen[-1].name}, its valves are not centred")
    return seen


def require_latched(peer: Peer, after: str) -> None:
    """Require a group that has stopped, latched the loss, and does not resume by itself."""
    state = peer.state()
    require(state.group_state is GroupState.ERROR_STOP, f"{state.group_state.name} after {after}")
    require(state.fault is FaultCode.REFERENCE_LINK_LOST, f"fault {state.fault.name} after {after}")
    require(state.severity is Severity.STOP, f"severity {state.severity.name} after {after}")
    peer.collect(300)
    later = peer.state()
    require(later.valves == (0.0,) * 6, f"valves {later.valves}")
    drift = math.dist(state.X_BT.p_m, later.X_BT.p_m)
    require(drift < DRIFT_M, f"it went on by {drift * 1e3:.1f} mm")
    wanted(peer, CommandCode.ENABLE, Reason.ERROR_LATCHED, "error")
    wanted(peer, CommandCode.RESET, Reason.ACCEPTED, "error")
    require(reach(peer, GroupState.DISABLED, "after RESET").fault is FaultCode.NONE, "RESET left a fault")


def require_dropped(peer: Peer, after: str) -> None:
    """Require a group that is DISABLED without a fault."""
    state = reach(peer, GroupState.DISABLED, f"after {after}", RAMPED_MS)
    require(state.fault is FaultCode.NONE, f"fault {state.fault.name} after {after}")
    wanted(peer, CommandCode.RESET, Reason.NOT_IN_ERROR, f"after {after}")


@case(534, "7.5", "BYE in motion stops the arm and latches; the next session finds it so", motion=True)
def bye_in_motion(peer: Peer) -> None:
    moving(peer)
    peer.leave()
    come_back(peer, "BYE in motion")
    require_latched(peer, "BYE in motion")


@case(535, "7.5", "a restart in place in motion stops the arm: what was asked for is not the new session's",
      motion=True)  # fmt: skip
def restart_in_motion(peer: Peer) -> None:
    moving(peer)
    come_back(peer, "a restart in motion")
    require_latched(peer, "a restart in motion")


@case(
    536, "4.5", "a HELLO of the client's address that begins no session does not stop a motion", motion=True
)
def hello_in_motion(peer: Peer) -> None:
    moving(peer)
    for _ in range(3):
        granted(peer)
        peer.collect(50)
    state = peer.state()
    require(state.group_state is GroupState.MOVING, f"{state.group_state.name} after HELLO alone")
    require(state.fault is FaultCode.NONE, f"fault {state.fault.name} after HELLO alone")
    wanted(peer, CommandCode.STOP, Reason.ACCEPTED, "MOVING")
    reach(peer, GroupState.STANDBY, "after STOP")


@case(537, "7.5", "BYE in STANDBY drops the enable without a fault", motion=True)
def bye_in_standby(peer: Peer) -> None:
    standby(peer)
    peer.leave()
    peer.open(period_ms=20)
    require_dropped(peer, "BYE in STANDBY")


@case(538, "7.5", "a restart in place in STANDBY drops the enable without a fault", motion=True)
def restart_in_standby(peer: Peer) -> None:
    standby(peer)
    peer.session = 0
    peer.open(period_ms=20)
    require_dropped(peer, "a restart in STANDBY")


@case(
    539,
    "7.5",
    "BYE while STOPPING: the ramp is finished, and the enable dropped without a fault",
    motion=True,
)
def bye_while_stopping(peer: Peer) -> None:
    moving(peer)
    peer.collect(1500)  # to its pace: from there the ramp takes longest
    wanted(peer, CommandCode.STOP, Reason.ACCEPTED, "MOVING")
    peer.leave()
    peer.session = 0
    seen = come_back(peer, "BYE while STOPPING")
    others = set(seen) - {GroupState.STOPPING, GroupState.DISABLED}
    require(not others, f"it was {', '.join(state.name for state in others)} after BYE while STOPPING")
    require_dropped(peer, "BYE while STOPPING")
