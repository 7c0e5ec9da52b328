"""Cases of LREALs: what is no number is refused wherever it stands, and every bound has two sides (6.10)."""

import math
import struct
from collections.abc import Callable, Iterator

from conformance.case import moving_case
from conformance.parts import OptionalPart
from conformance.peer import Peer
from conformance.reference.arm_state_truth import turned
from conformance.reference.arm_stream_times import LIMITS_FEED_MS, resting_stream
from conformance.reference.motion import expect_reason, moved, reference_reason, scaled, standby
from conformance.reference.streaming import Stream
from conformance.wire import Unsupported, require
from protocol.datagram_layout import HEADER_BYTES, MAX_WAYPOINTS, PAYLOADS, Kind, offsets
from protocol.faults import GroupState, Reason
from protocol.pose import Pose
from protocol.reference_messages import (
    Acknowledgement,
    ReferencePath,
    ReferencePose,
    Request,
    StreamedPose,
    StreamRefused,
)

PATHS, STREAMING = OptionalPart.PATHS, OptionalPart.STREAMING
_SIGN, _EXPONENT = 1 << 63, 0x7FF << 52
# NaN quiet and signalling, infinity, the greatest subnormal and the least, each with both signs.
ODD = [bits | sign for bits in (_EXPONENT | 1 << 51, _EXPONENT | 1, _EXPONENT, (1 << 52) - 1, 1)
       for sign in (0, _SIGN)]  # fmt: skip
LEAST_NORMAL, HUGE = 2.0**-1022, 2.0**500  # its square is a number too
SOUND = (-0.0, LEAST_NORMAL, -LEAST_NORMAL, HUGE, -HUGE)
NUMBERS_OF_A_POSE = 7
# What is computed from a number that was sent may be off by a few roundings; nothing else is.
ROUNDED = 1e-9
Ask = Callable[[float], Acknowledgement]


def reals(kind: Kind) -> Iterator[tuple[int, int, int]]:
    """Every LREAL of a kind: how many poses lie before it, -1 if it is in none; its place; its offset."""
    place = 0
    for field, offset in zip(PAYLOADS[kind], offsets(PAYLOADS[kind]), strict=True):
        for index in range(field.count if field.code == "d" else 0):
            yield index // NUMBERS_OF_A_POSE if field.poses else -1, place, HEADER_BYTES + offset + 8 * index
            place += 1


def _refused(peer: Peer, request: Request, offset: int, bits: int) -> Acknowledgement:
    peer.send_raw(peer.with_number(peer.encoded(request), offset, "Q", bits))
    return peer.answer_to(request.command_id, f"{bits:#018x} at byte {offset}")


def _all_refused(peer: Peer, kind: Kind, make: Callable[[], Request], poses: int) -> None:
    for pose, place, offset in reals(kind):
        # Of a long path each number once, and every odd number in its first and its last pose and its times.
        whole = poses == 1 or pose in (-1, 0, poses - 1)
        for bits in ODD if whole else (ODD[place % len(ODD)],):
            got = _refused(peer, make(), offset, bits)
            wanted = (Reason.NOT_FINITE, *((pose, poses) if pose >= 0 else (0.0, 0.0)))
            require(got[1:] == wanted, f"{bits:#018x} as number {place}: {got}, wanted {wanted}")
    require(peer.state().group_state is GroupState.STANDBY, "the arm moves")


@moving_case(
    521, "3.7", "what is no number, or subnormal, in any LREAL of a reference: NOT_FINITE, and where"
)
def in_a_pose(peer: Peer) -> None:
    here = standby(peer).X_BT_cmd
    _all_refused(peer, Kind.REFERENCE_POSE, lambda: ReferencePose(peer.new_id(), here, 0.0), 1)


@moving_case(440, "3.7", "the same of a path, in any of its waypoints; unused ones are ignored", needs=PATHS)
def in_a_path(peer: Peer) -> None:
    here = standby(peer).X_BT_cmd
    count = MAX_WAYPOINTS

    def path() -> ReferencePath:
        return ReferencePath(peer.new_id(), (here,) * count, 0.0, 0.0)

    _all_refused(peer, Kind.REFERENCE_PATH, path, count)
    count = 1
    for pose, _, offset in reals(Kind.REFERENCE_PATH):
        if pose in (1, MAX_WAYPOINTS - 1):
            got = _refused(peer, path(), offset, ODD[0])
            expect_reason(got, Reason.ACCEPTED, f"NaN in unused waypoint {pose}")


def _streamed(stream: Stream, here: Pose, offset: int, bits: int) -> StreamRefused | None:
    """What comes of a streamed reference with another number in it."""
    peer, number = stream.peer, stream.number
    data = peer.encoded(StreamedPose(stream.stream_id, number, peer.now_ns, here))
    stream.number += 1
    peer.send_raw(peer.with_number(data, offset, "Q", bits))
    return stream.verdict_on(number)


@moving_case(546, "12.4", "the same of a streamed reference, in its twist too", needs=STREAMING)
def in_a_stream(peer: Peer) -> None:
    stream, here = resting_stream(peer)
    for _, place, offset in reals(Kind.STREAMED_POSE):
        for bits in ODD:
            got = _streamed(stream, here, offset, bits)
            good = got is not None and got[2:] == (Reason.NOT_FINITE, 0.0, 1.0)
            require(good, f"{bits:#018x} as number {place}: {got}")
            stream.feed(here, 3 * LIMITS_FEED_MS)  # so long that it rests at its end
    require(math.dist(peer.state().X_BT_cmd.p_m, here.p_m) < ROUNDED, "the commanded pose moved")


def _bits(value: float) -> int:
    return int.from_bytes(struct.pack(">d", value), "big")


def _away(pose: Pose) -> Pose:
    """So far from ``pose`` that nothing moves, whichever of its numbers is another one."""
    return moved(pose, dx=1e3, dy=1e3, dz=1e3)


@moving_case(439, "3.7", "−0, the least normal number and a huge one are numbers: none is NOT_FINITE")
def sound_numbers(peer: Peer) -> None:
    here = standby(peer).X_BT_cmd
    far, paths = _away(here), peer.welcome.capabilities & 1
    kinds: dict[Kind, Request] = {Kind.REFERENCE_POSE: ReferencePose(1, far, 0.0)}
    if paths:
        kinds[Kind.REFERENCE_PATH] = ReferencePath(1, (far,), 0.0, 0.0)
    for kind, request in kinds.items():
        for index, place, offset in reals(kind):
            for value in SOUND if index <= 0 else ():
                got = _refused(peer, request._replace(command_id=peer.new_id()), offset, _bits(value))
                known = got.reason not in (Reason.NOT_FINITE, Reason.ACCEPTED)
                require(known, f"{kind.name}, {value:g} as number {place}: {got.reason.name}")
    for index, place, offset in reals(Kind.REFERENCE_POSE):
        if index < 0 or [*here.p_m, *here.q_wxyz][place] == 0.0:
            got = _refused(peer, ReferencePose(peer.new_id(), here, 0.0), offset, _bits(-0.0))
            expect_reason(got, Reason.ACCEPTED, f"-0 as number {place}, which is 0")
    for times in ((-0.0, 0.0), (0.0, -0.0), (-0.0, -0.0)) if paths else ():
        got = peer.ask(ReferencePath(peer.new_id(), (here,), *times), "a path")
        expect_reason(got, Reason.ACCEPTED, f"times of {times}")


@moving_case(597, "12.4", "the same of a streamed reference; a twist of −0 is followed", needs=STREAMING)
def sound_in_a_stream(peer: Peer) -> None:
    stream, here = resting_stream(peer)
    for index, place, offset in reals(Kind.STREAMED_POSE):
        for value in SOUND:
            got = _streamed(stream, _away(here), offset, _bits(value))
            known = got is not None and got.reason is not Reason.NOT_FINITE
            require(known, f"{value:g} as number {place}: {got}")
            stream.feed(here, LIMITS_FEED_MS)
        got = _streamed(stream, here, offset, _bits(-0.0)) if index < 0 else None
        require(got is None, f"-0 as number {place}: {got}")


def require_edge(ask: Ask, reason: Reason, far: float, what: str, slack: float = 0.0) -> bool:
    """Whether ``far`` breaks a bound; Failed unless what lies beyond it does, and the bound itself does not.

    ``slack``: how far beyond and within the bound is looked; 0: the next number, and the bound itself.
    """
    got = ask(far)
    if got.reason is not reason or not math.isclose(got.value, far, rel_tol=1e-6):
        return False
    bound = got.limit
    away = math.copysign(slack, far - bound)
    beyond = bound + away if slack else math.nextafter(bound, far)
    if 0.0 < abs(beyond) < LEAST_NORMAL:
        beyond = math.copysign(LEAST_NORMAL, far)
    got = ask(beyond)
    if got.reason is Reason.TOO_FAR is not reason:
        return False  # that is judged before
    note = f"{what} of {beyond!r}, beyond {bound!r}"
    require(got.reason is reason and got.limit == bound, f"{note}: {got}")
    require(abs(got.value - beyond) <= slack + ROUNDED * abs(beyond), f"{note}, is said to be {got.value!r}")
    for within in {bound - away, math.nextafter(bound, 2 * bound - far) if not slack else bound - 2 * away}:
        if within == 0.0 or abs(within) >= LEAST_NORMAL:
            got = ask(within)
            require(got.reason is not reason, f"{what} of {within!r}, within {bound!r}: {got}")
    return True


@moving_case(561, "6.10", "a motion's time: its bounds to the last bit")
def durations(peer: Peer) -> None:
    here = standby(peer).X_BT_cmd
    for far in (1e-6, 1e9):
        found = require_edge(lambda s: reference_reason(peer, here, s), Reason.BAD_DURATION, far, "a time")
        require(found, f"{far:g} s is not BAD_DURATION")
    for negative in (-1.0, -LEAST_NORMAL, -1e9):
        expect_reason(reference_reason(peer, here, negative), Reason.BAD_DURATION, f"{negative:g} s")


@moving_case(562, "6.10", "a path's times: their bounds to the last bit", needs=PATHS)
def path_times(peer: Peer) -> None:
    here = standby(peer).X_BT_cmd

    def answer_of(segment_s: float, dwell_s: float) -> Acknowledgement:
        return peer.ask(ReferencePath(peer.new_id(), (here,), segment_s, dwell_s), "a path")

    for name, ask, far in (
        *(("segment_s", lambda s: answer_of(s, 0.0), far) for far in (1e-6, 1e9)),
        *(("dwell_s", lambda s: answer_of(0.0, s), far) for far in (-1.0, 1e9)),
    ):
        require(require_edge(ask, Reason.BAD_DURATION, far, name), f"{name} of {far:g} is not BAD_DURATION")


@moving_case(564, "6.10", "the distance of the first pose: its bound, where there is one")
def distance(peer: Peer) -> None:
    here = standby(peer).X_BT_cmd

    def ask(metres: float) -> Acknowledgement:
        return reference_reason(peer, moved(here, dz=metres))

    if not require_edge(ask, Reason.TOO_FAR, 100.0, "a distance", ROUNDED):
        raise Unsupported("100 m away is not TOO_FAR: this controller has no such limit")


@moving_case(
    565, "6.10", "the workspace: the bounds of its coordinates, as far as a straight way leads there"
)
def workspace(peer: Peer) -> None:
    here = standby(peer).X_BT_cmd
    found = 0
    for axis in range(3):

        def ask(place: float, axis: int = axis) -> Acknowledgement:
            p_m = tuple(place if k == axis else each for k, each in enumerate(here.p_m))
            return reference_reason(peer, here._replace(p_m=(p_m[0], p_m[1], p_m[2])))

        for sign in (-1.0, 1.0):
            ways = (0.5, 1.0, 1.5, 2.0, 2.5, 2.9, 5.0, 10.0)
            found += any(
                require_edge(ask, Reason.OUTSIDE_WORKSPACE, here.p_m[axis] + sign * way, "a place", 1e-6)
                for way in ways
            )
    if not found:
        raise Unsupported("along no axis of B it is the workspace that ends")


@moving_case(566, "6.10", "the range of the last joint: its bound")
def joint_limit(peer: Peer) -> None:
    state = standby(peer)
    here, joint = state.X_BT_cmd, state.q_cmd[5]

    def ask(angle: float) -> Acknowledgement:
        return reference_reason(peer, turned(here, angle - joint))

    got = ask(joint + 3.0)
    if got.reason is not Reason.JOINT_LIMIT:
        raise Unsupported(f"a turn of 3 rad about the last joint's axis is {got.reason.name}")
    bound, side = abs(got.limit - joint), 1e-4
    beyond = reference_reason(peer, turned(here, bound + side))
    require(beyond.reason is Reason.JOINT_LIMIT and beyond.limit == got.limit, f"just beyond: {beyond}")
    require(abs(beyond.value - got.limit) < 0.1, f"just beyond the bound: value {beyond.value:g}")
    expect_reason(
        reference_reason(peer, turned(here, bound - side)), Reason.ACCEPTED, "just within the bound"
    )


@moving_case(
    441, "1.5", "the norm of a quaternion: beyond 0.001 off 1 it is refused, within it is normalised"
)
def norms(peer: Peer) -> None:
    here = standby(peer).X_BT_cmd
    here = scaled(here, 1.0 / here.quaternion_norm())
    for off in (-1.0, -0.5, -1e-3 - 1e-6, 1e-3 + 1e-6, 1.0, 1e150):
        got = reference_reason(peer, scaled(here, 1.0 + off))
        expect_reason(got, Reason.NOT_UNIT_QUATERNION, f"a norm of {1.0 + off}")
        note = math.isclose(got.value, 1.0 + off, abs_tol=ROUNDED) and got.limit == 1.0
        require(note, f"a norm of {1.0 + off}: value {got.value}, limit {got.limit}")
    for off in (-1e-3 + 1e-6, 1e-3 - 1e-6, -2.0):
        expect_reason(
            reference_reason(peer, scaled(here, 1.0 + off)), Reason.ACCEPTED, f"a norm of {1.0 + off}"
        )
        pose = peer.state().X_BT_cmd
        norm, turn = pose.quaternion_norm(), sum(a * b for a, b in zip(pose.q_wxyz, here.q_wxyz, strict=True))
        good = abs(norm - 1.0) < 1e-6 and abs(turn) > 1.0 - 1e-6
        require(good, f"it is followed with a norm of {norm:.7f}, or turned")
