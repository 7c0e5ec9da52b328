"""Guided sessions on an arm whose encoder zeros are wrong: what its nominal model lets one know."""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.stats import chi2

from controller.core.kinematics.denavit_hartenberg import dh_table, tool_pose
from controller.core.kinematics.inverse_kinematics import joint_angles
from nominal_arm.dimensions import dimensions
from protocol.errors import MeasurementFailed
from tests.vision_pc.hand_eye.still_rig import START_RAD as START
from tests.vision_pc.hand_eye.still_rig import still_settings
from vision_pc.config.hand_eye import ArmUncertainty
from vision_pc.core import se3
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.guided import nominal_model, shared_errors
from vision_pc.core.hand_eye.guided import solution as guided_solution
from vision_pc.core.hand_eye.guided import views as guided_views
from vision_pc.core.hand_eye.guided.session import Sample, Session
from vision_pc.core.hand_eye.guided.views import Surroundings
from vision_pc.core.hand_eye.solvers import methods
from vision_pc.core.hand_eye.solvers.maximum_likelihood import predicted
from vision_pc.core.perception import intrinsics
from vision_pc.core.se3 import Array

SETTINGS = still_settings()
GUIDED = SETTINGS.vision.hand_eye
LINKS, _ = dimensions(SETTINGS.arm)
CAMERA = intrinsics.calibration(SETTINGS.vision.camera)
TABLE = dh_table(SETTINGS.arm.dh)
MOUNTED = se3.transform(se3.exp_so3([0.05, -0.1, 0.03]), [0.01, -0.01, 0.02])
X_TC = guided_views.nominal_mount(GUIDED) @ MOUNTED
SEEN = np.diag(np.array([1e-4, 1e-4, 4e-4, 1.5e-3, 1.5e-3, 5e-4]) ** 2)  # of a marker's pose


def uncertainty(**changes: Any) -> ArmUncertainty:
    """What is configured, with ``changes``."""
    return GUIDED.arm.model_copy(update=changes)


NONE = (0.0,) * 6
ZEROS_ONLY = uncertainty(
    bending_mrad_m=NONE, play_mrad=NONE, link_offset_std_mm=NONE, link_tilt_std_mrad=NONE
)


class World(NamedTuple):
    """What is wrong: ``zeros`` (6,) rad to be added to the encoders, ``tool`` [δp; δθ] of the hand.

    ``play`` of each joint (rad); ``seen``: whether the marker's pose is noisy.
    """

    zeros: Array
    tool: Array
    play: Array
    seen: bool = True


def taken(rng: np.random.Generator, world: World, arm: ArmUncertainty, count: int = 17) -> Session:
    """A session in ``world`` at random views; the hand's poses by the controller's own kinematics."""
    Z = tool_pose(TABLE, START) @ X_TC @ se3.transform(np.diag([1.0, -1.0, -1.0]), [-0.05, 0.02, 0.7])
    views = guided_views.random_views(GUIDED, CAMERA, rng)
    found = [
        joint_angles(TABLE, X[:3, :3], X[:3, 3], START)
        for X in Z @ stacks.inverse(views) @ stacks.inverse(X_TC)
    ]
    reached = [q for verdict, q, _, _ in found if verdict == 0 and np.abs(q[3:]).max() < 1.5]
    q = np.stack([START, *reached])[:count]
    truly = q + world.zeros + rng.normal(size=q.shape) * world.play
    H = np.stack([se3.retract(X, _outer(X, world.tool)) for X in (tool_pose(TABLE, t) for t in truly)])
    P = predicted(H, X_TC, Z)
    if world.seen:
        P = np.stack([se3.retract(X, rng.multivariate_normal(np.zeros(6), SEEN)) for X in P])
    samples = tuple(
        Sample(str(k + 1), tool_pose(TABLE, q[k]), P[k], SEEN, np.zeros((4, 2)), 582, True, 0.0, q[k])
        for k in range(count)
    )
    around = Surroundings(CAMERA, samples[0].X_BT, ((), ()), np.zeros(3))
    settings = GUIDED.model_copy(update={"arm": arm, "principal_point_std_px": 0.0, "focal_std": 0.0})
    return Session("test", 1, settings, around, LINKS, samples)


def _outer(X: Array, twist: Array) -> Array:
    return np.concatenate([X[:3, :3] @ twist[:3], X[:3, :3] @ twist[3:]])


def off_mm(X: Array) -> float:
    return 1e3 * float(np.linalg.norm(X[:3, 3] - X_TC[:3, 3]))


def test_the_nominal_model_moves_as_the_controllers() -> None:
    q = np.random.default_rng(1).uniform(-1.2, 1.2, (5, 6))
    F = nominal_model.frames(LINKS, q)
    by_joint = nominal_model.joint_motions(F)
    for k in range(5):
        X = tool_pose(TABLE, q[k])
        assert np.allclose(F[k, -1], X, atol=1e-12)
        for joint in range(6):
            step = np.zeros(6)
            step[joint] = 1e-6
            moved = se3.local(X, tool_pose(TABLE, q[k] + step)) / 1e-6
            inside = np.concatenate([X[:3, :3].T @ moved[:3], X[:3, :3].T @ moved[3:]])
            assert np.allclose(by_joint[k, :, joint], inside, atol=1e-5)


def test_a_load_bends_the_arm_down_and_a_link_carries_what_is_beyond() -> None:
    """Bending lowers a hand that is out; a tilted last link turns the hand about that link's end."""
    arm = uncertainty(zero_std_mrad=0.0, link_offset_std_mm=NONE, link_tilt_std_mrad=(1.0,) * 6)
    columns = nominal_model.shared_errors(LINKS, arm, START[None])[0]
    X = tool_pose(TABLE, START)
    for joint, reach, stiff in ((1, 3.89 + 0.19, 1.5e-3), (2, 3.0, 6e-3)):
        assert (X[:3, :3] @ columns[:3, 8 * joint + 1])[2] == pytest.approx(-reach * reach * stiff, rel=0.12)
    about = columns[:, 8 * 4 + 5 : 8 * 5]  # tilts of wrist 2, 0.35 m behind the hand
    assert np.allclose(np.linalg.norm(about[3:], axis=0), 1e-3)
    assert np.allclose(about[:3], np.cross(about[3:].T, [0.0, 0.0, 0.35]).T, atol=1e-9)


def test_zeros_of_the_inner_joints_no_longer_move_the_camera() -> None:
    """Exact pictures, joints 2 to 5 off by up to 5 mrad: off by millimetres without the nominal model."""
    zeros = np.array([0.0, 0.004, -0.003, 0.005, -0.005, 0.0])
    world = World(zeros, np.zeros(6), np.zeros(6), seen=False)
    session = taken(np.random.default_rng(2), world, ZEROS_ONLY)
    found = guided_solution.solve(session)
    assert off_mm(methods.solve(session.pairs()).X) > 1.0
    assert off_mm(found.result.X) < 0.25
    assert np.abs(found.arm.zeros[3:5] - zeros[3:5]).max() < 3e-4
    assert np.allclose(found.pairs.H[:, :3, :3] @ found.result.X[:3, :3] @ found.pairs.P[:, :3, :3],
                       found.result.Z[:3, :3], atol=2e-3)  # fmt: skip
    assert found.arm.std[0] == pytest.approx(0.003, rel=0.02)  # it turns the target: nobody knows
    assert found.arm.std[5] == pytest.approx(0.003, rel=0.02)  # it turns the camera
    assert found.arm.std[4] < 0.0005


@pytest.mark.slow("a session is solved again and again")
def test_errors_are_what_the_covariance_says() -> None:
    """Mean NEES of 60 draws in its band, zeros, tool, play and pictures all wrong; far off by noise alone."""
    arm = uncertainty(
        bending_mrad_m=NONE, link_offset_std_mm=(*NONE[1:], 1.0), link_tilt_std_mrad=(*NONE[1:], 1.5)
    )
    runs, whole, noise = 60, [], []
    for run in range(runs):
        rng = np.random.default_rng([4, run])
        tool = rng.normal(size=6) * 1e-3 * np.repeat([1.0, 1.5], 3)
        world = World(rng.normal(size=6) * 1e-3 * arm.zero_std_mrad, tool, 1e-3 * np.array(arm.play_mrad))
        session = taken(rng, world, arm)
        pairs = session.pairs()
        samples = [session.samples[k] for k in pairs.order]
        doubts = guided_solution.doubts_of(samples, LINKS, session.settings, CAMERA.left)
        found = shared_errors.fit(pairs.H, pairs.P, np.ones(17), doubts, X_TC, pairs.H[0] @ X_TC @ pairs.P[0])
        error = se3.local(found.X, X_TC)
        whole.append(error @ np.linalg.solve(found.covariance[:6, :6], error))
        noise.append(error @ np.linalg.solve(found.by_noise, error))
    low, high = (chi2.ppf(p, 6 * runs) / runs for p in (0.005, 0.995))
    assert low < np.mean(whole) < high
    assert np.mean(noise) > 5.0 * high


def test_noise_larger_than_said_is_noticed() -> None:
    session = taken(np.random.default_rng(5), World(np.zeros(6), np.zeros(6), np.zeros(6)), uncertainty(), 30)
    surer = tuple(s._replace(covariance=s.covariance / 9.0) for s in session.samples)
    modest = replace(session, samples=surer)
    honest, louder = guided_solution.solve(session).arm, guided_solution.solve(modest).arm
    assert 0.75 < honest.camera_noise < 1.25
    assert 2.2 < louder.camera_noise < 3.6


def test_the_order_of_samples_changes_nothing_and_a_bad_one_is_left_out() -> None:
    rng = np.random.default_rng(6)
    session = taken(rng, World(rng.normal(size=6) * 0.003, np.zeros(6), np.zeros(6)), uncertainty())
    bad = session.samples[4]
    spoiled = bad._replace(X_CP=se3.retract(bad.X_CP, [0.02, 0.0, 0.01, 0.05, 0.0, 0.0]))
    session = replace(session, samples=(*session.samples[:4], spoiled, *session.samples[5:]))
    shuffled = replace(session, samples=tuple(session.samples[k] for k in rng.permutation(17)))
    one, other = guided_solution.solve(session), guided_solution.solve(shuffled)
    assert np.array_equal(one.result.X, other.result.X)
    assert np.array_equal(one.covariance, other.covariance)
    for solution in (one, other):
        result = solution.result
        assert [n for n, good in zip(result.names, result.inliers, strict=True) if not good] == [bad.name]
        worst = int(np.argmax(np.linalg.norm(result.residuals[:, :3], axis=1)))
        assert result.names[worst] == bad.name


def test_another_arms_nominal_model_is_refused() -> None:
    rng = np.random.default_rng(7)
    session = taken(rng, World(rng.normal(size=6) * 0.003, np.zeros(6), np.zeros(6)), uncertainty())
    shifted = replace(session, samples=tuple(s._replace(q=s.q + 0.01) for s in session.samples))
    with pytest.raises(MeasurementFailed, match="is not this arm's: it puts the hand of sample") as refused:
        guided_solution.solve(shifted)
    assert refused.value.cause == "measurement.hand_eye.another_arm"
