"""What odometry of recordings finds out about the camera: rows that are off, a shutter that rolls; and maps
that are withdrawn.
"""

import numpy as np
import pytest

from tests.vision_pc.odometry.test_odometry import pair_at
from tests.vision_pc.rendering import cropped, wall_texture
from vision_pc.config.vision import VisionConfig
from vision_pc.core import se3
from vision_pc.core.odometry.keyframes.offset_drift import view_rates
from vision_pc.core.odometry.rolling import (
    PictureMotion,
    PlacedPicture,
    PointViews,
    Readout,
    TakenOut,
    motions,
)
from vision_pc.core.odometry.segments import SegmentedOdometry, straightened
from vision_pc.core.perception import intrinsics
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, CameraModel, PointPairs, StereoPair
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


AT_REST = TakenOut(np.zeros(6), 0.0)
ALIKE = PictureMotion(np.concatenate([MOTION[:3, 3], se3.log_so3(MOTION[:3, :3])]), np.full(6, 1e-3))


def shown(
    camera: CameraCalibration, readout: Readout, points: Array, X_C0C: Array, share: float = SHARE
) -> PointViews:
    """What a camera whose rows take SHARE of the interval misses ``points`` by, its pose known."""
    rolls = rolling(camera, share, ALIKE)
    points_C = se3.apply(se3.inverse(X_C0C), points)
    rays, errors = [], []
    for eye in (camera.left, camera.right):
        straight = straight_rays(eye, points_C)
        bent = rolls.bent(eye, straight, points_C)
        rays.append(readout.straight(eye, bent, points_C))
        errors.append((rays[-1] - straight) * (eye.K[0, 0], eye.K[1, 1]))
    by_depth = np.ones((2, len(points), 2)) * (1.0, 0.0)
    return PointViews(points_C, np.stack(rays), np.stack(errors), np.ones((2, len(points))), by_depth)


def straight_rays(eye: CameraModel, points_C: Array) -> Array:
    in_eye = se3.apply(se3.inverse(eye.X_CE), points_C)
    return np.asarray(in_eye[:, :2] / in_eye[:, 2:])


def rolling(camera: CameraCalibration, share: float, motion: PictureMotion) -> Readout:
    """A readout that knows the ``motion`` of the picture that comes."""
    rolls = Readout(camera, learns=True)
    rolls.begin(share, {0: motion})
    rolls.foresee(0, None, se3.identity())
    return rolls


def test_the_share_of_a_rolling_shutter_is_learnt(camera: CameraCalibration, points: Array) -> None:
    """From a keyframe at rest; of one that moved alike nothing is, and a global shutter stays one."""
    eyes = (camera.left, camera.right)
    for kept, share in ((AT_REST, SHARE), (None, 0.0)):
        readout = Readout(camera, learns=True)
        for _ in range(3):
            readout.foresee(1, se3.identity(), MOTION)
            readout.moved(MOTION)
            views = shown(camera, readout, points, MOTION)
            readout.learn(eyes, views, readout.taken_out if kept is None else kept, 0.1)
        assert readout.share == pytest.approx(share, abs=0.02)
    still = Readout(camera, learns=True)
    still.foresee(1, se3.identity(), MOTION)
    still.moved(MOTION)
    views = shown(camera, still, points, MOTION)
    still.learn(eyes, views._replace(errors_px=np.zeros_like(views.errors_px)), AT_REST, 0.1)
    assert still.share == 0.0


@pytest.mark.parametrize("taken_out", [0.0, 0.3, 0.5])
def test_what_was_taken_out_of_the_keyframe_makes_no_other_share(
    camera: CameraCalibration, points: Array, taken_out: float
) -> None:
    """The keyframe turned the other way: its points lie as it showed them, but for what was known."""
    twist = np.array([0.0, 0.0, 0.0, 0.004, 0.003, -0.006])
    eyes = (camera.left, camera.right)
    readout = Readout(camera, learns=True)
    for _ in range(6):
        readout.foresee(1, se3.identity(), MOTION)
        readout.moved(MOTION)
        views = shown(camera, readout, points, MOTION)
        errors = views.errors_px.copy()
        for k, eye in enumerate(eyes):
            straight = straight_rays(eye, views.points_C)
            left = rolling(camera, SHARE - taken_out, PictureMotion(twist, np.zeros(6)))
            errors[k] -= (left.bent(eye, straight, views.points_C) - straight) * (eye.K[0, 0], eye.K[1, 1])
        readout.learn(eyes, views._replace(errors_px=errors), TakenOut(twist, taken_out), 0.1)
    assert readout.share == pytest.approx(SHARE, abs=0.005)


def test_a_motion_that_an_earlier_pass_found_is_believed(camera: CameraCalibration) -> None:
    """Of the first picture too, before which there was none, and of those after a loss."""
    readout = Readout(camera, learns=True)
    readout.begin(SHARE, {0: ALIKE, 5: ALIKE})
    for number in (0, 5):
        readout.foresee(number, None, se3.identity())
        assert readout.taken_out.twist == pytest.approx(ALIKE.twist)
        readout.moved(se3.identity())
        assert readout.taken_out.twist == pytest.approx(ALIKE.twist)
    readout.foresee(6, None, se3.identity())
    assert not readout.taken_out.twist.any()


def test_the_mean_of_before_and_after_is_the_motion_of_a_picture() -> None:
    """Of those at an end the one side: maps and gaps are ends. A missing pair makes motions longer."""
    places = (0.0, 0.1, 0.3, 0.6, 0.7, 1.0, 1.4)
    times = (0, 1, 2, 4, 5, 6, 7)
    placed = [
        PlacedPicture(k, 100 * t, int(k > 3), se3.transform(np.eye(3), (x, 0.0, 0.0)))
        for k, (x, t) in enumerate(zip(places, times, strict=True))
    ]
    found = motions([one for one in placed if one.number != 5])
    assert {k: round(float(one.twist[0]), 6) for k, one in found.items()} == {
        0: 0.1,
        1: 0.15,
        2: 0.175,
        3: 0.15,
    }
    unknown = {k: round(float(one.unknown[0]), 6) for k, one in found.items()}
    assert unknown == {0: 0.05, 1: 0.025, 2: 0.0125, 3: 0.025}
    assert sorted(motions(placed)) == [0, 1, 2, 3, 4, 5, 6]
    assert motions(placed[:1]) == {}


def test_a_pose_takes_upon_itself_what_is_not_known_of_the_motion(
    camera: CameraCalibration, points: Array, generator: np.random.Generator
) -> None:
    """By the solution of views that rows bend, drawn: the spread told is what such poses scatter by."""
    eyes = (camera.left, camera.right)
    views = shown(camera, Readout(camera, learns=False), points, se3.identity())
    rates = np.stack([view_rates(eye, se3.identity(), points)[1] for eye in eyes])
    weights = generator.uniform(0.2, 1.0, (2, len(points)))
    unknown = np.array([2e-3, 3e-3, 1e-3, 4e-3, 1e-3, 2e-3])
    still = PictureMotion(np.zeros(6), unknown)
    told = rolling(camera, SHARE, still).spread(eyes, views, rates, weights)
    scale = np.repeat(weights[:, :, None], 2, axis=2).ravel()
    poses = []
    for twist in generator.normal(0.0, unknown, (2000, 6)):
        rolls = rolling(camera, SHARE, PictureMotion(twist, unknown))
        errors = [
            (rolls.bent(eye, rays, points) - rays) * (eye.K[0, 0], eye.K[1, 1])
            for eye, rays in zip(eyes, views.rays, strict=True)
        ]
        A, b = scale[:, None] * rates.reshape(-1, 6), scale * np.stack(errors).ravel()
        poses.append(np.linalg.lstsq(A, b, rcond=None)[0])
    spread = np.cov(np.array(poses).T)
    assert np.diag(told) == pytest.approx(np.diag(spread), rel=0.1)
    lost = Readout(camera, learns=True)
    lost.begin(SHARE, {3: PictureMotion(10.0 * unknown, unknown)})
    lost.foresee(4, None, se3.identity())  # as it may have moved at its fastest
    assert np.diag(lost.spread(eyes, views, rates, weights)) == pytest.approx(100.0 * np.diag(told))


def test_what_is_not_known_of_the_first_pictures_motion_is_told_of_all_that_follow(
    camera: CameraCalibration, config: VisionConfig
) -> None:
    texture, told = wall_texture(1, 22.0, 1000), []
    for unknown in (1e-4, 0.03):
        odometry = SegmentedOdometry(camera, config.odometry, config.recorded_odometry)
        first = PictureMotion(np.zeros(6), np.array([0.0, 0.0, 0.0, unknown, unknown, unknown]))
        odometry.readout.begin(SHARE, {0: first, 1: first._replace(unknown=np.full(6, 1e-6))})
        placed = [
            odometry.process(pair_at(camera, texture, se3.identity())._replace(frame_id=number))
            for number in (0, 1)
        ]
        assert placed[1] is not None
        told.append(np.sqrt(np.diag(placed[1].pose.covariance)))
    assert (told[1] > 3.0 * told[0])[3:].all()


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
