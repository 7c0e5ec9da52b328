"""Classical solvers: OpenCV's, guarded against its defects; DQCR.

OpenCV 4.14 returns NaN (Daniilidis), reflections (Park) or, after a line on standard error, a rotation that
has nothing to do with the data (Tsai, which drops motions under 15 degrees). Here a result is a proper pose
or an error.
"""

import math
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

from protocol.errors import MeasurementFailed
from vision_pc.config.choices import Method
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.samples import PosePairs
from vision_pc.core.hand_eye.solvers.motions import (
    DualQuaternions,
    Motions,
    dual_quaternions,
    translation_of_dual,
)
from vision_pc.core.hand_eye.solvers.result import Certificate, SolverEstimate
from vision_pc.core.se3 import Array, nearest_rotation

_TSAI_LEAST = math.radians(15.0)  # OpenCV's Tsai drops motions outside these
_TSAI_MOST = math.pi - _TSAI_LEAST
_TSAI_SECOND_AXIS = math.radians(1.0)


AX_XB = {
    Method.TSAI: cv2.CALIB_HAND_EYE_TSAI,
    Method.PARK: cv2.CALIB_HAND_EYE_PARK,
    Method.HORAUD: cv2.CALIB_HAND_EYE_HORAUD,
    Method.ANDREFF: cv2.CALIB_HAND_EYE_ANDREFF,
    Method.DANIILIDIS: cv2.CALIB_HAND_EYE_DANIILIDIS,
}
AX_ZB = {
    Method.LI: cv2.CALIB_ROBOT_WORLD_HAND_EYE_LI,
    Method.SHAH: cv2.CALIB_ROBOT_WORLD_HAND_EYE_SHAH,
}


def from_poses(pairs: PosePairs, motions: Motions, method: Method) -> SolverEstimate:
    """X, and Z where the method estimates it, by OpenCV.

    ``motions`` are those of all pairs of samples. Raises MeasurementFailed:
    ``measurement.hand_eye.no_solution`` (OpenCV gave up or returned NaN), ``.left_handed`` (it returned a
    reflection).
    """
    H, P = pairs.H, pairs.P
    if method in AX_ZB:
        H_inverse = stacks.inverse(H)
        R_TZ, t_TZ, R_CX, t_CX = _called(
            cv2.calibrateRobotWorldHandEye,
            method,
            (P[:, :3, :3], P[:, :3, 3], H_inverse[:, :3, :3], H_inverse[:, :3, 3]),
            AX_ZB[method],
        )
        X, Z = (
            stacks.inverse(_proper(R_CX, t_CX, method)),
            stacks.inverse(_proper(R_TZ, t_TZ, method)),
        )
        return SolverEstimate(X, Z)
    if method is Method.TSAI and not _enough_for_opencv_tsai(motions):
        note = "OpenCV's Tsai would drop these rotations under 15 degrees; solved without its filter"
        return SolverEstimate(_tsai(motions), notes=(note,))
    poses = (H[:, :3, :3], H[:, :3, 3], P[:, :3, :3], P[:, :3, 3])
    R, t = _called(cv2.calibrateHandEye, method, poses, AX_XB[method])
    return SolverEstimate(_proper(R, t, method))


def _called(function: Callable[..., Any], method: Method, poses: tuple[Array, ...], flag: int) -> Any:
    try:
        return function(*poses, method=flag)
    except cv2.error as error:
        reason = " ".join(str(error).split())
        raise MeasurementFailed(
            "measurement.hand_eye.no_solution", f"{method}: OpenCV gave up: {reason}"
        ) from error


def _proper(R: Array, t: Array, method: Method) -> Array:
    """The pose, a slightly skewed rotation made orthonormal, or the error that it is none."""
    R, t = np.asarray(R, dtype=np.float64), np.asarray(t, dtype=np.float64).reshape(-1)
    if not (np.isfinite(R).all() and np.isfinite(t).all()):
        raise MeasurementFailed(
            "measurement.hand_eye.no_solution", f"{method}: the solver returned NaN or infinity"
        )
    determinant = float(np.linalg.det(R))
    if determinant <= 0.0:
        raise MeasurementFailed(
            "measurement.hand_eye.left_handed",
            f"{method}: the solver returned a reflection (det {determinant:.3f})",
        )
    return stacks.transform(nearest_rotation(R), t)


def _enough_for_opencv_tsai(motions: Motions) -> bool:
    vectors = stacks.log_so3(motions.A[:, :3, :3])
    angles = np.linalg.norm(vectors, axis=-1)
    kept = vectors[(angles > _TSAI_LEAST) & (angles < _TSAI_MOST)]
    return len(kept) > 1 and bool(np.linalg.eigvalsh(kept.T @ kept / len(kept))[1] > _TSAI_SECOND_AXIS**2)


def _tsai(motions: Motions) -> Array:
    """X (4, 4) by Tsai and Lenz 1989, eq. (12), (14), from all motions: skew(a + b) p = b − a, where a and b
    are twice the vector parts. Raises MeasurementFailed as ``from_poses``.
    """
    dual = dual_quaternions(motions)
    a, b = 2.0 * dual.x[:, 1:], 2.0 * dual.y[:, 1:]
    p = np.linalg.lstsq(stacks.hat(a + b).reshape(-1, 3), (b - a).reshape(-1), rcond=None)[0]
    R = stacks.rotation_from_quaternion(np.concatenate([[1.0], p]) / math.sqrt(1.0 + p @ p))
    return _proper(R, _translation(motions, R), Method.TSAI)


def _translation(motions: Motions, R: Array) -> Array:
    """t from (R_A − I) t = R t_B − t_A, all motions at once."""
    rows = (motions.A[:, :3, :3] - np.eye(3)).reshape(-1, 3)
    right = (motions.B[:, :3, 3] @ R.T - motions.A[:, :3, 3]).reshape(-1)
    return np.asarray(np.linalg.lstsq(rows, right, rcond=None)[0])


def dqcr(motions: DualQuaternions) -> tuple[Array, Certificate]:
    """X (4, 4) by DQCR's two problems in closed form, and the certificate of problem 1.

    With x_i, y_i the motions of hand and camera and g + ε g' the unknown, R_i = A(x_i) − B(y_i) and D_i =
    A(x'_i) − B(y'_i): problem 1, (27), is min Σ ‖R_i g‖² with gᵀg = 1, problem 2, (31), min Σ ‖R_i g' + D_i
    g‖² with gᵀg' = 0 (Hua et al. 2024, section 4.2). The first is a 4×4 eigenvalue problem and the second
    one of linear least squares, so the published moment relaxations are tight and have the same answer.
    """
    R, D = motions.rotation_rows(), motions.dual_rows()
    RR, RD = (np.einsum("mij,mik->jk", R, second) for second in (R, D))
    values, vectors = np.linalg.eigh(RR)
    g = vectors[:, 0]
    scale = float(np.trace(RR)) / 4.0
    system = np.zeros((5, 5))
    system[:4, :4] = RR / scale
    system[:4, 4] = system[4, :4] = g
    g_dual = np.linalg.solve(system, np.append(-RD @ g / scale, 0.0))[:4]
    S = RR - values[0] * np.eye(4)
    least, largest = float(np.linalg.eigvalsh(S)[0]), float(values[-1])
    certificate = Certificate(
        "eigenvalue problem, KKT", least / largest, float(np.abs(S @ g).max()) / largest, 0.0, rank=1
    )
    X = stacks.transform(stacks.rotation_from_quaternion(g), translation_of_dual(g, g_dual))
    return X, certificate
