"""What a drive does about joints that came too far, and about those that fell short."""

import numpy as np
import pytest

from protocol.faults import FaultCode, GroupState, Severity
from tests.vision_pc.program_settings import BOOM, shipped
from tests.vision_pc.synthetic import Q_START, forward
from vision_pc.core.calibration.arm_fields import boom_levers, joint_turns
from vision_pc.core.calibration.take_up import backlash_sides, first_take_up, move_with_take_up
from vision_pc.core.ports import ArmView
from vision_pc.core.se3 import Array, transform

MAP = shipped().local_map
RESIDUAL_RAD = MAP.take_up.residual_rad
END = forward(Q_START)


class ScriptedArm:
    """Ends every motion to ``END`` with its slew as far beyond it as the script says next; others exactly."""

    def __init__(self, beyond_rad: list[float]) -> None:
        self._script = beyond_rad
        self._here, self._told = END, END
        self.to_end = self.elsewhere = 0

    async def view(self) -> ArmView:
        q = np.zeros(6)
        return ArmView(
            0, GroupState.STANDBY, FaultCode.NONE, Severity.NONE, 1, True, True, q, q, self._here, self._told
        )

    async def move_to(self, X_BT_ref: Array, duration_s: float = 0.0) -> ArmView:
        self._told = self._here = X_BT_ref
        if np.abs(joint_turns(END, X_BT_ref, BOOM)).max() < 1e-6:
            beyond = np.array([self._script[min(self.to_end, len(self._script) - 1)], 0.0, 0.0])
            self._here = transform(END[:3, :3], END[:3, 3] + boom_levers(END, BOOM) @ beyond)
            self.to_end += 1
        else:
            self.elsewhere += 1
        return await self.view()

    async def follow(self, waypoints: list[Array], segment_s: float = 0.0, dwell_s: float = 0.0) -> ArmView:
        return await self.move_to(waypoints[-1])


@pytest.mark.parametrize(
    ("beyond", "to_end", "elsewhere"),
    [
        ([0.0], 1, 1),
        ([1.8 * RESIDUAL_RAD], 1, 1),  # within its play: sent back it would go through all of that
        ([-1.8 * RESIDUAL_RAD, -1.2 * RESIDUAL_RAD, 0.0], 3, 1),  # short: the servo has more time
        ([2.2 * RESIDUAL_RAD, 0.0], 2, 2),  # farther than a servo leaves it: from behind its end, again
        ([2.3 * RESIDUAL_RAD, 2.2 * RESIDUAL_RAD], 2, 2),  # as far once more: it stays, drives expect it
        ([9.0 * RESIDUAL_RAD, 7.0 * RESIDUAL_RAD, 5.0 * RESIDUAL_RAD, 3.0 * RESIDUAL_RAD], 4, 4),
    ],
    ids=["there", "a little too far", "short", "much too far", "as far each time", "always too far"],
)
async def test_a_joint_that_came_too_far_is_never_sent_back_to_the_end(
    beyond: list[float], to_end: int, elsewhere: int
) -> None:
    arm = ScriptedArm(beyond)
    ended = await move_with_take_up(arm, [END], first_take_up(MAP), BOOM, MAP)  # type: ignore[arg-type]
    assert (arm.to_end, arm.elsewhere) == (to_end, elsewhere)
    assert ended.residual[0] == pytest.approx(beyond[-1], abs=1e-6)
    assert joint_turns(END, ended.view.X_BT, BOOM)[0] == pytest.approx(beyond[-1], abs=1e-6)  # it ends there


def test_the_load_changes_sides_on_a_reversal_and_not_for_less() -> None:
    slew = np.array([0.0, 2e-3, 4e-3, 3.9e-3, 3e-3, 2e-3, 2.05e-3])
    assert backlash_sides(slew, 1e-3) == pytest.approx([0.0, -1.0, -1.0, -0.9, 0.0, 1.0, 0.95])
