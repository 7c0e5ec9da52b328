"""Cases 501…: the axes group (clause 7). Those that need the arm enabled are marked as motion."""

import math
from collections.abc import Sequence
from itertools import chain, pairwise

from conformance.case import case
from conformance.parts import OptionalPart
from conformance.peer import Peer
from conformance.wire import Unsupported, require
from protocol.faults import CommandCode, FaultCode, GroupState, Reason, Severity
from protocol.pose import Pose
from protocol.reference_messages import (
    CAPABILITY_PATHS,
    FLAG_EMERGENCY_LATCHED,
    Acknowledgement,
    Command,
    ReferencePath,
    ReferencePose,
    Request,
    State,
)

SETTLE_MS = 5000


def require_reason(peer: Peer, code: CommandCode, reason: Reason, state: str) -> None:
    """``code`` is answered with ``reason``."""
    got = peer.command(code)
    require(got is reason, f"{code.name} in {state}: {got.name}, wanted {reason.name}")


def reach(peer: Peer, state: GroupState, why: str, wait_ms: float = SETTLE_MS) -> State:
    """The first STATE that shows ``state``."""
    return peer.until(lambda seen: seen.group_state is state, wait_ms, f"{why}: {state.name}")


def disabled(peer: Peer, capabilities: int = CAPABILITY_PATHS, period_ms: int = 20) -> None:
    """Opens a session and brings the group to DISABLED. Raises Unsupported when it cannot be."""
    peer.open(period_ms=period_ms, capabilities=capabilities)
    state = peer.state()
    if state.flags & FLAG_EMERGENCY_LATCHED:
        peer.command(CommandCode.EMERGENCY_RELEASE)
    peer.command(CommandCode.DISABLE)
    for state in peer.states(SETTLE_MS):
        if state.group_state is GroupState.DISABLED:
            return
        if state.group_state is GroupState.ERROR_STOP:
            peer.command(CommandCode.RESET)
    raise Unsupported(f"the group stays in {state.group_state.name}, fault {state.fault.name}")


def accepted(peer: Peer, request: Request, what: str = "a motion") -> int:
    """The id of a request, which is accepted."""
    expect_reason(peer.ask(request, what), Reason.ACCEPTED, what)
    return request.command_id


def require_near(pose: Pose, goal: Pose, within_m: float, what: str) -> None:
    """Raises Failed unless ``pose`` is so near ``goal``."""
    off_m = math.dist(pose.p_m, goal.p_m)
    require(off_m < within_m, f"{what}: {off_m * 1e3:.3g} mm off")


CENTRED = (0.0,) * 6


def require_shown(state: State, when: str, **wanted: object) -> None:
    """Raises Failed unless these fields of ``state`` are as wanted."""
    for name, value in wanted.items():
        got = getattr(state, name)
        require(
            got == value, f"{name} {getattr(got, 'name', got)} {when}, wanted {getattr(value, 'name', value)}"
        )


def reference_reason(peer: Peer, pose: Pose, duration_s: float = 0.0) -> Acknowledgement:
    """The answer to a reference pose."""
    return peer.ask(ReferencePose(peer.new_id(), pose, duration_s), "a reference")


def expect_reason(got: Acknowledgement, reason: Reason, what: str) -> None:
    """Raises Failed unless ``got`` says ``reason``."""
    require(got.reason is reason, f"{what}: {got.reason.name}, wanted {reason.name}")


@case(507, "7.4", "the emergency stop latches, with its flag and its fault")
def emergency(peer: Peer) -> None:
    disabled(peer)
    require_reason(peer, CommandCode.EMERGENCY_STOP, Reason.ACCEPTED, "DISABLED")
    state = reach(peer, GroupState.ERROR_STOP, "after EMERGENCY_STOP")
    require(bool(state.flags & FLAG_EMERGENCY_LATCHED), "the flag is not set")
    require_shown(state, "after EMERGENCY_STOP", fault=FaultCode.EMERGENCY_STOP)
    peer.collect(200)
    require(bool(peer.state().flags & FLAG_EMERGENCY_LATCHED), "it is gone by itself")


@case(508, "7.4", "the emergency stop outlives the session")
def emergency_outlives(peer: Peer) -> None:
    disabled(peer)
    peer.command(CommandCode.EMERGENCY_STOP)
    peer.reopen(period_ms=20)
    require(bool(peer.state().flags & FLAG_EMERGENCY_LATCHED), "it was gone after a new session")
    require_reason(peer, CommandCode.ENABLE, Reason.EMERGENCY_LATCHED, "emergency")


@case(509, "7.4", "the emergency stop is left by EMERGENCY_RELEASE, then RESET, and not otherwise")
def emergency_left(peer: Peer) -> None:
    disabled(peer)
    peer.command(CommandCode.EMERGENCY_STOP)
    require_reason(peer, CommandCode.EMERGENCY_RELEASE, Reason.ACCEPTED, "emergency")
    state = peer.state()
    require(state.group_state is GroupState.ERROR_STOP, "EMERGENCY_RELEASE alone left the error")
    require(not state.flags & FLAG_EMERGENCY_LATCHED, "the flag is still set")
    require_reason(peer, CommandCode.ENABLE, Reason.ERROR_LATCHED, "error")
    require_reason(peer, CommandCode.RESET, Reason.ACCEPTED, "error")
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


PATHS = OptionalPart.PATHS
STEP_M = 0.02
# What an arm with centred valves may creep, and its encoders flicker, while it is looked at.
DRIFT_M = 0.002


# So far the cases take the arm by themselves, and so much its valves let it creep meanwhile.
AWAY_M, AWAY_RAD = 0.03, 0.05


def enabled(peer: Peer) -> State:
    """STATE in STANDBY, from DISABLED, with the arm where the run found it. Raises Unsupported."""
    reason = peer.command(CommandCode.ENABLE)
    if reason is not Reason.ACCEPTED:
        raise Unsupported(f"ENABLE was refused: {reason.name}", OptionalPart.MOTION)
    state = reach(peer, GroupState.STANDBY, "after ENABLE")
    home = peer.noted.home = peer.noted.home or state.X_BT_cmd
    if is_near(state.X_BT_cmd, home):
        return state
    answer = reference_reason(peer, home)
    for state in peer.states(4 * SETTLE_MS, "on the way back") if answer.reason is Reason.ACCEPTED else ():
        if state.group_state is GroupState.STANDBY and is_near(state.X_BT_cmd, home):
            return state
    away_mm = math.dist(state.X_BT_cmd.p_m, home.p_m) * 1e3
    why = f"the way back is answered {answer.reason.name}"
    raise Unsupported(f"not asked: an earlier case has left the arm {away_mm:.0f} mm away, and {why}")


def is_near(pose: Pose, other: Pose) -> bool:
    """Whether two poses differ by no more than what cases leave behind."""
    turn_rad = angle_between(pose.q_wxyz, other.q_wxyz)
    return math.dist(pose.p_m, other.p_m) < AWAY_M and turn_rad < AWAY_RAD


def angle_between(a: Sequence[float], b: Sequence[float]) -> float:
    """The angle (rad) of the turn between two unit quaternions."""
    return 2.0 * math.acos(min(1.0, abs(sum(x * y for x, y in zip(a, b, strict=True)))))


def standby(peer: Peer) -> State:
    """Opens a session and enables the group; its STATE. Raises Unsupported when it cannot be enabled."""
    disabled(peer)
    return enabled(peer)


def moved(pose: Pose, dx: float = 0.0, dy: float = 0.0, dz: float = 0.0) -> Pose:
    """``pose`` at another position."""
    x, y, z = pose.p_m
    return pose._replace(p_m=(x + dx, y + dy, z + dz))


def scaled(pose: Pose, scale: float) -> Pose:
    """``pose`` with its quaternion multiplied."""
    w, x, y, z = pose.q_wxyz
    return pose._replace(q_wxyz=(scale * w, scale * x, scale * y, scale * z))


@case(525, "6.9", "a pose far out of reach is refused with value and limit", motion=True)
def out_of_reach(peer: Peer) -> None:
    here = standby(peer).X_BT_cmd
    for pose in (moved(here, dx=100.0), moved(here, dz=1000.0), Pose((0.0, 0.0, -50.0), here.q_wxyz)):
        got = reference_reason(peer, pose)
        accepted = (Reason.TOO_FAR, Reason.UNREACHABLE, Reason.OUTSIDE_WORKSPACE, Reason.JOINT_LIMIT)
        require(got.reason in accepted, f"{pose.p_m}: {got.reason.name}")
        require(got.value != got.limit, "value and limit explain nothing")
    require(peer.state().group_state is GroupState.STANDBY, "the arm moves")


@case(526, "6.9", "a path with one waypoint out of reach is refused whole", motion=True, needs=PATHS)
def refused_whole(peer: Peer) -> None:
    here = standby(peer).X_BT_cmd
    path = ReferencePath(peer.new_id(), (here, moved(here, dz=STEP_M), moved(here, dz=50.0)), 0.0, 0.0)
    require(peer.ask(path, "a path").reason is not Reason.ACCEPTED, "it was accepted")
    require(peer.state().group_state is GroupState.STANDBY, "the arm moves")


@case(527, "6.7", "a small motion is made, done, and ends where it was asked to", motion=True)
def small_motion(peer: Peer) -> None:
    here = standby(peer).X_BT_cmd
    goal = moved(here, dz=STEP_M)
    motion_id = accepted(peer, ReferencePose(peer.new_id(), goal, 2.0), "a motion of 20 mm")
    first = peer.state()
    require_shown(first, "at first", motion_id=motion_id, motion_done=False)
    for before, last in pairwise(chain((first,), peer.states(30_000))):
        jump = math.dist(before.X_BT_cmd.p_m, last.X_BT_cmd.p_m)
        require(jump < STEP_M, f"the commanded pose jumped by {jump * 1e3:.1f} mm")
        if last.motion_done:
            break
    require(last.motion_done, "not done within 30 s")
    require_near(last.X_BT_cmd, goal, 1e-6, "the commanded pose, from the goal")
    require_near(last.X_BT, goal, 5e-3, "the arm, from the goal")
    expect_reason(reference_reason(peer, here, 2.0), Reason.ACCEPTED, "the way back")
    peer.collect(2500)


def moving(peer: Peer) -> State:
    """A session with a motion of 20 mm in 5 s under way; its STATE."""
    here = standby(peer).X_BT_cmd
    expect_reason(reference_reason(peer, moved(here, dz=STEP_M), 5.0), Reason.ACCEPTED, "a motion")
    return reach(peer, GroupState.MOVING, "after a reference")


def require_latched(peer: Peer, after: str) -> None:
    """Require a group that has stopped, latched the loss, and does not resume by itself."""
    state = peer.state()
    lost, stopped = FaultCode.REFERENCE_LINK_LOST, GroupState.ERROR_STOP
    require_shown(state, f"after {after}", group_state=stopped, fault=lost, severity=Severity.STOP)
    peer.collect(300)
    later = peer.state()
    require_shown(later, "300 ms later", valves=CENTRED)
    drift = math.dist(state.X_BT.p_m, later.X_BT.p_m)
    require(drift < DRIFT_M, f"it went on by {drift * 1e3:.1f} mm")
    require_reason(peer, CommandCode.ENABLE, Reason.ERROR_LATCHED, "error")
    require_reason(peer, CommandCode.RESET, Reason.ACCEPTED, "error")
    require(reach(peer, GroupState.DISABLED, "after RESET").fault is FaultCode.NONE, "RESET left a fault")


@case(532, "6.8", "a path is driven through its waypoints in order", motion=True, needs=PATHS)
def path(peer: Peer) -> None:
    here = standby(peer).X_BT_cmd
    points = (moved(here, dz=STEP_M), moved(here, dz=STEP_M, dx=-STEP_M), here)
    accepted(peer, ReferencePath(peer.new_id(), points, 1.5, 0.2), "a path of three waypoints")
    segments, nearest = [], [math.inf] * len(points)
    for state in peer.states(40_000):
        segments.append(state.segment)
        for i, point in enumerate(points):
            if state.segment in (i, i + 1):  # in their order: a waypoint that is met later does not count
                nearest[i] = min(nearest[i], math.dist(state.X_BT_cmd.p_m, point.p_m))
        if state.motion_done:
            break
    require(state.motion_done, "not done within 40 s")
    require(segments == sorted(segments), f"segments {segments}")
    require(max(nearest) < 1e-3, f"a waypoint was missed by {max(nearest) * 1e3:.1f} mm")
