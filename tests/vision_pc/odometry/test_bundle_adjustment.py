"""Keyframes and points adjusted together: the truth is found again, noise is spread as it should be, and a
full map forgets what lies farthest behind.
"""

import numpy as np
import pytest

from tests.vision_pc.odometry.test_odometry import pair_at
from tests.vision_pc.rendering import wall_texture
from vision_pc.config.vision import VisionConfig
from vision_pc.core import se3
from vision_pc.core.odometry import StereoOdometry
from vision_pc.core.odometry.keyframes import bundle_adjustment
from vision_pc.core.odometry.keyframes.bundle_adjustment import Depths, Problem, Views
from vision_pc.core.odometry.segments import SegmentedOdometry
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration

POINTS, CAMERAS, FIXED = 120, 5, 1


def true_poses() -> Array:
    """X_CC0 of cameras that go forwards and turn."""
    turns = [se3.exp_so3([0.01 * k, -0.03 * k, 0.02 * k]) for k in range(CAMERAS)]
    return np.stack([se3.transform(R, (0.1 * k, 0.02 * k, -0.3 * k)) for k, R in enumerate(turns)])


def problem(
    camera: CameraCalibration, generator: np.random.Generator, noise_px: float
) -> tuple[Problem, Array]:
    """A problem at the truth, seen with ``noise_px``, and its points (m, 3)."""
    points = generator.uniform((-2.0, -1.0, 4.0), (2.0, 1.0, 12.0), (POINTS, 3))
    poses = true_poses()
    k, m, eye = (index.ravel() for index in np.indices((CAMERAS, POINTS, 2)))
    X_EC = np.stack([se3.inverse(e.X_CE) for e in (camera.left, camera.right)])
    X = X_EC[eye] @ poses[k]
    seen = np.einsum("nij,nj->ni", X[:, :3, :3], points[m]) + X[:, :3, 3]
    rays = seen[:, :2] / seen[:, 2:] + generator.normal(0.0, noise_px / camera.left.K[0, 0], (len(k), 2))
    depths = Depths(
        np.zeros(POINTS, dtype=np.int64), np.arange(POINTS), 1.0 / points[:, 2], np.full(POINTS, 1e-3)
    )
    return Problem(poses, FIXED, points, Views(k, m, eye, rays, np.zeros(len(k))), depths), points


def disturbed(at: Problem, generator: np.random.Generator) -> Problem:
    """``at`` with free poses and all points off by centimetres and tenths of degrees."""
    poses = at.X_CC0.copy()
    for k in range(FIXED, CAMERAS):
        turn = se3.exp_so3(generator.normal(0.0, 5e-3, 3))
        poses[k] = se3.transform(turn, generator.normal(0.0, 0.02, 3)) @ poses[k]
    return at._replace(X_CC0=poses, points=at.points + generator.normal(0.0, 0.02, at.points.shape))


def test_the_truth_is_found_again(camera: CameraCalibration, generator: np.random.Generator) -> None:
    exact, points = problem(camera, generator, 0.0)
    found = bundle_adjustment.adjusted(disturbed(exact, generator), (camera.left, camera.right), 0.1, 50.0)
    np.testing.assert_allclose(found.X_CC0, exact.X_CC0, atol=1e-7)
    np.testing.assert_allclose(found.points, points, atol=1e-6)
    assert found.cost_after < 1e-6 < 1e3 < found.cost_before


def offset_told(camera: CameraCalibration, at: Problem, offset_px: float) -> bundle_adjustment.OffsetTold:
    """What ``at`` tells of an offset after the right eye's columns were moved by it, and all was adjusted."""
    nothing = np.zeros(0, dtype=np.int64)
    rays = at.views.rays.copy()
    rays[at.views.eye == 1, 0] += offset_px / camera.right.K[0, 0]
    moved = at._replace(
        views=at.views._replace(rays=rays), depths=Depths(nothing, nothing, np.zeros(0), np.zeros(0))
    )
    eyes = (camera.left, camera.right)
    found = bundle_adjustment.adjusted(moved, eyes, 0.1, 0.3)
    settled = moved._replace(X_CC0=found.X_CC0, points=found.points)
    return bundle_adjustment.shared_offset(settled, eyes, 0.1, 0.3)


@pytest.mark.parametrize("offset_px", [0.3, 0.0, -0.15])
def test_near_and_far_points_on_the_way_tell_the_offset_of_all_disparities(
    camera: CameraCalibration, generator: np.random.Generator, offset_px: float
) -> None:
    told = offset_told(camera, problem(camera, generator, 0.02)[0], offset_px)
    assert told.score / told.information == pytest.approx(offset_px, abs=0.03)
    assert told.information**-0.5 < 0.05


def test_points_of_one_distance_do_not_tell_the_offset(
    camera: CameraCalibration, generator: np.random.Generator
) -> None:
    """Before a wall, along it, an offset is as good as another scale."""
    at, points = problem(camera, generator, 0.0)
    wall = np.column_stack([points[:, :2], np.full(len(points), 8.0)])
    poses = np.stack([se3.transform(np.eye(3), (0.1 * k, 0.02 * k, 0.0)) for k in range(CAMERAS)])
    X_EC = np.stack([se3.inverse(e.X_CE) for e in (camera.left, camera.right)])
    X = X_EC[at.views.eye] @ poses[at.views.camera]
    seen = np.einsum("nij,nj->ni", X[:, :3, :3], wall[at.views.point]) + X[:, :3, 3]
    flat = at._replace(X_CC0=poses, points=wall, views=at.views._replace(rays=seen[:, :2] / seen[:, 2:]))
    alike, apart = offset_told(camera, flat, 0.0), offset_told(camera, at, 0.0)
    assert alike.information < 1e-3 * apart.information


def test_a_camera_and_a_point_that_no_view_tells_of_stay_where_they_are(
    camera: CameraCalibration, generator: np.random.Generator
) -> None:
    exact, _ = problem(camera, generator, 0.0)
    views, depths = exact.views, exact.depths
    told = (views.camera != CAMERAS - 1) & (views.point != 7)
    unseen = exact._replace(
        views=Views(*(part[told] for part in views)),
        depths=Depths(*(part[(depths.point != 7) & (depths.camera != CAMERAS - 1)] for part in depths)),
    )
    off = disturbed(unseen, generator)
    found = bundle_adjustment.adjusted(off, (camera.left, camera.right), 0.1, 50.0)
    np.testing.assert_allclose(found.X_CC0[:-1], exact.X_CC0[:-1], atol=1e-6)
    np.testing.assert_array_equal(found.X_CC0[-1], off.X_CC0[-1])
    np.testing.assert_array_equal(found.points[7], off.points[7])


def test_cost_of_noise_is_its_degrees_of_freedom(
    camera: CameraCalibration, generator: np.random.Generator
) -> None:
    noisy, _ = problem(camera, generator, 0.1)
    found = bundle_adjustment.adjusted(disturbed(noisy, generator), (camera.left, camera.right), 0.1, 50.0)
    free = 2 * len(noisy.views.eye) + POINTS - 3 * POINTS - 6 * (CAMERAS - FIXED)
    exact_depths = POINTS  # drawn without noise: they add little
    assert abs(found.cost_after - free) < exact_depths + 4.0 * np.sqrt(2.0 * free)
    np.testing.assert_array_equal(found.X_CC0[:FIXED], noisy.X_CC0[:FIXED])


def test_wild_views_do_not_bend_it(camera: CameraCalibration, generator: np.random.Generator) -> None:
    exact, _ = problem(camera, generator, 0.02)
    rays = exact.views.rays.copy()
    rays[::23] += 0.03
    wild = exact._replace(views=exact.views._replace(rays=rays))
    found = bundle_adjustment.adjusted(wild, (camera.left, camera.right), 0.02, 0.06)
    off = [np.linalg.norm((a @ se3.inverse(b))[:3, 3]) for a, b in zip(found.X_CC0, exact.X_CC0, strict=True)]
    assert max(off) < 2e-3


@pytest.fixture(scope="module")
def long_way() -> list[Array]:
    return [se3.transform(np.eye(3), (0.35 * k, 0.0, 0.0)) for k in range(9)]


@pytest.mark.slow("a map is filled picture by picture")
def test_a_full_map_goes_on(
    camera: CameraCalibration, config: VisionConfig, long_way: list[Array], texture: Array
) -> None:
    settings = config.odometry.model_copy(update={"keyframes": 3})
    odometry = StereoOdometry(camera, settings)
    for k, X in enumerate(long_way):
        pose = odometry.process(pair_at(camera, texture, X, seed=k))
        assert pose is not None, odometry.last_loss
        assert odometry.keyframes <= 3
        assert np.linalg.norm(se3.local(X, pose.X_C0C)[:3]) < 1e-3
    assert odometry.keyframes == 3


def test_a_full_map_of_a_recording_tells_what_its_new_keyframes_err_by(
    camera: CameraCalibration, config: VisionConfig, long_way: list[Array], texture: Array
) -> None:
    """Once it ended in a KeyError: a keyframe that took the place of another was not seen to be new."""
    settings = config.odometry_of_recordings.model_copy(update={"keyframes": 2, "keyframe_overlap": 0.9})
    odometry = SegmentedOdometry(camera, settings)
    for k, X in enumerate(long_way[:5]):
        placed = odometry.process(pair_at(camera, texture, X, seed=k))
        assert placed is not None, odometry.last_loss
        error = se3.local(X, placed.pose.X_C0C)
        if k:
            assert error @ np.linalg.solve(placed.pose.covariance, error) < 30.0
    assert odometry.keyframes == 2


@pytest.fixture(scope="module")
def texture() -> Array:
    return wall_texture(1, 22.0, 3200)


def test_views_that_are_known_to_be_off_do_not_draw_keyframes_away(
    camera: CameraCalibration, generator: np.random.Generator
) -> None:
    """A sixth of the points is seen 0.6 px to one side by the last camera: patches at a depth step are."""
    exact, _ = problem(camera, generator, 0.02)
    astray = (exact.views.point < POINTS // 6) & (exact.views.camera == CAMERAS - 1)
    rays = exact.views.rays + np.outer(astray, (0.6 / camera.left.K[0, 0], 0.0))
    away = []
    for stds in (np.zeros(len(astray)), 0.6 * astray):
        told = exact._replace(views=exact.views._replace(rays=rays, stds=stds))
        found = bundle_adjustment.adjusted(told, (camera.left, camera.right), 0.1, 0.3)
        away.append(np.linalg.norm(se3.local(exact.X_CC0[-1], found.X_CC0[-1])))
    assert away[1] < 0.4 * away[0]
