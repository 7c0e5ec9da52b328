"""What a guided session answers: looks at the marker, residuals, the solution with its proof and verdict."""

import math
from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from protocol.errors import MeasurementFailed
from vision_pc.application.results import JSON, pose_json
from vision_pc.core import se3
from vision_pc.core.hand_eye.guided import sampling as guided_sampling
from vision_pc.core.hand_eye.guided import solution as guided_solution
from vision_pc.core.hand_eye.guided.cabinet import Located
from vision_pc.core.hand_eye.guided.sampling import Belief
from vision_pc.core.hand_eye.guided.session import Sample, Session, proposal_json
from vision_pc.core.hand_eye.guided.solution import GuidedSolution
from vision_pc.core.hand_eye.guided.target import TargetLook
from vision_pc.core.hand_eye.samples import PosePairs
from vision_pc.core.hand_eye.solvers import bundle, methods
from vision_pc.core.hand_eye.solvers import maximum_likelihood as ml
from vision_pc.core.hand_eye.solvers.bundle import RobotNoise
from vision_pc.core.hand_eye.solvers.methods import Method
from vision_pc.core.hand_eye.solvers.result import HandEyeResult
from vision_pc.core.se3 import Array

COMPARED = (Method.TSAI, Method.HORAUD, Method.DANIILIDIS, Method.DQCR, Method.MAXIMUM_LIKELIHOOD)
WANTED_STD_M = 0.003


def believed(session: Session) -> Belief:
    """What the session's samples and the tape measure say of X and Z."""
    return guided_sampling.believed(session.pairs(), session.around, session.settings)


def checked(session: Session, X_BT: Array, seen: TargetLook) -> JSON:
    """The verdict on the starting pose: the view of the marker, and what the poses around it promise."""
    settings = session.settings
    here = Sample("start", X_BT, seen.X_CP, seen.covariance, seen.corners_left, settings.marker_id, True, 0.0)
    belief = believed(session.with_sample(here))
    choices = 0
    for number in range(settings.poses - 1):
        proposal = guided_sampling.propose(
            belief, session.around, settings, np.random.default_rng([session.seed, 1, number])
        )
        choices = choices or proposal.choices
        added = guided_sampling.information_of(proposal, belief, session.around, settings)
        belief = belief._replace(information=belief.information + added)
    return {
        "marker": marker_json(seen),
        "poses_in_view": f"{choices} of {settings.candidates}",
        "promised_std_mm": 1e3 * belief.std[0],
        "promised_std_deg": math.degrees(belief.std[1]),
        "verdict": f"marker {settings.marker_id} seen, 0/{settings.poses}: ready",
    }


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


def located(X_BT: Array, X_TC: Array, places: Sequence[Located]) -> JSON:
    """Targets seen from X_BT in the camera, in the hand by X_TC, and in the base."""
    return {
        "X_BT": pose_json(X_BT),
        "targets": [
            {
                "name": t.name,
                "p_C_m": t.p_C.tolist(),
                "p_T_m": se3.apply(X_TC, t.p_C[None])[0].tolist(),
                "p_B_m": se3.apply(X_BT @ X_TC, t.p_C[None])[0].tolist(),
                "gap_px": t.gap_px,
                "correlation": t.correlation,
            }
            for t in places
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


def solved(session: Session) -> tuple[JSON, Array]:
    """The solution of a session with covariance, residuals, proof and verdict; others beside it.

    The image-space adjustment takes the hand's poses as the solution has corrected them, others as reported.
    """
    pairs = session.pairs()
    solution = guided_solution.solve(session)
    result = solution.result
    answer = _solution_json(solution) | {"others": [_other(pairs, m, result) for m in COMPARED]}
    noise = result.noise
    robot = None
    if noise is not None and min(noise.robot_rotation, noise.robot_translation) > 0.0:
        robot = RobotNoise(noise.robot_rotation, noise.robot_translation)
    try:
        adjusted = bundle.adjust(solution.pairs, result, robot)
    except MeasurementFailed as error:
        answer["others"].append({"method": "image-space", "failed": f"{error.cause}: {error}"})
    else:
        answer["others"].append(
            {"method": "image-space", "p_mm": _milli(adjusted.X[:3, 3]), "off": off(adjusted.X, result.X)}
        )
    return answer, result.X


def _other(pairs: PosePairs, method: Method, result: HandEyeResult) -> JSON:
    try:
        X = methods.solve(pairs, method).X
    except MeasurementFailed as error:
        return {"method": method.value, "failed": f"{error.cause}: {error}"}
    return {"method": method.value, "p_mm": _milli(X[:3, 3]), "off": off(X, result.X)}


def _milli(values: Array, digits: int = 3) -> list[float]:
    return [round(1e3 * float(v), digits) for v in values]


def _deg(values: Array, digits: int = 4) -> list[float]:
    return [round(math.degrees(float(v)), digits) for v in values]


def _solution_json(solution: GuidedSolution) -> JSON:
    result, arm = solution.result, solution.arm
    assert result.covariance is not None
    assert result.certificate is not None
    left_out = [name for name, inlier in zip(result.names, result.inliers, strict=True) if not inlier]
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
        "left_out": left_out,
        "residuals": [
            {"name": name, "mm": _milli(r[:3]), "deg": _deg(r[3:])}
            for name, r in zip(result.names, result.residuals, strict=True)
        ],
        "certificate": asdict(result.certificate) | {"holds": result.certificate.holds},
        "observability": result.observability.reason,
        "notes": list(result.notes),
        **_verdict_json(solution.covariance, result.certificate.holds, len(left_out), len(result.names)),
    }


def _uncertainty_json(covariance: Array) -> JSON:
    std = np.sqrt(np.diag(covariance))
    return {
        "std_mm": _milli(std[:3], 4),
        "std_deg": _deg(std[3:], 5),
        "covariance_p_theta": covariance.tolist(),
    }


def _verdict_json(covariance: Array, proven: bool, left_out: int, samples: int) -> JSON:
    """Whether X is good enough, and why in one line; ``covariance`` counts what the arm is not known by."""
    std = np.sqrt(np.diag(covariance))
    std_m, std_rad = float(np.linalg.norm(std[:3])), float(np.linalg.norm(std[3:]))
    good = proven and std_m <= WANTED_STD_M
    return {
        "good": good,
        "verdict": (
            f"{'good' if good else 'take more samples'}: X known to {1e3 * std_m:.2f} mm and "
            f"{math.degrees(std_rad):.3f}°, {'proven global' if proven else 'not proven global'}, "
            f"{left_out} of {samples} samples left out"
        ),
    }
