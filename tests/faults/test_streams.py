"""Faults 1 to 4 and 10 of a streamed motion at 60 Hz, judged at the plant's registers and its true spools."""

import math

import numpy as np
import pytest

from protocol.datagram_layout import Kind
from protocol.faults import CommandCode, FaultCode, GroupState, Reason
from protocol.pose import Pose
from protocol.reference_messages import Command, StreamedPose
from tests.faults.registers import assert_driving, shut_since
from tests.faults.rig import MS, FaultRig

RATE_HZ = 60.0
REACH_M = 0.1
OMEGA = 0.9  # rad/s
_KIND_AT = 6


class StreamingRig(FaultRig):
    """A rig that follows a slow sway across, streamed at 60 Hz; the wire counts the references."""

    def __init__(self) -> None:
        super().__init__()
        self.enabled()
        self._start = self.state.X_BT_cmd
        answer = self.ask(Command(0, CommandCode.START_STREAM))
        assert answer.reason is Reason.ACCEPTED
        self.stream_id = answer.command_id
        self._began_ns = self.now_ns
        self.sent = 0
        self.last_through_ns = 0

    def lose(self, lost: object) -> None:
        """From now on references for which ``lost(number)`` holds, 1 the next one, do not come through."""
        first = self.sent

        def wire(datagrams: list[bytes]) -> list[bytes]:
            passed = []
            for data in datagrams:
                if data[_KIND_AT] == Kind.STREAMED_POSE:
                    if lost(self.sent - first):  # type: ignore[operator]
                        continue
                    self.last_through_ns = self.now_ns
                passed.append(data)
            return passed

        self.world.to_controller = wire

    def stream(self, seconds: float) -> None:
        """Time passes, with references that are sent when they are due."""
        end_ns = self.now_ns + round(seconds * 1e9)
        while self.now_ns < end_ns:
            t = (self.now_ns - self._began_ns) / 1e9
            if t * RATE_HZ >= self.sent and self.world.link.connected:
                self.sent += 1
                sway, speed = REACH_M * math.sin(OMEGA * t), REACH_M * OMEGA * math.cos(OMEGA * t)
                x, y, z = self._start.p_m
                reference = StreamedPose(
                    self.stream_id,
                    self.sent,
                    self.world.vision_ns,
                    Pose((x, y + sway, z), self._start.q_wxyz),
                    (0.0, speed, 0.0, 0.0, 0.0, 0.0),
                )
                self.world.link.stream(reference)
            self.world.clock.advance()

    def assert_following(self) -> None:
        """Asserts that the arm moves, driven through the registers, without a fault."""
        assert (self.state.group_state, self.state.fault) == (GroupState.MOVING, FaultCode.NONE)
        assert_driving(self.registers, self.now_ns - 100 * MS)
        tool = [row.X_WT[:3, 3] for row in self.world.truths if row.time_ns > self.now_ns - 500 * MS]
        assert np.linalg.norm(tool[-1] - tool[0]) > 0.005


def test_case_01_a_stream_that_stops_is_safe_within_130_ms() -> None:
    rig = StreamingRig()
    rig.lose(lambda _: False)
    rig.stream(1.2)  # in mid sway: it turns round after 1.75 s
    rig.assert_following()
    rig.lose(lambda _: True)
    rig.stream(0.4)
    shut_ms = (shut_since(rig.registers) - rig.last_through_ns) / MS
    assert 0.0 < shut_ms <= 130.0
    rig.lose(lambda _: False)
    rig.stream(0.5)  # references come again: nothing follows them
    assert (shut_since(rig.registers) - rig.last_through_ns) < 0
    rig.assert_safe(FaultCode.REFERENCE_STALE, rig.now_ns - 400 * MS, 0.0)
    assert rig.command(CommandCode.RESET) is Reason.ACCEPTED


def test_case_02_2_percent_loss_at_60_hz_is_completed_and_counted() -> None:
    rig = StreamingRig()
    draws = np.random.default_rng(1).random(1000) < 0.02
    rig.lose(lambda number: bool(draws[number]))
    rig.stream(6.0)
    rig.assert_following()
    lost = int(draws[1 : rig.sent + 1].sum())
    assert lost >= 4
    assert rig.state.references_lost == pytest.approx(lost, abs=1)
    assert rig.command(CommandCode.STOP) is Reason.ACCEPTED
    rig.run(1.0)
    assert (rig.state.group_state, rig.state.fault) == (GroupState.STANDBY, FaultCode.NONE)


def test_case_03_a_burst_of_4_lost_goes_on() -> None:
    rig = StreamingRig()
    rig.lose(lambda number: number % 40 in (10, 11, 12, 13))
    rig.stream(4.0)
    rig.assert_following()
    assert rig.state.references_lost >= 20


def test_case_04_a_burst_of_86_lost_is_safe() -> None:
    rig = StreamingRig()
    rig.lose(lambda number: 60 < number <= 146)
    rig.stream(1.1)
    last_ns = rig.last_through_ns
    rig.stream(2.0)
    assert rig.sent > 150  # the burst is over, and references come again
    assert (shut_since(rig.registers) - last_ns) / MS <= 130.0
    assert rig.state.fault is FaultCode.REFERENCE_STALE
    rig.assert_safe(FaultCode.REFERENCE_STALE, last_ns, 0.1)
