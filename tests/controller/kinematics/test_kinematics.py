"""Kinematics against Pinocchio, built from the drawings (axes, points), not from the DH table."""

import math

import numpy as np
import pinocchio as pin
import pytest

from controller.core.kinematics.denavit_hartenberg import chain, damped_inverse, geometric_jacobian, tool_pose
from controller.core.kinematics.inverse_kinematics import REACHED, TOO_FAR, joint_angles
from controller.core.kinematics.rotations import Array
from nominal_arm.description import NominalArm

START = np.radians([0.0, 50.0, -75.0, 0.0, -25.0, 0.0])
EXTENSION_M = 1.0


def drawn_arm() -> tuple[pin.Model, pin.Data, int]:
    """The arm by joint axes and points at q = 0, where lift and tilt links are level and point along x."""
    pivots = np.array(
        [
            [0.0, 0.0, 0.0],
            [-0.18926, 0.0, 0.85],
            [-0.18926 + 1.59687, 0.0, 0.85 + 0.100002],
            *[[-0.18926 + 1.59687 + 1.99949 + EXTENSION_M, 0.0, 0.85 + 0.100002 + 0.15264]] * 3,
        ]
    )
    axes = np.array([[0, 0, 1], [0, -1, 0], [0, -1, 0], [1, 0, 0], [0, 1, 0], [-1, 0, 0]], dtype=float)
    model = pin.Model()
    parent, origin = 0, np.zeros(3)
    for i in range(6):
        placement = pin.SE3(np.eye(3), pivots[i] - origin)
        parent = model.addJoint(parent, pin.JointModelRevoluteUnaligned(axes[i]), placement, f"joint{i}")
        origin = pivots[i]
    R = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    tool = pin.SE3(R, np.array([0.35, 0.0, 0.0]))
    frame = model.addFrame(pin.Frame("T", parent, 0, tool, pin.FrameType.OP_FRAME))
    return model, model.createData(), frame


@pytest.fixture(scope="module")
def oracle() -> tuple[pin.Model, pin.Data, int]:
    return drawn_arm()


def test_spot_checks_of_the_drawing(arm: NominalArm, table: Array) -> None:
    X_BT = tool_pose(table, START)
    assert X_BT[:3, 3] == pytest.approx([3.89355, 0.0, 1.00825], abs=5e-6)
    assert X_BT[:3, :3] == pytest.approx(np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]]), abs=1e-12)
    short = table.copy()
    short[3, 3], short[5, 3] = 1.99949 + 0.5, 0.0
    tip = tool_pose(short, np.radians([0.0, 45.0, -90.0, 0.0, 0.0, 0.0]))[:3, 3]
    assert tip == pytest.approx([2.7445, 0.0, 0.3904], abs=5e-5)


def test_forward_kinematics_equals_pinocchio(table, joint_range, oracle) -> None:
    model, data, frame = oracle
    rng = np.random.default_rng(1)
    for _ in range(500):
        q = rng.uniform(*joint_range)
        pin.framesForwardKinematics(model, data, q)
        assert np.abs(tool_pose(table, q) - data.oMf[frame].homogeneous).max() < 1e-9


def test_jacobian_equals_pinocchio(table, joint_range, oracle) -> None:
    model, data, frame = oracle
    rng = np.random.default_rng(2)
    for _ in range(200):
        q = rng.uniform(*joint_range)
        want = pin.computeFrameJacobian(model, data, q, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        assert np.abs(geometric_jacobian(chain(table, q)) - want).max() < 1e-9


def test_damping_is_exactly_zero_away_from_singularities(table) -> None:
    J = geometric_jacobian(chain(table, START))
    inverse, least, square = damped_inverse(J, 0.05, 0.1)
    assert square == 0.0
    assert least == pytest.approx(np.linalg.svd(J)[1][-1])
    assert np.abs(inverse @ J - np.eye(6)).max() < 1e-12


def test_damping_grows_smoothly_to_its_maximum_at_the_wrist_singularity(table) -> None:
    squares, norms = [], []
    for wrist2_deg in np.linspace(10.0, 0.0, 101):
        q = START.copy()
        q[4] = math.radians(wrist2_deg)
        inverse, _, square = damped_inverse(geometric_jacobian(chain(table, q)), 0.05, 0.05)
        squares.append(square)
        norms.append(np.linalg.norm(inverse, 2))
    assert squares[0] == 0.0
    assert squares[-1] == pytest.approx(0.05**2)
    assert np.all(np.diff(squares) >= 0.0)
    assert np.abs(np.diff(squares)).max() < 1.5e-4  # no step at the onset
    assert max(norms) < 1.0 / 0.05  # a bare inverse would be without bound


def test_inverse_kinematics_undoes_forward_kinematics(table, joint_range) -> None:
    rng = np.random.default_rng(4)
    tried = 0
    while tried < 500:
        q = rng.uniform(*joint_range)
        frames = chain(table, q)
        if np.cos(q[0]) * frames[4, 0, 3] + np.sin(q[0]) * frames[4, 1, 3] < 0.1:
            continue  # the wrist centre behind the slew axis is outside the workspace
        tried += 1
        branch = q + np.where(np.arange(6) == 4, 0.0, rng.normal(0.0, 0.1, 6))
        verdict, found, _, _ = joint_angles(table, frames[7, :, :3].copy(), frames[7, :, 3].copy(), branch)
        assert verdict == REACHED
        assert found == pytest.approx(q, abs=1e-9)


def test_inverse_kinematics_at_the_wrist_singularity_keeps_wrist_1(table) -> None:
    q = np.radians([10.0, 40.0, -70.0, 20.0, 0.0, -30.0])
    frames = chain(table, q)
    verdict, found, _, _ = joint_angles(table, frames[7, :, :3].copy(), frames[7, :, 3].copy(), q)
    assert verdict == REACHED
    assert found == pytest.approx(q, abs=1e-7)


def test_inverse_kinematics_names_distance_and_reach(table) -> None:
    R = tool_pose(table, START)[:3, :3].copy()
    verdict, _, distance, reach = joint_angles(table, R, np.array([9.0, 0.0, 0.85]), START)
    assert verdict == TOO_FAR
    assert distance == pytest.approx(9.0 - 0.35 + 0.18926)
    assert reach == pytest.approx(math.hypot(1.59687, 0.100002) + math.hypot(0.15264, 2.99949))
    verdict, _, distance, reach = joint_angles(table, R, np.array([0.3, 0.0, 0.85]), START)
    assert verdict == TOO_FAR
    assert distance < reach == pytest.approx(math.hypot(0.15264, 2.99949) - math.hypot(1.59687, 0.100002))
