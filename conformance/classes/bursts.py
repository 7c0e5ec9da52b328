"""Cases of several datagrams at once: each has its one answer, as 6.2 to 6.14 say, whatever its kind."""

from collections.abc import Iterator
from functools import partial
from itertools import pairwise, product
from typing import NamedTuple

from conformance.case import case
from conformance.parts import OptionalPart
from conformance.peer import Peer
from conformance.reference.handshake import granted
from conformance.reference.motion import STEP_M, disabled, enabled, moved
from conformance.reference.streaming import BOTH
from conformance.wire import Unsupported, require
from protocol.axes_group import ANSWERS, GroupRequest, Mode
from protocol.datagram_layout import HEADER_BYTES, MAX_WAYPOINTS, Kind
from protocol.faults import CommandCode, Reason
from protocol.pose import Pose
from protocol.reference_messages import (
    CAPABILITY_PATHS,
    CAPABILITY_STREAMING,
    FLAG_EMERGENCY_LATCHED,
    Acknowledgement,
    Bye,
    Command,
    Heartbeat,
    HeartbeatReply,
    Message,
    ReferencePath,
    ReferencePose,
    Request,
    StreamedPose,
    StreamRefused,
)

STOPS = (GroupRequest.STOP, GroupRequest.DISABLE, GroupRequest.EMERGENCY_STOP)
AT_REST = (Mode.DISABLED, Mode.ERROR_HELD, Mode.EMERGENCY, Mode.STANDBY)
_DONE = (Reason.ACCEPTED, Reason.ALREADY_DONE)
_TO_DISABLED = (CommandCode.EMERGENCY_STOP, CommandCode.EMERGENCY_RELEASE, CommandCode.RESET)
_FROM_DISABLED: dict[Mode, tuple[CommandCode, ...]] = {
    Mode.DISABLED: (),
    Mode.STANDBY: (CommandCode.ENABLE,),
    Mode.ERROR_HELD: (CommandCode.EMERGENCY_STOP, CommandCode.EMERGENCY_RELEASE),
    Mode.EMERGENCY: (CommandCode.EMERGENCY_STOP,),
}
CODE = HEADER_BYTES + 8
UNKNOWN = 99
# A scan may begin between two of a burst; not between those of each burst.
TRIES = 4


class Way(NamedTuple):
    """A request in a burst; ``request_kind``: of the group; ``refused``: why, before it waits (6.6).

    A refused one may also be judged behind what waits: then a stop overtakes it (6.13).
    """

    name: str
    request_kind: GroupRequest | None
    refused: Reason | None = None


_COMMANDS = [Way(code.name, GroupRequest(code)) for code in CommandCode]
WAYS = (
    *_COMMANDS,
    Way("a pose", GroupRequest.MOVE),
    Way("a path", GroupRequest.MOVE),
    Way("a pose of NaN", GroupRequest.MOVE),
    Way("an unknown command", None, Reason.UNKNOWN_COMMAND),
    Way("no path", None, Reason.EMPTY_PATH),
    Way("too long a path", None, Reason.TOO_MANY_WAYPOINTS),
)


def _request(peer: Peer, way: Way, here: Pose) -> tuple[Request, bytes]:
    """The request, to a place that it does not reach within a burst, and its datagram."""
    number, goal = peer.new_id(), moved(here, dz=STEP_M)
    if way.name == "a pose of NaN":
        goal = goal._replace(p_m=(float("nan"), 1e3, 1e3))
    request: Request = ReferencePath(number, (goal,), 5.0, 0.0)
    if "pose" in way.name:
        request = ReferencePose(number, goal, 5.0)
    elif "path" not in way.name:
        request = Command(number, CommandCode(way.request_kind or CommandCode.STOP))
    data, counts = peer.encoded(request), {Reason.EMPTY_PATH: 0, Reason.TOO_MANY_WAYPOINTS: MAX_WAYPOINTS + 1}
    if way.refused is not None:
        data = peer.with_number(data, CODE, "I", counts.get(way.refused, UNKNOWN))
    return request, data


def _alone(mode: Mode, way: Way) -> tuple[Reason, Mode]:
    """What answers it in ``mode``, and where it leads."""
    if way.refused is not None or way.request_kind is None:
        return way.refused or Reason.ACCEPTED, mode
    step = ANSWERS[mode, way.request_kind]
    odd = way.name == "a pose of NaN" and step.reason is Reason.ACCEPTED
    return (Reason.NOT_FINITE, mode) if odd else (step.reason, step.mode)


def allowed(mode: Mode, ways: tuple[Way, ...], *, parted: bool = True) -> Iterator[tuple[Reason, ...]]:
    """The answers that ``ways`` may have, wherever the beginning of a scan parts them; or if none does."""
    for parts in product((False, True) if parted else (False,), repeat=len(ways) - 1):
        begins = [0, *(n for n, part in enumerate(parts, 1) if part), len(ways)]
        scans = [range(a, b) for a, b in pairwise(begins)]
        for late in (False, True):  # what is refused before it waits may be refused when it is judged
            now = mode
            answers: dict[int, Reason] = {}
            for scan in scans:
                now = _judge(now, scan, ways, answers, late=late)
            yield tuple(answers[n] for n in range(len(ways)))


def _judge(mode: Mode, scan: range, ways: tuple[Way, ...], answers: dict[int, Reason], *, late: bool) -> Mode:
    last_stop = max((n for n in scan if ways[n].request_kind in STOPS), default=-1)
    newest = max((n for n in scan if ways[n].request_kind is GroupRequest.MOVE), default=-1)
    for n in scan:
        way = ways[n]
        gone = n < last_stop and way.request_kind not in STOPS and (late or way.refused is None)
        if gone or (way.request_kind is GroupRequest.MOVE and n < newest):
            answers[n] = Reason.OVERTAKEN
        else:
            answers[n], mode = _alone(mode, way)
    return mode


def to_mode(peer: Peer, mode: Mode) -> None:
    """From wherever the group is, by commands that move nothing; STANDBY only with an ENABLE."""
    for code in (*_TO_DISABLED, *_FROM_DISABLED[mode]):
        reason = peer.command(code)
        if code is CommandCode.ENABLE and reason is Reason.PLANT_NOT_READY:
            raise Unsupported(f"ENABLE was refused: {reason.name}", OptionalPart.MOTION)
        require(reason in _DONE, f"{code.name} on the way to {mode.name}: {reason.name}")


def judge_burst(peer: Peer, mode: Mode, ways: tuple[Way, ...], here: Pose) -> bool:
    """Whether ``ways``, sent at once, were judged in one scan. Failed unless each has its one answer."""
    to_mode(peer, mode)
    made = [_request(peer, way, here) for way in ways]
    for _, data in made:
        peer.send_raw(data)
    requests = [request for request, _ in made]
    answers = peer.gather(Acknowledgement, len(requests))
    got = tuple(a.reason for r in requests for a in answers if a.command_id == r.command_id)
    note = f"{' and '.join(way.name for way in ways)} in {mode.name}: {', '.join(r.name for r in got)}"
    require(len(answers) == len(ways) and got in set(allowed(mode, ways)), note)
    for answer in answers:
        ids = [float(r.command_id) for r in requests if r.command_id > answer.command_id]
        own = answer.value == float(answer.command_id) and answer.limit in ids
        require(answer.reason is not Reason.OVERTAKEN or own, f"{note}: {answer}")
        empty = answer.value == answer.limit == 0.0
        require(answer.reason >= Reason.NOT_FINITE or empty, f"{note}: {answer}")
    return got in set(allowed(mode, ways, parted=False))


def bursts(mode: Mode) -> Iterator[tuple[Way, ...]]:
    """Every pair; a few requests on either side of each stop; and each request alone."""
    yield from ((way,) for way in WAYS)
    yield from product(WAYS, repeat=2)
    stop, pose, unknown = WAYS[2], WAYS[8], WAYS[11]
    for way in _COMMANDS:
        yield from ((pose, way, pose), (way, pose, stop), (unknown, way, pose), (pose, stop, way))
        if way.request_kind in STOPS:
            yield (way, way, way)


def at_once(mode: Mode, peer: Peer) -> None:
    disabled(peer, capabilities=BOTH)
    if peer.welcome.capabilities & BOTH != BOTH:
        raise Unsupported("paths or streams are not granted", OptionalPart.STREAMING)
    here = enabled(peer).X_BT_cmd if mode is Mode.STANDBY else peer.state().X_BT
    for ways in bursts(mode):
        moves = mode is Mode.STANDBY or all(way.request_kind is not GroupRequest.ENABLE for way in ways)
        if moves or mode is Mode.EMERGENCY:
            in_one_scan = any(judge_burst(peer, mode, ways, here) for _ in range(TRIES))
            names = " and ".join(way.name for way in ways)
            require(in_one_scan, f"{names} in {mode.name}: none overtakes another")
    to_mode(peer, Mode.DISABLED)


for _number, _clause, _mode in zip(
    (424, 425, 427, 426), ("6.6", "6.10", "6.11", "6.13"), AT_REST, strict=True
):
    case(
        _number,
        _clause,
        f"of requests that come at once in {_mode.name} each is judged, in its order, or overtaken",
        motion=_mode is Mode.STANDBY,
        needs=OptionalPart.PATHS,
    )(partial(at_once, _mode))


@case(435, "6.10", "without a capability what needs it is refused, and overtakes nothing")
def not_negotiated(peer: Peer) -> None:
    disabled(peer, capabilities=0)
    here = peer.state().X_BT
    pose, path = WAYS[8], Way("a path", None, Reason.NOT_NEGOTIATED)
    for ways in ((pose, path), (path, pose), (path, path)):
        made = [ReferencePose(peer.new_id(), here, 0.0) if way is pose
                else ReferencePath(peer.new_id(), (here,), 0.0, 0.0) for way in ways]  # fmt: skip
        peer.send_at_once(made)
        got = [answer.reason for answer in sorted(peer.gather(Acknowledgement, len(made)))]
        wanted = [Reason.DISABLED if way is pose else Reason.NOT_NEGOTIATED for way in ways]
        require(got == wanted, f"{[way.name for way in ways]}: {[reason.name for reason in got]}")


@case(423, "6.12", "EMERGENCY_STOP is judged though its session ends in the same scan, by BYE or a restart")
def stop_and_end(peer: Peer) -> None:
    for end in ("BYE", "restart", "BYE", "restart"):
        disabled(peer)
        data = peer.encoded(Command(peer.new_id(), CommandCode.EMERGENCY_STOP))
        session = peer.session if end == "BYE" else granted(peer)
        last: Message = Bye(Reason.SHUTDOWN) if end == "BYE" else Heartbeat(peer.now_ns)
        for each in (data, peer.encoded(last, session=session)):
            peer.send_raw(each)
        peer.open(period_ms=20)
        latched = bool(peer.state().flags & FLAG_EMERGENCY_LATCHED)
        require(latched, f"EMERGENCY_STOP was forgotten at {end}")


def _use(message: object) -> object:
    """What tells which datagram was answered."""
    if isinstance(message, HeartbeatReply):
        return message.sent_ns
    return getattr(message, "command_id", getattr(message, "number", None))


def _new(peer: Peer, kind: Kind, here: Pose) -> tuple[Message, object]:
    """A message of ``kind`` that is answered, and what tells its answer."""
    number = peer.new_id()
    made: dict[Kind, Message] = {
        Kind.HEARTBEAT: Heartbeat(number), Kind.COMMAND: Command(number, CommandCode.RESET),
        Kind.REFERENCE_POSE: ReferencePose(number, here, 0.0),
        Kind.REFERENCE_PATH: ReferencePath(number, (here,), 0.0, 0.0),
        Kind.STREAMED_POSE: StreamedPose(number, number % 2**32, peer.now_ns, here),
    }  # fmt: skip
    return made[kind], number % 2**32 if kind is Kind.STREAMED_POSE else number


@case(401, "6.2", "of every two and three kinds in one read each is answered once, also if it came twice")
def kinds_at_once(peer: Peer) -> None:
    disabled(peer, capabilities=BOTH)
    peer.open(capabilities=BOTH)  # a restart in place, that is a session as any other
    can, here = peer.welcome.capabilities, peer.state().X_BT
    kinds = [Kind.HEARTBEAT, Kind.COMMAND, Kind.REFERENCE_POSE]
    kinds += [Kind.REFERENCE_PATH] if can & CAPABILITY_PATHS else []
    kinds += [Kind.STREAMED_POSE] if can & CAPABILITY_STREAMING else []
    for burst in (*product(kinds, repeat=2), *((kind,) * 3 for kind in kinds), (*kinds, *kinds)):
        made = [_new(peer, kind, here) for kind in burst]
        peer.drain()
        several = peer.send_at_once(message for message, _ in made)
        for data in (several[-1], several[0]):  # duplicates (5.2)
            peer.send_raw(data)
        wanted = {use for message, use in made if not isinstance(message, StreamedPose)}
        got = peer.gather(
            Acknowledgement | HeartbeatReply | StreamRefused,
            len(wanted),
            peer.grace_ms,
            after_ms=peer.grace_ms,
            beating=False,
        )
        came = [_use(message) for message in got]
        streamed = {use for message, use in made if isinstance(message, StreamedPose)}
        names = " and ".join(kind.name for kind in burst)
        require(wanted <= set(came), f"{names} at once: {len(wanted - set(came))} not answered")
        require(len(came) == len(set(came)), f"{names} at once: one was answered twice")
        require(not streamed or bool(streamed & set(came)), f"{names} at once: no STREAM_REFUSED")
        require(set(came) <= wanted | streamed, f"{names} at once: {set(came) - wanted - streamed} came")
