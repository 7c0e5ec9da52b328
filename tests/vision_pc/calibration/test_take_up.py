"""How each motion ends: by a short turn in the positive sense, after which the residual is measured."""

import numpy as np
import pytest

from protocol.faults import FaultCode, GroupState, Severity
from tests.vision_pc.program_settings import BOOM, shipped
from tests.vision_pc.synthetic import Q_START, forward
from vision_pc.core.calibration.boom_levers import boom_levers, joint_turns
from vision_pc.core.calibration.take_up import backlash_sides, move_with_take_up
from vision_pc.core.ports import ArmView
from vision_pc.core.se3 import Array, transform

MAP = shipped().local_map
END = forward(Q_START)
BEYOND = np.array([5e-4, 0.0, -2e-4])  # rad, of slew, lift and tilt


class RecordingArm:
    """Keeps what it is asked for; ends at ``END`` with its joints ``BEYOND`` it, and elsewhere exactly."""

    def __init__(self) -> None:
        self.references: list[Array] = []
        self.durations_s: list[float] = []

    async def move_to(self, X_BT_ref: Array, duration_s: float = 0.0) -> ArmView:
        self.references.append(X_BT_ref)
        self.durations_s.append(duration_s)
        here = X_BT_ref
        if np.array_equal(here, END):
            here = transform(END[:3, :3], END[:3, 3] + boom_levers(END, BOOM) @ BEYOND)
        q = np.zeros(6)
        state = (0, GroupState.STANDBY, FaultCode.NONE, Severity.NONE, 1, True, True)
        return ArmView(*state, q, q, here, X_BT_ref)

    async def follow(self, waypoints: list[Array], segment_s: float = 0.0, dwell_s: float = 0.0) -> ArmView:
        return [await self.move_to(X) for X in waypoints][-1]


async def test_a_motion_ends_by_a_slow_turn_of_slew_lift_and_tilt_in_the_positive_sense() -> None:
    arm, corner = RecordingArm(), transform(END[:3, :3], END[:3, 3] + [0.1, 0.0, 0.2])
    ended = await move_with_take_up(arm, [corner, END], BOOM, MAP)  # type: ignore[arg-type]
    on_the_way, before, end = arm.references
    assert on_the_way is corner
    assert end is END
    turns = joint_turns(before, END, BOOM)
    boom_rad = MAP.take_up.boom_rad
    assert turns == pytest.approx([MAP.take_up.slew_rad, boom_rad, boom_rad], rel=0.01)
    assert arm.durations_s == [0.0, 0.0, MAP.take_up.duration_s]
    assert ended.residual == pytest.approx(BEYOND, abs=1e-9)


def test_the_load_changes_sides_on_a_reversal_and_not_for_less() -> None:
    slew = np.array([0.0, 2e-3, 4e-3, 3.9e-3, 3e-3, 2e-3, 2.05e-3])
    assert backlash_sides(slew, 1e-3) == pytest.approx([0.0, -1.0, -1.0, -0.9, 0.0, 1.0, 0.95])
