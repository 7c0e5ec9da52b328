"""The camera matrix's share in X's covariance: against finite differences, and against truth."""

import cv2
import numpy as np
import pytest

from laboratory.experiments.hand_eye import scenes
from protocol.errors import RequestRefused
from tests.vision_pc.hand_eye.data import noisy_pairs
from vision_pc.config.choices import Method
from vision_pc.core import se3
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.samples import CornerViews, KnownLens, PosePairs, pose_pairs
from vision_pc.core.hand_eye.solvers import lens, methods
from vision_pc.core.hand_eye.solvers.methods import RobustSettings
from vision_pc.core.perception import zhang_intrinsics as zhang
from vision_pc.core.perception.zhang_intrinsics import BoardView
from vision_pc.core.se3 import Array


def alone(*std: float) -> KnownLens:
    """A usual lens of which only these of fx, fy, cx, cy are unknown, px."""
    return KnownLens(np.diag([1000.0, 1000.0, 1.0]), np.zeros(5), np.diag(np.square(std)))


def measured_with(pairs: PosePairs, K: Array) -> PosePairs:
    """The same pictures of a square target, their poses found with another camera matrix."""
    poses = []
    for P in pairs.P:
        side = 0.1 * float(np.linalg.norm(P[:3, 3]))
        points = side * np.array([(x, y, 0.0) for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)])
        turn, shift = cv2.Rodrigues(P[:3, :3])[0], P[:3, 3:].copy()
        pixels = cv2.projectPoints(points, turn, shift, alone(0, 0, 0, 0).K, np.zeros(5))[0]
        _, turn, shift = cv2.solvePnP(points, pixels, K, np.zeros(5), turn, shift, True)
        turn, shift = cv2.solvePnPRefineLM(points, pixels, K, np.zeros(5), turn, shift)
        poses.append(se3.transform(cv2.Rodrigues(turn)[0], np.ravel(shift)))
    return pose_pairs(pairs.X_BT, np.stack(poses), pairs.setup)


@pytest.mark.parametrize("unknown", [(1.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0)])
def test_the_share_is_what_a_wrong_camera_matrix_does_to_x(unknown: tuple[float, ...]) -> None:
    pairs, _ = noisy_pairs(71, 9)
    kept = RobustSettings(noise=scenes.noise(0.1, 0.5))
    first = methods.solve(pairs, Method.MAXIMUM_LIKELIHOOD, kept)
    right = alone(0, 0, 0, 0)
    wrong = right.K.copy()
    wrong[[0, 1, 0, 1], [0, 1, 2, 2]] += 0.5 * np.array(unknown)
    moved = methods.solve(measured_with(pairs, wrong), Method.MAXIMUM_LIKELIHOOD, kept)
    delta = 0.5 * np.array(unknown)
    share = lens.share(pairs, first, right._replace(covariance=np.outer(delta, delta)))
    turn = moved.X[:3, :3] @ first.X[:3, :3].T
    change = np.concatenate([moved.X[:3, 3] - first.X[:3, 3], stacks.log_so3(turn[None])[0]])
    np.testing.assert_allclose(np.outer(change, change), share, atol=0.05 * np.abs(share).max())


def test_the_error_is_what_the_covariance_says_when_the_camera_is_estimated() -> None:
    of_samples, with_lens = np.mean([squared_errors(seed) for seed in range(3)], axis=0)
    assert of_samples > 30.0
    assert 0.5 < with_lens < 15.0


def squared_errors(seed: int) -> tuple[float, float]:
    """Squared error of X over its covariance, without and with the camera matrix's share.

    The camera matrix comes from the pictures of the same calibration.
    """
    rng = np.random.default_rng([41, seed])
    scene = scenes.viewing_scene(rng, 20, distance_m=0.6, tilt_deg=35.0)
    rows, columns = np.mgrid[0:7, 0:10]
    points = np.stack([columns.ravel() - 4.5, rows.ravel() - 3.0, np.zeros(70)], axis=1) * 0.025
    K, distortion = np.array([[1050.0, 0.0, 655.0], [0.0, 1050.0, 352.0], [0.0, 0.0, 1.0]]), np.zeros(5)
    pixels = []
    for P in scene.P():
        seen = cv2.projectPoints(points, cv2.Rodrigues(P[:3, :3])[0], P[:3, 3], K, distortion)[0]
        pixels.append(seen.reshape(-1, 2) + rng.normal(size=(len(points), 2)) * 0.15)
    found = zhang.calibrate([BoardView(str(k), points, seen) for k, seen in enumerate(pixels)], 1280, 720)
    hand = scenes.noise(0.01, 0.05, robot=True)
    turn = stacks.exp_so3(rng.normal(size=(20, 3)) * hand.robot_rotation)
    shift = rng.normal(size=(20, 3)) * hand.robot_translation
    X_BT = stacks.transform(scene.X_BT[:, :3, :3] @ turn, scene.X_BT[:, :3, 3] + shift)
    corners = CornerViews(points, np.stack(pixels), found.K, found.distortion)
    pairs = pose_pairs(X_BT, found.X_CB, corners=corners)
    result = methods.solve(pairs)
    assert result.covariance is not None
    of_lens = lens.share(pairs, result, KnownLens(found.K, found.distortion, found.covariance))
    error = se3.local(result.X, scene.X)
    narrow, wide = (np.linalg.solve(c, error) for c in (result.covariance, result.covariance + of_lens))
    return float(error @ narrow), float(error @ wide)


def test_without_a_covariance_a_usual_lens_is_reckoned_in_and_said() -> None:
    pairs, _ = noisy_pairs(73, 9)
    result = methods.solve(pairs)
    widened = lens.widened(pairs, result)
    assert any("camera_covariance is not given" in note for note in widened.notes)
    assert result.covariance is not None
    assert widened.covariance is not None
    assert widened.of_lens is not None
    np.testing.assert_allclose(widened.covariance - widened.of_lens, result.covariance, rtol=1e-6)
    assert np.sqrt(np.trace(widened.of_lens[3:, 3:])) > 0.3 * lens.PRINCIPAL_STD
    assert lens.widened(pairs, methods.solve(pairs, Method.TSAI)).covariance is None


def bad_covariances() -> list[Array]:
    asymmetric = np.eye(4)
    asymmetric[0, 1] = 0.5
    return [np.eye(3), np.full((4, 4), np.nan), asymmetric, np.diag([1.0, 1.0, 1.0, -1.0])]


@pytest.mark.parametrize("covariance", bad_covariances())
def test_a_covariance_that_is_none_is_refused(covariance: Array) -> None:
    with pytest.raises(RequestRefused, match="camera_covariance") as caught:
        lens.checked(np.eye(3), np.zeros(5), covariance)
    assert caught.value.cause == "refused.hand_eye.camera_covariance"
