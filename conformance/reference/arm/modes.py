"""How each mode of the axes group is reached (7.3), and how a client tells that it is in one.

Modes that STATE shows alike are told apart by what they answer to a request that changes nothing.
"""

from collections.abc import Callable
from typing import NamedTuple

from conformance.parts import OptionalPart
from conformance.peer import Peer
from conformance.reference.group import disabled, expect_reason, reach, wanted
from conformance.reference.motion import STEP_M, moved
from conformance.reference.streaming import BOTH, Stream
from conformance.wire import Unsupported, require
from protocol.axes_group import GROUP_STATE, Mode
from protocol.faults import CommandCode, GroupState, Reason
from protocol.pose import Pose
from protocol.reference_messages import (
    FLAG_EMERGENCY_LATCHED,
    FLAG_STREAMING,
    Command,
    ReferencePose,
    State,
)

# The arm is to be well on its way, so that a ramp takes a while: a client's question takes less.
UNDER_WAY_MS = 60.0
MOTION_S = 1.5


class ReachedMode(NamedTuple):
    """A mode that was reached: where the arm stood then, where it is sent, and the stream that is open."""

    here: Pose
    goal: Pose
    stream: Stream | None = None


def entered(peer: Peer, mode: Mode) -> ReachedMode:
    """A session with STATE in every scan, and the group in ``mode``. Raises Unsupported when it cannot be."""
    disabled(peer, capabilities=BOTH, period_ms=0)
    return _WAYS[mode](peer)


def _here(peer: Peer) -> ReachedMode:
    here = peer.state().X_BT_cmd
    return ReachedMode(here, moved(here, dz=STEP_M))


def _standby(peer: Peer) -> ReachedMode:
    reason = peer.command(CommandCode.ENABLE)
    if reason is not Reason.ACCEPTED:
        raise Unsupported(f"ENABLE was refused: {reason.name}", OptionalPart.MOTION)
    here = reach(peer, GroupState.STANDBY, "after ENABLE").X_BT_cmd
    return ReachedMode(here, moved(here, dz=STEP_M))


def _moving(peer: Peer) -> ReachedMode:
    scene = _standby(peer)
    answer = peer.ask(ReferencePose(peer.new_id(), scene.goal, MOTION_S), "a motion of 20 mm")
    expect_reason(answer, Reason.ACCEPTED, "a motion of 20 mm")
    peer.collect(UNDER_WAY_MS)
    return scene


def opened_stream(peer: Peer) -> Stream:
    """A new stream, in STANDBY. Raises Unsupported when streaming is not granted."""
    assert peer.welcome is not None
    if peer.welcome.capabilities & BOTH != BOTH:
        raise Unsupported("STREAMING is not granted", OptionalPart.STREAMING)
    request = Command(peer.new_id(), CommandCode.START_STREAM)
    expect_reason(peer.ask(request, "START_STREAM"), Reason.ACCEPTED, "START_STREAM in STANDBY")
    return Stream(peer, request.command_id)


def _streaming(peer: Peer) -> ReachedMode:
    scene = _standby(peer)
    stream = opened_stream(peer)
    stream.feed(scene.goal, UNDER_WAY_MS)
    return scene._replace(stream=stream)


def _after(way: Callable[[Peer], ReachedMode], *codes: CommandCode) -> Callable[[Peer], ReachedMode]:
    def enter(peer: Peer) -> ReachedMode:
        scene = way(peer)
        for code in codes:
            wanted(peer, code, Reason.ACCEPTED, "the way there")
        return scene

    return enter


def _error_ramp(peer: Peer) -> ReachedMode:
    """The session of a motion ends, which is a loss of its link (7.5); the next one finds the ramp."""
    scene = _moving(peer)
    peer.leave()
    peer.open(capabilities=BOTH, period_ms=0)
    return scene


_WAYS: dict[Mode, Callable[[Peer], ReachedMode]] = {
    Mode.DISABLED: _here,
    Mode.STANDBY: _standby,
    Mode.MOVING: _moving,
    Mode.STREAMING: _streaming,
    Mode.STOPPING: _after(_moving, CommandCode.STOP),
    Mode.DISABLING: _after(_moving, CommandCode.DISABLE),
    Mode.ERROR_RAMP: _error_ramp,
    Mode.ERROR_HELD: _after(_here, CommandCode.EMERGENCY_STOP, CommandCode.EMERGENCY_RELEASE),
    Mode.EMERGENCY: _after(_here, CommandCode.EMERGENCY_STOP),
}

# What only one of two modes that look alike in STATE answers.
_TOLD_BY = {
    Mode.STOPPING: (CommandCode.ENABLE, Reason.ALREADY_DONE),
    Mode.DISABLING: (CommandCode.ENABLE, Reason.STOPPING),
    Mode.ERROR_RAMP: (CommandCode.RESET, Reason.STOPPING),
    Mode.ERROR_HELD: (CommandCode.DISABLE, Reason.ALREADY_DONE),
}


def shown(state: State, mode: Mode) -> bool:
    """Whether ``state`` may be one of ``mode``."""
    flags = bool(state.flags & FLAG_EMERGENCY_LATCHED), bool(state.flags & FLAG_STREAMING)
    wanted_flags = mode is Mode.EMERGENCY, mode is Mode.STREAMING
    if state.group_state is not GROUP_STATE[mode] or flags != wanted_flags:
        return False
    held = mode in (Mode.ERROR_HELD, Mode.EMERGENCY, Mode.DISABLED)
    return not (held and any(state.valves))


def require_mode(peer: Peer, mode: Mode, what: str) -> None:
    """Raises Failed unless the group is in ``mode``: by STATE, and by an answer where STATE is not enough."""
    state = peer.state()
    require(
        shown(state, mode),
        f"{what}: STATE shows {state.group_state.name}, flags {state.flags:#x}, not {mode.name}",
    )
    if mode in _TOLD_BY:
        code, reason = _TOLD_BY[mode]
        got = peer.command(code)
        require(got is reason, f"{what}: not in {mode.name}, where {code.name} is {reason.name}: {got.name}")


def is_ramping(state: State) -> bool:
    """Whether ``state`` is one of an error's ramp that goes on: its valves are still driven."""
    return state.group_state is GroupState.ERROR_STOP and any(state.valves)
