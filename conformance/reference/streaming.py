"""Cases 541…: streamed references (clause 12). Most enable the group, and many move the arm."""

import math
from itertools import pairwise
from typing import Any

from conformance.case import case, stream_case
from conformance.parts import OptionalPart
from conformance.peer import Peer
from conformance.reference.motion import (
    DRIFT_M,
    STEP_M,
    accepted,
    disabled,
    enabled,
    moved,
    reach,
    require_near,
    require_reason,
    require_shown,
)
from conformance.wire import ANSWER_MS, Failed, Unsupported, known, require
from protocol.faults import CommandCode, FaultCode, GroupState, Reason
from protocol.pose import Pose
from protocol.reference_messages import (
    CAPABILITY_PATHS,
    CAPABILITY_STREAMING,
    FLAG_STREAMING,
    Acknowledgement,
    Command,
    State,
    StreamedPose,
    StreamRefused,
)

BOTH = CAPABILITY_PATHS | CAPABILITY_STREAMING
FEED_MS = 10.0  # between references: so often that a busy tester's hiccups are not a silence
SILENCE_MS = 100.0
NUMBERS = 1 << 32


class Stream:
    """A stream of the tester's: its id, and the number of its next reference."""

    def __init__(self, peer: Peer, stream_id: int, number: int = 1) -> None:
        self.peer = peer
        self.stream_id = stream_id
        self.number = number

    def give(self, pose: Pose, **more: Any) -> int:
        """Sends the next reference; ``more`` overrides fields of it. Returns the time of sending, ns."""
        now_ns = self.peer.now_ns
        fields = {"stream_id": self.stream_id, "number": self.number, "time_ns": now_ns}
        self.peer.send(StreamedPose(X_BT_ref=pose, **(fields | more)))
        self.number = (self.number + 1) % NUMBERS
        return now_ns

    def feed(self, pose: Pose, wait_ms: float) -> list[State]:
        """References to ``pose`` for ``wait_ms``, none of them refused; the states that came meanwhile."""
        states = []
        for _ in self.peer.within(wait_ms):
            self.give(pose)
            for datagram in self.peer.collect(FEED_MS):
                message = datagram.message
                if isinstance(message, StreamRefused):
                    require(False, f"reference {message.number} was refused: {message.reason.name}")
                if isinstance(message, State):
                    states.append(message)
        return states

    def verdict(self, pose: Pose, *, shown: bool = True, **more: Any) -> StreamRefused | None:
        """The refusal of the next reference, or None when it is followed; as ``give`` and ``verdict_on``."""
        number = more.get("number", self.number)
        shown_before = number == (self.number - 1) % NUMBERS
        self.give(pose, **more)
        return self.verdict_on(number, shown=shown and not shown_before)

    def verdict_on(self, number: int, *, shown: bool = True) -> StreamRefused | None:
        """The refusal of reference ``number``, or None once STATE names it; Failed when neither comes.

        ``shown``: whether STATE names it only if it is followed.
        """
        for _, message in self.peer.arriving(ANSWER_MS):
            if isinstance(message, StreamRefused) and message.number == number:
                return message
            if shown and isinstance(message, State) and message.stream_number == number:
                return None
        raise Failed(f"reference {number} is neither followed nor refused")

    def refused(self, pose: Pose, reason: Reason, what: str) -> None:
        """Require that the next reference is refused with ``reason``."""
        got = known(self.verdict(pose, shown=False), what)
        require(got.stream_id == self.stream_id, f"{what}: of stream {got.stream_id}")
        require(got.reason is reason, f"{what}: {got.reason.name}, wanted {reason.name}")


def streamless(peer: Peer, period_ms: int = 20) -> State:
    """A session with the capability, the group DISABLED; its STATE. Raises Unsupported without it."""
    disabled(peer, capabilities=BOTH, period_ms=period_ms)
    if not peer.welcome.capabilities & CAPABILITY_STREAMING:
        raise Unsupported("STREAMING is not granted", OptionalPart.STREAMING)
    return peer.state()


def opened_stream(peer: Peer) -> Stream:
    """A new stream, in STANDBY. Raises Unsupported when streaming is not granted."""
    if peer.welcome.capabilities & BOTH != BOTH:
        raise Unsupported("STREAMING is not granted", OptionalPart.STREAMING)
    request = Command(peer.new_id(), CommandCode.START_STREAM)
    return Stream(peer, accepted(peer, request, "START_STREAM in STANDBY"))


def opened(peer: Peer, period_ms: int = 20) -> tuple[Stream, State]:
    """An open stream without a reference yet, and a STATE in it. Raises Unsupported when it cannot be."""
    streamless(peer, period_ms)
    enabled(peer)
    return opened_stream(peer), reach(peer, GroupState.MOVING, "after START_STREAM")


@case(541, "12.1", "streaming that was not negotiated: NOT_NEGOTIATED", needs=OptionalPart.STREAMING)
def not_negotiated(peer: Peer) -> None:
    streamless(peer)
    peer.reopen(capabilities=CAPABILITY_PATHS, period_ms=20)
    here = peer.state().X_BT
    require_reason(peer, CommandCode.START_STREAM, Reason.NOT_NEGOTIATED, "a session without the capability")
    require_reason(peer, CommandCode.END_STREAM, Reason.NOT_NEGOTIATED, "a session without the capability")
    Stream(peer, peer.new_id()).refused(here, Reason.NOT_NEGOTIATED, "a streamed reference")


@case(
    543,
    "12.4",
    "the group's state is judged before the content of a streamed reference",
    needs=OptionalPart.STREAMING,
)
def state_first(peer: Peer) -> None:
    streamless(peer)
    nan = Pose((math.nan, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    Stream(peer, peer.new_id()).refused(nan, Reason.DISABLED, "NaN in DISABLED")


@stream_case(544, "12.2", "START_STREAM in STANDBY: MOVING with the flag, named by its id, and at rest")
def starts(peer: Peer) -> None:
    stream, state = opened(peer)
    require(bool(state.flags & FLAG_STREAMING), "the flag STREAMING is not set")
    require_shown(state, "at the start", motion_id=stream.stream_id, motion_done=False)
    peer.collect(200)
    later = peer.state()
    require(later.X_BT_cmd == state.X_BT_cmd, "the commanded pose moves without a reference")


@stream_case(550, "12.3", "what is followed is not acknowledged; STATE names the newest")
def not_acknowledged(peer: Peer) -> None:
    stream, state = opened(peer)
    peer.passed_over.clear()
    states = stream.feed(state.X_BT_cmd, 400.0)
    require(len(states) > 2, "no STATE while references came")
    require(states[-1].stream_number > states[0].stream_number, "stream_number stands still")
    require(states[-1].stream_number < stream.number, "stream_number is ahead of what was sent")
    answers = [d for d in peer.passed_over if isinstance(d.message, Acknowledgement)]
    require(not answers, "a streamed reference was acknowledged")


@stream_case(551, "12.7", "the commanded pose goes to the reference without a step and rests there")
def follows(peer: Peer) -> None:
    stream, state = opened(peer)
    goal = moved(state.X_BT_cmd, dz=STEP_M)
    states = stream.feed(goal, 2500.0)
    steps = [math.dist(a.X_BT_cmd.p_m, b.X_BT_cmd.p_m) for a, b in pairwise(states)]
    require(max(steps) < STEP_M, f"the commanded pose jumped by {max(steps) * 1e3:.1f} mm")
    require_near(states[-1].X_BT_cmd, goal, 1e-6, "the commanded pose, from the reference")
    require_shown(states[-1], "in an open stream", group_state=GroupState.MOVING, motion_done=False)
    stream.feed(state.X_BT_cmd, 2500.0)


@stream_case(553, "12.4", "references that are refused do not keep a stream alive")
def refused_is_silence(peer: Peer) -> None:
    stream, state = opened(peer)
    stream.feed(state.X_BT_cmd, 200.0)
    nan = Pose((math.nan, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    for _ in peer.within(1000):
        stream.give(nan)
        peer.collect(FEED_MS)
    seen = peer.state()
    require(seen.fault is FaultCode.REFERENCE_STALE, f"fault {seen.fault.name} after a second of NaN")


@stream_case(554, "12.9", "after silence nothing resumes: not by references, not by RESET and ENABLE")
def no_resume(peer: Peer) -> None:
    stream, state = opened(peer)
    stream.feed(moved(state.X_BT_cmd, dz=STEP_M), 300.0)
    state = reach(peer, GroupState.ERROR_STOP, "after silence", 2000)
    ahead = moved(state.X_BT_cmd, dz=STEP_M)
    stream.refused(ahead, Reason.ERROR_LATCHED, "a reference after the stop")
    require_reason(peer, CommandCode.START_STREAM, Reason.ERROR_LATCHED, "error")
    require_reason(peer, CommandCode.RESET, Reason.ACCEPTED, "error")
    stream.refused(ahead, Reason.DISABLED, "a reference after RESET")
    require_reason(peer, CommandCode.ENABLE, Reason.ACCEPTED, "DISABLED")
    stream.refused(ahead, Reason.NOT_STREAMING, "a reference after ENABLE")
    require_reason(peer, CommandCode.START_STREAM, Reason.ACCEPTED, "STANDBY")
    stream.refused(ahead, Reason.NOT_STREAMING, "a reference of the old stream in a new one")
    drift = math.dist(peer.state().X_BT.p_m, state.X_BT.p_m)
    require(drift < DRIFT_M, f"the arm went on by {drift * 1e3:.1f} mm")


@stream_case(555, "12.10", "END_STREAM leads to the newest reference, and the motion is done there")
def ends(peer: Peer) -> None:
    stream, state = opened(peer)
    goal = moved(state.X_BT_cmd, dz=STEP_M)
    stream.feed(goal, 300.0)
    require_reason(peer, CommandCode.END_STREAM, Reason.ACCEPTED, "a stream")
    stream.refused(state.X_BT_cmd, Reason.NOT_STREAMING, "a reference after END_STREAM")
    for seen in peer.states(20_000):
        if seen.motion_done:
            break
        require(not seen.flags & FLAG_STREAMING, "the flag STREAMING is still set")
    require_shown(seen, "within 20 s", motion_done=True, motion_id=stream.stream_id)
    require_near(seen.X_BT_cmd, goal, 1e-6, "the commanded pose, from the reference")


@stream_case(556, "12.2", "a stream closes with its session")
def closes(peer: Peer) -> None:
    stream, state = opened(peer)
    stream.feed(moved(state.X_BT_cmd, dz=STEP_M), 200.0)
    peer.reopen(period_ms=20, capabilities=BOTH)
    stream.give(state.X_BT_cmd)
    got = peer.expect(StreamRefused, "a reference of a stream of another session", ANSWER_MS)
    closed = (Reason.NOT_STREAMING, Reason.ERROR_LATCHED, Reason.DISABLED)
    require(got.reason in closed, f"a stream of another session: {got.reason.name}")
    peer.collect(300)
    seen = peer.state()
    require(not any(seen.valves), f"valves {seen.valves}")
    require(seen.group_state is not GroupState.MOVING, "the arm still follows the stream")
