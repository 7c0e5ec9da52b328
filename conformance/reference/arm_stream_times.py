"""Cases 572, 574, 576 and 587: when a stream is slowed down and stopped (12.8 to 12.10).

Times are judged on the tester's clock: from the sending of a reference to the scan of a STATE.
"""

import math
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import Any

from conformance.case import stream_case
from conformance.peer import Peer
from conformance.reference.arm_state_truth import StateWatch, Watched, turned, watched
from conformance.reference.arm_transitions import entered
from conformance.reference.motion import moved, reach, require_near, require_reason, require_shown, scaled
from conformance.reference.streaming import BOTH, NUMBERS, SILENCE_MS, Stream, opened_stream
from conformance.wire import MS, known, require
from protocol.axes_group import Mode
from protocol.faults import CommandCode, FaultCode, GroupState, Reason
from protocol.pose import Pose
from protocol.reference_messages import FLAG_STREAMING, State, StreamRefused

FIRST_REFERENCE_MS, RAMP_MS = 1000.0, 12.0
# What a busy machine adds: a scan of 5 ms. The controller's own figures leave 7 ms more to the 100 of 12.8.
LATE_MS = 5.0
FEED_MS = 10.0


def followed(peer: Peer, metres: float = 0.02) -> tuple[Stream, StateWatch, Pose]:
    """A stream that is on its way up by ``metres``, a watch, and the pose that it is sent to."""
    scene, watch = watched(peer, Mode.STANDBY)  # before the stream: its echoes take longer than a silence may
    stream = opened_stream(peer)
    goal = moved(scene.here, dz=metres)
    stream.feed(goal, 150.0)
    return stream, watch, goal


def _is_over(state: State) -> bool:
    return state.group_state is GroupState.ERROR_STOP and not any(state.valves)


def _until_over(watch: StateWatch, sent_ns: int, most_ms: float) -> list[tuple[float, Watched]]:
    """STATEs until silence has stopped the arm, with the ms since ``sent_ns``."""
    seen = watch.until(_is_over, most_ms, f"the arm was not stopped within {most_ms:g} ms of silence")
    require_shown(seen[-1].state, "after silence", fault=FaultCode.REFERENCE_STALE)
    return [((each.scan_ns - sent_ns) / MS, each) for each in seen]


@stream_case(572, "12.8", "silence: slowed down, then valves centred within 100 ms of the last reference")
def silence_stops(peer: Peer) -> None:
    stream, watch, goal = followed(peer)
    cycle_ms = peer.welcome.cycle_ns / MS
    sent_ns = stream.give(goal)
    seen = _until_over(watch, sent_ns, 2000.0)
    after, last = seen[-1]
    require(not last.state.flags & FLAG_STREAMING, "the flag STREAMING is still set")
    uncertain = watch.uncertainty_ms
    require(after < SILENCE_MS + LATE_MS + uncertain, f"centred only {after:.1f} ms after the last reference")
    earliest = SILENCE_MS - 2 * cycle_ms - 2.0
    # The scan decides after the encoders were read and before STATE comes; only what came too soon is early.
    came_ms = (last.came_ns - sent_ns) / MS
    require(came_ms > earliest - 1.0, f"centred already {came_ms:.1f} ms after the last reference")
    _require_ramp(seen, earliest - RAMP_MS, cycle_ms)


def _require_ramp(seen: list[tuple[float, Watched]], begins_ms: float, cycle_ms: float) -> None:
    """The way from STATE to STATE is shorter in the ramp than before it."""
    ways = [
        (
            *(from_ms, at_ms),
            math.dist(a.state.X_BT_cmd.p_m, b.state.X_BT_cmd.p_m) / max(b.state.cycle - a.state.cycle, 1),
        )
        for (from_ms, a), (at_ms, b) in pairwise(seen)
        if b.state.group_state is GroupState.MOVING
    ]
    before = [way for _, at_ms, way in ways if begins_ms - 4 * cycle_ms < at_ms < begins_ms - 1.0]
    within = [way for from_ms, _, way in ways if from_ms > begins_ms - 1.0]
    if before and within:  # scans that came late leave none in between
        require(within[-1] < 0.8 * max(before), "it is not slowed down before its valves are centred")


@stream_case(574, "12.8", f"the first reference is waited for, at rest, for {FIRST_REFERENCE_MS:g} ms")
def first_reference(peer: Peer) -> None:
    _, watch = watched(peer, Mode.STANDBY)
    sent_ns = peer.now_ns
    opened_stream(peer)
    at = peer.state().X_BT_cmd
    seen = _until_over(watch, sent_ns, 2 * FIRST_REFERENCE_MS)
    for _, each in seen[:-1]:
        require(each.state.X_BT_cmd == at, "the commanded pose moves without a reference")
    after = seen[-1][0]
    require(abs(after - FIRST_REFERENCE_MS) < 30.0, f"it waited for {after:.0f} ms")


@stream_case(
    576, "12.9", "when the session ends a stream is stopped by its silence, and latches REFERENCE_STALE"
)
def session_ends(peer: Peer) -> None:
    stream, watch, goal = followed(peer)
    sent_ns = stream.give(goal)
    peer.collect(FEED_MS)
    peer.reopen(capabilities=BOTH, period_ms=0)
    seen = _until_over(watch, sent_ns, 2000.0)
    after = seen[-1][0]
    late = SILENCE_MS + LATE_MS + watch.uncertainty_ms
    require(len(seen) == 1 or after < late, f"centred only {after:.1f} ms after the last reference")


@stream_case(587, "12.10", "END_STREAM before any reference rests where it is, and the motion is done")
def ends_without_reference(peer: Peer) -> None:
    entered(peer, Mode.STANDBY)
    stream = opened_stream(peer)
    at = peer.state().X_BT_cmd
    require_reason(peer, CommandCode.END_STREAM, Reason.ACCEPTED, "a stream")
    state = reach(peer, GroupState.STANDBY, "after END_STREAM", 1000)
    require_near(state.X_BT_cmd, at, 1e-6, "it moved")
    seen = StateWatch(peer).until(lambda state: state.motion_done, 500.0, "motion_done does not follow")
    require_shown(seen[-1].state, "after END_STREAM", motion_id=stream.stream_id)


DISTANCE_M, TURN_RAD, AGE_MS = 0.5, math.radians(30.0), 250.0
SPEED_M_S, TURN_RAD_S = 0.25 * 0.8 / math.sqrt(3.0), math.radians(12.0) * 0.8 / math.sqrt(3.0)
# A limit's two sides lie this far from it, in parts of it; for an age in ms, for the network and a scan.
SIDE, AGE_SIDE_MS = 1e-6, 20.0
LIMITS_FEED_MS = 8.0
# What two clocks that drift by 100 ppm differ by within the 5 s of a case.
CLOCKS_MS = 0.5


def resting_stream(peer: Peer) -> tuple[Stream, Pose]:
    """A stream that rests at the pose returned."""
    stream = entered(peer, Mode.STREAMING).stream
    stream.feed(peer.state().X_BT_cmd, 600.0)
    return stream, peer.state().X_BT_cmd


def _require_sides(got: StreamRefused, reason: Reason, sent: float, most: float, what: str) -> float:
    """The limit that ``got`` names."""
    require(got.reason is reason, f"{what} of {sent:g}: {got.reason.name}, wanted {reason.name}")
    require(abs(got.value - sent) < 0.03 * sent, f"{what} of {sent:g} is said to be {got.value:g}")
    require(0.0 < got.limit <= most * 1.005, f"{what}: a limit of {got.limit:g}, at most {most:g}")
    return got.limit


@stream_case(580, "12.4", "a reference that breaks several rules is refused for the first of them")
def order(peer: Peer) -> None:
    stream, here = resting_stream(peer)
    newest = (stream.number - 1) % NUMBERS
    _, y, z = here.p_m
    spoilt: list[tuple[Reason, dict[str, Any]]] = [
        (Reason.NOT_STREAMING, {"stream_id": stream.stream_id - 1}),
        (Reason.OVERTAKEN, {"number": newest}),
        (Reason.STALE, {"time_ns": peer.now_ns - 10_000 * MS}),
        (Reason.NOT_FINITE, {"X_BT_ref": here._replace(p_m=(math.nan, y, z + 100.0))}),
        (Reason.NOT_UNIT_QUATERNION, {"X_BT_ref": scaled(moved(here, dz=100.0), 1.5)}),
        (Reason.TOO_FAST, {"twist_ref": (0.0, 50.0, 0.0, 0.0, 0.0, 0.0)}),
        (Reason.TOO_FAR, {"X_BT_ref": moved(here, dz=100.0)}),
    ]
    spoilt[3][1]["X_BT_ref"] = scaled(spoilt[3][1]["X_BT_ref"], 1.5)
    for first, (reason, _) in enumerate(spoilt):
        fields: dict[str, Any] = {}
        for _, more in reversed(spoilt[first:]):
            fields |= more
        followed_why = f"what should be {reason.name} is followed"
        got = known(stream.verdict(fields.pop("X_BT_ref"), **fields), followed_why)
        require(got.reason is reason, f"what should be {reason.name} first is {got.reason.name}")
        stream.feed(here, LIMITS_FEED_MS)
        spoilt[1][1]["number"] = (stream.number - 1) % NUMBERS


def _refusal_of(stream: Stream, pose: Pose, **more: Any) -> StreamRefused:
    return known(stream.verdict(pose, **more), "it is followed although it is beyond the limit")


def bound(what: str, there: Callable[[Pose, float], Pose], far: float, most: float, peer: Peer) -> None:
    """Both sides of the limit of how far ``there`` may be from the commanded pose."""
    stream, here = resting_stream(peer)
    limit = _require_sides(_refusal_of(stream, there(here, far)), Reason.TOO_FAR, far, most, what)
    beyond = limit * (1.0 + SIDE)
    _require_sides(_refusal_of(stream, there(here, beyond)), Reason.TOO_FAR, beyond, most, what)
    inside = stream.verdict(there(here, limit * (1.0 - SIDE)))
    require(inside is None or inside.reason is not Reason.TOO_FAR, f"{what} within its limit is TOO_FAR")


for _number, _what, _there, _far, _most in (
    (581, "distance", lambda here, far: moved(here, dx=-far), 100.0, DISTANCE_M),
    (582, "angle", turned, 2.0, TURN_RAD),
):
    stream_case(_number, "12.4", f"the {_what} from the commanded pose: both sides of its limit")(
        partial(bound, _what, _there, _far, _most)
    )


@stream_case(583, "12.4", "its own speed, each axis: both sides of its limit")
def speed(peer: Peer) -> None:
    stream, here = resting_stream(peer)
    for axis in range(6):
        most = SPEED_M_S if axis < 3 else TURN_RAD_S

        def twist(rate: float, axis: int = axis) -> tuple[float, ...]:
            return tuple(rate if k == axis else 0.0 for k in range(6))

        got = _refusal_of(stream, here, twist_ref=twist(50.0))
        limit = _require_sides(got, Reason.TOO_FAST, 50.0, most, f"axis {axis}, a speed")
        beyond = limit * (1.0 + 2 * SIDE)
        got = _refusal_of(stream, here, twist_ref=twist(-beyond))
        _require_sides(got, Reason.TOO_FAST, beyond, most, f"axis {axis}, a speed")
        inside = stream.verdict(here, twist_ref=twist(limit * (1.0 - 2 * SIDE)))
        require(inside is None, f"axis {axis}: refused within its limit: {inside}")
        stream.feed(here, LIMITS_FEED_MS)


@stream_case(584, "12.6", "the age of the measurement: both sides of its limit")
def age(peer: Peer) -> None:
    stream, here = resting_stream(peer)

    def aged(ms: float) -> StreamRefused | None:
        begin_ns = peer.now_ns
        got = stream.verdict(here, time_ns=begin_ns - int(ms * MS))
        if got is not None and got.reason is Reason.STALE:
            # It left at this age or later, and was judged before its answer came.
            most_ms = ms + (peer.now_ns - begin_ns) / MS
            stated_ms = got.value * 1e3
            fits = ms - CLOCKS_MS < stated_ms < most_ms + CLOCKS_MS
            require(fits, f"its age is said to be {stated_ms:.2f} ms: it is {ms:.2f} to {most_ms:.2f}")
        return got

    oldest = known(aged(10_000.0), "10 s old, and followed")
    limit_ms = 1e3 * _require_sides(oldest, Reason.STALE, 10.0, AGE_MS * 1e-3, "an age")
    for nth, ms in enumerate((limit_ms + 2.0, *[limit_ms * 1.5] * 3)):
        peer.collect(1.3 * nth)  # whenever the next scan is
        got = aged(ms)
        require(got is not None and got.reason is Reason.STALE, f"{ms:g} ms old, and not STALE: {got}")
    stream.feed(here, LIMITS_FEED_MS)
    got = aged(limit_ms - AGE_SIDE_MS)
    require(got is None, f"{AGE_SIDE_MS:g} ms within its limit, and refused: {got}")
