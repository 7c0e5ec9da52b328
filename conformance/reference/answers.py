"""Cases 430…: what a request means, and what its one answer says (clauses 1.5, 3.6, 3.7 and 6)."""

import math
from collections.abc import Iterator

from conformance.case import reference
from conformance.parts import OptionalPart
from conformance.peer import Peer
from conformance.reference.framing import stop
from conformance.reference.handshake import granted, require_begun
from conformance.reference.motion import (
    STEP_M,
    disabled,
    expect_reason,
    moved,
    reach,
    reference_reason,
    scaled,
    standby,
)
from conformance.wire import MS, require
from protocol.datagram_layout import HEADER_BYTES, MAX_WAYPOINTS, PAYLOADS, Kind, offsets
from protocol.faults import CommandCode, GroupState, Reason
from protocol.pose import IDENTITY, Pose
from protocol.reference_messages import (
    CAPABILITY_PATHS,
    Acknowledgement,
    Command,
    ReferencePath,
    ReferencePose,
    Request,
)

case = reference.case
COUNT = HEADER_BYTES + 8
SUBNORMAL = 5e-324
ODD = (math.nan, math.inf, -math.inf, SUBNORMAL, -1e-310)
WAITING = 64
# A commanded place counts as reached; and what STATE and a busy tester add to a time.
AT_M = 1e-6
PATH_SLACK_MS = 250


@case(430, "6.2", "in a session that took the place of another a request has exactly one answer")
def once_after_a_restart(peer: Peer) -> None:
    peer.open()
    peer.ask(stop(peer), "the session before")
    require_begun(peer, granted(peer), "the session that takes its place")
    request = stop(peer)
    peer.send(request)
    answers = peer.answers("one request") + peer.answers("one request, later")
    require(answers == [Acknowledgement(request.command_id, Reason.ACCEPTED, 0.0, 0.0)], f"came {answers}")


def path_that_says(peer: Peer, count: int, command_id: int | None = None) -> Acknowledgement:
    """The answer to a path whose count of waypoints says ``count``."""
    points = (IDENTITY,) * min(max(count, 1), MAX_WAYPOINTS)
    path = ReferencePath(command_id or peer.new_id(), points, 0.0, 0.0)
    peer.send_raw(peer.with_number(peer.encoded(path), COUNT, "I", count))
    return peer.answer_to(path.command_id, f"{count} waypoints")


@case(431, "3.6", "paths of 1 and of 24 waypoints can be meant, of 0 and of 25 cannot, and it is said")
def counts_of_waypoints(peer: Peer) -> None:
    peer.open()
    impossible = (Reason.EMPTY_PATH, Reason.TOO_MANY_WAYPOINTS)
    for count in (1, 2, MAX_WAYPOINTS - 1, MAX_WAYPOINTS):
        got = path_that_says(peer, count)
        require(got.reason not in impossible, f"{count} waypoints: {got.reason.name}")
    got = path_that_says(peer, 0)
    require(got[1:] == (Reason.EMPTY_PATH, 0.0, 1.0), f"0 waypoints: {got}")
    for count in (MAX_WAYPOINTS + 1, MAX_WAYPOINTS + 2, 2**31, 2**32 - 1):
        got = path_that_says(peer, count)
        expected = (Reason.TOO_MANY_WAYPOINTS, float(count), float(MAX_WAYPOINTS))
        require(got[1:] == expected, f"{count} waypoints: {got}")


@case(432, "3.6", "the code of an unknown command is its value, its limit 0; codes 0 and 9 are unknown")
def unknown_codes(peer: Peer) -> None:
    peer.open()
    for code in (0, max(CommandCode) + 1, max(CommandCode) + 2, 255, 256, 2**16 + 1, 2**31 + 3):
        request = stop(peer)
        peer.send_raw(peer.with_number(peer.encoded(request), HEADER_BYTES + 8, "I", code))
        got = peer.answer_to(request.command_id, f"command code {code}")
        require(got[1:] == (Reason.UNKNOWN_COMMAND, float(code), 0.0), f"command code {code}: {got}")


def _changed_numbers(kind: Kind) -> Iterator[tuple[str, int, str]]:
    """Every number of a request but its id and padding: its name, offset in the datagram, and type."""
    fields = PAYLOADS[kind]
    for field, offset in zip(fields, offsets(fields), strict=True):
        if field.name not in ("command_id", "padding"):
            # Of many numbers the first and the last.
            for index in {0, field.count - 1}:
                yield (
                    f"{field.name} {index}",
                    HEADER_BYTES + offset + index * field.size // field.count,
                    field.code,
                )


@case(433, "6.5", "an id that comes again with any other number in it: REPEATED_COMMAND_ID")
def any_other_content(peer: Peer) -> None:
    peer.open()
    full = (IDENTITY,) * MAX_WAYPOINTS
    for request in (
        stop(peer),
        ReferencePose(peer.new_id(), IDENTITY, 1.0),
        ReferencePath(peer.new_id(), full, 1.0, 1.0),
    ):
        first = peer.ask(request, "the first time")
        kind = {Command: Kind.COMMAND, ReferencePose: Kind.REFERENCE_POSE}.get(
            type(request), Kind.REFERENCE_PATH
        )
        for name, offset, code in _changed_numbers(kind):
            peer.send_raw(peer.with_number(peer.encoded(request), offset, code, 2))
            got = peer.answer_to(request.command_id, f"{kind.name} again with another {name}")
            require(
                got.reason is Reason.REPEATED_COMMAND_ID, f"{kind.name}, another {name}: {got.reason.name}"
            )
            require(got[2:] == (0.0, 0.0), f"value {got.value:g}, limit {got.limit:g}")
        require(peer.ask(request, "as it was") == first, "the first answer was lost")


@case(434, "6.1", "ids have 64 bits: they are compared whole, up to the greatest")
def long_ids(peer: Peer) -> None:
    peer.open()
    for command_id in (
        2**32 + 5,
        2**33 + 3,
        2**53 + 1,
        2**53 + 2,
        2**63 - 1,
        2**63 + 2,
        2**64 - 2,
        2**64 - 1,
    ):
        got = peer.ask(Command(command_id, CommandCode.STOP), f"id {command_id:#x}")
        require(got.reason is Reason.ACCEPTED, f"id {command_id:#x}: {got.reason.name}")
    got = peer.ask(Command(2**33 + 4, CommandCode.STOP), "an id that was leapt over")
    require(got.reason is Reason.OVERTAKEN, f"an id that was leapt over: {got.reason.name}")


@case(435, "6.10", "a request is judged by its id, by what it cannot mean, then by its capability")
def in_order(peer: Peer) -> None:
    peer.open(capabilities=0)
    before, used = peer.new_id(), stop(peer)
    peer.ask(used, "STOP")
    for count in (0, MAX_WAYPOINTS + 1, 1):
        got = path_that_says(peer, count, used.command_id)
        expect_reason(got, Reason.REPEATED_COMMAND_ID, f"a used id for a path of {count}")
    expect_reason(path_that_says(peer, 0, before), Reason.OVERTAKEN, "an id that was overtaken, for no path")
    expect_reason(path_that_says(peer, 0), Reason.EMPTY_PATH, "no path, without the capability")
    got = path_that_says(peer, MAX_WAYPOINTS + 1)
    expect_reason(got, Reason.TOO_MANY_WAYPOINTS, "too long a path, without the capability")
    got = path_that_says(peer, 1)
    require(got[1:] == (Reason.NOT_NEGOTIATED, 0.0, 0.0), f"a path without the capability: {got}")


@case(436, "6.2", "an unusable request uses its id up, and its answer is repeated")
def unusable_uses_its_id(peer: Peer) -> None:
    peer.open()
    held = stop(peer)
    command_id = peer.new_id()
    first = path_that_says(peer, 0, command_id)
    require(path_that_says(peer, 0, command_id) == first, "another answer to the same path")
    expect_reason(
        peer.ask(held, "an id below it"), Reason.OVERTAKEN, "an id below that of an unusable request"
    )
    got = peer.ask(Command(command_id, CommandCode.STOP), "its id again")
    expect_reason(got, Reason.REPEATED_COMMAND_ID, "the id of an unusable request, again")


@case(437, "6.14", "64 requests that come at once all wait: none is overtaken")
def sixty_four_wait(peer: Peer) -> None:
    disabled(peer)
    requests = [Command(peer.new_id(), CommandCode.EMERGENCY_RELEASE) for _ in range(WAITING)]
    for data in [peer.encoded(request) for request in requests]:
        peer.send_raw(data)
    answers: list[Acknowledgement] = []
    for _ in range(20):
        answers += peer.answers("64 requests")
        if len(answers) >= WAITING:
            break
    reasons = {answer.reason for answer in answers}
    require(len(answers) == WAITING, f"{len(answers)} answers")
    require(reasons == {Reason.ALREADY_DONE}, f"answered {sorted(reason.name for reason in reasons)}")


@case(438, "6.3", "the same request with other optional flags and time is a repetition")
def repeated_otherwise(peer: Peer) -> None:
    peer.open()
    for request in (stop(peer), ReferencePose(peer.new_id(), IDENTITY, 1.0)):
        first = peer.ask(request, "the first time")
        peer.send(request, flags=2, sent_ns=peer.now_ns - 1_000_000)
        require(peer.answer_to(request.command_id, "again") == first, "another answer")
        padded = peer.answers("after a repetition")
        require(not padded, f"{len(padded)} answers too many")


@case(439, "3.7", "NaN, infinity and subnormals in a pose: NOT_FINITE, and where", motion=True)
def odd_numbers_in_a_pose(peer: Peer) -> None:
    here = standby(peer).X_BT_cmd
    for odd in ODD:
        for place in range(8):
            pose, duration = _with(here, 0.0, place, odd)
            got = reference_reason(peer, pose, duration)
            expected = (Reason.NOT_FINITE, 0.0, 0.0 if place == 7 else 1.0)
            require(got[1:] == expected, f"{odd} at place {place}: {got}")
    require(peer.state().group_state is GroupState.STANDBY, "the arm moves")


@case(
    440,
    "3.7",
    "NaN, infinity and subnormals in a path: NOT_FINITE, and in which waypoint",
    motion=True,
    needs=OptionalPart.PATHS,
)
def odd_numbers_in_a_path(peer: Peer) -> None:
    here = standby(peer).X_BT_cmd
    for odd in ODD:
        for waypoint in range(3):
            for place in range(7):
                points = [here] * 3
                points[waypoint], _ = _with(here, 0.0, place, odd)
                got = peer.ask(ReferencePath(peer.new_id(), tuple(points), 0.0, 0.0), f"{odd} in a path")
                expected = (Reason.NOT_FINITE, float(waypoint), 3.0)
                require(got[1:] == expected, f"{odd} at place {place} of waypoint {waypoint}: {got}")
        for what, times in (("segment_s", (odd, 0.0)), ("dwell_s", (0.0, odd))):
            got = peer.ask(ReferencePath(peer.new_id(), (here,), *times), f"{odd} as {what}")
            require(got[1:] == (Reason.NOT_FINITE, 0.0, 0.0), f"{odd} as {what}: {got}")
    require(peer.state().group_state is GroupState.STANDBY, "the arm moves")


@case(441, "1.5", "the norm of a quaternion: off by 0.0009 it is accepted, by 0.0011 refused", motion=True)
def norms(peer: Peer) -> None:
    here = standby(peer).X_BT_cmd
    here = scaled(here, 1.0 / here.quaternion_norm())
    for off in (0.0011, -0.0011):
        got = reference_reason(peer, scaled(here, 1.0 + off))
        expect_reason(got, Reason.NOT_UNIT_QUATERNION, f"a norm of {1.0 + off}")
        said = abs(got.value - 1.0 - off) < 1e-9 and got.limit == 1.0
        require(said, f"a norm of {1.0 + off}: value {got.value}, limit {got.limit}")
    for off in (0.0009, -0.0009):
        expect_reason(
            reference_reason(peer, scaled(here, 1.0 + off)), Reason.ACCEPTED, f"a norm of {1.0 + off}"
        )
        state = peer.state()
        norm = state.X_BT_cmd.quaternion_norm()
        require(abs(norm - 1.0) < 1e-6, f"it is followed with a norm of {norm:.7f}")
        reach(peer, GroupState.STANDBY, "a motion to where it is", 20_000)
        norm = peer.state().X_BT_cmd.quaternion_norm()
        require(abs(norm - 1.0) < 1e-6, f"it is held with a norm of {norm:.7f}")


@case(442, "6.11", "an accepted or an ordinary refused request has value 0 and limit 0")
def nothing_to_say(peer: Peer) -> None:
    disabled(peer, CAPABILITY_PATHS)
    for code in (CommandCode.STOP, CommandCode.DISABLE, CommandCode.RESET, CommandCode.EMERGENCY_RELEASE):
        got = peer.ask(Command(peer.new_id(), code), code.name)
        require(got[2:] == (0.0, 0.0), f"{code.name}: value {got.value:g}, limit {got.limit:g}")


def _with(pose: Pose, duration: float, place: int, value: float) -> tuple[Pose, float]:
    """``pose`` and ``duration`` with the number at ``place``, 0…7, replaced."""
    numbers = [*pose.p_m, *pose.q_wxyz, duration]
    numbers[place] = value
    x, y, z, qw, qx, qy, qz, duration = numbers
    return Pose((x, y, z), (qw, qx, qy, qz)), duration


@case(443, "6.2", "a refusal is said once, with value and limit 0 where its reason needs none")
def refused_once(peer: Peer) -> None:
    disabled(peer, 0)
    here = peer.state().X_BT

    def once(request: Request, reason: Reason) -> None:
        peer.send(request)
        got = peer.answers(reason.name)
        require(got == [Acknowledgement(request.command_id, reason, 0.0, 0.0)], f"{reason.name}: came {got}")

    def once_of(code: CommandCode, reason: Reason) -> None:
        once(Command(peer.new_id(), code), reason)

    once_of(CommandCode.RESET, Reason.NOT_IN_ERROR)
    once_of(CommandCode.DISABLE, Reason.ALREADY_DONE)
    once(ReferencePose(peer.new_id(), here, 0.0), Reason.DISABLED)
    once(ReferencePath(peer.new_id(), (here,), 0.0, 0.0), Reason.NOT_NEGOTIATED)
    once_of(CommandCode.EMERGENCY_STOP, Reason.ACCEPTED)
    once_of(CommandCode.ENABLE, Reason.EMERGENCY_LATCHED)
    once_of(CommandCode.EMERGENCY_RELEASE, Reason.ACCEPTED)
    once_of(CommandCode.ENABLE, Reason.ERROR_LATCHED)
    once_of(CommandCode.RESET, Reason.ACCEPTED)


@case(444, "3.6", "a request that cannot be meant is answered once")
def unusable_once(peer: Peer) -> None:
    peer.open()
    for count in (0, MAX_WAYPOINTS + 1):
        path_that_says(peer, count)
        more = peer.answers(f"{count} waypoints")
        require(not more, f"{count} waypoints: {len(more)} more answers")
    request = stop(peer)
    peer.send_raw(peer.with_number(peer.encoded(request), HEADER_BYTES + 8, "I", 1000))
    answers = peer.answers("an unknown command")
    require(len(answers) == 1, f"an unknown command: {len(answers)} answers")


@case(
    445,
    "6.8",
    f"two paths keep their own waypoints, segment_s and dwell_s (slack {PATH_SLACK_MS} ms)",
    motion=True,
    needs=OptionalPart.PATHS,
)
def paths_in_time(peer: Peer) -> None:
    here = standby(peer).X_BT_cmd
    corner = (moved(here, dz=STEP_M), moved(here, dz=STEP_M, dy=STEP_M), here)
    for points, segment_s, dwell_s in ((corner, 1.5, 0.4), ((moved(here, dx=-STEP_M), here), 2.2, 0.9)):
        request = ReferencePath(peer.new_id(), points, segment_s, dwell_s)
        expect_reason(peer.ask(request, "a path"), Reason.ACCEPTED, "a path")
        _require_path_driven(peer, here, request)


def _require_path_driven(peer: Peer, start: Pose, path: ReferencePath) -> None:
    """Require that the path is driven through its waypoints in its own time."""
    rests = [0.0] * len(path.waypoints)
    left_ns = arrived_ns = seen_ns = peer.now_ns
    state = peer.state()
    while not state.motion_done and peer.now_ns < seen_ns + 30_000 * MS:
        before_ns, seen_ns = seen_ns, peer.now_ns
        state = peer.state()
        place = state.X_BT_cmd.p_m
        if math.dist(place, start.p_m) < AT_M and state.segment == 0:
            left_ns = seen_ns
        for i, waypoint in enumerate(path.waypoints):
            # At the last one it rests for ever; at the others for dwell_s, before the next segment.
            if math.dist(place, waypoint.p_m) < AT_M:
                rests[i] += (seen_ns - before_ns) / MS
        if math.dist(place, path.waypoints[-1].p_m) > AT_M:
            arrived_ns = seen_ns
    require(state.motion_done, "not done within 30 s")
    require(min(rests) > 0.0, f"waypoint {rests.index(min(rests))} was not driven through")
    count = len(path.waypoints)
    wanted_ms = 1e3 * (count * path.segment_s + (count - 1) * path.dwell_s)
    took_ms = (arrived_ns - left_ns) / MS
    require(abs(took_ms - wanted_ms) < PATH_SLACK_MS, f"it took {took_ms:.0f} ms, wanted {wanted_ms:.0f}")
    for rest_ms in rests[:-1]:
        early = rest_ms > 1e3 * path.dwell_s - PATH_SLACK_MS
        require(early, f"it rested {rest_ms:.0f} ms of {1e3 * path.dwell_s:.0f}")


@case(446, "6.3", "a request that comes again before it is decided is decided once, and answered alike")
def again_at_once(peer: Peer) -> None:
    peer.open()
    for _ in range(5):
        request = stop(peer)
        copies = [peer.encoded(request) for _ in range(4)]
        other = peer.encoded(request._replace(code=CommandCode.DISABLE))
        for data in (*copies, other):
            peer.send_raw(data)
        answers = peer.answers("four times the same request, and its id for another one")
        reasons = [answer.reason for answer in answers if answer.command_id == request.command_id]
        accepted, repeated = reasons.count(Reason.ACCEPTED), reasons.count(Reason.REPEATED_COMMAND_ID)
        require(accepted >= 1, f"answered {[reason.name for reason in reasons]}")
        require(repeated == 1, f"its id for another request: {repeated} times REPEATED_COMMAND_ID")
        require(accepted + repeated == len(answers), f"answered {[reason.name for reason in reasons]}")
