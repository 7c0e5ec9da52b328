"""Cases 590…595: every field of a STATE is of the scan that its time names (7.7, 12.3); signs of joints.

STATEs are asked for so rarely that a field of the STATE before is older than any slack.
"""

import math
from collections.abc import Sequence
from itertools import pairwise

from conformance.case import case, moving_case
from conformance.parts import OptionalPart
from conformance.peer import Peer
from conformance.reference.arm_state_truth import StateWatch, require_following, turned, watched
from conformance.reference.framing import stop
from conformance.reference.motion import (
    CENTRED,
    STEP_M,
    accepted,
    angle_between,
    disabled,
    enabled,
    moved,
    require_reason,
    require_shown,
)
from conformance.reference.streaming import BOTH, FEED_MS, opened_stream
from conformance.wire import MS, require
from protocol.axes_group import Mode
from protocol.faults import CommandCode, Reason, Severity
from protocol.pose import Pose
from protocol.reference_messages import ReferencePath, ReferencePose, State, StreamRefused

RARELY_MS = 250
SEGMENT_S = 0.8
# What a busy machine adds; and what scans that it skipped may lack of their time.
LATE_MS, SKIPPED_MS = 30.0, 50.0
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
    peer.reopen(capabilities=BOTH, period_ms=RARELY_MS)
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
)
def cycle_counts(peer: Peer) -> None:
    cycle_ns = peer.open(period_ms=0).cycle_ns
    watch = StateWatch(peer)
    states = [each.state for each in watch.during(100.0)]
    peer.reopen(period_ms=RARELY_MS)
    states += [watch.next(4 * RARELY_MS).state for _ in range(3)]
    for a, b in pairwise(states):
        counted_ms, passed_ms = (b.cycle - a.cycle) * cycle_ns / MS, (b.time_ns - a.time_ns) / MS
        require(
            abs(counted_ms - passed_ms) < SKIPPED_MS,
            f"cycle went on by {b.cycle - a.cycle}, which is {counted_ms:.0f} ms, within {passed_ms:.0f} ms",
        )


@case(591, "7.7", "what STATE counts and latches is of its scan, not of the STATE before")
def counts_of_the_scan(peer: Peer) -> None:
    watch, _ = rarely(peer)
    before = first_after(watch)
    lost, gone = before.references_lost, before.references_dropped
    held = [peer.encoded(stop(peer)) for _ in range(3)]
    peer.alive("behind a gap of 3")
    require_shown(first_after(watch), "behind a gap of 3", references_lost=lost + 3)
    peer.send_raw(held[1])
    peer.alive("behind a late one")
    one_came = {"references_lost": lost + 2, "references_dropped": gone + 1}
    require_shown(first_after(watch), "of a gap of 3 of which one came late", **one_came)
    for code, severity in (
        (CommandCode.EMERGENCY_STOP, Severity.EMERGENCY),
        (CommandCode.EMERGENCY_RELEASE, Severity.EMERGENCY),
        (CommandCode.RESET, Severity.NONE),
    ):
        require_reason(peer, code, Reason.ACCEPTED, "turn")
        require_shown(first_after(watch), f"after {code.name}", severity=severity)


@moving_case(592, "7.7", "in motion, and where it is cut off, STATE is of its scan, not of the STATE before")
def motion_of_the_scan(peer: Peer) -> None:
    watch, here = enabled_rarely(peer)
    goal = moved(here, dz=STEP_M)
    states = [first_after(watch)]
    for pose, seconds in ((goal, 0.8), (here, 1.5)):
        motion_id = accepted(peer, ReferencePose(peer.new_id(), pose, seconds))
        for _ in range(8 if pose is goal else 3):
            states.append(first_after(watch))
            require(states[-1].motion_id == motion_id, "motion_id is not the motion's")
    for joints, tool in (("q_meas", "X_BT"), ("q_cmd", "X_BT_cmd")):
        _require_one_way(states[:9], joints, tool)
    require_reason(peer, CommandCode.EMERGENCY_STOP, Reason.ACCEPTED, "MOVING")
    state = first_after(watch)
    require_following([state])
    require_shown(state, "after EMERGENCY_STOP", valves=CENTRED)


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


@moving_case(593, "7.7", f"segment is the one of the scan (slack {LATE_MS:g} ms)", needs=OptionalPart.PATHS)
def segment_of_the_scan(peer: Peer) -> None:
    watch, here = enabled_rarely(peer)
    middle = moved(here, dz=STEP_M / 2)
    sent_ns = peer.now_ns
    accepted(peer, ReferencePath(peer.new_id(), (middle, here, middle), SEGMENT_S, 0.0), "a path")
    accepted_ns = peer.now_ns
    segment_ms = 1e3 * SEGMENT_S
    for each in watch.during(2.9 * segment_ms):
        # It was accepted between the two instants, and a scan may be late.
        least = int(((each.scan_ns - accepted_ns) / MS - LATE_MS) // segment_ms)
        most = int(((each.scan_ns - sent_ns) / MS + LATE_MS) // segment_ms)
        sure = least == most and 0 <= most <= 2
        require(not sure or each.state.segment == most, f"segment {each.state.segment} in segment {most}")


@moving_case(
    594,
    "12.3",
    f"stream_number is the newest of the scan (slack {LATE_MS:g} ms)",
    needs=OptionalPart.STREAMING,
)
def number_of_the_scan(peer: Peer) -> None:
    watch, here = enabled_rarely(peer)
    stream = opened_stream(peer)
    cycle_ns = peer.welcome.cycle_ns
    given, seen = [], []
    for _ in peer.within(4 * RARELY_MS):
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
            note = f"stream_number {state.stream_number}, the newest of its scan is {least} to {most}"
            require(least <= state.stream_number <= most, note)


TURN_RAD, SECONDS, SETTLES_MS = 0.04, 1.2, 700.0
# Of the way of the busiest joint: from so far on a joint's own says something.
MOVES = 0.3
# What an arm that follows is from its command.
NEAR_M, NEAR_RAD = 5e-3, 1e-2
# By so much per radian (m, rad) a joint does move T that way.
ACTS = 0.2
SLEW, LIFT, TILT, UP, ABOUT_UP = 0, 1, 2, 2, 5


def _goals(here: Pose) -> list[Pose]:
    axes = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    return [*(moved(here, *(STEP_M * c for c in axis)) for axis in axes),
            *(turned(here, TURN_RAD, axis, in_base=True) for axis in axes)]  # fmt: skip


def _way(watch: StateWatch, goal: Pose) -> list[State]:
    before = watch.next().state
    accepted(watch.peer, ReferencePose(watch.peer.new_id(), goal, SECONDS), "a small motion")
    return [before, *(each.state for each in watch.during(1e3 * SECONDS + SETTLES_MS))]


def _together(a: Sequence[float], b: Sequence[float]) -> float:
    """How much two go together: their covariance, times their number."""
    mean = sum(a) / len(a)
    return sum((x - mean) * y for x, y in zip(a, b, strict=True))


def _require_driven(states: list[State], there: State, what: str) -> None:
    commanded, measured = ([*zip(*rows, strict=True)] for rows in (
        [s.q_cmd for s in states], [s.q_meas for s in states]))  # fmt: skip
    spans, ways = ([max(each) - min(each) for each in joints] for joints in (commanded, measured))
    gains = []
    for j in range(6):
        speeds = [b - a for a, b in pairwise(measured[j])]
        gains.append(_together([s.valves[j] for s in states[1:]], speeds))
        if spans[j] > MOVES * max(spans):
            goes = _together(commanded[j], measured[j])
            require(goes > 0.0, f"{what}: q_meas of joint {j + 1} goes against q_cmd")
            follows = ways[j] > FOLLOWS * spans[j]
            require(not follows or gains[j] > 0.0, f"{what}: the valve of joint {j + 1} drives it backwards")
    mover = max(range(6), key=spans.__getitem__)
    for j in (
        j for j in range(6) if spans[j] < RESTS * spans[mover] and ways[mover] > FOLLOWS * spans[mover]
    ):
        speeds = [b - a for a, b in pairwise(measured[mover])]
        gain = _together([s.valves[j] for s in states[1:]], speeds)
        require(abs(gain) < gains[mover], f"{what}: joint {j + 1} rests, but its valve is driven")
    for last in (there, states[-1]):
        _require_near(last, what)


def _require_near(last: State, what: str) -> None:
    off_m = math.dist(last.X_BT.p_m, last.X_BT_cmd.p_m)
    off_rad = angle_between(last.X_BT.q_wxyz, last.X_BT_cmd.q_wxyz)
    note = f"{what}: X_BT is {off_m * 1e3:.1f} mm and {off_rad * 1e3:.0f} mrad from X_BT_cmd"
    require(off_m < NEAR_M and off_rad < NEAR_RAD, note)


def _solved(rows: list[list[float]], right: list[float]) -> list[float]:
    """x of rows · x = right; 0 where the rows leave it open."""
    system = [[*row, r] for row, r in zip(rows, right, strict=True)]
    size = len(rows)
    for k in range(size):
        best = max(range(k, size), key=lambda i: abs(system[i][k]))
        system[k], system[best] = system[best], system[k]
        if abs(system[k][k]) < 1e-9:
            return [0.0] * size
        for i in range(size):
            factor = system[i][k] / system[k][k] if i != k else 0.0
            system[i] = [a - factor * b for a, b in zip(system[i], system[k], strict=True)]
    return [row[size] / row[k] for k, row in enumerate(system)]


@case(595, "1.6", "each joint goes as its command and its valve say, and as its sign says", motion=True)
def signs(peer: Peer) -> None:
    (here, *_), watch = watched(peer, Mode.STANDBY)
    turns: list[list[float]] = []
    for axis, goal in enumerate(_goals(here)):
        what = f"along axis {axis + 1}" if axis < 3 else f"about axis {axis - 2}"
        there = _way(watch, goal)
        turns.append([b - a for a, b in zip(there[0].q_cmd, there[-1].q_cmd, strict=True)])
        _require_driven([*there, *_way(watch, here)], there[-1], what)

    def per_radian(axis: int) -> list[float]:
        step = STEP_M if axis < 3 else TURN_RAD
        return _solved(turns, [step if k == axis else 0.0 for k in range(6)])

    for axis, joint, name in ((UP, LIFT, "lift"), (UP, TILT, "tilt"), (ABOUT_UP, SLEW, "slew")):
        acts = per_radian(axis)[joint]
        require(acts > -ACTS, f"positive {name} moves T by {acts:.2f} per radian the other way")
