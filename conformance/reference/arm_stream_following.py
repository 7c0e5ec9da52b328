"""Cases 573, 575, 577…579, 586, 588 and 589: how streamed references are followed (12.3, 12.4, 12.7, 12.10).

A reference that moves is judged where it is at the instant of a STATE's scan, on the tester's clock.
"""

import math
from functools import partial
from typing import NamedTuple

from conformance.case import stream_case
from conformance.peer import Peer
from conformance.reference.arm_state_truth import StateWatch, Watched, turned, watched
from conformance.reference.arm_transitions import entered
from conformance.reference.motion import angle_between, moved, reach, require_near, require_reason
from conformance.reference.streaming import NUMBERS, Stream, opened_stream
from conformance.wire import MS, Unsupported, require
from protocol.axes_group import Mode
from protocol.faults import CommandCode, GroupState, Reason
from protocol.pose import Pose
from protocol.reference_messages import FLAG_STREAMING, State, StreamRefused

Axes = tuple[float, float, float]
SPEED_M_S = 0.05
RISING: Axes = (0.0, 0.0, SPEED_M_S)
TURNING: Axes = (0.0, 0.0, 0.06)
AT_REST: Axes = (0.0, 0.0, 0.0)
PERIOD_MS = 25.0
# Two scans of 5 ms and what a busy machine adds, in time; what is met without its velocity lags by 6 mm.
BEHIND_MS = 25.0
# It is met within this time, from rest: a page that bounds speed and acceleration bounds no time.
MET_MS = 1200.0
RECOVERY_MS, LONG_GAP_MS, GAP_STEP_MS, MOST_GAPS = 100.0, 83.0, 2.0, 12
SLOWED = 0.8  # of its pace
# Between references: most of the silence that is survived at full pace, with scans of 5 ms.
GAP_MS = 65.0
ACCELERATION_M_S2, JERK_M_S3 = 0.35, 3.0


class MovingReference(NamedTuple):
    """A reference that moves and turns in B, from ``begin`` at ``begin_ns`` (tester's clock)."""

    begin: Pose
    begin_ns: int
    velocity: Axes
    turning: Axes

    @property
    def speed(self) -> float:
        """How fast it moves (m/s)."""
        return math.hypot(*self.velocity)

    @property
    def turn(self) -> float:
        """How fast it turns (rad/s)."""
        return math.hypot(*self.turning)

    def at(self, at_ns: int) -> Pose:
        """Where it is."""
        seconds = (at_ns - self.begin_ns) * 1e-9
        there = moved(self.begin, *(v * seconds for v in self.velocity))
        if self.turn == 0.0:
            return there
        x, y, z = (w / self.turn for w in self.turning)
        return turned(there, self.turn * seconds, (x, y, z), in_base=True)

    def give(self, stream: Stream, age_ms: float = 0.0) -> None:
        """Sends it, as it was ``age_ms`` ago."""
        at_ns = stream.peer.now_ns - int(age_ms * MS)
        stream.give(self.at(at_ns), time_ns=at_ns, twist_ref=(*self.velocity, *self.turning))

    def feed(self, stream: Stream, watch: StateWatch, wait_ms: float, age_ms: float = 0.0) -> list[Watched]:
        """Sends it for ``wait_ms``; the STATEs that came meanwhile."""
        seen: list[Watched] = []
        for _ in stream.peer.within(wait_ms):
            self.give(stream, age_ms)
            seen += watch.during(PERIOD_MS)
        refused = [d.message for d in stream.peer.passed_over if isinstance(d.message, StreamRefused)]
        require(not refused, f"a moving reference was refused: {refused[:1]}")
        return seen


def _begin_stream(
    peer: Peer, velocity: Axes, turning: Axes = AT_REST
) -> tuple[Stream, StateWatch, MovingReference]:
    scene, watch = watched(peer, Mode.STANDBY)
    stream = opened_stream(peer)
    peer.passed_over.clear()
    return stream, watch, MovingReference(scene.here, peer.now_ns, velocity, turning)


def _require_met(seen: list[Watched], target: MovingReference) -> None:
    for each in seen:
        wanted_pose = target.at(each.scan_ns)
        off_m = math.dist(each.state.X_BT_cmd.p_m, wanted_pose.p_m)
        off_rad = angle_between(each.state.X_BT_cmd.q_wxyz, wanted_pose.q_wxyz)
        require(off_m < target.speed * BEHIND_MS * 1e-3, f"{off_m * 1e3:.1f} mm from the reference")
        require(
            off_rad <= target.turn * BEHIND_MS * 1e-3 + 1e-4, f"{off_rad * 1e3:.1f} mrad from the reference"
        )


def followed_with_velocity(velocity: Axes, turning: Axes, age_ms: float, peer: Peer) -> None:
    stream, watch, target = _begin_stream(peer, velocity, turning)
    target.feed(stream, watch, MET_MS, age_ms)
    _require_met(target.feed(stream, watch, 300.0, age_ms), target)
    require_reason(peer, CommandCode.STOP, Reason.ACCEPTED, "a stream")


for _number, _title, _velocity, _turning, _age_ms in (
    (577, "a reference that moves is met, and followed with its own velocity", RISING, TURNING, 0.0),
    # In every direction another speed: one that is taken for another is off by several millimetres.
    (578, "a reference that moves has gone on since the instant that it rests on",
     (-0.02, 0.04, -0.05), (0.03, -0.03, -0.06), 120.0),
):  # fmt: skip
    stream_case(_number, "12.7", _title)(partial(followed_with_velocity, _velocity, _turning, _age_ms))


def _furthest(seconds: float) -> float:
    """The longest way (m) from rest within ``seconds`` that jerk and acceleration allow."""
    rise = min(seconds, ACCELERATION_M_S2 / JERK_M_S3)
    rest = seconds - rise
    at_rise = JERK_M_S3 * rise**2 / 2.0 * rest
    return JERK_M_S3 * rise**3 / 6.0 + at_rise + ACCELERATION_M_S2 * rest**2 / 2.0


@stream_case(579, "12.7", "it sets out with bounded acceleration and jerk")
def sets_out_smoothly(peer: Peer) -> None:
    scene, watch = watched(peer, Mode.STANDBY)
    stream = opened_stream(peer)
    seen, sent_ns = [], peer.now_ns
    for _ in range(12):
        stream.give(moved(scene.here, dx=-0.05, dy=0.05, dz=0.05))  # the vector is bounded: all axes move
        seen += watch.during(PERIOD_MS)
    still = [each for each in seen if each.state.X_BT_cmd == scene.here]
    going = [each for each in seen if each.state.X_BT_cmd != scene.here]
    require(bool(going), "it does not set out")
    begin_ns = still[-1].scan_ns if still else sent_ns - peer.welcome.cycle_ns
    for each in going:
        seconds = (each.scan_ns - begin_ns + peer.welcome.cycle_ns) * 1e-9 + 2e-3
        way = math.dist(each.state.X_BT_cmd.p_m, scene.here.p_m)
        most = _furthest(seconds)
        note = f"{way * 1e3:.2f} mm within {seconds * 1e3:.0f} ms, at most {most * 1e3:.2f}"
        require(way < most + 1e-6, note)


@stream_case(
    573, "12.8", f"a reference every {GAP_MS:g} ms, or less with a longer cycle, is followed at full pace"
)
def gaps(peer: Peer) -> None:
    stream, watch, target = _begin_stream(peer, RISING)
    gap_ms = min(GAP_MS, 82.0 - 3.0 * peer.welcome.cycle_ns / MS)  # it slows down by its own cycle (12.8)
    target.feed(stream, watch, MET_MS)
    for _ in range(6):
        target.give(stream)
        seen = watch.during(gap_ms)
        for each in seen:
            require(each.state.group_state is GroupState.MOVING, f"fault {each.state.fault.name}")
            require(bool(each.state.flags & FLAG_STREAMING), "the stream has ended")
        _require_met(seen, target)


@stream_case(
    575, "12.8", "after a silence that slowed it down a reference is followed again, soon at full pace"
)
def recovers(peer: Peer) -> None:
    """How long a silence slows down and does not yet stop is found: its scan sees it up to a cycle later."""
    gap_ms, least_ms, most_ms = LONG_GAP_MS, 0.0, math.inf
    for _ in range(MOST_GAPS):
        stream, watch, target = _begin_stream(peer, RISING)
        seen = target.feed(stream, watch, 600.0)
        target.give(stream)
        seen = watch.during(gap_ms)
        sent_ns = peer.now_ns
        for _ in range(10):
            target.give(stream)
            seen += watch.during(PERIOD_MS)
        if any(each.state.group_state is not GroupState.MOVING for each in seen):
            most_ms = min(most_ms, gap_ms)
        elif _mean_speed(seen, sent_ns, -5.0, 25.0) > SLOWED * SPEED_M_S:
            least_ms = max(least_ms, gap_ms)
            require_reason(peer, CommandCode.STOP, Reason.ACCEPTED, "a stream")
        else:
            require_reason(peer, CommandCode.STOP, Reason.ACCEPTED, "a stream")
            back = _mean_speed(seen, sent_ns, RECOVERY_MS - 15.0, RECOVERY_MS + 15.0)
            require(
                back > 0.9 * SPEED_M_S, f"{back * 1e3:.0f} mm/s {RECOVERY_MS:g} ms later: not at full pace"
            )
            return
        gap_ms += GAP_STEP_MS if gap_ms <= least_ms else -GAP_STEP_MS
    if least_ms == 0.0:
        raise Unsupported("the tester is too late to be silent for so short a time")
    require(
        False,
        f"at full pace after {least_ms:.0f} ms of silence, stopped after {most_ms:.0f}: not slowed down",
    )


def _mean_speed(seen: list[Watched], sent_ns: int, begin_ms: float, end_ms: float) -> float:
    """Mean speed (m/s) between two times after a reference that was followed again, or over two STATEs."""
    part = [each for each in seen if begin_ms <= (each.scan_ns - sent_ns) / MS <= end_ms]
    part = part if len(part) > 1 else [each for each in seen if begin_ms <= (each.scan_ns - sent_ns) / MS][:2]
    seconds = (part[-1].scan_ns - part[0].scan_ns) * 1e-9
    return math.dist(part[0].state.X_BT_cmd.p_m, part[-1].state.X_BT_cmd.p_m) / seconds


@stream_case(
    586, "12.3", "of a burst the newest is followed, the others have no answer; lost ones are not missed"
)
def burst(peer: Peer) -> None:
    scene = entered(peer, Mode.STREAMING)
    stream = scene.stream
    for lost in (0, 3, 1, 40):
        stream.number = (stream.number + lost) % NUMBERS
        for _ in range(8):
            stream.give(scene.goal)
        newest = (stream.number - 1) % NUMBERS
        # No clock is estimated meanwhile: a controller that answers in its scans would end the stream (12.8).
        got = [datagram.message for datagram in peer.collect(60.0)]
        shown = [message.stream_number for message in got if isinstance(message, State)]
        require(newest in shown, f"the newest of a burst is not followed, {lost} lost before it")
        answers = [message for message in got if isinstance(message, StreamRefused)]
        require(not answers, f"one of a burst was refused: {answers[:1]}")


@stream_case(588, "12.10", "END_STREAM rests where a moving reference was when it was last accepted")
def ends_at_its_last_place(peer: Peer) -> None:
    stream, watch, target = _begin_stream(peer, (0.0, 0.0, -SPEED_M_S))
    target.feed(stream, watch, 600.0)
    target.give(stream)
    last_ns = peer.now_ns
    peer.collect(15.0)
    require_reason(peer, CommandCode.END_STREAM, Reason.ACCEPTED, "a stream")
    state = reach(peer, GroupState.STANDBY, "after END_STREAM", 10_000)
    most_m = SPEED_M_S * BEHIND_MS * 1e-3
    require_near(state.X_BT_cmd, target.at(last_ns), most_m, "from where the reference was")


@stream_case(589, "12.4", "what is refused takes no number, and the one before stays in force")
def refused_has_no_effect(peer: Peer) -> None:
    scene = entered(peer, Mode.STREAMING)
    stream, number = scene.stream, scene.stream.number - 1
    nan = scene.here._replace(p_m=(math.nan, 0.0, 0.0))
    for bad, reason in ((nan, Reason.NOT_FINITE), (moved(scene.here, dz=100.0), Reason.TOO_FAR)):
        stream.refused(bad, reason, f"{bad.p_m}")
        require(peer.state().stream_number == number, "stream_number names one that was refused")
        stream.number = number + 1
        stream.feed(scene.goal, PERIOD_MS)
        number = stream.number - 1
    stream.refused(nan, Reason.NOT_FINITE, "NaN")
    stream.feed(scene.goal, 1200.0)
    require_near(peer.state().X_BT_cmd, scene.goal, 1e-4, "from the reference that stayed in force")
