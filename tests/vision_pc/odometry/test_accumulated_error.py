"""What a path's poses are known to: an offset of all disparities bends it as a solution with one does, and
keyframes hand on what they got wrong.
"""

import numpy as np
import pytest

from vision_pc.core import se3
from vision_pc.core.odometry.keyframes.keyframe import Indices
from vision_pc.core.odometry.keyframes.keyframe_map import HeldViews, KeyframeMap
from vision_pc.core.odometry.keyframes.triangulation import disparity_metres
from vision_pc.core.odometry.pose_spread import EXACT, AccumulatedError, PoseSpread, pose_spread
from vision_pc.core.perception import stereo_pose
from vision_pc.core.perception.stereo_pose import BodyView, Priors
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, StereoOffset

OFFSET_PX = 0.05
NOTHING, NO_MOTION = np.zeros((6, 6)), np.zeros(6)
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


def held_views(known: KeyframeMap, ids: Indices, X_C0C: Array, errors_px: Array) -> HeldViews:
    return HeldViews(errors_px, np.ones((2, len(ids))), known.sensitivity(ids, se3.inverse(X_C0C)))


def spread_at(known: KeyframeMap, ids: Indices, X_C0C: Array) -> PoseSpread:
    """Of a camera that the points hold and that misses none of them."""
    views = held_views(known, ids, X_C0C, np.zeros((2, len(ids), 2)))
    return pose_spread(known, ids, se3.inverse(X_C0C), views, 0.1)


def grown(known: KeyframeMap, X_C0C: Array, points_C: Array, by_offset: Array = NO_MOTION) -> Indices:
    """The points of one more keyframe."""
    return known.add_points(X_C0C, points_C, 0.1, by_offset=by_offset)


def test_the_way_and_what_is_found_on_it_go_as_a_solution_does(camera: CameraCalibration) -> None:
    generator = np.random.default_rng(5)
    first, later = aslant(generator), aslant(generator) + np.array([0.3, 0.0, 0.1])
    known = KeyframeMap(camera, 0.2)
    ids = grown(known, se3.identity(), mapped(camera, se3.identity(), first))
    found = solved(camera, known.points[ids], seen_with_offset(camera, AHEAD, first), AHEAD)
    by_offset = spread_at(known, ids, AHEAD).by_offset
    gone = se3.local(AHEAD, found)
    assert np.linalg.norm(gone[:3]) > 2e-4
    assert np.linalg.norm(gone[3:]) > 1e-5, "a wall aslant turns the camera too"
    np.testing.assert_allclose(OFFSET_PX * by_offset, gone, rtol=0.05, atol=3e-6)

    ids = grown(known, found, mapped(camera, AHEAD, later), by_offset)
    further = solved(camera, known.points[ids], seen_with_offset(camera, BEYOND, later), BEYOND)
    by_offset = spread_at(known, ids, BEYOND).by_offset
    np.testing.assert_allclose(OFFSET_PX * by_offset, se3.local(BEYOND, further), rtol=0.05, atol=6e-6)


def test_what_pictures_teach_of_depths_goes_too(camera: CameraCalibration) -> None:
    """The way tells depths better than a base of 0.12 m does: a wall aslant hardly turns the camera then."""
    true, ways = aslant(np.random.default_rng(5)), {}
    for pictures in (0, 6):
        known = KeyframeMap(camera, 0.2)
        ids = known.add_points(se3.identity(), mapped(camera, se3.identity(), true), 0.1)
        for _ in range(pictures):
            seen = seen_with_offset(camera, AHEAD, true)
            found = solved(camera, known.points[ids], seen, AHEAD)
            errors = missed(camera, known.points[ids], seen, found)
            views = held_views(known, ids, found, errors)
            known.update(ids, views, 0.1, spread_at(known, ids, found).views_by_offset)
        found = solved(camera, known.points[ids], seen_with_offset(camera, BEYOND, true), BEYOND)
        ways[pictures] = OFFSET_PX * spread_at(known, ids, BEYOND).by_offset
        np.testing.assert_allclose(ways[pictures], se3.local(BEYOND, found), rtol=0.05, atol=3e-6)
    assert np.linalg.norm(ways[6][3:]) < 0.5 * np.linalg.norm(ways[0][3:])


def held(covariance: Array, shown_by: list[int], by_offset: Array = NO_MOTION) -> PoseSpread:
    """Each keyframe holds the pose in all directions by its share of ``shown_by``."""
    held_by = {number: shown_by.count(number) / len(shown_by) * np.eye(6) for number in shown_by}
    return PoseSpread(covariance, by_offset, np.zeros((2, 0, 2)), held_by)


def new_error(disparity_std_px: float) -> AccumulatedError:
    error = AccumulatedError(disparity_std_px)
    assert np.abs(error.after(se3.identity(), EXACT, 0)).max() == 0.0
    return error


def test_an_offset_of_all_disparities_bends_the_way_as_it_is_told() -> None:
    by_offset = np.array([0.025, 0.0, 0.0, 0.0, 0.004, 0.0])  # m and rad a px
    covariance = new_error(0.2).after(se3.identity(), held(NOTHING, [0], by_offset), None)
    std = np.sqrt(np.diag(covariance))
    assert std[[0, 4]] == pytest.approx([0.005, 0.0008], rel=0.03)
    assert covariance[0, 4] == pytest.approx(0.005 * 0.0008, rel=0.01)
    assert (std[[1, 2]] > 0.0).all()  # what is not linear in the offset goes astray
    assert (std[[1, 2]] < 0.05 * std[0]).all()


def test_a_keyframes_error_goes_on_until_an_older_one_holds_the_pose_again() -> None:
    """Once it went on for ever: 50 mm were told of a hand that was back where it began, to 3 mm."""
    error, own = new_error(0.0), np.diag([1e-6] * 6)
    error.after(se3.identity(), held(own, [0]), 1)
    error.after(se3.identity(), held(own, [1]), 2)

    def handed_on(shown_by: list[int]) -> float:
        return float(error.after(se3.identity(), held(own, shown_by), None)[0, 0]) - 1e-6

    assert handed_on([1] * 10) >= 1e-6
    assert np.sqrt(handed_on([2] * 10)) == pytest.approx(2.0 * np.sqrt(handed_on([1] * 10)))
    assert np.sqrt(handed_on([1] * 5 + [2] * 5)) == pytest.approx(1.5 * np.sqrt(handed_on([1] * 10)))
    assert handed_on([0] * 10) == pytest.approx(0.0, abs=1e-12)


def test_a_keyframe_hands_on_what_its_own_points_hold() -> None:
    """Its few points were near, those of the first far away: once half of an error was told that was all
    there (road_open 8801: 75 mm, told 19).
    """
    error = new_error(0.0)
    error.after(se3.identity(), held(np.diag([1e-4] * 3 + [1e-6] * 3), [0]), 1)
    aside = np.diag([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    spread = held(NOTHING, [0])._replace(held_by={0: np.eye(6) - aside, 1: aside})
    covariance = error.after(se3.identity(), spread, None)
    assert covariance[0, 0] >= 1e-4
    assert np.diag(covariance)[1:] == pytest.approx(0.0, abs=1e-15)
