"""Cases 800…889: every request in every mode, generated from the table of 7.3: 800 + 10 · row + column."""

from conformance.case import reference
from conformance.parts import OptionalPart
from conformance.peer import Peer
from conformance.reference.arm.modes import ReachedMode, entered, is_ramping, require_mode
from conformance.reference.streaming import Stream
from conformance.wire import ANSWER_MS, MS, Failed, Unsupported, require
from protocol.axes_group import ANSWERS, Asked, Mode, Transition
from protocol.faults import CommandCode, Reason
from protocol.reference_messages import CAPABILITY_STREAMING, ReferencePose, State, StreamRefused

case = reference.case
FIRST = 800
COLUMNS = tuple(Asked)
_OF_STREAMS = (Asked.START_STREAM, Asked.END_STREAM, Asked.STREAMED)
_STILL = (Mode.DISABLED, Mode.ERROR_HELD, Mode.EMERGENCY)
# An error's ramp may be over before the question comes; then it is asked again.
_TRIES = 4
_TITLES = {Asked.MOVE: "a reference", Asked.STREAMED: "a streamed reference"}


def number_of(mode: Mode, asked: Asked) -> int:
    """The case that asks for a cell."""
    return FIRST + 10 * mode + COLUMNS.index(asked)


def title_of(mode: Mode, asked: Asked) -> str:
    """What the case asks."""
    step = ANSWERS[mode, asked]
    leads = "" if step.mode is mode else f" and {step.mode.name}"
    return f"{_TITLES.get(asked, asked.name)} in {mode.name}: {step.reason.name}{leads}"


def answered(peer: Peer, asked: Asked, scene: ReachedMode) -> Reason:
    """The reason that answers; for a streamed reference that is followed, ACCEPTED."""
    if asked is Asked.STREAMED:
        return _streamed(peer, scene)
    if asked is Asked.MOVE:
        return peer.ask(ReferencePose(peer.new_id(), scene.goal, 3.0), "a reference").reason
    return peer.command(CommandCode(asked))


def _streamed(peer: Peer, scene: ReachedMode) -> Reason:
    stream = scene.stream or Stream(peer, peer.new_id())
    number = stream.number
    stream.give(scene.goal)
    until_ns = peer.now_ns + ANSWER_MS * MS
    while peer.now_ns < until_ns:
        datagram = peer.receive(ANSWER_MS)
        message = datagram.message if datagram else None
        if isinstance(message, StreamRefused) and message.number == number:
            return message.reason
        if isinstance(message, State) and scene.stream is not None and message.stream_number == number:
            return Reason.ACCEPTED
    raise Failed("a streamed reference is neither followed nor refused")


def ask_cell(peer: Peer, mode: Mode, asked: Asked, step: Transition) -> None:
    """Asks once; raises Failed unless the answer and the next mode are those of ``step``."""
    scene = entered(peer, mode)
    assert peer.welcome is not None
    if asked in _OF_STREAMS and not peer.welcome.capabilities & CAPABILITY_STREAMING:
        raise Unsupported("STREAMING is not granted", OptionalPart.STREAMING)
    if mode is Mode.ERROR_RAMP and not is_ramping(peer.state()):
        raise _Over
    what = title_of(mode, asked)
    reason = answered(peer, asked, scene)
    if asked is Asked.ENABLE and step.reason is Reason.ACCEPTED and reason is Reason.PLANT_NOT_READY:
        raise Unsupported(f"ENABLE was refused: {reason.name}", OptionalPart.MOTION)
    require(reason is step.reason, f"{what}: answered {reason.name}")
    require_mode(peer, step.mode, what)


class _Over(Exception):
    """The ramp was over before it could be asked in."""


def _ask_in_a_ramp(peer: Peer, asked: Asked, step: Transition) -> None:
    """As ``ask_cell``, but asked again when the ramp may have ended between the question and the answer."""
    last: Exception = Unsupported("an error's ramp is over before a client can ask in it")
    for _ in range(_TRIES):
        try:
            ask_cell(peer, Mode.ERROR_RAMP, asked, step)
        except _Over:
            continue
        except Failed as failure:
            last = failure
        else:
            return
    raise last


def _enter(mode: Mode, asked: Asked, step: Transition) -> None:
    def run(peer: Peer) -> None:
        if mode is Mode.ERROR_RAMP:
            _ask_in_a_ramp(peer, asked, step)
        else:
            ask_cell(peer, mode, asked, step)

    motion = mode not in _STILL or step.mode not in _STILL
    streams = asked in _OF_STREAMS or mode is Mode.STREAMING
    needs = OptionalPart.STREAMING if streams else None
    case(number_of(mode, asked), "7.3", title_of(mode, asked), motion=motion, needs=needs)(run)


for _cell, _step in ANSWERS.items():
    _enter(*_cell, _step)
