"""The result of a local calibration: how camera axes lie in the base, and how well that is known."""

import math
from typing import NamedTuple

import numpy as np

from protocol.errors import MeasurementFailed
from vision_pc.core.se3 import Array, angle_between, hat, local, retract


class ResidualTable(NamedTuple):
    """Mäkinen et al. 2023, Table 3: absolute residuals per axis of B (3,), metres, after matching."""

    mean_m: Array
    maximum_m: Array


class LocalCalibration(NamedTuple):
    """Camera axes in base axes, found by moving.

    ``R_BC`` holds at the end of the path; ``R_TC`` carries it along when the tool turns (None: as in the
    paper, R_BC is taken for constant). ``covariance`` (3×3) rad² is of a left perturbation of R_BC, in base
    axes; residuals alone do not show it. ``condition``: ratio of the greatest to the least rotational
    information. ``method`` names the form; ``scale`` is kinematic over camera extent; ``inlier_share`` of
    ``samples`` fit. ``object_stands``: the object was seen to stand still along the path.
    """

    R_BC: Array
    R_TC: Array | None
    covariance: Array
    residuals: ResidualTable
    condition: float
    method: str
    samples: int
    inlier_share: float
    extent_m: float
    scale: float
    object_stands: bool = False

    def rotation_at(self, X_BT: Array) -> Array:
        """R_BC (3×3) with the arm at ``X_BT``."""
        if self.R_TC is None:
            return self.R_BC
        R: Array = X_BT[:3, :3] @ self.R_TC
        return R

    def rotation_std(self) -> float:
        """Standard deviation (rad) about the least known axis."""
        return math.sqrt(float(np.linalg.eigvalsh(self.covariance)[-1]))

    def goal_covariance(self, p_lc: Array) -> Array:
        """Covariance (3×3) m² in B of where a step of ``p_lc`` (3,) ends, as far as the rotation decides."""
        lever = hat(p_lc)
        covariance: Array = lever @ self.covariance @ lever.T
        return covariance


def settled_pose(X: Array) -> Array:
    """The mean pose (4×4) of ``X`` (N, 4, 4), poses at rest, single glitches left out.

    The poses within a centimetre and half a degree of the most central one are averaged.
    """
    apart = np.array(
        [[angle_between(a[:3, :3], b[:3, :3]) + math.dist(a[:3, 3], b[:3, 3]) for b in X] for a in X]
    )
    centre = X[int(np.median(apart, axis=1).argmin())]
    offsets = np.array([local(centre, Y) for Y in X])
    near = (np.linalg.norm(offsets[:, :3], axis=1) < 0.01) & (np.linalg.norm(offsets[:, 3:], axis=1) < 0.01)
    return retract(centre, offsets[near].mean(axis=0))


def residual_table(residuals: Array) -> ResidualTable:
    """Mean and maximum of the absolute ``residuals`` (N, 3)."""
    return ResidualTable(np.abs(residuals).mean(axis=0), np.abs(residuals).max(axis=0))


def rotation_information(points: Array, weights: Array) -> Array:
    """Σ w (‖r‖² I − r rᵀ) (3×3) m² of ``points`` (N, 3) about their weighted mean."""
    r = points - weights @ points / weights.sum()
    squared = (r**2).sum(axis=1)
    information: Array = (weights @ squared) * np.eye(3) - (r * weights[:, None]).T @ r
    return information


def rotation_covariance(
    points: Array, residuals: Array, weights: Array, independent: int
) -> tuple[Array, float]:
    """(covariance (3×3) rad² of a left perturbation in base axes, condition of the information matrix).

    Residuals of an arm's kinematics are smooth along the path, so that N samples are worth only
    ``independent`` ones. Raises MeasurementFailed (``measurement.ill_conditioned``) when the points lie on
    a line.
    """
    information = rotation_information(points, weights)
    eigenvalues = np.linalg.eigvalsh(information)
    if eigenvalues[0] <= 1e-9 * eigenvalues[-1]:
        raise MeasurementFailed("measurement.ill_conditioned", "rotation from points on one line")
    total = float(weights.sum())
    variance = float(weights @ (residuals**2).sum(axis=1)) / (3.0 * total)
    inflation = max(total / independent, 1.0)
    covariance = np.asarray(variance * inflation * np.linalg.inv(information), dtype=np.float64)
    return covariance, float(eigenvalues[-1] / eigenvalues[0])
