"""What the steps of a guided session answer, to the API and the event log: mm and degrees."""

import math
from dataclasses import asdict

import numpy as np

from vision_pc.application.results import JSON, pose_json
from vision_pc.core import se3
from vision_pc.core.hand_eye.guided import sampling
from vision_pc.core.hand_eye.guided.sampling import Belief
from vision_pc.core.hand_eye.guided.session import Session
from vision_pc.core.hand_eye.guided.solution import GuidedSolution
from vision_pc.core.hand_eye.guided.target import TargetLook
from vision_pc.core.hand_eye.solvers import maximum_likelihood as ml
from vision_pc.core.ports import ArmView
from vision_pc.core.se3 import Array

WANTED_STD_M = 0.003


def believed(session: Session) -> Belief:
    """What the session's samples and the tape measure say of X and Z."""
    return sampling.believed(session.pairs(), session.around, session.settings)


def check_json(session: Session, seen: TargetLook, choices: int) -> JSON:
    """The verdict on the starting pose, around which ``choices`` poses keep all bounds."""
    settings = session.settings
    return {
        "marker": marker_json(seen),
        "poses_in_view": f"{choices} of {settings.candidates}",
        "verdict": f"marker {settings.marker_id} seen, 0/{settings.poses}: ready",
    }


def session_json(session: Session) -> JSON:
    """The session: its samples with residuals."""
    belief = believed(session) if session.samples else None
    return {
        "name": session.name,
        "count": f"{len(session.samples)}/{session.settings.poses}",
        "complete": session.complete,
        "marker_id": session.settings.marker_id,
        "samples": [] if belief is None else residuals(session, belief),
        "std_mm": None if belief is None else 1e3 * belief.std[0],
        "std_deg": None if belief is None else math.degrees(belief.std[1]),
        "refused": len(session.refused),
    }


def arrival_json(view: ArmView, X_BT_ref: Array) -> JSON:
    """Where the arm stands, and how far from where it was sent."""
    away = se3.local(view.X_BT, X_BT_ref)
    off_m, off_rad = (float(np.linalg.norm(part)) for part in (away[:3], away[3:]))
    return {
        "X_BT_reached": pose_json(view.X_BT),
        "settled": view.settled,
        "off": {"mm": round(1e3 * off_m, 2), "deg": round(math.degrees(off_rad), 3)},
    }


def sample_json(session: Session, belief: Belief, seen: TargetLook, moved_mrad: float) -> JSON:
    """The newest sample: its look, its residual by what is believed, and how well X is known."""
    row = residuals(session, belief)[-1]
    std_m, std_rad = belief.std
    return {
        "sample": row["name"],
        "marker": marker_json(seen),
        "count": len(session.samples),
        "moved_mrad": round(moved_mrad, 3),
        "residual_mm": row["residual_mm"],
        "residual_deg": row["residual_deg"],
        "std_mm": 1e3 * std_m,
        "std_deg": math.degrees(std_rad),
    }


def residuals(session: Session, belief: Belief) -> list[JSON]:
    """For each sample what its marker's pose differs by from the prediction, in camera axes."""
    pairs = session.pairs()
    r = ml.residuals(pairs.H, pairs.P, belief.X, belief.Z)
    by_name = dict(zip(pairs.names, r, strict=True))
    return [
        {
            "name": s.name,
            "residual_mm": _milli(by_name[s.name][:3]),
            "residual_deg": _deg(by_name[s.name][3:]),
            "distance_m": round(float(np.linalg.norm(s.X_CP[:3, 3])), 3),
            "settled": s.settled,
        }
        for s in session.samples
    ]


def marker_json(seen: TargetLook) -> JSON:
    """What one look at the marker gave."""
    std = np.sqrt(np.diag(seen.covariance))
    p = seen.X_CP[:3, 3]
    cosine = -float(p @ seen.X_CP[:3, 2]) / float(np.linalg.norm(p))
    return {
        "X_CP": pose_json(seen.X_CP),
        "std_mm": _milli(std[:3]),
        "std_deg": _deg(std[3:]),
        "distance_m": round(float(np.linalg.norm(p)), 4),
        "obliquity_deg": round(math.degrees(math.acos(min(max(cosine, -1.0), 1.0))), 2),
        "seen": f"{seen.seen}/{seen.frames}",
    }


def _milli(values: Array, digits: int = 3) -> list[float]:
    return [round(1e3 * float(v), digits) for v in values]


def _deg(values: Array, digits: int = 4) -> list[float]:
    return [round(math.degrees(float(v)), digits) for v in values]


def solved_json(solution: GuidedSolution) -> JSON:
    """X with covariance, residuals, proof and verdict, which counts the errors of arm and camera."""
    result, arm = solution.result, solution.arm
    assert result.covariance is not None
    assert result.certificate is not None
    left_out = [name for name, used in zip(result.names, result.inliers, strict=True) if not used]
    std = np.sqrt(np.diag(solution.covariance))
    std_m, std_rad = float(np.linalg.norm(std[:3])), float(np.linalg.norm(std[3:]))
    proven = result.certificate.holds
    good = proven and std_m <= WANTED_STD_M
    verdict = (
        f"{'good' if good else 'take more samples'}: X known to {1e3 * std_m:.2f} mm and "
        f"{math.degrees(std_rad):.3f}°, {'proven global' if proven else 'not proven global'}, "
        f"{len(left_out)} of {len(result.names)} samples left out"
    )
    return {
        "method": result.method,
        "X_TC": pose_json(result.X),
        "X_BP": pose_json(result.Z),
        **_uncertainty_json(result.covariance),
        "with_arm": _uncertainty_json(solution.covariance),
        "arm": {
            "zeros_mrad": _milli(arm.zeros),
            "std_mrad": _milli(arm.std),
            "camera_noise": round(arm.camera_noise, 3),
            "play": round(arm.play, 3),
        },
        "left_out": left_out,
        "residuals": [
            {"name": name, "mm": _milli(r[:3]), "deg": _deg(r[3:])}
            for name, r in zip(result.names, result.residuals, strict=True)
        ],
        "certificate": asdict(result.certificate) | {"holds": proven},
        "observability": result.observability.reason,
        "notes": list(result.notes),
        "good": good,
        "verdict": verdict,
    }


def _uncertainty_json(covariance: Array) -> JSON:
    std = np.sqrt(np.diag(covariance))
    return {
        "std_mm": _milli(std[:3], 4),
        "std_deg": _deg(std[3:], 5),
        "covariance_p_theta": covariance.tolist(),
    }
