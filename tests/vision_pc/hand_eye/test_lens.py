"""The camera matrix's share in X's covariance: against finite differences."""

import cv2
import numpy as np
import pytest

from tests.vision_pc.hand_eye.data import noisy_pairs
from vision_pc.config.choices import Method
from vision_pc.core import se3
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.samples import PosePairs, pose_pairs
from vision_pc.core.hand_eye.solvers import lens, methods
from vision_pc.core.hand_eye.solvers import maximum_likelihood as ml
from vision_pc.core.hand_eye.solvers.maximum_likelihood import Equations
from vision_pc.core.se3 import Array

USUAL_K = np.diag([1000.0, 1000.0, 1.0])


def measured_with(pairs: PosePairs, K: Array) -> PosePairs:
    """The same pictures of a square target, their poses found with another camera matrix."""
    poses = []
    for P in pairs.P:
        side = 0.1 * float(np.linalg.norm(P[:3, 3]))
        points = side * np.array([(x, y, 0.0) for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)])
        turn, shift = cv2.Rodrigues(P[:3, :3])[0], P[:3, 3:].copy()
        pixels = cv2.projectPoints(points, turn, shift, USUAL_K, np.zeros(5))[0]
        _, turn, shift = cv2.solvePnP(points, pixels, K, np.zeros(5), turn, shift, True)
        turn, shift = cv2.solvePnPRefineLM(points, pixels, K, np.zeros(5), turn, shift)
        poses.append(se3.transform(cv2.Rodrigues(turn)[0], np.ravel(shift)))
    return pose_pairs(pairs.X_BT, np.stack(poses), pairs.setup)


@pytest.mark.parametrize("unknown", [(1.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0)])
def test_the_share_is_what_a_wrong_camera_matrix_does_to_x(unknown: tuple[float, ...]) -> None:
    pairs, _ = noisy_pairs(71, 9)
    first = methods.solve(pairs, Method.MAXIMUM_LIKELIHOOD)
    assert first.noise is not None
    wrong = USUAL_K.copy()
    wrong[[0, 1, 0, 1], [0, 1, 2, 2]] += 0.5 * np.array(unknown)
    other = measured_with(pairs, wrong)
    moved = ml.maximize(Equations(other.H, other.P, np.ones(9), other.setup), first.X, first.Z, first.noise)
    delta = 0.5 * np.pad(unknown, (0, 5))
    share = lens.share(pairs, first, np.outer(delta, delta))
    turn = moved.X[:3, :3] @ first.X[:3, :3].T
    change = np.concatenate([moved.X[:3, 3] - first.X[:3, 3], stacks.log_so3(turn[None])[0]])
    np.testing.assert_allclose(np.outer(change, change), share, atol=0.05 * np.abs(share).max())


def test_a_usual_lens_is_reckoned_in_and_said() -> None:
    pairs, _ = noisy_pairs(73, 9)
    result = methods.solve(pairs)
    widened = lens.widened(pairs, result)
    assert any("focal length taken as known" in note for note in widened.notes)
    assert result.covariance is not None
    assert widened.covariance is not None
    assert widened.of_lens is not None
    np.testing.assert_allclose(widened.covariance - widened.of_lens, result.covariance, rtol=1e-6)
    assert np.sqrt(np.trace(widened.of_lens[3:, 3:])) > 0.3 * lens.PRINCIPAL_STD
    assert lens.widened(pairs, methods.solve(pairs, Method.TSAI)).covariance is None
