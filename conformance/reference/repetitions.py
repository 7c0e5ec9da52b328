"""Cases 419…422: what counts as a repetition, and what a newer request overtakes (5.5, 6.5, 6.6, 6.11)."""

from conformance.case import reference
from conformance.peer import Peer
from conformance.reference.framing import stop
from conformance.reference.group import disabled
from conformance.reference.motion import STEP_M, moved, standby
from conformance.wire import MS, require
from protocol.faults import CommandCode, GroupState, Reason
from protocol.pose import IDENTITY
from protocol.reference_messages import Command, Heartbeat, HeartbeatReply, ReferencePath, ReferencePose

case = reference.case
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
