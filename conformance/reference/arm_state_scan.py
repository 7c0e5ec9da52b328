"""Cases 590…595: every field of a STATE is of the scan that its time names (7.7, 12.3); valves by joint.

STATEs are asked for so rarely that a field of the STATE before is older than any slack.
"""

import math
from collections.abc import Sequence
from functools import partial
from itertools import pairwise

from conformance.case import reference
from conformance.parts import OptionalPart
from conformance.peer import Peer
from conformance.reference.arm_state_truth import StateWatch, Watched
from conformance.reference.arm_transitions import entered, opened_stream
from conformance.reference.framing import stop
from conformance.reference.motion import STEP_M, disabled, enabled, expect_reason, moved, require_reason
from conformance.reference.streaming import BOTH, FEED_MS
from conformance.wire import MS, require
from protocol.axes_group import Mode
from protocol.faults import CommandCode, Reason, Severity
from protocol.pose import Pose
from protocol.reference_messages import ReferencePath, ReferencePose, State, StreamRefused

case = partial(reference.case, motion=True)
RARELY_MS = 250
SEGMENT_S = 0.8
# What a busy machine adds; and what scans that it skipped may lack of their time.
LATE_MS, SKIPPED_MS = 30.0, 50.0
# Of what follows the measurement in the same scan: two digits of an encoder, and a rounding.
SAME_RAD, SAME_M = 1e-4, 1e-6
# A joint that moves by less than this part of what the busiest one moves by is at rest.
RESTS = 0.05
# One that moves by this part of what it was asked for follows.
FOLLOWS = 0.5
# From so far on the way of T is in proportion to the turn of what moves it, within a factor.
FAR_M, APART = 0.002, 2.0


def rarely(peer: Peer) -> tuple[StateWatch, Pose]:
    """A session with STATE every 250 ms and the group DISABLED; a watch, and the pose T has."""
    disabled(peer, capabilities=BOTH, period_ms=0)
    here = peer.state().X_BT
    peer.leave()
    peer.open(capabilities=BOTH, period_ms=RARELY_MS)
    return StateWatch(peer), here


def enabled_rarely(peer: Peer) -> tuple[StateWatch, Pose]:
    """As ``rarely``, in STANDBY, with the pose that is held. Raises Unsupported when it cannot be enabled."""
    watch, _ = rarely(peer)
    enabled(peer)
    return watch, first_after(watch).X_BT_cmd


def first_after(watch: StateWatch) -> State:
    """The first STATE of a scan after now."""
    now_ns = watch.peer.now_ns + int(watch.uncertainty_ms * MS)
    while True:
        seen = watch.next(4 * RARELY_MS)
        if seen.scan_ns > now_ns:
            return seen.state


@case(
    590,
    "7.7",
    f"cycle counts the scans (slack {SKIPPED_MS:g} ms), at any period and over sessions",
    motion=False,
)
def cycle_counts(peer: Peer) -> None:
    cycle_ns = peer.open(period_ms=0).cycle_ns
    watch = StateWatch(peer)
    states = [each.state for each in watch.during(100.0)]
    peer.leave()
    peer.open(period_ms=RARELY_MS)
    states += [watch.next(4 * RARELY_MS).state for _ in range(3)]
    for a, b in pairwise(states):
        counted_ms, passed_ms = (b.cycle - a.cycle) * cycle_ns / MS, (b.time_ns - a.time_ns) / MS
        require(
            abs(counted_ms - passed_ms) < SKIPPED_MS,
            f"cycle went on by {b.cycle - a.cycle}, which is {counted_ms:.0f} ms, within {passed_ms:.0f} ms",
        )


@case(591, "7.7", "what STATE counts and latches is of its scan, not of the STATE before", motion=False)
def counts_of_the_scan(peer: Peer) -> None:
    watch, _ = rarely(peer)
    before = first_after(watch)
    held = [peer.encoded(stop(peer)) for _ in range(3)]
    peer.alive("behind a gap of 3")
    lost = _difference(first_after(watch).references_lost, before.references_lost)
    require(lost == 3, f"{lost} lost of a gap of 3")
    peer.send_raw(held[1])
    peer.alive("behind a late one")
    state = first_after(watch)
    lost = _difference(state.references_lost, before.references_lost)
    gone = _difference(state.references_dropped, before.references_dropped)
    require((lost, gone) == (2, 1), f"{lost} lost of a gap of 3 of which one came late, {gone} dropped")
    for code, severity in (
        (CommandCode.EMERGENCY_STOP, Severity.EMERGENCY),
        (CommandCode.EMERGENCY_RELEASE, Severity.EMERGENCY),
        (CommandCode.RESET, Severity.NONE),
    ):
        require_reason(peer, code, Reason.ACCEPTED, "turn")
        state = first_after(watch)
        require(state.severity is severity, f"severity {state.severity.name} after {code.name}")


def _difference(later: int, earlier: int) -> int:
    """Counts wrap."""
    return (later - earlier) % 2**32


@case(592, "7.7", "in motion, and where it is cut off, STATE is of its scan, not of the STATE before")
def motion_of_the_scan(peer: Peer) -> None:
    watch, here = enabled_rarely(peer)
    goal = moved(here, dz=STEP_M)
    states = [first_after(watch)]
    for pose, seconds in ((goal, 0.8), (here, 1.5)):
        request = ReferencePose(peer.new_id(), pose, seconds)
        expect_reason(peer.ask(request, "a motion"), Reason.ACCEPTED, "a motion")
        for _ in range(8 if pose is goal else 3):
            states.append(first_after(watch))
            require(states[-1].motion_id == request.command_id, "motion_id is not the motion's")
    for joints, tool in (("q_meas", "X_BT"), ("q_cmd", "X_BT_cmd")):
        _require_one_way(states[:9], joints, tool)
    require_reason(peer, CommandCode.EMERGENCY_STOP, Reason.ACCEPTED, "MOVING")
    state = first_after(watch)
    off = max(abs(c - m) for c, m in zip(state.q_cmd, state.q_meas, strict=True))
    require(off < SAME_RAD, f"q_cmd and q_meas are {off * 1e3:.2f} mrad apart although nothing is driven")
    off = math.dist(state.X_BT_cmd.p_m, state.X_BT.p_m)
    require(off < SAME_M, f"X_BT_cmd and X_BT are {off * 1e3:.2f} mm apart although nothing is driven")
    require(not any(state.valves), f"valves {state.valves} after EMERGENCY_STOP")


def _require_one_way(states: Sequence[State], joints: str, tool: str) -> None:
    """Raises Failed unless T and one of the busier joints, in these fields, go the same way together."""
    turns: list[Sequence[float]] = [getattr(state, joints) for state in states]
    places: list[Sequence[float]] = [getattr(state, tool).p_m for state in states]
    ways_m = [math.dist(a, b) for a, b in pairwise(places)]
    whole_m = math.dist(places[0], places[-1])
    if whole_m < 2.0 * FAR_M:
        return  # an arm that hardly follows tells nothing here
    whole = [abs(turns[-1][j] - turns[0][j]) for j in range(6)]

    def together(j: int) -> bool:
        expected = [whole[j] * way_m / whole_m for way_m in ways_m]
        found = [abs(b[j] - a[j]) for a, b in pairwise(turns)]
        return all(
            way_m < FAR_M or e / APART < f < e * APART
            for way_m, e, f in zip(ways_m, expected, found, strict=True)
        )

    busy = [j for j in range(6) if whole[j] > RESTS * max(whole)]
    require(
        any(together(j) for j in busy), f"no joint of {joints} goes with {tool}: they are not of one scan"
    )


@case(593, "7.7", f"segment is the one of the scan (slack {LATE_MS:g} ms)", needs=OptionalPart.PATHS)
def segment_of_the_scan(peer: Peer) -> None:
    watch, here = enabled_rarely(peer)
    middle = moved(here, dz=STEP_M / 2)
    sent_ns = peer.now_ns
    request = ReferencePath(peer.new_id(), (middle, here, middle), SEGMENT_S, 0.0)
    expect_reason(peer.ask(request, "a path"), Reason.ACCEPTED, "a path")
    accepted_ns = peer.now_ns
    segment_ms = 1e3 * SEGMENT_S
    for each in watch.during(2.9 * segment_ms):
        # It was accepted between the two instants, and a scan may be late.
        least = int(((each.scan_ns - accepted_ns) / MS - LATE_MS) // segment_ms)
        most = int(((each.scan_ns - sent_ns) / MS + LATE_MS) // segment_ms)
        sure = least == most and 0 <= most <= 2
        require(not sure or each.state.segment == most, f"segment {each.state.segment} in segment {most}")
    peer.command(CommandCode.STOP)


@case(
    594,
    "12.3",
    f"stream_number is the newest of the scan (slack {LATE_MS:g} ms)",
    needs=OptionalPart.STREAMING,
)
def number_of_the_scan(peer: Peer) -> None:
    watch, here = enabled_rarely(peer)
    stream = opened_stream(peer)
    assert peer.welcome is not None
    cycle_ns = peer.welcome.cycle_ns
    given, seen = [], []
    until_ns = peer.now_ns + 4 * RARELY_MS * MS
    while peer.now_ns < until_ns:
        given.append((peer.now_ns, stream.number))
        stream.give(here)
        for datagram in peer.collect(FEED_MS):
            require(not isinstance(datagram.message, StreamRefused), f"refused: {datagram.message}")
            if isinstance(datagram.message, State):
                seen.append(datagram.message)
    require(len(seen) >= 2, f"{len(seen)} STATEs while references came")
    for state in seen:
        scan_ns = state.time_ns - watch.offset_ns
        least = max((n for at_ns, n in given if at_ns < scan_ns - LATE_MS * MS), default=None)
        # A scan may wait for what comes after its readings, and judge it.
        judged_ns = scan_ns + cycle_ns + watch.uncertainty_ms * MS
        most = max((n for at_ns, n in given if at_ns <= judged_ns), default=0)
        if least is not None:  # before, there may be none to be named
            said = f"stream_number {state.stream_number}, the newest of its scan is {least} to {most}"
            require(least <= state.stream_number <= most, said)
    peer.command(CommandCode.STOP)


def _there_and_back(watch: StateWatch, goal: Pose, here: Pose) -> list[State]:
    peer = watch.peer
    seen: list[Watched] = []
    for pose in (goal, here):
        request = ReferencePose(peer.new_id(), pose, 1.2)
        expect_reason(peer.ask(request, "a motion"), Reason.ACCEPTED, "a motion")
        seen += watch.during(1400.0)
    return [each.state for each in seen]


def _together(valve: Sequence[float], speed: Sequence[float]) -> float:
    """How much a valve goes with a speed: their covariance, times their number."""
    mean = sum(valve) / len(valve)
    return sum((v - mean) * s for v, s in zip(valve, speed, strict=True))


def _ranges(angles: Sequence[Sequence[float]]) -> list[float]:
    return [max(each) - min(each) for each in zip(*angles, strict=True)]


@case(595, "7.7", "the valve of a joint that moves goes with its speed, more than that of one that rests")
def valves_by_joint(peer: Peer) -> None:
    scene = entered(peer, Mode.STANDBY)
    watch = StateWatch(peer)
    for goal in (moved(scene.here, dz=STEP_M), moved(scene.here, dy=STEP_M)):
        states = _there_and_back(watch, goal, scene.here)
        ways, asked = _ranges([s.q_meas for s in states]), _ranges([s.q_cmd for s in states])
        mover = max(range(6), key=asked.__getitem__)
        if ways[mover] < FOLLOWS * asked[mover]:
            continue  # an arm that hardly follows tells nothing here
        speeds = [b.q_meas[mover] - a.q_meas[mover] for a, b in pairwise(states)]
        gains = [_together([s.valves[j] for s in states[1:]], speeds) for j in range(6)]
        require(gains[mover] > 0.0, f"the valve of joint {mover + 1} does not go with the joint's speed")
        for j in (j for j in range(6) if asked[j] < RESTS * asked[mover]):
            said = (
                f"joint {mover + 1} moves and joint {j + 1} rests, but the valve of joint {j + 1} is driven"
            )
            require(abs(gains[j]) < gains[mover], said)
    peer.command(CommandCode.STOP)
