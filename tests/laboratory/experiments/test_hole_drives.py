"""Hole drives: the arm can be at every drawn hole, and what was not reached counts as outside."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest

from controller.core.kinematics.denavit_hartenberg import dh_table, tool_pose
from controller.core.kinematics.inverse_kinematics import REACHED, joint_angles
from laboratory.campaigns.campaign import CampaignRequest
from laboratory.campaigns.experiment import Finished
from laboratory.campaigns.rows import typed
from laboratory.experiments.targets import hole_drives
from laboratory.experiments.targets.hole_drives import (
    HoleDriveRow,
    HoleDriveSettings,
    HoleEnd,
    hole_drive,
    hole_drive_table,
    hole_drive_verdict,
    hole_scenario,
)
from plant_emulator.core.camera.scene import R_WO_FACING_ARM
from plant_emulator.core.camera.wall.bores import hole_places
from tests.support.paths import CONFIGS
from vision_pc.core import se3
from vision_pc.core.targets.sighting import Click
from vision_pc.core.targets.target import TargetRefused

REQUEST = CampaignRequest(CONFIGS, Path("nowhere"), runs=2, seed=7)


@pytest.mark.parametrize(("seed", "holes"), [(45666, 1), (5023, 9)])
def test_the_arm_can_be_at_every_hole_that_is_driven_to_as_the_tool_stands(seed: int, holes: int) -> None:
    task = {"seed": seed, "world": "lab", "arm": "plant", "holes": holes, "assignments": []}
    settings = hole_scenario(CONFIGS, task)
    start, table = np.radians(settings.plant.start_pose_deg), dh_table(settings.arm.dh)
    X_WT, mount = tool_pose(table, start), settings.scene.mount
    at, joints, box = settings.scene.object_of_interest, settings.arm.joints, settings.arm.workspace
    R_WO = R_WO_FACING_ARM @ se3.exp_so3(np.radians(at.tilt_deg))
    clearance = X_WT[:3, :3] @ se3.exp_so3(np.radians(mount.rotation_deg)) @ np.array([0.0, 0.0, 0.1])
    for place in hole_places(settings.scene.wall)[:holes]:
        goal = R_WO @ place + np.array(at.position_m) - clearance
        verdict, q, _, _ = joint_angles(table, X_WT[:3, :3].copy(), goal, start)
        assert verdict == REACHED
        assert abs(q[4]) > np.radians(5.5), "the wrist is stretched: the controller would refuse it"
        assert all(
            joint.lower_deg < a < joint.upper_deg for joint, a in zip(joints, np.degrees(q), strict=True)
        )
        assert all(low < x < high for x, (low, high) in zip(goal, (box.x_m, box.y_m, box.z_m), strict=True))


def test_a_hole_that_was_not_reached_is_outside() -> None:
    good = {"worst_mm": 1.0, "x_mm": 1.0, "y_mm": 0.5, "told": 0.99, "seconds": 25.0}
    cells = {"seed": 1, "world": "lab", "holes": 2}
    cells |= {f"hole{number}_{name}": value for number in (1, 2) for name, value in good.items()}
    rows = [typed(HoleDriveRow, cells) for _ in range(199)]
    failed = typed(HoleDriveRow, {"seed": 2, "world": "lab", "failure": "target.no_hole: none"})
    settings = HoleDriveSettings(holes=2)

    def met(rows: list[HoleDriveRow]) -> list[bool | None]:
        return [check.met for check in hole_drive_verdict(Finished(REQUEST, settings, (), rows, 0))]

    assert met([*rows, rows[0]]) == [True, None, True, None]
    assert met([*rows, failed]) == [True, None, True, None]
    assert met([*rows, *[failed] * 5])[0] is False
    one = typed(HoleDriveRow, cells | {"hole2_worst_mm": None, "hole2_failure": "target.hidden: x"})
    assert met([*rows, *[one] * 10])[2] is False
    assert hole_drive_table(Finished(REQUEST, settings, (), rows, 0))[0].row_count == 3


class PassedBy:
    """A rig whose holes (of three in a row) are seen from some of the stops only; one click is refused."""

    SEEN = ([0, 1], [1, 2], [1], [0])  # from the start, and after each drive

    def __init__(self, *_: object) -> None:
        plant = SimpleNamespace(truth=lambda: SimpleNamespace(R_CO=np.eye(3), p_CO=np.zeros(3)))
        self.world = SimpleNamespace(plant=plant)
        self.camera, self.stop, self.refusals = self, 0, 1

    def command(self, _: str) -> None:
        """Enabled."""

    def holes(self) -> list[tuple[Any, Any]]:
        return [(np.array([hole, 0.0]), PLACES[hole]) for hole in self.SEEN[self.stop]]

    async def target_at(self, click: Click, _: None) -> SimpleNamespace:
        hole = int(click.pixel[0])
        if hole == 1 and self.refusals:
            self.refusals = 0
            raise TargetRefused("target.hidden", "target: the tool is before it")
        return SimpleNamespace(id=f"t{hole}")


PLACES = np.array([[0.2 * number, 0.0, 1.0] for number in range(3)])


def test_a_hole_that_is_seen_on_the_way_alone_is_driven_to(monkeypatch: pytest.MonkeyPatch) -> None:
    def visited(rig: PassedBy, target: str, _: object) -> HoleEnd:
        rig.stop += 1
        return HoleEnd(known=target)

    for name, fake in (("LockstepRig", PassedBy), ("hole_scenario", lambda *_: MagicMock()),
                       ("hole_places", lambda _: PLACES), ("_drive_to_hole", visited)):  # fmt: skip
        monkeypatch.setattr(hole_drives, name, fake)
    asked = {"seed": 1, "world": "lab", "arm": "plant", "holes": 3}
    driven = hole_drive(CONFIGS, asked)
    assert [driven[f"hole{number}"].known for number in (1, 2, 3)] == ["t0", "t1", "t2"]
    assert driven["seen"] == 3
    monkeypatch.setattr(PassedBy, "SEEN", ([0, 1], [1], [1], [0]))
    assert hole_drive(CONFIGS, asked)["hole3"].failure == "target.no_hole"
