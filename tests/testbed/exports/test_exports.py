"""The exported arm in two readers that share no line with ours: its poses; and what is refused."""

from pathlib import Path

import numpy as np
import pytest

from controller.core.kinematics.denavit_hartenberg import dh_table, tool_pose
from foundation.configuration import load
from nominal_arm.description import JOINT_NAMES, NominalArm
from testbed.exports.arm_tree import nominal_tree, roll_pitch_yaw, urdf
from tests.support.paths import CONFIGS
from tests.testbed.exports.readers import READERS, MujocoReader
from vision_pc.core.se3 import exp_so3


@pytest.mark.parametrize("arm_file", ["arm.yaml", "arms/long_crane/arm.yaml"])
def test_the_nominal_arm_has_the_controllers_poses(arm_file: str, tmp_path: Path) -> None:
    arm = load(NominalArm, CONFIGS / arm_file)
    tree, table, path = nominal_tree(arm), dh_table(arm.dh), tmp_path / "arm.urdf"
    path.write_text(urdf(tree), encoding="utf-8")
    assert MujocoReader(path).names == list(JOINT_NAMES)
    lower, upper = np.array([joint.limits for joint in tree.joints]).T
    readers = [reader(path) for reader in READERS]
    for q in np.random.default_rng(1).uniform(lower, upper, (1000, len(lower))):
        for reader in readers:
            np.testing.assert_allclose(reader.pose(q), tool_pose(table, q), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("pitch", [0.0, 0.3, np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-9])
def test_roll_pitch_and_yaw_give_the_rotation_back_also_at_gimbal_lock(pitch: float) -> None:
    for roll, yaw in np.random.default_rng(5).uniform(-3.0, 3.0, (50, 2)):
        x, y, z = (exp_so3(np.eye(3)[i] * angle) for i, angle in enumerate((roll, pitch, yaw)))
        r, p, w = roll_pitch_yaw(z @ y @ x)
        again = exp_so3([0.0, 0.0, w]) @ exp_so3([0.0, p, 0.0]) @ exp_so3([r, 0.0, 0.0])
        np.testing.assert_allclose(again, z @ y @ x, rtol=0.0, atol=4e-15)
