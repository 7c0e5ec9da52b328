"""How a pose gives way to an offset of all disparities: as a solution with such an offset does."""

import numpy as np
import pytest

from vision_pc.core import se3
from vision_pc.core.odometry.keyframe_map import KeyframeMap, disparity_metres
from vision_pc.core.perception import stereo_pose
from vision_pc.core.perception.stereo_pose import BodyView, Priors
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, StereoOffset

OFFSET_PX = 0.05
AHEAD = se3.transform(se3.exp_so3([0.02, -0.03, 0.01]), (0.3, -0.1, 0.15))
BEYOND = AHEAD @ se3.transform(se3.exp_so3([-0.01, 0.02, 0.0]), (0.2, 0.05, 0.0))


def aslant(generator: np.random.Generator) -> Array:
    """Points (n, 3) of a wall that is turned against the line of sight."""
    x, y = generator.uniform(-0.7, 0.7, (2, 200))
    return np.column_stack([x, y, 1.6 + 0.2 * x - 0.1 * y])


def seen_with_offset(camera: CameraCalibration, X_C0C: Array, true: Array) -> Array:
    """Both eyes' rays (2, n, 2) to ``true`` points (n, 3) in C0, the right columns too great."""
    rays = []
    for k, eye in enumerate((camera.left, camera.right)):
        at = se3.apply(se3.inverse(X_C0C @ eye.X_CE), true)
        rays.append(at[:, :2] / at[:, 2:] + (k * OFFSET_PX / eye.K[0, 0], 0.0))
    return np.stack(rays)


def mapped(camera: CameraCalibration, X_C0C: Array, true: Array) -> Array:
    """Where a camera at ``X_C0C`` puts ``true`` points (n, 3) in C: their disparities are too small."""
    points = se3.apply(se3.inverse(X_C0C), true)
    return points / (1.0 - OFFSET_PX / disparity_metres(camera) * points[:, 2:])


def solved(camera: CameraCalibration, points: Array, rays: Array, start: Array) -> Array:
    priors = Priors(0.1, 1e-9, StereoOffset(0.0, 0.0, 1e-9, 1e-9))
    views = [BodyView(points, rays, np.ones((2, len(points))))]
    return se3.inverse(stereo_pose.solve(views, [se3.inverse(start)], camera, priors).X_CA[0])


def test_the_way_and_what_is_found_on_it_go_as_a_solution_does(camera: CameraCalibration) -> None:
    generator = np.random.default_rng(5)
    first, later = aslant(generator), aslant(generator) + np.array([0.3, 0.0, 0.1])
    known = KeyframeMap(camera, 0.2)
    ids = known.add_points(se3.identity(), mapped(camera, se3.identity(), first), 0.1)
    ones = np.ones((2, len(ids)))
    found = solved(camera, known.points[ids], seen_with_offset(camera, AHEAD, first), AHEAD)
    by_offset = known.by_offset(ids, se3.inverse(AHEAD), ones)
    gone = se3.local(AHEAD, found)
    assert np.linalg.norm(gone[:3]) > 2e-4
    assert np.linalg.norm(gone[3:]) > 1e-5, "a wall aslant turns the camera too"
    np.testing.assert_allclose(OFFSET_PX * by_offset, gone, rtol=0.05, atol=3e-6)

    grown = known.add_points(found, mapped(camera, AHEAD, later), 0.1, by_offset)
    further = solved(camera, known.points[grown], seen_with_offset(camera, BEYOND, later), BEYOND)
    by_offset = known.by_offset(grown, se3.inverse(BEYOND), ones)
    np.testing.assert_allclose(OFFSET_PX * by_offset, se3.local(BEYOND, further), rtol=0.05, atol=6e-6)


def test_where_the_map_began_nothing_goes(camera: CameraCalibration) -> None:
    known = KeyframeMap(camera, 0.2)
    ids = known.add_points(se3.identity(), aslant(np.random.default_rng(6)), 0.1)
    by_offset = known.by_offset(ids, se3.identity(), np.ones((2, len(ids))))
    np.testing.assert_allclose(by_offset, 0.0, atol=1e-9)


def test_a_wall_square_to_the_line_of_sight_only_scales_the_way(camera: CameraCalibration) -> None:
    x, y = np.random.default_rng(7).uniform(-0.7, 0.7, (2, 200))
    known = KeyframeMap(camera, 0.2)
    ids = known.add_points(se3.identity(), np.column_stack([x, y, np.full(200, 1.5)]), 0.1)
    aside = se3.transform(np.eye(3), (0.4, 0.0, 0.0))
    by_offset = known.by_offset(ids, se3.inverse(aside), np.ones((2, len(ids))))
    assert by_offset[0] == pytest.approx(0.4 * 1.5 / disparity_metres(camera), rel=1e-6)
    np.testing.assert_allclose(by_offset[1:], 0.0, atol=1e-9)
