"""Drawn walls are what they say, and the verdict over their rows counts what was not told."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
import typer

from controller.core.kinematics.denavit_hartenberg import dh_table, tool_pose
from controller.core.kinematics.inverse_kinematics import REACHED, joint_angles
from laboratory.campaigns.campaign import CampaignRequest
from laboratory.campaigns.experiment import Finished
from laboratory.campaigns.rows import typed
from laboratory.experiments.targets import hole_drives
from laboratory.experiments.targets.drawn_walls import Aspect, drawn_wall
from laboratory.experiments.targets.hole_drives import (
    HoleDriveRow,
    HoleDriveSettings,
    HoleEnd,
    hole_drive,
    hole_drive_table,
    hole_drive_verdict,
    hole_scenario,
)
from laboratory.experiments.targets.one_look import (
    TARGETS,
    TargetSceneSettings,
    target_table,
    target_tasks,
    target_verdict,
)
from laboratory.experiments.targets.one_target import TargetRow, one_target, target_error
from plant_emulator.core.camera.scene import R_WO_FACING_ARM
from plant_emulator.core.camera.wall.bores import hole_places
from tests.support.paths import CONFIGS
from vision_pc.core import se3
from vision_pc.core.perception import intrinsics
from vision_pc.core.targets.measuring import at_click
from vision_pc.core.targets.sighting import Click
from vision_pc.core.targets.target import TargetObservation, TargetRefused

REQUEST = CampaignRequest(CONFIGS, Path("nowhere"), runs=2, seed=7)


def row(**cells: object) -> TargetRow:
    usual = {
        "row": "hole-1.0",
        "seed": 1,
        "visible": 4,
        "found": 4,
        "false": 0,
        "refused": "",
        "measure_ms": 9.0,
    }
    errors = {"lateral_mm": 0.2, "depth_mm": 1.0, "normal_deg": 0.5}
    errors |= {"nees": 1.0, "nees_lateral": 1.0, "nees_depth": 1.0, "nees_normal": 1.0}
    both = {f"{which}_{name}": value for which in ("seen", "known") for name, value in errors.items()}
    return typed(TargetRow, usual | both | cells)


def finished(rows: list[TargetRow]) -> Finished[TargetSceneSettings, TargetRow]:
    return Finished(REQUEST, TargetSceneSettings(), (), rows, 0)


def test_a_drawn_wall_is_true_where_it_says_and_what_is_told_of_it_is_near() -> None:
    wall = drawn_wall(CONFIGS, 20, Aspect(1.0), {})
    X = wall.aim
    pixel = intrinsics.project(wall.known.camera.left, X[None, :3, 3])[0]
    assert np.abs(pixel - wall.pixel).max() < 0.35  # of the ring's mean height, not the middle's
    assert wall.whole[0]
    assert np.linalg.norm(wall.places[0] - X[:3, 3]) < 1e-9
    seen = at_click(wall.known, Click("left", wall.pixel, "hole"))
    error = target_error(seen, X, seen.covariance)
    assert error.lateral_mm < 0.8
    assert abs(error.depth_mm) < 2.0
    assert error.normal_deg < 3.0


def test_errors_are_told_across_along_and_of_the_normal() -> None:
    wall_X = se3.transform(np.diag([1.0, -1.0, -1.0]), [0.0, 0.0, 1.0])
    seen = typed_target(se3.transform(np.diag([1.0, -1.0, -1.0]), [0.003, 0.004, 1.002]))
    covariance = np.diag([9e-6, 16e-6, 4e-6, 1e-4, 1e-4, 1e-6])
    error = target_error(seen, wall_X, covariance)
    assert error.lateral_mm == pytest.approx(5.0)
    assert error.depth_mm == pytest.approx(2.0)
    assert (error.nees_lateral, error.nees_depth) == (pytest.approx(1.0), pytest.approx(1.0))
    assert error.nees_normal == pytest.approx(0.0)
    assert error.nees == pytest.approx(3.0 / 5.0)


def typed_target(X: se3.Array) -> TargetObservation:
    return TargetObservation("hole", X, np.eye(6), np.zeros((6, 6)), 1.0, np.zeros((4, 2)), 0.045)


def test_the_same_seeds_make_every_row_and_an_unknown_row_is_refused() -> None:
    tasks = target_tasks(REQUEST, TargetSceneSettings(only=["bare", "hole-2.0"]))
    assert [task["key"] for task in tasks] == ["bare-7", "bare-8", "hole-2.0-7", "hole-2.0-8"]
    with pytest.raises(typer.BadParameter, match="no row 'moon'"):
        target_tasks(REQUEST, TargetSceneSettings(only=["moon"]))


def test_what_was_refused_counts_as_not_told_and_a_wrong_answer_fails() -> None:
    good = [row() for _ in range(98)]
    checks = {check.what: check for check in target_verdict(finished(good))}
    assert all(check.met for check in checks.values())
    refused = typed(TargetRow, {"row": "hole-1.0", "refused": "target.not_round", "visible": 4, "found": 3,
                                "false": 3, "measure_ms": 9.0})  # fmt: skip
    checks = {check.what: check for check in target_verdict(finished([*good, refused, refused]))}
    failed = {what for what, check in checks.items() if check.met is False}
    assert failed == {"hole, 1 m: told", "false holes a picture, of 100"}
    assert checks["hole, 1 m: found of 400 visible"].found == "0.995"
    bare = [row(row="bare", wrong=False, refused="target.low_texture"), row(row="bare", wrong=True)]
    checks = {check.what: check for check in target_verdict(finished(bare))}
    assert checks["click on a bare wall, 2: wrong answers"].met is False
    assert target_table(finished([*good, refused]))[0].row_count == 1
    assert not target_table(finished(bare))
    assert TARGETS.runs == 200


@pytest.mark.slow("walls are drawn")
def test_what_must_be_refused_is_clicked_as_on_the_console_and_a_hole_there_is_wrong(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    board = {"row": "repetitive", "seed": 3000}
    assert one_target(CONFIGS, board)["refused"] == "target.ambiguous"
    at_a_hole = drawn_wall(CONFIGS, 20, Aspect(1.0), {})
    hole = at_click(at_a_hole.known, Click("left", at_a_hole.pixel, "hole"))
    clicked: list[Click] = []

    def believing(_: object, click: Click) -> TargetObservation:
        clicked.append(click)
        return hole

    monkeypatch.setattr("laboratory.experiments.targets.one_target.at_click", believing)
    assert one_target(CONFIGS, board)["wrong"]
    assert {click.kind for click in clicked} == {"auto"}


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
