"""Cases 430…: what a request means, and what its one answer says (clauses 1.5, 3.6, 3.7 and 6)."""

from collections.abc import Iterator

from conformance.case import case
from conformance.peer import Peer
from conformance.reference.framing import stop
from conformance.reference.motion import (
    disabled,
)
from conformance.wire import MS, require
from protocol.datagram_layout import HEADER_BYTES, MAX_WAYPOINTS, PAYLOADS, Kind, offsets
from protocol.faults import CommandCode, GroupState, Reason
from protocol.pose import IDENTITY
from protocol.reference_messages import (
    Acknowledgement,
    Command,
    ReferencePath,
    ReferencePose,
    State,
)

COUNT = HEADER_BYTES + 8
WAITING = 64


def path_that_says(peer: Peer, count: int, command_id: int | None = None) -> Acknowledgement:
    """The answer to a path whose count of waypoints says ``count``."""
    points = (IDENTITY,) * min(max(count, 1), MAX_WAYPOINTS)
    path = ReferencePath(command_id or peer.new_id(), points, 0.0, 0.0)
    peer.send_raw(peer.with_number(peer.encoded(path), COUNT, "I", count))
    return peer.answer_to(path.command_id, f"{count} waypoints")


@case(
    431, "3.6", "paths of 1 and of 24 waypoints can be meant, of 0 and of 25 cannot, and it is said", opens=50
)
def counts_of_waypoints(peer: Peer) -> None:
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


@case(
    432,
    "3.6",
    "the code of an unknown command is its value, its limit 0; codes 0 and 9 are unknown",
    opens=50,
)
def unknown_codes(peer: Peer) -> None:
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


@case(433, "6.5", "an id that comes again with any other number in it: REPEATED_COMMAND_ID", opens=50)
def any_other_content(peer: Peer) -> None:
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


@case(437, "6.14", "64 requests that come at once all wait: none is overtaken")
def sixty_four_wait(peer: Peer) -> None:
    disabled(peer)
    requests = [Command(peer.new_id(), CommandCode.EMERGENCY_RELEASE) for _ in range(WAITING)]
    peer.send_at_once(requests)
    answers = peer.gather(Acknowledgement, WAITING, 2000, after_ms=peer.grace_ms)
    reasons = {answer.reason for answer in answers}
    require(len(answers) == WAITING, f"{len(answers)} answers")
    require(reasons == {Reason.ALREADY_DONE}, f"answered {sorted(reason.name for reason in reasons)}")


@case(438, "6.3", "the same request with other optional flags and time is a repetition", opens=50)
def repeated_otherwise(peer: Peer) -> None:
    for request in (stop(peer), ReferencePose(peer.new_id(), IDENTITY, 1.0)):
        first = peer.ask(request, "the first time")
        peer.send(request, flags=2, sent_ns=peer.now_ns - 1_000_000)
        require(peer.answer_to(request.command_id, "again") == first, "another answer")
        padded = peer.answers("after a repetition")
        require(not padded, f"{len(padded)} answers too many")


REMEMBERED = 256


@case(402, "6.3", "a repeated request is answered with the same acknowledgement", opens=50)
def repeated(peer: Peer) -> None:
    request = stop(peer)
    first = peer.ask(request, "the first time")
    for _ in range(5):
        require(peer.ask(request, "again") == first, "another acknowledgement")
    require(len(peer.answers("after repetitions")) == 0, "more answers than requests")


@case(403, "6.3", "a refusal is repeated as it was given, though the state has changed since", opens=50)
def refusal_repeated(peer: Peer) -> None:
    request = Command(peer.new_id(), CommandCode.RESET)
    first = peer.ask(request, "RESET")
    peer.ask(stop(peer), "STOP")
    require(peer.ask(request, "RESET again").reason is not Reason.OVERTAKEN, "forgotten at once")
    require(peer.ask(request, "RESET again") == first, "another acknowledgement")


@case(407, "8", "an answer is remembered for 256 requests, and an older id is still not executed", opens=50)
def memory(peer: Peer) -> None:
    first, second = stop(peer), stop(peer)
    peer.ask(first, "the first request")
    peer.ask(second, "the second request")
    for _ in range(REMEMBERED - 1):
        peer.ask(stop(peer), "one of many")
    require(peer.ask(second, "remembered").reason is Reason.ACCEPTED, "forgotten too early")
    got = peer.ask(first, "forgotten").reason
    require(got in (Reason.OVERTAKEN, Reason.ACCEPTED), f"answered {got.name}")


@case(408, "4.7", "a new session knows nothing of the ids of the one before", opens=50)
def ids_start_again(peer: Peer) -> None:
    high = stop(peer)
    peer.ask(high, "the first session")
    peer.reopen()
    low = high._replace(command_id=high.command_id - 5)
    require(peer.ask(low, "a lower id").reason is Reason.ACCEPTED, "refused for an id of another session")


@case(411, "7.7", "STATE comes at the rate that was asked for")
def rates(peer: Peer) -> None:
    for period_ms, span in ((0, 500.0), (20, 2000.0), (100, 1500.0)):
        welcome = peer.open(period_ms=period_ms)
        period = max(welcome.state_period_ms, welcome.cycle_ns / MS)  # as granted (4.2)
        peer.collect(50)
        halves = [sum(isinstance(d.message, State) for d in peer.collect(span / 2.0)) for _ in range(2)]
        for got in halves:  # one scan in ten may be late, and one STATE at either end
            expected_count = span / 2.0 / period
            note = f"{got} in {span / 2.0:g} ms at a period of {period:g} ms"
            require(0.9 * expected_count - 2 <= got <= 1.05 * expected_count + 2, note)
        peer.leave()


@case(414, "7.5", "a session begins without motion", opens=20)
def begins_at_rest(peer: Peer) -> None:
    state = peer.state()
    require(state.group_state is not GroupState.MOVING, "the arm moves although nothing was asked")


COMMAND_PADDING, PATH_PADDING, FIRST_UNUSED = 52, 52, 56 + 56


@case(419, "6.5", "padding and unused waypoints do not make a repetition another request", opens=50)
def padding_repeated(peer: Peer) -> None:
    requests: list[tuple[Command | ReferencePath, list[int]]] = [
        (stop(peer), [COMMAND_PADDING]),
        (ReferencePath(peer.new_id(), (IDENTITY,), 0.0, 0.0), [PATH_PADDING, FIRST_UNUSED]),
    ]
    for request, places in requests:
        first = peer.ask(request, "the request itself")
        for place in places:
            peer.send_raw(peer.with_number(peer.encoded(request), place, "I", 0xA5A5A5A5))
            again = peer.answer_to(request.command_id, "its repetition")
            note = f"{again.reason.name}, before {first.reason.name}"
            require(again == first, f"with rubbish at byte {place}: {note}")
