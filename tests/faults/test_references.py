"""Faults 12 to 17: references and datagrams that cannot be meant, judged at the plant's registers."""

import math
from collections.abc import Callable
from functools import cache

import pytest

from protocol.faults import GroupState, Reason
from protocol.pose import Pose
from protocol.process_image import ValveImage
from protocol.reference_messages import Acknowledgement, ReferencePath, ReferencePose
from tests.faults.rig import FaultRig

DENORMAL = 5e-324
Meant = Callable[[FaultRig], ReferencePose | ReferencePath]


@cache
def left_alone(moving: bool) -> list[ValveImage]:
    """The images of a rig that is never asked anything odd."""
    rig = FaultRig().moving() if moving else FaultRig().enabled()
    rig.run(0.6)
    return [row.image for row in rig.registers.written]


def refused(make: Meant, *, moving: bool = False) -> Acknowledgement:
    """The answer to a reference that must change nothing: every image is that of a rig never asked."""
    rig = FaultRig().moving() if moving else FaultRig().enabled()
    answer = rig.ask(make(rig))
    rig.run(0.3)
    images = [row.image for row in rig.registers.written]
    assert images == left_alone(moving)[: len(images)]
    assert answer.reason is not Reason.ACCEPTED
    assert rig.state.group_state is (GroupState.MOVING if moving else GroupState.STANDBY)
    return answer


def at(place: int, number: float) -> Meant:
    """A pose with one of its seven numbers replaced."""

    def make(rig: FaultRig) -> ReferencePose:
        numbers = [*rig.shifted(z=0.05).p_m, *rig.shifted().q_wxyz]
        numbers[place] = number
        return ReferencePose(0, Pose(tuple(numbers[:3]), tuple(numbers[3:])), 0.0)  # type: ignore[arg-type]

    return make


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf, DENORMAL, -1e-310])
def test_case_12_nan_inf_and_denormals_are_refused_and_the_arm_holds(number: float) -> None:
    rig = FaultRig().enabled()
    for place in range(7):
        assert rig.ask(at(place, number)(rig)).reason is Reason.NOT_FINITE
    images = [row.image for row in rig.registers.written]
    assert images == left_alone(False)[: len(images)]


def scaled(factor: float) -> Meant:
    """A pose whose quaternion has this norm."""

    def make(rig: FaultRig) -> ReferencePose:
        pose = rig.shifted(z=0.05)
        w, x, y, z = (factor * part for part in pose.q_wxyz)
        return ReferencePose(0, Pose(pose.p_m, (w, x, y, z)), 2.0)

    return make


@pytest.mark.parametrize("norm", [1.0 + 1.1e-3, 1.0 - 1.1e-3, 0.0, 2.0])
def test_case_13_a_quaternion_off_its_norm_by_more_than_a_thousandth_is_refused(norm: float) -> None:
    answer = refused(scaled(norm))
    assert answer.reason is Reason.NOT_UNIT_QUATERNION
    assert answer.value == pytest.approx(norm)


def bent(how: str) -> Callable[[list[bytes]], list[bytes]]:
    """A wire that sends a spoilt copy ahead of every datagram."""

    def spoilt(data: bytes) -> bytes:
        return data[: len(data) // 2] if how == "truncated" else data[:-1] + bytes([data[-1] ^ 1])

    return lambda datagrams: [copy for data in datagrams for copy in (spoilt(data), data)]


def test_case_14_truncated_datagrams_are_dropped_and_counted() -> None:
    judge_bent("truncated")


def test_case_15_datagrams_of_a_wrong_sum_are_dropped_and_counted() -> None:
    judge_bent("bad crc")


def judge_bent(how: str) -> None:
    """Asserts that a motion over a wire that adds spoilt copies is the same image by image, and counted."""
    rig = FaultRig()
    server = rig.world.controller._server
    before = server.statistics.received
    rig.world.to_controller = bent(how)
    rig.moving()
    rig.run(0.3)
    images = [row.image for row in rig.registers.written]
    assert images == left_alone(True)[: len(images)]
    assert server.statistics.refused == server.statistics.received - before > 5
    assert rig.state.references_dropped >= server.statistics.refused - 3


def test_case_16_a_path_with_one_unreachable_waypoint_is_refused_whole() -> None:
    def make(rig: FaultRig) -> ReferencePath:
        near, far = rig.shifted(z=0.05), rig.shifted(x=1.0, z=1.5)
        return ReferencePath(0, (near, far, near), 0.0, 0.0)

    answer = refused(make)
    assert answer.reason in (Reason.UNREACHABLE, Reason.JOINT_LIMIT, Reason.OUTSIDE_WORKSPACE)
    assert answer.value != answer.limit
    assert refused(make, moving=True).reason is answer.reason


def test_case_17_a_jump_is_refused_with_the_measured_jump() -> None:
    answer = refused(lambda rig: ReferencePose(0, rig.shifted(x=-3.0, z=1.0), 0.0))
    assert answer.reason is Reason.TOO_FAR
    assert answer.value == pytest.approx(math.hypot(3.0, 1.0), abs=1e-3)
    assert answer.limit == 3.0
