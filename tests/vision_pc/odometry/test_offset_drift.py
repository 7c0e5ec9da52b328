"""How a pose gives way to an offset of all disparities: as a solution with such an offset does."""

import numpy as np

from vision_pc.core import se3
from vision_pc.core.odometry.keyframes.keyframe import Indices
from vision_pc.core.odometry.keyframes.keyframe_map import KeyframeMap
from vision_pc.core.odometry.keyframes.offset_drift import PoseDrift
from vision_pc.core.odometry.keyframes.triangulation import disparity_metres
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


def missed(camera: CameraCalibration, points: Array, rays: Array, X_C0C: Array) -> Array:
    """Measured minus expected px (2, n, 2) of ``points`` (n, 3) at a camera at ``X_C0C``."""
    errors = []
    for k, eye in enumerate((camera.left, camera.right)):
        at = se3.apply(se3.inverse(X_C0C @ eye.X_CE), points)
        errors.append((rays[k] - at[:, :2] / at[:, 2:]) * eye.K[0, 0])
    return np.stack(errors)


def drift(known: KeyframeMap, ids: Indices, X_C0C: Array) -> PoseDrift:
    found = known.drift(ids, se3.inverse(X_C0C), np.ones((2, len(ids))))
    assert found is not None
    return found


def test_the_way_and_what_is_found_on_it_go_as_a_solution_does(camera: CameraCalibration) -> None:
    generator = np.random.default_rng(5)
    first, later = aslant(generator), aslant(generator) + np.array([0.3, 0.0, 0.1])
    known = KeyframeMap(camera, 0.2, drifts=True)
    ids = known.add_points(se3.identity(), mapped(camera, se3.identity(), first), 0.1)
    found = solved(camera, known.points[ids], seen_with_offset(camera, AHEAD, first), AHEAD)
    by_offset = drift(known, ids, AHEAD).pose
    gone = se3.local(AHEAD, found)
    assert np.linalg.norm(gone[:3]) > 2e-4
    assert np.linalg.norm(gone[3:]) > 1e-5, "a wall aslant turns the camera too"
    np.testing.assert_allclose(OFFSET_PX * by_offset, gone, rtol=0.05, atol=3e-6)

    grown = known.add_points(found, mapped(camera, AHEAD, later), 0.1, by_offset)
    further = solved(camera, known.points[grown], seen_with_offset(camera, BEYOND, later), BEYOND)
    by_offset = drift(known, grown, BEYOND).pose
    np.testing.assert_allclose(OFFSET_PX * by_offset, se3.local(BEYOND, further), rtol=0.05, atol=6e-6)


def test_what_pictures_teach_of_depths_goes_too(camera: CameraCalibration) -> None:
    """The way tells depths better than a base of 0.12 m does: a wall aslant hardly turns the camera then."""
    true, ways = aslant(np.random.default_rng(5)), {}
    for pictures in (0, 6):
        known = KeyframeMap(camera, 0.2, drifts=True)
        ids = known.add_points(se3.identity(), mapped(camera, se3.identity(), true), 0.1)
        for _ in range(pictures):
            seen = seen_with_offset(camera, AHEAD, true)
            found = solved(camera, known.points[ids], seen, AHEAD)
            errors = missed(camera, known.points[ids], seen, found)
            ones = np.ones((2, len(ids)))
            known.update(ids, se3.inverse(found), errors, ones, 0.1, drift(known, ids, found))
        found = solved(camera, known.points[ids], seen_with_offset(camera, BEYOND, true), BEYOND)
        ways[pictures] = OFFSET_PX * drift(known, ids, BEYOND).pose
        np.testing.assert_allclose(ways[pictures], se3.local(BEYOND, found), rtol=0.05, atol=3e-6)
    assert np.linalg.norm(ways[6][3:]) < 0.5 * np.linalg.norm(ways[0][3:])
