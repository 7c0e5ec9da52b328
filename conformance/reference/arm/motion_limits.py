"""Cases 561…567: both sides of each limit of a reference (6.7 to 6.9).

A limit is the one that a refusal names; what lies just beyond it is refused with it, what lies just within
it is not. What is accepted is replaced or stopped before the arm has gone anywhere.
"""

import math

from conformance.case import reference
from conformance.parts import OptionalPart
from conformance.peer import Peer
from conformance.reference.arm.modes import entered
from conformance.reference.arm.watching import turned
from conformance.reference.group import expect_reason
from conformance.reference.motion import moved
from conformance.wire import Unsupported, require
from protocol.axes_group import Mode
from protocol.faults import CommandCode, Reason
from protocol.pose import Pose
from protocol.reference_messages import Acknowledgement, ReferencePath, ReferencePose

case = reference.case
SIDE, SIDE_M, SIDE_RAD = 0.01, 0.01, 0.01
TRIES = 12


def asked_for(peer: Peer, goal: Pose, seconds: float = 0.0) -> Acknowledgement:
    """The answer to a reference."""
    return peer.ask(ReferencePose(peer.new_id(), goal, seconds), "a reference")


def _require(got: Acknowledgement, reason: Reason, limit: float, what: str) -> None:
    expect_reason(got, reason, what)
    require(abs(got.limit - limit) < 1e-9, f"{what}: limit {got.limit:g}, before it was {limit:g}")


@case(561, "6.7", "a time: both sides of its bounds", motion=True)
def durations(peer: Peer) -> None:
    here = entered(peer, Mode.STANDBY).here
    for far, inwards in ((1e-6, 1.0 + SIDE), (1e9, 1.0 - SIDE)):
        got = asked_for(peer, here, far)
        expect_reason(got, Reason.BAD_DURATION, f"{far:g} s")
        require(math.isclose(got.value, far), f"{far:g} s: value {got.value:g}")
        bound = got.limit
        _require(asked_for(peer, here, bound / inwards), Reason.BAD_DURATION, bound, f"beyond {bound:g} s")
        within = asked_for(peer, here, bound * inwards)
        require(within.reason is not Reason.BAD_DURATION, f"within {bound:g} s it is BAD_DURATION")
    peer.command(CommandCode.STOP)


@case(562, "6.8", "the times of a path: both sides of their bounds", motion=True, needs=OptionalPart.PATHS)
def path_durations(peer: Peer) -> None:
    here = entered(peer, Mode.STANDBY).here

    def asked(segment_s: float, dwell_s: float) -> Acknowledgement:
        return peer.ask(ReferencePath(peer.new_id(), (here,), segment_s, dwell_s), "a path")

    for far, inwards in ((1e-6, 1.0 + SIDE), (1e9, 1.0 - SIDE)):
        bound = asked(far, 0.0).limit
        _require(asked(bound / inwards, 0.0), Reason.BAD_DURATION, bound, "segments just beyond")
        within = asked(bound * inwards, 0.0)
        require(within.reason is not Reason.BAD_DURATION, "segments just within are BAD_DURATION")
    for odd in (-0.01, -1e9, 1e9):
        expect_reason(asked(0.0, odd), Reason.BAD_DURATION, f"a dwell of {odd:g} s")
    peer.command(CommandCode.STOP)


@case(563, "6.9", "a time that is too short for the way: both sides of what is TOO_FAST", motion=True)
def too_fast(peer: Peer) -> None:
    goal = moved(entered(peer, Mode.STANDBY).here, dz=0.06)
    seconds = asked_for(peer, goal, 1e-6).limit * (1.0 + SIDE)
    for _ in range(TRIES):
        got = asked_for(peer, goal, seconds)
        expect_reason(got, Reason.TOO_FAST, f"60 mm in {seconds:g} s")
        require(got.value > got.limit > 0.0, f"value {got.value:g}, limit {got.limit:g}")
        ratio = got.value / got.limit
        if ratio < 1.0 + 4 * SIDE:
            break
        # Speeds go with 1/T, accelerations with 1/T²: the root asks for nothing within the limits.
        seconds *= math.sqrt(ratio) * (1.0 - SIDE)
    require(ratio < 1.0 + 4 * SIDE, "the values of TOO_FAST lead nowhere")
    expect_reason(
        asked_for(peer, goal, seconds * ratio * (1.0 + SIDE)), Reason.ACCEPTED, "a little more time"
    )
    peer.command(CommandCode.STOP)


@case(564, "6.9", "a first pose that is too far: both sides of its limit, where there is one", motion=True)
def too_far(peer: Peer) -> None:
    here = entered(peer, Mode.STANDBY).here
    got = asked_for(peer, moved(here, dz=100.0))
    if got.reason is not Reason.TOO_FAR:
        raise Unsupported(f"100 m away is {got.reason.name}: this controller has no such limit")
    require(abs(got.value - 100.0) < 1e-3, f"100 m away is said to be {got.value:g}")
    limit = got.limit
    beyond = limit * (1.0 + SIDE)
    got = asked_for(peer, moved(here, dz=beyond))
    _require(got, Reason.TOO_FAR, limit, f"{beyond:g} m away")
    require(abs(got.value - beyond) < 1e-3, f"{beyond:g} m away is said to be {got.value:g}")
    got = asked_for(peer, moved(here, dz=limit * (1.0 - SIDE)))
    require(got.reason is not Reason.TOO_FAR, "within the limit it is TOO_FAR")
    peer.command(CommandCode.STOP)


@case(565, "6.9", "the workspace: both sides of the bound below", motion=True)
def workspace(peer: Peer) -> None:
    here = entered(peer, Mode.STANDBY).here
    for down in (2.5, 2.0, 1.5, 5.0, 10.0):
        got = asked_for(peer, moved(here, dz=-down))
        if got.reason is Reason.OUTSIDE_WORKSPACE:
            break
    if got.reason is not Reason.OUTSIDE_WORKSPACE:
        raise Unsupported(f"straight down it is not the workspace that ends: {got.reason.name}")
    bound, height = got.limit, here.p_m[2]
    require(got.value < bound < height, f"value {got.value:g}, bound {bound:g}, the tool at {height:g} m")
    got = asked_for(peer, moved(here, dz=bound - SIDE_M - height))
    _require(got, Reason.OUTSIDE_WORKSPACE, bound, "just below the bound")
    require(bound - 2 * SIDE_M < got.value < bound, f"just below the bound: value {got.value:g}")
    got = asked_for(peer, moved(here, dz=bound + SIDE_M - height))
    require(got.reason is not Reason.OUTSIDE_WORKSPACE, "just above the bound it is OUTSIDE_WORKSPACE")
    peer.command(CommandCode.STOP)


@case(566, "6.9", "the range of the last joint: both sides of its bound", motion=True)
def joint_limit(peer: Peer) -> None:
    here = entered(peer, Mode.STANDBY).here
    joint = peer.state().q_meas[5]
    got = asked_for(peer, turned(here, 3.0))
    if got.reason is not Reason.JOINT_LIMIT:
        raise Unsupported(f"a turn of 3 rad about the last joint's axis is {got.reason.name}")
    bound = got.limit
    require(abs(got.value) > abs(bound), f"value {got.value:g}, bound {bound:g}")
    left = abs(bound - joint)
    got = asked_for(peer, turned(here, left + SIDE_RAD))
    _require(got, Reason.JOINT_LIMIT, bound, "just beyond the bound")
    require(abs(got.value - bound) < 2 * SIDE_RAD, f"just beyond the bound: value {got.value:g}")
    expect_reason(asked_for(peer, turned(here, left - SIDE_RAD)), Reason.ACCEPTED, "just within the bound")
    peer.command(CommandCode.STOP)


@case(567, "6.9", "a singularity: refused from the value on that the refusal names", motion=True)
def singular(peer: Peer) -> None:
    here = entered(peer, Mode.STANDBY).here
    about = (1.0, 0.0, 0.0)

    def at(degrees: float) -> Acknowledgement:
        return asked_for(peer, turned(here, math.radians(degrees), about))

    tried = [side * 2.5 * step for step in range(1, 19) for side in (-1.0, 1.0)]
    refused = next((each for each in tried if at(each).reason is Reason.SINGULAR), None)
    if refused is None:
        raise Unsupported("no singularity within 45° of the tool's pitch")
    within, beyond, edge = refused - math.copysign(2.5, refused), refused, at(refused)
    for _ in range(TRIES):
        middle = (within + beyond) / 2.0
        got = at(middle)
        require(got.reason in (Reason.ACCEPTED, Reason.SINGULAR), f"{middle:g}°: {got.reason.name}")
        if got.reason is Reason.SINGULAR:
            beyond, edge = middle, got
        else:
            within = middle
    peer.command(CommandCode.STOP)
    require(edge.value < edge.limit, f"value {edge.value:g}, limit {edge.limit:g}")
    said = f"accepted until {edge.value:g}, the limit is said to be {edge.limit:g}"
    require(edge.value > 0.9 * edge.limit, said)
