"""Targets at the boundary: mm and degrees, and what an operator is to know of each."""

import math
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from foundation.configuration import StrictModel
from vision_pc.application.results import JSON, degrees, pose_json, xyz
from vision_pc.config.programs import PositioningSettings
from vision_pc.core.se3 import Array
from vision_pc.core.targets.keeper import KeptTarget, TargetKeeper
from vision_pc.core.targets.sighting import Click
from vision_pc.core.targets.target import Candidate, TargetObservation


class ClickBody(StrictModel):
    """A click on the left eye's picture, in px of the camera's own pictures.

    ``frame_id`` of the picture that was clicked, among those shown in the last 3 s; None: a fresh one.
    ``kind`` auto: a hole where one is under the click, else the surface. ``other_u_px``, ``other_v_px``: the
    same place in the right eye, where one click is ambiguous.
    """

    u_px: float = Field(ge=-10_000.0, le=10_000.0, examples=[812.4])
    v_px: float = Field(ge=-10_000.0, le=10_000.0, examples=[301.0])
    frame_id: int | None = Field(None, ge=0, lt=2**63, examples=[4711])
    kind: Literal["auto", "plane", "hole"] = "auto"
    diameter_mm: float | None = Field(None, gt=5.0, le=500.0, examples=[45.0])
    other_u_px: float | None = Field(None, ge=-10_000.0, le=10_000.0)
    other_v_px: float | None = Field(None, ge=-10_000.0, le=10_000.0)

    @model_validator(mode="after")
    def _check_complete(self) -> "ClickBody":
        if (self.other_u_px is None) != (self.other_v_px is None):
            raise ValueError("other_u_px and other_v_px are one place: give both, or none")
        return self

    def click(self) -> Click:
        """The click itself."""
        other = None
        if self.other_u_px is not None and self.other_v_px is not None:
            other = np.array([self.other_u_px, self.other_v_px])
        return Click(np.array([self.u_px, self.v_px]), self.kind, self.diameter_mm, other)


def target_json(
    target: KeptTarget,
    keeper: TargetKeeper,
    settings: PositioningSettings,
    p_CM: Array | None,
    X_BT: Array | None,
) -> JSON:
    """One target. ``p_CM`` (3,) where the tool's marker was seen last, None before that; ``X_BT`` where the
    arm stands unwatched, None where somebody watches.
    """
    aimed = keeper.aimed
    step = None if p_CM is None else target.X_CO[:3, 3] - p_CM - np.array([0.0, 0.0, settings.clearance_m])
    length = None if step is None else float(np.linalg.norm(step))
    return {
        "id": target.id,
        "kind": target.kind,
        "known": target.known if X_BT is None else keeper.known_at(target, X_BT),
        "aimed": aimed is not None and aimed.id == target.id,
        "recognised": _in_words(target.kind, target.diameter_m),
        "frame_id": target.frame_id,
        "X_CO": pose_json(target.X_CO),
        "X_BO": None if target.X_BO is None else pose_json(target.X_BO),
        "normal_C": [round(float(v), 6) for v in target.X_CO[:3, 2]],
        "std_mm": xyz(np.sqrt(np.diag(target.covariance)[:3])),
        "std_sight_mm": _by_the_sight(target),
        "std_deg": degrees(np.sqrt(np.diag(target.covariance)[3:])),
        "diameter_mm": None if target.diameter_m is None else round(1e3 * target.diameter_m, 2),
        "quality": round(target.quality, 3),
        "outline": _pixels(target.outline),
        "carried_mm": round(1e3 * target.way_m, 1),
        "distance_mm": None if length is None else round(1e3 * length, 1),
        "reachable": None if length is None else length <= settings.step_limit_m,
    }


def hole_json(seen: TargetObservation) -> JSON:
    """A hole that was detected and is no target yet."""
    middle = seen.outline.mean(axis=0)
    return {
        "at": [round(float(v), 2) for v in middle],
        "p_C_m": [round(float(v), 5) for v in seen.X_CO[:3, 3]],
        "std_mm": xyz(np.sqrt(np.diag(seen.covariance)[:3])),
        "diameter_mm": round(1e3 * (seen.diameter_m or math.nan), 2),
        "quality": round(seen.quality, 3),
        "outline": _pixels(seen.outline),
    }


def candidate_json(candidate: Candidate) -> JSON:
    """One of several places that a click may mean."""
    return {
        "other_px": [round(float(v), 2) for v in candidate.right_px],
        "p_C_m": [round(float(v), 4) for v in candidate.p_C],
        "distance_mm": round(1e3 * float(np.linalg.norm(candidate.p_C)), 1),
    }


def _by_the_sight(target: KeptTarget) -> JSON:
    """Standard deviations across the line of sight (the worst) and along it."""
    place, ray = target.covariance[:3, :3], target.X_CO[:3, 3] / np.linalg.norm(target.X_CO[:3, 3])
    beside = np.eye(3) - np.outer(ray, ray)
    across = math.sqrt(float(np.linalg.eigvalsh(beside @ place @ beside)[-1]))
    along = math.sqrt(float(ray @ place @ ray))
    return {"across": round(1e3 * across, 3), "along": round(1e3 * along, 3)}


def _in_words(kind: str, diameter_m: float | None) -> str:
    return "surface" if diameter_m is None else f"{kind} {1e3 * diameter_m:.1f} mm"


def _pixels(outline: Array) -> list[list[float]]:
    return [[round(float(u), 2), round(float(v), 2)] for u, v in outline]
