"""What odometry of recordings finds out about the camera: rows that are off, a shutter that rolls; and maps
that are withdrawn.
"""

import numpy as np
import pytest

from tests.vision_pc.odometry.test_odometry import pair_at
from tests.vision_pc.rendering import cropped, wall_texture
from vision_pc.config.vision import VisionConfig
from vision_pc.core import se3
from vision_pc.core.odometry.motion_prior import MotionHistory
from vision_pc.core.odometry.rolling import PointViews, Readout
from vision_pc.core.odometry.segments import SegmentedOdometry
from vision_pc.core.odometry.straightening import straightened
from vision_pc.core.perception import intrinsics
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, PointPairs, StereoPair
from vision_pc.shell.cameras.sequence import follow_pairs

SHARE = 0.4
MOTION = se3.transform(se3.exp_so3([0.004, -0.01, 0.006]), (0.03, 0.01, 0.015))


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


def shown(
    camera: CameraCalibration, readout: Readout, points: Array, X_C0C: Array, share: float = SHARE
) -> PointViews:
    """What a camera whose rows take SHARE of the interval misses ``points`` by, its pose known."""
    rolls = Readout(camera, learns=True)
    rolls.begin(share)
    rolls.foresee(se3.identity(), MOTION)
    rolls.moved(MOTION)
    points_C = se3.apply(se3.inverse(X_C0C), points)
    rays, errors = [], []
    for eye in (camera.left, camera.right):
        in_eye = se3.apply(se3.inverse(eye.X_CE), points_C)
        straight = in_eye[:, :2] / in_eye[:, 2:]
        bent = rolls.bent(eye, straight, points_C)
        rays.append(readout.straight(eye, bent, points_C))
        errors.append((rays[-1] - straight) * (eye.K[0, 0], eye.K[1, 1]))
    by_depth = np.ones((2, len(points), 2)) * (1.0, 0.0)
    return PointViews(points_C, np.stack(rays), np.stack(errors), np.ones((2, len(points))), by_depth)


def test_the_share_of_a_rolling_shutter_is_learnt(camera: CameraCalibration, points: Array) -> None:
    """From a keyframe at rest; of one that moved alike nothing is, and a global shutter stays one."""
    eyes = (camera.left, camera.right)
    for kept, share in ((np.zeros(6), SHARE), (None, 0.0)):
        readout = Readout(camera, learns=True)
        for _ in range(3):
            readout.foresee(se3.identity(), MOTION)
            readout.moved(MOTION)
            views = shown(camera, readout, points, MOTION)
            readout.learn(eyes, views, readout.twist if kept is None else kept, 0.1)
        assert readout.share == pytest.approx(share, abs=0.02)
    still = Readout(camera, learns=True)
    still.foresee(se3.identity(), MOTION)
    still.moved(MOTION)
    views = shown(camera, still, points, MOTION)
    still.learn(eyes, views._replace(errors_px=np.zeros_like(views.errors_px)), np.zeros(6), 0.1)
    assert still.share == 0.0


@pytest.mark.parametrize(("share", "believed"), [(0.023, 0.0), (0.08, 0.08)])
def test_what_little_looks_like_a_readout_is_none(
    camera: CameraCalibration, points: Array, share: float, believed: float
) -> None:
    """A drone's rendered pairs of a global shutter told 0.023, and surely so (seed 8101): its rays were
    straightened, and its way was off by twice as much.
    """
    readout = Readout(camera, learns=True)
    for _ in range(9):
        readout.foresee(se3.identity(), MOTION)
        readout.moved(MOTION)
        views = shown(camera, readout, points, MOTION, share)
        readout.learn((camera.left, camera.right), views, np.zeros(6), 0.01)
    assert readout.share == pytest.approx(believed, abs=0.01)


def test_rays_are_straightened_and_bent_back(camera: CameraCalibration, points: Array) -> None:
    readout = Readout(camera, learns=True)
    rays = points[:, :2] / points[:, 2:]
    assert readout.straight(camera.left, rays, points) is rays  # no shutter known: to the last bit
    readout.begin(SHARE)
    readout.foresee(se3.identity(), MOTION)
    bent = readout.bent(camera.left, rays, points)
    off_px = camera.left.K[0, 0] * np.abs(bent - rays).max()
    assert off_px > 0.5
    back = readout.straight(camera.left, bent, points)
    assert camera.left.K[0, 0] * np.abs(back - rays).max() < 0.01 * off_px
    readout.moved(MOTION)
    assert 0.0 < readout.std(1.5).max() < readout.begun_std(1.5).max()


def test_a_map_of_two_motions_is_withdrawn(camera: CameraCalibration, config: VisionConfig) -> None:
    """A thing over 60 % of the picture from the first pair on: its first pose was a compromise."""
    texture = wall_texture(1, 22.0, 1000)
    pairs = []
    for k in range(4):
        X = se3.transform(np.eye(3), (0.004 * k * k, 0.0, 0.0))
        Y = X @ se3.transform(np.eye(3), (-0.012 * k * k, 0.004 * k * k, 0.0))
        rest, part = (pair_at(camera, texture, place, z=z, seed=k) for place, z in ((X, 1.5), (Y, 1.2)))
        left, right = (
            np.hstack([b[:, :384], a[:, 384:]]) for a, b in ((rest.left, part.left), (rest.right, part.right))
        )
        pairs.append(StereoPair(left, right, k, k))
    result = follow_pairs(
        lambda: pairs, lambda _: SegmentedOdometry(camera, config.odometry, config.recorded_odometry)
    )
    assert result.lost == 4
    assert set(result.losses) == {"two_motions"}
    assert result.apart == []


def test_nothing_is_undecided_where_nothing_is_foreseen() -> None:
    assert not MotionHistory(0.0).undecided
    assert MotionHistory(3.0).undecided
