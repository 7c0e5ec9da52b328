"""The camera matrix's share in the uncertainty of X: an error that all samples have in common.

A focal length that is too long puts every target too far, a principal point that is off turns every target
about the camera; residuals hardly show either, and no number of samples averages it out. The error of each
measured pose follows from the pose's own equation: the pixels stay, so J_pose δP + J_camera δc = 0. How those
errors move X is the estimator's linear answer; the camera's covariance is carried through both.
"""

from dataclasses import replace

import cv2
import numpy as np

from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.samples import PosePairs
from vision_pc.core.hand_eye.solvers import maximum_likelihood as ml
from vision_pc.core.hand_eye.solvers.maximum_likelihood import Equations
from vision_pc.core.hand_eye.solvers.result import HandEyeResult
from vision_pc.core.se3 import Array

FOCAL_STD = 0.002  # [E] relative; calibrations of one camera by different hands agree to 0.1 to 0.3 %
PRINCIPAL_STD = 0.002  # [E] of the focal length: 1 to 2 px at 720p
# Radial terms trade between each other, so that k1 stands for all: half a pixel at half of 1000 px.
DISTORTION_STD = (4e-3, 0.0, 4e-4, 4e-4, 0.0)  # [E] of k1 k2 p1 p2 k3
_USUAL_K = np.diag(
    [1000.0, 1000.0, 1.0]
)  # px, of a camera that nobody described; results do not depend on it
_HALF_SIDE = 0.1  # of a target whose corners nobody gave, over its distance


def usual_covariance(K: Array) -> Array:
    """The covariance (9, 9) of fx, fy, cx, cy (px) and k1 k2 p1 p2 k3 of a camera ``K`` (3, 3) that is known
    as well as calibrations usually are: focal length to 0.2 %, axis to 2 mrad, distortion to half a pixel.
    """
    f = np.array([K[0, 0], K[1, 1]])
    common = np.zeros((9, 9))
    common[:2, :2] = np.outer(FOCAL_STD * f, FOCAL_STD * f)  # both focal lengths are off by the same share
    common[2:4, 2:4] = np.diag((PRINCIPAL_STD * f) ** 2)
    common[4:, 4:] = np.diag(np.square(DISTORTION_STD))
    return common


def widened(pairs: PosePairs, result: HandEyeResult) -> HandEyeResult:
    """``result`` with the lens's share in its covariance, of a lens known as usual."""
    if result.covariance is None:
        return result
    K = _USUAL_K if pairs.corners is None else pairs.corners.K
    note = (
        f"focal length taken as known to {100.0 * FOCAL_STD:g} %, principal point to "
        f"{100.0 * PRINCIPAL_STD:g} % of it, k1 to {DISTORTION_STD[0]:g}"
    )
    of_lens = share(pairs, result, usual_covariance(K))
    covariance, notes = result.covariance + of_lens, (*result.notes, note)
    return replace(result, covariance=covariance, of_lens=of_lens, notes=notes)


def share(pairs: PosePairs, result: HandEyeResult, of_camera: Array) -> Array:
    """What the covariance ``of_camera`` (9, 9), as of ``usual_covariance``, adds to that of X (6, 6), by the
    samples that ``result`` used.

    Where no corners are known, a square target of a fifth of its distance stands in for it.
    """
    inliers = pairs.subset(result.inliers[np.array(pairs.order)])
    equations = Equations(inliers.H, inliers.P, np.ones(len(inliers)), inliers.setup)
    noise = result.noise or result.residual_noise()
    moved = np.stack([_target_motion_by_lens(inliers, k) for k in range(len(inliers))])
    r = ml.residuals(inliers.H, inliers.P, result.X, result.Z)
    W = ml.whitener(equations, result.X, result.Z, noise)
    J = ml.whitened(W, ml.jacobian(equations, result.X, result.Z, r)).reshape(-1, 12)
    D = ml.whitened(W, moved).reshape(-1, moved.shape[-1])
    by_lens = np.linalg.solve(J.T @ J, J.T @ D)[:6]
    return np.asarray(by_lens @ of_camera @ by_lens.T)


def _target_motion_by_lens(pairs: PosePairs, k: int) -> Array:
    """How the measured target of sample k moves, [δp; δθ] in camera axes, for each of the lens's numbers."""
    P, K, distortion = pairs.P[k], _USUAL_K, np.zeros(5)
    if pairs.corners is None:
        side = _HALF_SIDE * float(np.linalg.norm(P[:3, 3]))
        points = side * np.array([(x, y, 0.0) for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)])
    else:
        points = pairs.corners.points_P[np.isfinite(pairs.corners.pixels[k]).all(axis=-1)]
        K, distortion = pairs.corners.K, pairs.corners.distortion
    turned = points @ P[:3, :3].T
    nothing = np.zeros(3)
    slopes = cv2.projectPoints(turned + P[:3, 3], nothing, nothing, K, distortion)[1]
    by_point = slopes[:, 3:6].reshape(-1, 2, 3)
    by_pose = np.concatenate([by_point, -by_point @ stacks.hat(turned)], axis=-1).reshape(-1, 6)
    by_lens = slopes[:, 6:15]
    return np.asarray(-np.linalg.lstsq(by_pose, by_lens, rcond=None)[0])
