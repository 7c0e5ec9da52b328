"""Cases 401…: every request at most once, every answer exactly once (clause 6), and STATE (7.7)."""

import itertools
import math

from conformance.case import reference
from conformance.peer import Peer
from conformance.reference.framing import stop
from conformance.reference.motion import STEP_M, disabled, moved, standby
from conformance.wire import MS, require
from protocol.faults import CommandCode, GroupState, Reason
from protocol.pose import IDENTITY
from protocol.reference_messages import (
    Acknowledgement,
    Command,
    Heartbeat,
    HeartbeatReply,
    ReferencePath,
    ReferencePose,
    State,
)

case = reference.case
REMEMBERED = 256


@case(401, "6.2", "a request has exactly one acknowledgement")
def once(peer: Peer) -> None:
    peer.open()
    request = stop(peer)
    peer.send(request)
    answers = peer.answers("one request") + peer.answers("one request, later")
    require(answers == [Acknowledgement(request.command_id, Reason.ACCEPTED, 0.0, 0.0)], f"came {answers}")


@case(402, "6.3", "a repeated request is answered with the same acknowledgement")
def repeated(peer: Peer) -> None:
    peer.open()
    request = stop(peer)
    first = peer.ask(request, "the first time")
    for _ in range(5):
        require(peer.ask(request, "again") == first, "another acknowledgement")
    require(len(peer.answers("after repetitions")) == 0, "more answers than requests")


@case(403, "6.3", "a refusal is repeated as it was given, though the state has changed since")
def refusal_repeated(peer: Peer) -> None:
    peer.open()
    request = Command(peer.new_id(), CommandCode.RESET)
    first = peer.ask(request, "RESET")
    peer.ask(stop(peer), "STOP")
    require(peer.ask(request, "RESET again").reason is not Reason.OVERTAKEN, "forgotten at once")
    require(peer.ask(request, "RESET again") == first, "another acknowledgement")


@case(404, "6.5", "an id with another content is acknowledged with REPEATED_COMMAND_ID")
def other_content(peer: Peer) -> None:
    peer.open()
    request = stop(peer)
    peer.ask(request, "STOP")
    answer = peer.ask(request._replace(code=CommandCode.DISABLE), "the same id for DISABLE")
    require(answer.reason is Reason.REPEATED_COMMAND_ID, f"answered {answer.reason.name}")
    answer = peer.ask(ReferencePose(request.command_id, IDENTITY, 0.0), "the same id for a pose")
    require(answer.reason is Reason.REPEATED_COMMAND_ID, f"answered {answer.reason.name}")
    require(peer.ask(request, "STOP again").reason is Reason.ACCEPTED, "the first answer was lost")


@case(405, "6.4", "an id below the newest is acknowledged with OVERTAKEN")
def overtaken(peer: Peer) -> None:
    peer.open()
    held = Command(peer.new_id(), CommandCode.DISABLE)
    newest = stop(peer)
    peer.ask(newest, "the later request")
    answer = peer.ask(held, "the request that was overtaken")
    require(answer.reason is Reason.OVERTAKEN, f"answered {answer.reason.name}")
    require((answer.value, answer.limit) == (held.command_id, newest.command_id), "value and limit")
    require(not peer.answers("a request that was overtaken"), "it was answered twice")


@case(406, "6.1", "ids may leap")
def ids_leap(peer: Peer) -> None:
    peer.open()
    for leap in (1, 1000, 2**40):
        request = stop(peer)
        request = request._replace(command_id=request.command_id + leap)
        require(peer.ask(request, f"an id {leap} further").reason is Reason.ACCEPTED, "refused")


@case(407, "8", "an answer is remembered for 256 requests, and an older id is still not executed")
def memory(peer: Peer) -> None:
    peer.open()
    first, second = stop(peer), stop(peer)
    peer.ask(first, "the first request")
    peer.ask(second, "the second request")
    for _ in range(REMEMBERED - 1):
        peer.ask(stop(peer), "one of many")
    require(peer.ask(second, "remembered").reason is Reason.ACCEPTED, "forgotten too early")
    got = peer.ask(first, "forgotten").reason
    require(got in (Reason.OVERTAKEN, Reason.ACCEPTED), f"answered {got.name}")


@case(408, "4.7", "a new session knows nothing of the ids of the one before")
def ids_start_again(peer: Peer) -> None:
    peer.open()
    high = stop(peer)
    peer.ask(high, "the first session")
    peer.leave()
    peer.open()
    low = high._replace(command_id=high.command_id - 5)
    require(peer.ask(low, "a lower id").reason is Reason.ACCEPTED, "refused for an id of another session")


@case(409, "6.2", "a hundred requests in a row are answered each once, in order")
def many(peer: Peer) -> None:
    peer.open()
    asked = []
    for _ in range(100):  # no stops: of stops sent at once but the last of a kind may be left out (6.12)
        request = Command(peer.new_id(), CommandCode.END_STREAM)
        asked.append(request.command_id)
        peer.send(request)
    answers: list[int] = []
    until_ns = peer.now_ns + 2000 * MS
    while len(answers) < len(asked) and peer.now_ns < until_ns:
        answers += [a.command_id for a in peer.answers("a hundred requests")]
    answers += [a.command_id for a in peer.answers("after a hundred requests")]
    require(answers == asked, f"{len(answers)} answers to 100 requests, or not in order")


@case(410, "3.7", "a NaN in a reference does not end the session or move the arm")
def nan(peer: Peer) -> None:
    peer.open(period_ms=20)
    for place in range(8):
        numbers = [0.0] * 8
        numbers[place] = math.nan
        x, y, z, qw, qx, qy, qz, duration = numbers
        pose = IDENTITY._replace(p_m=(x, y, z), q_wxyz=(qw, qx, qy, qz))
        answer = peer.ask(ReferencePose(peer.new_id(), pose, duration), f"NaN at place {place}")
        require(answer.reason is not Reason.ACCEPTED, f"a NaN at place {place} was accepted")


@case(411, "7.7", "STATE comes at the rate that was asked for")
def rates(peer: Peer) -> None:
    for period_ms, span in ((0, 500.0), (20, 2000.0), (100, 1500.0)):
        welcome = peer.open(period_ms=period_ms)
        period = max(welcome.state_period_ms, welcome.cycle_ns / MS)  # as granted (4.2)
        peer.collect(50)
        halves = [sum(isinstance(d.message, State) for d in peer.collect(span / 2.0)) for _ in range(2)]
        for got in halves:  # one scan in ten may be late, and one STATE at either end
            asked = span / 2.0 / period
            said = f"{got} in {span / 2.0:g} ms at a period of {period:g} ms"
            require(0.9 * asked - 2 <= got <= 1.05 * asked + 2, said)
        peer.leave()


@case(412, "7.7", "STATE is whole: finite numbers, unit quaternions, valves in range")
def state_is_whole(peer: Peer) -> None:
    peer.open(period_ms=0)
    for _ in range(3):
        state = peer.state()
        for name, pose in (("X_BT", state.X_BT), ("X_BT_cmd", state.X_BT_cmd)):
            require(pose.is_finite(), f"{name} is not finite")
            require(abs(pose.quaternion_norm() - 1.0) < 1e-6, f"{name}: norm {pose.quaternion_norm():.9f}")
        require(all(map(math.isfinite, (*state.q_meas, *state.q_cmd, state.supply_bar))), "not finite")
        require(all(-1.0 <= v <= 1.0 for v in state.valves), f"valves {state.valves}")


@case(413, "7.7", "cycle and time of STATE rise together")
def state_rises(peer: Peer) -> None:
    welcome = peer.open(period_ms=0)
    states = [d.message for d in peer.collect(300) if isinstance(d.message, State)]
    require(len(states) >= 5, f"{len(states)} in 300 ms")
    for a, b in itertools.pairwise(states):
        require(b.cycle > a.cycle, f"cycle {b.cycle} after {a.cycle}")
        require(b.time_ns > a.time_ns, "time_ns did not rise")
    cycles = states[-1].cycle - states[0].cycle
    span_ns = states[-1].time_ns - states[0].time_ns
    require(
        0.8 <= span_ns / (cycles * welcome.cycle_ns) <= 1.6,
        f"{cycles} cycles of {welcome.cycle_ns / MS:g} ms in {span_ns / MS:.0f} ms",
    )


@case(414, "7.5", "a session begins without motion")
def begins_at_rest(peer: Peer) -> None:
    peer.open(period_ms=20)
    state = peer.state()
    require(state.group_state is not GroupState.MOVING, "the arm moves although nothing was asked")


COMMAND_PADDING, PATH_PADDING, FIRST_UNUSED = 52, 52, 56 + 56
# Of so many pairs of references a scan may come between the two of one or another.
PAIRS, PARTED = 6, 2


@case(419, "6.5", "padding and unused waypoints do not make a repetition another request")
def padding_repeated(peer: Peer) -> None:
    peer.open()
    requests: list[tuple[Command | ReferencePath, list[int]]] = [
        (stop(peer), [COMMAND_PADDING]),
        (ReferencePath(peer.new_id(), (IDENTITY,), 0.0, 0.0), [PATH_PADDING, FIRST_UNUSED]),
    ]
    for request, places in requests:
        first = peer.ask(request, "the request itself")
        for place in places:
            peer.send_raw(peer.with_number(peer.encoded(request), place, "I", 0xA5A5A5A5))
            again = peer.answer_to(request.command_id, "its repetition")
            said = f"{again.reason.name}, before {first.reason.name}"
            require(again == first, f"with rubbish at byte {place}: {said}")


@case(420, "6.6", "a reference that is refused overtakes the good one before it: nothing moves", motion=True)
def refused_overtakes(peer: Peer) -> None:
    here = standby(peer).X_BT_cmd
    parted = 0
    for _ in range(PAIRS):
        good = ReferencePose(peer.new_id(), moved(here, dz=STEP_M), 5.0)
        bad = ReferencePose(peer.new_id(), moved(here, dz=1000.0), 5.0)
        for data in [peer.encoded(good), peer.encoded(bad)]:
            peer.send_raw(data)
        answers = {a.command_id: a.reason for a in peer.answers("two references at once")}
        require(len(answers) == 2, f"{len(answers)} answers to two references")
        require(answers[bad.command_id] is not Reason.ACCEPTED, "a reference 1 km away was accepted")
        if answers[good.command_id] is Reason.OVERTAKEN:
            require(peer.state().group_state is GroupState.STANDBY, "the arm moves")
            continue
        parted += 1
        peer.command(CommandCode.STOP)
        peer.collect(500)
    require(parted <= PARTED, f"the good reference was judged in {parted} of {PAIRS} pairs")


@case(421, "6.11", "OVERTAKEN names the request itself and the one that overtook it")
def overtaken_by_name(peer: Peer) -> None:
    disabled(peer)
    here = peer.state().X_BT
    named = 0
    for _ in range(3):
        ids = [peer.new_id() for _ in range(8)]
        for data in [peer.encoded(ReferencePose(i, here, 0.0)) for i in ids]:
            peer.send_raw(data)
        for answer in peer.answers("eight references at once"):
            if answer.reason is Reason.OVERTAKEN:
                named += 1
                own = answer.command_id
                require(answer.value == float(own), f"v {answer.value:.0f}, wanted its own id {own}")
                newer = [float(i) for i in ids if i > own]
                require(answer.limit in newer, f"l {answer.limit:.0f} is none of the newer ids {newer}")
    require(named > 0, "of three times eight references at once none was overtaken")


@case(422, "5.5", "HEARTBEAT's own time is repeated as it came, whatever the header says")
def own_time(peer: Peer) -> None:
    peer.open()
    for own_ns in (0, 1, 2**63, 2**64 - 1):
        peer.drain()
        peer.send(Heartbeat(own_ns))
        until_ns = peer.now_ns + 200 * MS
        replies: list[int] = []
        while not replies and peer.now_ns < until_ns:
            got = [d.message for d in peer.collect(5.0, beating=False)]
            replies = [m.sent_ns for m in got if isinstance(m, HeartbeatReply)]
        require(replies == [own_ns], f"sent_ns {own_ns} came back as {replies}")
