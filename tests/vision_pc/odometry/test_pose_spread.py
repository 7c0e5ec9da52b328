"""What is told of a pose that few near points hold, some of them followed wrongly."""

from typing import NamedTuple

import numpy as np

from tests.vision_pc.odometry.test_keyframe_map import grown
from vision_pc.core import se3
from vision_pc.core.odometry.keyframes.keyframe_map import HeldViews, KeyframeMap
from vision_pc.core.odometry.keyframes.triangulation import disparity_metres
from vision_pc.core.odometry.pose_spread import pose_spread
from vision_pc.core.perception import stereo_pose
from vision_pc.core.perception.stereo_pose import BodyView, Priors
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, StereoOffset

FAR, NEAR, ASTRAY = 150, 12, 6  # points at 3 m, at 0.8 m, and of these the ones that are followed wrongly
TRUE = se3.transform(se3.exp_so3([0.004, -0.006, 0.002]), (0.03, -0.02, 0.01))
NOISE_PX, DEPTH_PX, WRONG_PX = 0.08, 0.03, 0.5
TRIALS = 60


class Told(NamedTuple):
    """Mean error² over variance (1: honest) by the spread and by the solution's own covariance."""

    spread: float
    solution: float


def world(generator: np.random.Generator) -> Array:
    depths = np.concatenate([np.full(FAR, 3.0), np.full(NEAR, 0.8)]) * generator.uniform(
        0.95, 1.05, FAR + NEAR
    )
    return np.column_stack([generator.uniform(-0.4, 0.4, (FAR + NEAR, 2)) * depths[:, None], depths])


def told(camera: CameraCalibration, wrong_px: float) -> Told:
    generator = np.random.default_rng(8)
    found = [_one(camera, generator, wrong_px) for _ in range(TRIALS)]
    return Told(*np.mean(found, axis=0).tolist())


def _one(camera: CameraCalibration, generator: np.random.Generator, wrong_px: float) -> tuple[float, float]:
    true, eyes = world(generator), (camera.left, camera.right)
    inverse = 1.0 / true[:, 2] + generator.normal(0.0, DEPTH_PX, len(true)) / disparity_metres(camera)
    known = KeyframeMap(camera, 0.2)
    ids = known.add_points(se3.identity(), true / (true[:, 2:] * inverse[:, None]), DEPTH_PX)
    off = generator.normal(0.0, NOISE_PX, (2, len(true), 2))
    off[:, -ASTRAY:] += generator.normal(0.0, wrong_px, (ASTRAY, 2))
    at = [se3.apply(se3.inverse(TRUE @ eye.X_CE), true) for eye in eyes]
    rays = np.stack([p[:, :2] / p[:, 2:] for p in at]) + off / camera.left.K[0, 0]
    ones = np.ones((2, len(true)))
    priors = Priors(NOISE_PX, 1e-9, StereoOffset(0.0, 0.0, 1e-9, 1e-9))
    solution = stereo_pose.solve([BodyView(known.points, rays, ones)], [se3.inverse(TRUE)], camera, priors)
    X_CC0 = solution.X_CA[0]
    there = [se3.apply(se3.inverse(eye.X_CE) @ X_CC0, known.points) for eye in eyes]
    errors = (rays - np.stack([p[:, :2] / p[:, 2:] for p in there])) * camera.left.K[0, 0]
    views = HeldViews(errors, ones, known.sensitivity(ids, X_CC0))
    spread = pose_spread(known, ids, X_CC0, views, NOISE_PX).covariance
    own = se3.inverse_covariance(X_CC0, solution.covariances[0])
    error = se3.local(TRUE, se3.inverse(X_CC0))
    first, second = (float(error @ np.linalg.solve(C, error)) / 6.0 for C in (spread, own))
    return first, second


def test_a_pose_that_wrong_points_hold_is_told_as_wide_as_it_is(camera: CameraCalibration) -> None:
    """Six of 162 points, near ones: the solution's own covariance knows nothing of them."""
    astray, clean = told(camera, WRONG_PX), told(camera, 0.0)
    assert astray.solution > 2.0, "these points would mislead nobody"
    assert 0.25 < astray.spread < 1.0, "twice as wide as these points ask: others err together"
    assert 0.25 < clean.spread < 1.0


def test_the_keyframe_that_shows_what_is_near_holds_the_camera_aside(camera: CameraCalibration) -> None:
    """A tenth of the points: moved as one, they move the pose by what the solution makes of that."""
    points = world(np.random.default_rng(9))
    known = KeyframeMap(camera, 0.2)
    far = grown(known, 0.0, points[:FAR]).ids
    near = grown(known, 0.0, points[FAR:]).ids
    ids, ones = np.concatenate([far, near]), np.ones((2, FAR + NEAR))
    X_CC0 = se3.inverse(TRUE)
    views = HeldViews(np.zeros((2, FAR + NEAR, 2)), ones, known.sensitivity(ids, X_CC0))
    shares = pose_spread(known, ids, X_CC0, views, NOISE_PX).held_by
    assert sorted(shares) == [0, 1]
    np.testing.assert_allclose(shares[0] + shares[1], np.eye(6), atol=1e-9)
    moved = np.array([0.0, 0.0, 0.0, 0.0, 1e-4, 0.0])  # the near points turn about C0
    J = np.swapaxes(known.pose_rates(ids, se3.inverse(TRUE)), 0, 1).reshape(len(ids), 4, 6)
    views = np.where(np.isin(ids, near)[:, None], J @ moved, 0.0)
    pose = np.linalg.lstsq(J.reshape(-1, 6), views.ravel(), rcond=None)[0]
    np.testing.assert_allclose(shares[1] @ moved, pose, rtol=1e-6, atol=1e-12)
    assert shares[1][0, 0] > 0.5
