"""What odometry of recordings finds out about the camera: rows that are off; and that
nothing which moves is followed.
"""

import numpy as np
import pytest

from tests.vision_pc.odometry.test_odometry import pair_at
from tests.vision_pc.rendering import cropped, wall_texture
from vision_pc.config.vision import VisionConfig
from vision_pc.core import se3
from vision_pc.core.odometry.segments import SegmentedOdometry, straightened
from vision_pc.core.perception import intrinsics
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, PointPairs, StereoPair
from vision_pc.shell.cameras.sequence import follow_pairs


@pytest.fixture(scope="module")
def camera(config: VisionConfig) -> CameraCalibration:
    return cropped(intrinsics.calibration(config.camera))


@pytest.fixture
def points(generator: np.random.Generator) -> Array:
    return generator.uniform((-1.0, -0.6, 1.2), (1.0, 0.6, 2.5), (150, 3))


@pytest.mark.parametrize(("rows_px", "turn_rad"), [(0.3, 0.0), (-1.2, 2e-3)])
def test_rows_are_straightened_from_one_pair(
    camera: CameraCalibration,
    points: Array,
    generator: np.random.Generator,
    rows_px: float,
    turn_rad: float,
) -> None:
    truly = intrinsics.with_offset(camera, 0.0, rows_px)
    turned = truly.right.X_CE @ se3.transform(se3.exp_so3([0.0, 0.0, turn_rad]), np.zeros(3))
    truly = truly._replace(right=truly.right._replace(X_CE=turned))
    seen = [intrinsics.project(eye, points) for eye in (truly.left, truly.right)]
    seen[1] += generator.normal(0.0, 0.05, seen[1].shape)
    seen[1][:10, 1] += 3.0  # mismatches
    found = straightened(camera, PointPairs(*seen)).right
    assert found.K[1, 2] - camera.right.K[1, 2] == pytest.approx(rows_px, abs=0.03)
    assert se3.log_so3(found.X_CE[:3, :3])[2] == pytest.approx(turn_rad, abs=1e-4)
    few = PointPairs(seen[0][:10], seen[1][:10])
    assert straightened(camera, few) is camera


def test_no_pose_of_two_motions_is_believed(camera: CameraCalibration, config: VisionConfig) -> None:
    """A thing over 60 % of the picture from the first pair on: no pose is a compromise."""
    texture = wall_texture(1, 22.0, 1000)
    pairs = []
    for k in range(4):
        X = se3.transform(np.eye(3), (0.004 * k, 0.0, 0.0))
        Y = X @ se3.transform(np.eye(3), (-0.05 * k, 0.02 * k, 0.0))
        rest, part = (pair_at(camera, texture, place, z=z, seed=k) for place, z in ((X, 1.5), (Y, 1.2)))
        left, right = (
            np.hstack([b[:, :384], a[:, 384:]]) for a, b in ((rest.left, part.left), (rest.right, part.right))
        )
        pairs.append(StereoPair(left, right, k, k))
    result = follow_pairs(lambda: pairs, lambda _: SegmentedOdometry(camera, config.odometry_of_recordings))
    assert set(result.losses) == {"two_motions"}
    assert all(len(result.poses_of(k)) <= 1 for k in range(len(result.joints)))
