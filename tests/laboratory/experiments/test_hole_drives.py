"""Hole drives: the arm can be at every drawn hole, and what was not reached counts as outside."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from controller.core.kinematics.denavit_hartenberg import dh_table, tool_pose
from controller.core.kinematics.inverse_kinematics import REACHED, joint_angles
from laboratory.campaigns.campaign import CampaignRequest
from laboratory.campaigns.experiment import Finished
from laboratory.experiments.targets.hole_drives import (
    HoleDriveSettings,
    click_hole,
    hole_drive_tables,
    hole_drive_verdict,
    hole_scenario,
)
from plant_emulator.core.camera.scene import R_WO_FACING_ARM
from plant_emulator.core.camera.wall.bores import hole_places
from protocol.errors import MeasurementFailed
from tests.support.paths import CONFIGS
from vision_pc.core import se3
from vision_pc.core.targets.sighting import Click
from vision_pc.core.targets.target import TargetRefused

REQUEST = CampaignRequest(CONFIGS, Path("nowhere"), runs=2, seed=7)


@pytest.mark.parametrize("seed", [45666, 5023])
def test_the_arm_can_be_at_the_hole_that_is_driven_to_as_the_tool_stands(seed: int) -> None:
    task = {"seed": seed, "world": "lab", "arm": "plant", "assignments": []}
    settings = hole_scenario(CONFIGS, task)
    start, table = np.radians(settings.plant.start_pose_deg), dh_table(settings.arm.dh)
    X_WT, mount = tool_pose(table, start), settings.scene.mount
    at, joints, box = settings.scene.object_of_interest, settings.arm.joints, settings.arm.workspace
    R_WO = R_WO_FACING_ARM @ se3.exp_so3(np.radians(at.tilt_deg))
    clearance = X_WT[:3, :3] @ se3.exp_so3(np.radians(mount.rotation_deg)) @ np.array([0.0, 0.0, 0.1])
    for place in hole_places(settings.scene.wall)[:1]:
        goal = R_WO @ place + np.array(at.position_m) - clearance
        verdict, q, _, _ = joint_angles(table, X_WT[:3, :3].copy(), goal, start)
        assert verdict == REACHED
        assert abs(q[4]) > np.radians(5.5), "the wrist is stretched: the controller would refuse it"
        assert all(
            joint.lower_deg < a < joint.upper_deg for joint, a in zip(joints, np.degrees(q), strict=True)
        )
        assert all(low < x < high for x, (low, high) in zip(goal, (box.x_m, box.y_m, box.z_m), strict=True))


def test_a_hole_that_was_not_reached_is_outside() -> None:
    rows: list[dict[str, Any]] = [{"worst_mm": 1.0, "seconds": 25.0}] * 199
    failed = {"seed": 2, "failure": "target.no_hole: none"}

    def met(rows: list[dict[str, Any]]) -> list[bool | None]:
        done = Finished(REQUEST, HoleDriveSettings(), (), rows, 0)
        assert hole_drive_tables(done)[0].row_count == 1
        return [check.met for check in hole_drive_verdict(done)]

    assert met(rows) == [None, None], "fewer than 200 prove nothing"
    assert met([*rows, failed]) == [True, None]
    assert met([*rows, *[failed] * 5])[0] is False


class HolesInView:
    """A rig that sees holes 1 and 2 of three; the click on hole 1 is refused."""

    def __init__(self) -> None:
        plant = SimpleNamespace(truth=lambda: SimpleNamespace(R_CO=np.eye(3), p_CO=np.zeros(3)))
        self.world = SimpleNamespace(plant=plant)
        self.camera = self
        self.refused = {1}

    def holes(self) -> list[tuple[Any, Any]]:
        return [(np.array([hole, 0.0]), PLACES[hole]) for hole in (2, 1)]

    async def target_at(self, click: Click, _: None) -> SimpleNamespace:
        hole = int(click.pixel[0])
        if hole in self.refused:
            raise TargetRefused("target.hidden", "target: the tool is before it")
        return SimpleNamespace(id=f"t{hole}")


PLACES = np.array([[0.2 * number, 0.0, 1.0] for number in range(3)])


def test_the_first_hole_that_is_seen_and_not_refused_is_driven_to() -> None:
    rig: Any = HolesInView()
    assert click_hole(rig, PLACES) == ("t2", 2)
    rig.refused = {1, 2}
    with pytest.raises(MeasurementFailed, match="no hole is seen"):
        click_hole(rig, PLACES)
