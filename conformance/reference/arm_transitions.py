"""How each mode of the axes group is reached (7.3), and how a client tells that it is in one.

Modes that STATE shows alike are told apart by what they answer to a request that changes nothing.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from conformance.case import case
from conformance.parts import OptionalPart
from conformance.peer import Peer
from conformance.reference.motion import STEP_M, accepted, disabled, enabled, moved, require_reason
from conformance.reference.streaming import BOTH, Stream, opened_stream
from conformance.wire import Failed, Unsupported, require
from protocol.axes_group import ANSWERS, GROUP_STATE, GroupRequest, Mode, Transition
from protocol.faults import CommandCode, GroupState, Reason
from protocol.pose import Pose
from protocol.reference_messages import (
    CAPABILITY_STREAMING,
    FLAG_EMERGENCY_LATCHED,
    FLAG_STREAMING,
    ReferencePose,
    State,
)

# The arm is to be well on its way, so that a ramp takes a while: a client's question takes less.
UNDER_WAY_MS = 60.0
MOTION_S = 1.5


class ReachedMode(NamedTuple):
    """A mode that was reached: where the arm stood, where it is sent, and a stream (open in STREAMING)."""

    here: Pose
    goal: Pose
    stream: Stream


def entered(peer: Peer, mode: Mode) -> ReachedMode:
    """A session with STATE in every scan, and the group in ``mode``. Raises Unsupported when it cannot be."""
    disabled(peer, capabilities=BOTH, period_ms=0)
    return _WAYS[mode](peer)


def _here(peer: Peer) -> ReachedMode:
    here = peer.state().X_BT_cmd
    return ReachedMode(here, moved(here, dz=STEP_M), Stream(peer, peer.new_id()))


def _standby(peer: Peer) -> ReachedMode:
    enabled(peer)
    return _here(peer)


def _moving(peer: Peer) -> ReachedMode:
    scene = _standby(peer)
    accepted(peer, ReferencePose(peer.new_id(), scene.goal, MOTION_S), "a motion of 20 mm")
    peer.collect(UNDER_WAY_MS)
    return scene


def _streaming(peer: Peer) -> ReachedMode:
    scene = _standby(peer)
    stream = opened_stream(peer)
    stream.feed(scene.goal, UNDER_WAY_MS)
    return scene._replace(stream=stream)


def _after(way: Callable[[Peer], ReachedMode], *codes: CommandCode) -> Callable[[Peer], ReachedMode]:
    def enter(peer: Peer) -> ReachedMode:
        scene = way(peer)
        for code in codes:
            require_reason(peer, code, Reason.ACCEPTED, "the way there")
        return scene

    return enter


def _error_ramp(peer: Peer) -> ReachedMode:
    """The session of a motion ends, which is a loss of its link (7.5); the next one finds the ramp."""
    scene = _moving(peer)
    peer.reopen(capabilities=BOTH, period_ms=0)
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
_SHOWN_BY = {
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


def require_mode(peer: Peer, mode: Mode, what: str) -> State:
    """A STATE of ``mode``; raises Failed unless the group is in it, by an answer if STATE is not enough."""
    state = peer.state()
    require(
        shown(state, mode),
        f"{what}: STATE shows {state.group_state.name}, flags {state.flags:#x}, not {mode.name}",
    )
    if mode in _SHOWN_BY:
        code, reason = _SHOWN_BY[mode]
        got = peer.command(code)
        require(got is reason, f"{what}: not in {mode.name}, where {code.name} is {reason.name}: {got.name}")
    return state


def is_ramping(state: State) -> bool:
    """Whether ``state`` is one of an error's ramp that goes on: its valves are still driven."""
    return state.group_state is GroupState.ERROR_STOP and any(state.valves)


FIRST = 800
COLUMNS = tuple(GroupRequest)
_OF_STREAMS = (GroupRequest.START_STREAM, GroupRequest.END_STREAM, GroupRequest.STREAMED)
_STILL = (Mode.DISABLED, Mode.ERROR_HELD, Mode.EMERGENCY)
# An error's ramp may be over before the question comes; then it is asked again.
_TRIES = 4
_TITLES = {GroupRequest.MOVE: "a reference", GroupRequest.STREAMED: "a streamed reference"}


def number_of(mode: Mode, request: GroupRequest) -> int:
    """The case that asks for a cell."""
    return FIRST + 10 * mode + COLUMNS.index(request)


def title_of(mode: Mode, request: GroupRequest) -> str:
    """What the case asks."""
    step = ANSWERS[mode, request]
    leads = "" if step.mode is mode else f" and {step.mode.name}"
    return f"{_TITLES.get(request, request.name)} in {mode.name}: {step.reason.name}{leads}"


def answered(peer: Peer, mode: Mode, request: GroupRequest, scene: ReachedMode) -> Reason:
    """The reason that answers; for a streamed reference that is followed, ACCEPTED."""
    if request is GroupRequest.STREAMED:
        refused = scene.stream.verdict(scene.goal, shown=mode is Mode.STREAMING)
        return Reason.ACCEPTED if refused is None else refused.reason
    if request is GroupRequest.MOVE:
        return peer.ask(ReferencePose(peer.new_id(), scene.goal, 3.0), "a reference").reason
    return peer.command(CommandCode(request))


def ask_cell(peer: Peer, mode: Mode, request: GroupRequest, step: Transition) -> None:
    """Asks once; raises Failed unless the answer and the next mode are those of ``step``."""
    scene = entered(peer, mode)
    if request in _OF_STREAMS and not peer.welcome.capabilities & CAPABILITY_STREAMING:
        raise Unsupported("STREAMING is not granted", OptionalPart.STREAMING)
    before = peer.state()
    if mode is Mode.ERROR_RAMP and not is_ramping(before):
        raise _Over
    what = title_of(mode, request)
    reason = answered(peer, mode, request, scene)
    if request is GroupRequest.ENABLE and step.reason is Reason.ACCEPTED and reason is Reason.PLANT_NOT_READY:
        raise Unsupported(f"ENABLE was refused: {reason.name}", OptionalPart.MOTION)
    require(reason is step.reason, f"{what}: answered {reason.name}")
    after = require_mode(peer, step.mode, what)
    if reason is not Reason.ACCEPTED:
        shown = [(s.motion_id, s.fault, s.severity) for s in (before, after)]
        require(shown[0] == shown[1], f"{what}: motion_id, fault, severity were {shown[0]}, are {shown[1]}")


class _Over(Exception):
    """The ramp was over before it could be asked in."""


def ask(mode: Mode, request: GroupRequest, step: Transition, peer: Peer) -> None:
    """As ``ask_cell``; again where an error's ramp may have ended between the question and the answer."""
    last: Exception = Unsupported("an error's ramp is over before a client can ask in it")
    for _ in range(_TRIES if mode is Mode.ERROR_RAMP else 1):
        try:
            return ask_cell(peer, mode, request, step)
        except _Over:
            continue
        except Failed as failure:
            last = failure
    raise last


for (_mode, _request), _step in ANSWERS.items():
    case(
        number_of(_mode, _request),
        "7.3",
        title_of(_mode, _request),
        motion=_mode not in _STILL or _step.mode not in _STILL,
        needs=OptionalPart.STREAMING if _request in _OF_STREAMS or _mode is Mode.STREAMING else None,
    )(partial(ask, _mode, _request, _step))
