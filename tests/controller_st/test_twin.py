"""Recorded scans through both joint laws, Python's and the text's: the same spools, poses and Jacobians."""

import numpy as np
import pytest

from controller.core.kinematics.denavit_hartenberg import damped_inverse
from controller.core.kinematics.inverse_kinematics import joint_angles
from controller.core.kinematics.rotations import rows
from controller.core.servo.servo_step import tool_state
from controller.core.settings import settings_from
from controller_st.program import texts
from structured_text.program import CompiledProgram
from testbed.scenarios.scenario import load_settings
from tests.controller_st.twin import Twin, recorded_scans, worst_of
from tests.support.paths import CONFIGS

SPOOL, EXACT = 1e-9, 1e-12
SCANS = 10_000


@pytest.fixture(scope="module")
def program() -> CompiledProgram:
    shipped = load_settings(CONFIGS, {})
    return CompiledProgram(texts(shipped.arm, shipped.controller))


@pytest.mark.timeout(900)
@pytest.mark.slow("10,000 scans on the emulated oil, through both laws")
def test_both_joint_laws_make_the_same_spools_of_recorded_images(program: CompiledProgram) -> None:
    twin = Twin(recorded_scans(SCANS))
    assert len(twin.live) > 0.99 * SCANS
    assert sum(one.after.mode.name == "MOVING" for one in twin.live) > 0.2 * SCANS
    assert worst_of(program, twin) < SPOOL


@pytest.mark.slow("the program is compiled")
def test_tool_jacobian_inverse_and_joint_angles_are_the_same(program: CompiledProgram) -> None:
    shipped, rng = load_settings(CONFIGS, {}), np.random.default_rng(1)
    settings = settings_from(shipped.arm, shipped.controller)
    low, high = settings.planning.planned_range
    for _ in range(500):
        q = rng.uniform(low, high)
        angles, branch = program.new("T_LR_Joints"), program.new("T_LR_Joints")
        angles.numbers[:], branch.numbers[:] = q, q + rng.uniform(-0.1, 0.1, 6)
        python = tool_state(settings.table, q)
        text = program.call("F_LR_ToolState", aq=angles).outputs["stTool"]
        assert np.abs(text.p.numbers - python.p_BT).max() < EXACT
        assert np.abs(text.q.numbers - python.quaternion).max() < EXACT
        assert np.abs(text.aJ.numbers - python.J_BT).max() < EXACT
        inverse, least, _ = damped_inverse(python.J_BT, 0.05, 0.05)
        solved = program.call("F_LR_DampedInverse", aJ=text.aJ, fOnset=0.05, fDamping=0.05)
        assert solved.result == pytest.approx(least, abs=EXACT)
        off = np.abs(solved.outputs["aInverse"].numbers - inverse).max()
        assert off < 1e-11 * np.abs(inverse).max()
        R_BT = np.array(rows(python.quaternion))
        _, expected, _, _ = joint_angles(settings.table, R_BT, python.p_BT, branch.numbers.copy())
        found = program.call("F_LR_JointAngles", p=text.p, q=text.q, aBranch=branch)
        assert found.result
        assert np.abs(found.outputs["aq"].numbers - expected).max() < 1e-11
