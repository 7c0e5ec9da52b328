"""Cases 557…560 and 568…571: motions take their time, go on without a step, and end as told (6.7 to 6.9).

Times are judged on the tester's clock. That the speed has no step is told by the way: what moves at 25 mm/s
and ramps down in 0.3 s goes on by 3.7 mm, and what stops at once by nothing.
"""

import math
from itertools import pairwise

from conformance.case import case
from conformance.parts import OptionalPart
from conformance.peer import Peer
from conformance.reference.arm_state_truth import StateWatch, Watched, turned, watched
from conformance.reference.arm_transitions import entered
from conformance.reference.motion import (
    CENTRED,
    accepted,
    expect_reason,
    moved,
    reference_reason,
    require_near,
    require_reason,
    require_shown,
)
from conformance.wire import MS, Unsupported, require
from protocol.axes_group import Mode
from protocol.faults import CommandCode, FaultCode, GroupState, Reason
from protocol.reference_messages import FLAG_EMERGENCY_LATCHED, Acknowledgement, ReferencePath, ReferencePose

# What a busy machine adds to the time of a motion.
LATE_MS = 30.0
# The least way of a ramp from the middle of the motion, and the furthest from one STATE to the next.
RAMP_M, STEP_OF_A_SCAN_M = 5e-4, 2e-3
AT_M = 1e-7
UNDER_WAY_MS = 600.0


def until_done(watch: StateWatch, request: ReferencePose | ReferencePath) -> list[Watched]:
    """The STATEs of an accepted motion, from the first that names it to the first that calls it done."""
    wanted_id = accepted(watch.peer, request)
    seen = watch.until(lambda s: s.motion_done and s.motion_id == wanted_id, 30_000.0, "it is not done")
    return [each for each in seen if each.state.motion_id == wanted_id]


def height(each: Watched) -> float:
    """How high the commanded tool is (m)."""
    return each.state.X_BT_cmd.p_m[2]


def require_no_jump(seen: list[Watched], what: str) -> None:
    """Raises Failed when the commanded position jumps."""
    jump = max(math.dist(a.state.X_BT_cmd.p_m, b.state.X_BT_cmd.p_m) for a, b in pairwise(seen))
    require(jump < STEP_OF_A_SCAN_M, f"{what}: the commanded position jumps by {jump * 1e3:.1f} mm")


def _took_ms(seen: list[Watched]) -> float:
    """From the scan that accepted a motion to the one that ended it."""
    return (seen[-1].scan_ns - seen[0].scan_ns) / MS


@case(
    557,
    "6.8",
    "segment_s and dwell_s are kept, at rest at each waypoint",
    motion=True,
    needs=OptionalPart.PATHS,
)
def path_times(peer: Peer) -> None:
    scene, watch = watched(peer, Mode.STANDBY)
    middle = moved(scene.here, dz=0.015)
    seen = until_done(watch, ReferencePath(peer.new_id(), (middle, scene.here), 0.8, 0.4))
    at_rest = [each for each in seen if math.dist(each.state.X_BT_cmd.p_m, middle.p_m) < AT_M]
    require(bool(at_rest), "it does not rest at the first waypoint")
    arrives = (at_rest[0].scan_ns - seen[0].scan_ns) / MS
    rests = (at_rest[-1].scan_ns - at_rest[0].scan_ns) / MS
    leaves = (seen[-1].scan_ns - at_rest[-1].scan_ns) / MS
    slack = LATE_MS + watch.period_ms
    require(abs(arrives - 800.0) < slack, f"there after {arrives:.0f} ms, asked for 800")
    require(abs(rests - 400.0) < slack, f"it rests for {rests:.0f} ms, asked for 400")
    ends = min(abs(leaves - 800.0), abs(leaves - 1200.0))
    require(ends < slack, f"the second segment takes {leaves:.0f} ms, asked for 800")
    for each in seen[:-1]:
        segment = 0 if each.scan_ns < at_rest[0].scan_ns else 1
        near = math.dist(each.state.X_BT_cmd.p_m, middle.p_m) < 1e-4
        require(near or each.state.segment == segment, f"segment {each.state.segment}, on the way {segment}")
    require_no_jump(seen, "a path")


@case(558, "6.7", "duration_s is the time of the motion", motion=True)
def takes_its_time(peer: Peer) -> None:
    scene, watch = watched(peer, Mode.STANDBY)
    for goal, seconds in ((scene.goal, 0.8), (scene.here, 1.2)):
        took = _took_ms(until_done(watch, ReferencePose(peer.new_id(), goal, seconds)))
        slack = LATE_MS + watch.period_ms
        require(
            abs(took - 1e3 * seconds) < slack,
            f"it took {took:.0f} ms, asked for {1e3 * seconds:g}",
        )


@case(559, "6.7", "duration_s of 0 is the shortest time that would have been accepted", motion=True)
def shortest(peer: Peer) -> None:
    scene, watch = watched(peer, Mode.STANDBY)
    took = _took_ms(until_done(watch, ReferencePose(peer.new_id(), scene.goal, 0.0)))
    # The way back is as long; a controller that calls a motion done when the arm has settled adds its lag.
    shorter = reference_reason(peer, scene.here, 0.6 * took * 1e-3)
    refused = (Reason.TOO_FAST, Reason.BAD_DURATION)
    require(shorter.reason in refused, f"it took {took:.0f} ms, and 60 % of that is {shorter.reason.name}")
    longer = reference_reason(peer, scene.here, (1.05 * took + 2 * watch.period_ms) * 1e-3)
    expect_reason(longer, Reason.ACCEPTED, f"it took {took:.0f} ms, and 5 % more")


@case(560, "6.9", "a new reference replaces the one being followed, without a step of the speed", motion=True)
def replaces(peer: Peer) -> None:
    scene, watch = watched(peer, Mode.MOVING)
    before = watch.during(UNDER_WAY_MS)
    seen = until_done(watch, ReferencePose(peer.new_id(), scene.here, 1.5))
    require_near(seen[-1].state.X_BT_cmd, scene.here, 1e-6, "it ends from where it was sent")
    went_on = max(map(height, seen)) - height(before[-1])
    require(went_on > RAMP_M, "the speed drops to nothing when a new reference comes")
    require_no_jump([before[-1], *seen], "a new reference")


@case(568, "6.9", "a reference that is refused leaves the motion that is followed as it is", motion=True)
def refused_in_motion(peer: Peer) -> None:
    scene, watch = watched(peer, Mode.MOVING)
    motion_id = peer.state().motion_id
    seen = watch.during(100.0)
    nan = scene.here._replace(p_m=(math.nan, 0.0, 0.0))
    for bad in (nan, moved(scene.here, dz=50.0)):
        require(reference_reason(peer, bad, 0.0).reason is not Reason.ACCEPTED, f"{bad.p_m} was accepted")
    why = "the motion was not driven to its end"
    seen += watch.until(lambda state: state.motion_done and state.motion_id == motion_id, 3000.0, why)
    last = seen[-1].state
    require(math.dist(last.X_BT_cmd.p_m, scene.goal.p_m) < 1e-6, "it ends somewhere else")
    require_no_jump(seen, "refused references")


def _ramp_states(peer: Peer, code: CommandCode, end: GroupState) -> list[Watched]:
    """The STATEs from a stop in the middle of a motion to its end; the first is of before."""
    scene, watch = watched(peer, Mode.MOVING)
    seen = watch.during(UNDER_WAY_MS)[-1:]
    require_reason(peer, code, Reason.ACCEPTED, "MOVING")
    what = f"{code.name} does not lead to {end.name}"
    seen += watch.until(lambda state: state.group_state is end, 3000.0, what)
    driven = [each for each in seen if each.state.group_state is not GroupState.DISABLED]
    require(height(driven[-1]) - height(seen[0]) > RAMP_M, f"{code.name} stops the arm with a step")
    require_no_jump(driven, code.name)
    off_m = math.dist(driven[-1].state.X_BT_cmd.p_m, scene.goal.p_m)
    require(off_m > 1e-3, "it went on to its goal")
    return seen


@case(569, "7.3", "DISABLE in motion ramps down before it drops the enable, without a fault", motion=True)
def disabled_in_motion(peer: Peer) -> None:
    last = _ramp_states(peer, CommandCode.DISABLE, GroupState.DISABLED)[-1].state
    require_shown(last, "after the ramp", valves=CENTRED, fault=FaultCode.NONE)


@case(570, "7.3", "STOP in motion ramps down without a step of the speed, and holds there", motion=True)
def stop_is_smooth(peer: Peer) -> None:
    last = _ramp_states(peer, CommandCode.STOP, GroupState.STANDBY)[-1].state
    require(peer.state().X_BT_cmd == last.X_BT_cmd, "the commanded pose moves on")


@case(
    571, "7.4", "EMERGENCY_STOP in motion: no valve is driven from the scan on that latches it", motion=True
)
def centred_at_once(peer: Peer) -> None:
    _, watch = watched(peer, Mode.MOVING)
    watch.during(UNDER_WAY_MS / 2.0)
    sent_ns = peer.now_ns
    require_reason(peer, CommandCode.EMERGENCY_STOP, Reason.ACCEPTED, "MOVING")
    peer.passed_over.clear()
    seen = watch.during(150.0)
    latched = [each for each in seen if each.state.flags & FLAG_EMERGENCY_LATCHED]
    require(bool(latched), "it does not latch")
    after = (latched[0].scan_ns - sent_ns) / MS
    limit = 3 * peer.welcome.cycle_ns / MS + LATE_MS
    require(after < limit, f"latched {after:.0f} ms after it was sent")
    for each in seen[seen.index(latched[0]) :]:
        require(not any(each.state.valves), f"valves {each.state.valves} although it is latched")
        require(bool(each.state.flags & FLAG_EMERGENCY_LATCHED), "the latch is gone")


SIDE = 0.01
TRIES = 12


@case(563, "6.9", "a time that is too short for the way: both sides of what is TOO_FAST", motion=True)
def too_fast(peer: Peer) -> None:
    goal = moved(entered(peer, Mode.STANDBY).here, dz=0.06)
    seconds = reference_reason(peer, goal, 1e-6).limit * (1.0 + SIDE)
    for _ in range(TRIES):
        got = reference_reason(peer, goal, seconds)
        expect_reason(got, Reason.TOO_FAST, f"60 mm in {seconds:g} s")
        require(got.value > got.limit > 0.0, f"value {got.value:g}, limit {got.limit:g}")
        ratio = got.value / got.limit
        if ratio < 1.0 + 4 * SIDE:
            break
        # Speeds go with 1/T, accelerations with 1/T²: the root asks for nothing within the limits.
        seconds *= math.sqrt(ratio) * (1.0 - SIDE)
    require(ratio < 1.0 + 4 * SIDE, "the values of TOO_FAST lead nowhere")
    expect_reason(
        reference_reason(peer, goal, seconds * ratio * (1.0 + SIDE)), Reason.ACCEPTED, "a little more time"
    )


@case(567, "6.9", "a singularity: refused from the value on that the refusal names", motion=True)
def singular(peer: Peer) -> None:
    here = entered(peer, Mode.STANDBY).here
    about = (1.0, 0.0, 0.0)

    def at(degrees: float) -> Acknowledgement:
        return reference_reason(peer, turned(here, math.radians(degrees), about))

    tried = [side * 2.5 * step for step in range(1, 19) for side in (-1.0, 1.0)]
    refused = next((each for each in tried if at(each).reason is Reason.SINGULAR), None)
    if refused is None:
        raise Unsupported("no singularity within 45° of the tool's pitch")
    within, beyond, edge = refused - math.copysign(2.5, refused), refused, at(refused)
    for _ in range(TRIES):
        middle = (within + beyond) / 2.0
        got = at(middle)
        require(got.reason in (Reason.ACCEPTED, Reason.SINGULAR), f"{middle:g}°: {got.reason.name}")
        if got.reason is Reason.SINGULAR:
            beyond, edge = middle, got
        else:
            within = middle
    peer.command(CommandCode.STOP)
    require(edge.value < edge.limit, f"value {edge.value:g}, limit {edge.limit:g}")
    note = f"accepted until {edge.value:g}, the limit is said to be {edge.limit:g}"
    require(edge.value > 0.9 * edge.limit, note)
