"""What the steps of a guided session return, as the API and the event log have it: mm and degrees."""

import math
from dataclasses import asdict

import numpy as np

from protocol.errors import MeasurementFailed
from vision_pc.application.hand_eye.steps import (
    HandArrival,
    NextPose,
    OtherMethod,
    SolvedSession,
    StartCheck,
    TakenSample,
    Targets,
    believed,
    left_out,
    verdict_of,
)
from vision_pc.application.results import JSON, pose_json
from vision_pc.core import se3
from vision_pc.core.hand_eye.guided.sampling import Belief
from vision_pc.core.hand_eye.guided.session import Session, proposal_json
from vision_pc.core.hand_eye.guided.solution import GuidedSolution
from vision_pc.core.hand_eye.guided.target import TargetLook
from vision_pc.core.hand_eye.solvers import maximum_likelihood as ml
from vision_pc.core.se3 import Array


def check_json(check: StartCheck) -> JSON:
    """The verdict on the starting pose."""
    settings = check.session.settings
    std_m, std_rad = check.promised_std
    return {
        "marker": marker_json(check.seen),
        "poses_in_view": f"{check.choices} of {settings.candidates}",
        "promised_std_mm": 1e3 * std_m,
        "promised_std_deg": math.degrees(std_rad),
        "verdict": f"marker {settings.marker_id} seen, 0/{settings.poses}: ready",
    }


def start_json(check: StartCheck) -> JSON:
    """The verdict on the starting pose, and the session that begins there."""
    return check_json(check) | {"session": session_json(check.session)}


def session_json(session: Session) -> JSON:
    """The session: its samples with residuals, and the proposal."""
    belief = believed(session) if session.samples else None
    return {
        "name": session.name,
        "count": f"{len(session.samples)}/{session.settings.poses}",
        "complete": session.complete,
        "marker_id": session.settings.marker_id,
        "samples": [] if belief is None else residuals(session, belief),
        "std_mm": None if belief is None else 1e3 * belief.std[0],
        "std_deg": None if belief is None else math.degrees(belief.std[1]),
        "proposal": None if session.proposal is None else proposal_json(session.proposal),
        "refused": len(session.refused),
    }


def arrival_json(arrival: HandArrival) -> JSON:
    """Where the arm stands, and how far from where it was sent."""
    view = arrival.view
    return {
        "X_BT_reached": pose_json(view.X_BT),
        "settled": view.settled,
        "off": off(view.X_BT, arrival.X_BT_ref),
    }


def next_json(done: NextPose) -> JSON:
    """The proposal, and where the arm stands."""
    return proposal_json(done.proposal) | arrival_json(done.arrival)


def sample_json(taken: TakenSample) -> JSON:
    """The look, the sample's residual by what is believed, and how well X is known."""
    row = next(row for row in residuals(taken.session, taken.belief) if row["name"] == taken.name)
    std_m, std_rad = taken.belief.std
    return {
        "sample": taken.name,
        "marker": marker_json(taken.seen),
        "count": len(taken.session.samples),
        "moved_mrad": round(taken.moved_mrad, 3),
        "residual_mm": row["residual_mm"],
        "residual_deg": row["residual_deg"],
        "std_mm": 1e3 * std_m,
        "std_deg": math.degrees(std_rad),
    }


def targets_json(found: Targets) -> JSON:
    """The targets in the camera, in the hand, and in the base."""
    return {
        "X_BT": pose_json(found.X_BT),
        "targets": [
            {
                "name": t.name,
                "p_C_m": t.p_C.tolist(),
                "p_T_m": found.in_hand(t).tolist(),
                "p_B_m": found.in_base(t).tolist(),
                "gap_px": t.gap_px,
                "correlation": t.correlation,
            }
            for t in found.targets
        ],
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


def solved_json(answer: SolvedSession) -> JSON:
    """X with covariance, residuals, proof and verdict, and what other methods make of the samples."""
    X_TC = answer.solution.result.X
    return _solution_json(answer.solution) | {"others": [_other_json(o, X_TC) for o in answer.others]}


def _other_json(other: OtherMethod, X_TC: Array) -> JSON:
    X = other.answer
    if isinstance(X, MeasurementFailed):
        return {"method": other.name, "failed": f"{X.cause}: {X}"}
    return {"method": other.name, "p_mm": _milli(X[:3, 3]), "off": off(X, X_TC)}


def _milli(values: Array, digits: int = 3) -> list[float]:
    return [round(1e3 * float(v), digits) for v in values]


def _deg(values: Array, digits: int = 4) -> list[float]:
    return [round(math.degrees(float(v)), digits) for v in values]


def _solution_json(solution: GuidedSolution) -> JSON:
    result, arm = solution.result, solution.arm
    assert result.covariance is not None
    assert result.certificate is not None
    verdict = verdict_of(solution)
    return {
        "method": result.method,
        "X_TC": pose_json(result.X),
        "X_BP": pose_json(result.Z),
        **_uncertainty_json(result.covariance),
        "with_arm": _uncertainty_json(solution.covariance),
        "arm": arm
        and {
            "zeros_mrad": _milli(arm.zeros),
            "std_mrad": _milli(arm.std),
            "camera_noise": round(arm.camera_noise, 3),
            "play": round(arm.play, 3),
        },
        "left_out": left_out(result),
        "residuals": [
            {"name": name, "mm": _milli(r[:3]), "deg": _deg(r[3:])}
            for name, r in zip(result.names, result.residuals, strict=True)
        ],
        "certificate": asdict(result.certificate) | {"holds": result.certificate.holds},
        "observability": result.observability.reason,
        "notes": list(result.notes),
        "good": verdict.good,
        "verdict": verdict.text,
    }


def _uncertainty_json(covariance: Array) -> JSON:
    std = np.sqrt(np.diag(covariance))
    return {
        "std_mm": _milli(std[:3], 4),
        "std_deg": _deg(std[3:], 5),
        "covariance_p_theta": covariance.tolist(),
    }
