"""What a guided session answers: looks at the marker, residuals, the solution with its proof and verdict."""

import math
from dataclasses import asdict

import numpy as np

from protocol.errors import MeasurementFailed
from vision_pc.core import se3
from vision_pc.core.hand_eye import bundle, methods
from vision_pc.core.hand_eye import maximum_likelihood as ml
from vision_pc.core.hand_eye.bundle import RobotNoise
from vision_pc.core.hand_eye.guided_sampling import Belief, arm_zero_covariance
from vision_pc.core.hand_eye.guided_settings import GuidedSettings
from vision_pc.core.hand_eye.methods import Method
from vision_pc.core.hand_eye.result import HandEyeResult
from vision_pc.core.hand_eye.samples import PosePairs
from vision_pc.core.hand_eye.session import Session
from vision_pc.core.hand_eye.target import TargetLook
from vision_pc.core.se3 import Array
from vision_pc.shell.schemas import JSON, pose_json

COMPARED = (Method.TSAI, Method.HORAUD, Method.DANIILIDIS, Method.DQCR, Method.MAXIMUM_LIKELIHOOD)
WANTED_STD_M = 0.003


def residuals(session: Session, belief: Belief) -> list[JSON]:
    """For each sample what its marker's pose differs by from the prediction, in camera axes."""
    pairs = session.pairs()
    r = ml.residuals(pairs.H, pairs.P, belief.X, belief.Z)
    by_name = dict(zip(pairs.names, r, strict=True))
    return [
        {
            "name": s.name,
            "residual_mm": [round(1e3 * float(v), 3) for v in by_name[s.name][:3]],
            "residual_deg": [round(math.degrees(float(v)), 4) for v in by_name[s.name][3:]],
            "distance_m": round(float(np.linalg.norm(s.X_CT[:3, 3])), 3),
            "settled": s.settled,
        }
        for s in session.samples
    ]


def off(X: Array, Y: Array) -> JSON:
    """How far Y is from X."""
    away = se3.local(X, Y)
    return {
        "mm": round(1e3 * float(np.linalg.norm(away[:3])), 2),
        "deg": round(math.degrees(float(np.linalg.norm(away[3:]))), 3),
    }


def marker_json(seen: TargetLook) -> JSON:
    """What one look at the marker gave."""
    std = np.sqrt(np.diag(seen.covariance))
    p = seen.X_CT[:3, 3]
    cosine = -float(p @ seen.X_CT[:3, 2]) / float(np.linalg.norm(p))
    return {
        "X_CT": pose_json(seen.X_CT),
        "std_mm": [round(1e3 * float(v), 3) for v in std[:3]],
        "std_deg": [round(math.degrees(float(v)), 4) for v in std[3:]],
        "distance_m": round(float(np.linalg.norm(p)), 4),
        "obliquity_deg": round(math.degrees(math.acos(min(max(cosine, -1.0), 1.0))), 2),
        "seen": f"{seen.seen}/{seen.frames}",
    }


def solved(session: Session) -> tuple[JSON, Array]:
    """The robust solution of a session with covariance, residuals, proof and verdict, others beside it."""
    pairs = session.pairs()
    result = methods.solve(pairs, Method.ROBUST)
    answer = _result_json(result, session.settings) | {"others": [_other(pairs, m, result) for m in COMPARED]}
    noise = result.noise
    robot = None
    if noise is not None and min(noise.robot_rotation, noise.robot_translation) > 0.0:
        robot = RobotNoise(noise.robot_rotation, noise.robot_translation)
    try:
        adjusted = bundle.adjust(pairs, result, robot)
    except MeasurementFailed as error:
        answer["others"].append({"method": "image-space", "failed": f"{error.cause}: {error}"})
    else:
        answer["others"].append(
            {"method": "image-space", "p_mm": _mm(adjusted.X), "off": off(adjusted.X, result.X)}
        )
    return answer, result.X


def _other(pairs: PosePairs, method: Method, result: HandEyeResult) -> JSON:
    try:
        X = methods.solve(pairs, method).X
    except MeasurementFailed as error:
        return {"method": method.value, "failed": f"{error.cause}: {error}"}
    return {"method": method.value, "p_mm": _mm(X), "off": off(X, result.X)}


def _mm(X: Array) -> list[float]:
    return [round(1e3 * float(v), 3) for v in X[:3, 3]]


def _result_json(result: HandEyeResult, settings: GuidedSettings) -> JSON:
    assert result.covariance is not None
    assert result.certificate is not None
    std = np.sqrt(np.diag(result.covariance))
    whole = result.covariance + arm_zero_covariance(result.X, settings)
    whole_std = np.sqrt(np.diag(whole))
    std_m = float(np.linalg.norm(std[:3]))
    left_out = [name for name, inlier in zip(result.names, result.inliers, strict=True) if not inlier]
    good = result.certificate.holds and std_m <= WANTED_STD_M
    proof = "proven global" if result.certificate.holds else "not proven global"
    verdict = (
        f"{'good' if good else 'take more samples'}: X known to {1e3 * std_m:.2f} mm and "
        f"{math.degrees(float(np.linalg.norm(std[3:]))):.3f}°, {proof}, {len(left_out)} of "
        f"{len(result.names)} samples left out"
    )
    return {
        "method": result.method,
        "X_TC": pose_json(result.X),
        "X_BT_target": pose_json(result.Z),
        "std_mm": [round(1e3 * float(v), 4) for v in std[:3]],
        "std_deg": [round(math.degrees(float(v)), 5) for v in std[3:]],
        "covariance_p_theta": result.covariance.tolist(),
        "with_arm_zero": {
            "std_mm": [round(1e3 * float(v), 4) for v in whole_std[:3]],
            "std_deg": [round(math.degrees(float(v)), 5) for v in whole_std[3:]],
            "covariance_p_theta": whole.tolist(),
        },
        "left_out": left_out,
        "residuals": [
            {
                "name": name,
                "mm": [round(1e3 * float(v), 3) for v in r[:3]],
                "deg": [round(math.degrees(float(v)), 4) for v in r[3:]],
            }
            for name, r in zip(result.names, result.residuals, strict=True)
        ],
        "certificate": asdict(result.certificate) | {"holds": result.certificate.holds},
        "observability": result.observability.reason,
        "notes": list(result.notes),
        "good": good,
        "verdict": verdict,
    }
