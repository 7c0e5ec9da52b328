"""ATE, RPE, scale and drift of trajectories whose errors are known."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from protocol.errors import ConfigurationError
from testbed.reporting.trajectory_errors import errors_of_maps, trajectory_errors
from vision_pc.core import se3
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.se3 import Array
from vision_pc.core.types import OdometryPose

X_WC0 = se3.transform(se3.exp_so3([0.3, -0.2, 1.0]), (5.0, -2.0, 1.0))


def path(count: int = 40) -> list[Array]:
    angles = np.linspace(0.0, 2.0, count)
    return [se3.transform(se3.exp_so3([0.0, a, 0.0]), (3.0 * np.sin(a), 0.1 * a, 3.0 * a)) for a in angles]


def poses(of: list[Array]) -> list[OdometryPose]:
    return [OdometryPose(k * 100_000_000, k, X, np.eye(6), 100, 1.0, 0.1) for k, X in enumerate(of)]


def truth() -> tuple[Array, Array]:
    return 0.1 * np.arange(40) + 0.01, np.stack([X_WC0 @ X for X in path()])


def test_a_right_path_in_another_world_has_no_error() -> None:
    errors = trajectory_errors(poses(path()), *truth(), "truth")
    assert max(errors.ate_mm, errors.rpe_mm) < 1e-6
    assert errors.scale == pytest.approx(1.0, abs=1e-12)
    assert errors.drift_percent == pytest.approx(0.0, abs=1e-6)


def test_a_scale_is_found_and_is_the_drift() -> None:
    stretched = [se3.transform(X[:3, :3], 1.02 * X[:3, 3]) for X in path()]
    errors = trajectory_errors(poses(stretched), *truth(), "truth")
    assert errors.scale == pytest.approx(1.02, abs=1e-9)
    assert errors.drift_percent == pytest.approx(2.0, rel=0.05)


def test_one_jump_is_one_error_from_pose_to_pose() -> None:
    jumped = [se3.transform(X[:3, :3], X[:3, 3] + (0.5 if k >= 20 else 0.0)) for k, X in enumerate(path())]
    errors = trajectory_errors(poses(jumped), *truth(), "truth")
    assert errors.rpe_mm == pytest.approx(1e3 * 0.5 * np.sqrt(3.0) / np.sqrt(39), rel=1e-6)
    assert errors.ate_mm > 100.0


@pytest.mark.parametrize("late", [-7, -1, 0, 2, 10])
def test_a_truth_by_another_clock_is_named(late: int) -> None:
    angles = np.cumsum(0.05 + 0.03 * np.sin(0.7 * np.arange(60)))
    true = np.stack(
        [X_WC0 @ se3.transform(se3.exp_so3([0.0, a, 0.1 * a]), (a, 0.0, 3.0 * a)) for a in angles]
    )
    seen = poses(list(true))
    times_s = 0.1 * (np.arange(60) + late)
    if late == 0:
        assert trajectory_errors(seen, times_s, true, "t").rpe_deg < 1e-6
        return
    with pytest.raises(ConfigurationError, match=f"its times are {0.1 * late:g} s less"):
        trajectory_errors(seen, times_s, true, "t")


def test_a_truth_in_another_reading_is_named() -> None:
    times_s, true = truth()
    noisy = poses([se3.transform(X[:3, :3], X[:3, 3] + 1e-3 * np.sin(7.0 * k)) for k, X in enumerate(path())])
    for k, turn in enumerate(Rotation.create_group("O").as_matrix().round()):
        written = true @ se3.transform(turn, np.zeros(3))
        if np.allclose(turn, np.eye(3)):
            assert trajectory_errors(noisy, times_s, written, "t").rpe_mm < 2.0
            continue
        with pytest.raises(
            ConfigurationError, match=r"t: RPE .* mm if its rotations are of a camera with axes"
        ):
            trajectory_errors(noisy, times_s, written, f"t{k}"[:1])
    R, p = true[:, :3, :3], true[:, :3, 3]
    rolled = Rotation.from_quat(
        np.roll(Rotation.from_matrix(R).as_quat(), 1, axis=1)
    )  # w first, taken for last
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    for written, words in (
        (np.linalg.inv(true), "of the world in the camera"),
        (stacks.transform(rolled.as_matrix(), p), "quaternions are w"),
        (stacks.transform(np.swapaxes(R, -1, -2), p), "rotations are transposed"),
        (stacks.transform(R, 1e3 * p), r"in another unit \(times 0\.001\)"),
        (stacks.transform(R, p[:, [1, 0, 2]] * [1.0, 1.0, -1.0]), "positions are along y x -z of the axes"),
        (mirror @ true @ mirror, "axes are left-handed"),
    ):
        with pytest.raises(ConfigurationError, match=words):
            trajectory_errors(noisy, times_s, written, "t")


def test_what_odometry_does_wrong_is_not_the_truths_reading() -> None:
    times_s, true = truth()
    stretched = [se3.transform(X[:3, :3], 1.5 * X[:3, 3]) for X in path()]
    still = [se3.transform(np.eye(3), 1e-5 * np.sin(9.0 * k * np.arange(1.0, 4.0))) for k in range(40)]
    for found in (stretched, still, [X if k < 20 else path()[20] for k, X in enumerate(path())]):
        assert trajectory_errors(poses(found), times_s, true, "t").rpe_mm > 10.0


def test_each_map_is_judged_and_a_short_one_spoils_no_other() -> None:
    maps = {0: poses(path())[:2], 1: poses(path())[5:]}
    errors = errors_of_maps(maps, *truth(), "truth")
    assert errors[0] is None
    assert (errors[1].poses, round(errors[1].ate_mm, 6)) == (35, 0.0)
    with pytest.raises(ConfigurationError, match="do not overlap"):
        errors_of_maps({0: poses(path())[:2]}, *truth(), "truth")


def test_truth_of_another_clock_is_named() -> None:
    times, true = truth()
    with pytest.raises(ConfigurationError, match="do not overlap"):
        trajectory_errors(poses(path()), times + 1000.0, true, "truth")
