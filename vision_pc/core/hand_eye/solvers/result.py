"""What a hand-eye calibration returns, and whether its samples can determine X at all.

Rotation about one axis only leaves the position along it free; too little rotation leaves everything to
noise. Both show in the scatter of the motions' rotation vectors: its second root-mean-square says how far
the hand turned about any axis other than the main one.
"""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from protocol.errors import MeasurementFailed
from vision_pc.config.choices import Setup
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.solvers.maximum_likelihood import Noise
from vision_pc.core.hand_eye.solvers.motions import Motions
from vision_pc.core.se3 import Array

_LEAST_SAMPLES = 3
_LEAST_ROTATION = math.radians(1.0)  # between some two samples
_SECOND_AXIS = math.radians(0.3)  # rms that the hand must turn about axes other than the main one
_ABOVE_NOISE = 1.2  # the same, times the rotation noise that the motions show
_UNCERTAINTY = 0.1  # rad, that this noise, averaged over the samples, may leave in the rotation of X
_STRANGERS = math.radians(5.0)  # no noise: whatever X is, hand and camera turn by equal angles


class Observability(NamedTuple):
    """What the samples offer; ``cause`` is None when X can be determined, and ``reason`` says why.

    ``largest_rotation`` between two samples, ``second_axis`` rms about axes other than the main one,
    ``mismatch`` rms of the difference between hand's and camera's rotation angle (a measure of noise), rad.
    """

    samples: int
    largest_rotation: float
    second_axis: float
    mismatch: float
    cause: str | None
    reason: str

    def demand(self) -> None:
        """Raise MeasurementFailed with the reason when X cannot be determined."""
        if self.cause is not None:
            raise MeasurementFailed(self.cause, self.reason)


def verdict(samples: int, motions: Motions, whatever_the_noise: bool = False) -> Observability:
    """Whether X can be determined from these ``samples`` and the ``motions`` between them."""
    if samples < _LEAST_SAMPLES or not len(motions.A):
        reason = f"{samples} samples are too few: at least {_LEAST_SAMPLES} are needed"
        return Observability(samples, 0.0, 0.0, 0.0, "measurement.hand_eye.too_few_samples", reason)
    hand, camera = stacks.log_so3(motions.A[:, :3, :3]), stacks.log_so3(motions.B[:, :3, :3])
    hand_angles = np.linalg.norm(hand, axis=-1)
    largest = float(hand_angles.max())
    second = min(_second_axis(hand), _second_axis(camera))
    difference = np.abs(hand_angles - np.linalg.norm(camera, axis=-1))
    mismatch = 1.4826 * float(np.median(difference))  # robust: a few bad samples do not count as noise
    cause, reason, needed = None, "two or more axes, enough rotation", _SECOND_AXIS
    if not whatever_the_noise:
        by_noise = max(_ABOVE_NOISE, 1.0 / (_UNCERTAINTY * math.sqrt(max(samples - 2, 1))))
        needed = max(needed, by_noise * mismatch)
    if largest < _LEAST_ROTATION:
        cause = "measurement.hand_eye.too_little_rotation"
        least = _deg(_LEAST_ROTATION)
        reason = f"largest rotation between samples is {_deg(largest)}, at least {least} is needed"
    elif _SECOND_AXIS <= second < needed and mismatch > _STRANGERS:
        cause = "measurement.hand_eye.motions_differ"
        reason = (
            f"hand and camera turn by different angles between the same samples, {_deg(mismatch)} apart, "
            f"limit {_deg(_STRANGERS)}: their poses do not belong together"
        )
    elif second < needed:
        cause = "measurement.hand_eye.parallel_axes"
        reason = (
            f"rotation axes are parallel: only {_deg(second)} rms about a second axis, "
            f"{_deg(needed)} is needed; turn the hand about another axis too"
        )
    return Observability(samples, largest, second, mismatch, cause, reason)


def _second_axis(vectors: Array) -> float:
    """Rms rotation about the second of the principal axes."""
    return float(np.sqrt(max(np.linalg.eigvalsh(vectors.T @ vectors / len(vectors))[1], 0.0)))


def _deg(angle: float) -> str:
    return f"{math.degrees(angle):.2f} deg"


LEAST_EIGENVALUE = -1e-9  # relative; what counts as positive semidefinite in double precision
STATIONARITY = 1e-8  # relative; an interior-point solver's digits: the objective is off by its square

_LEAST = 1e-9  # rad and m: exact synthetic data still need finite weights


@dataclass(frozen=True)
class Certificate:
    """Proof of global optimality by the KKT conditions, relative to the objective's largest eigenvalue.

    ``least_eigenvalue`` of the Lagrangian's matrix (0 up to rounding when it proves the optimum);
    ``stationarity`` the largest entry of its product with the solution; ``gap`` objective minus lower bound;
    ``rank`` of the relaxation's moment matrix (1, or 2 where a solution and its negative are the same).
    """

    kind: str
    least_eigenvalue: float
    stationarity: float
    gap: float
    rank: int

    @property
    def holds(self) -> bool:
        """Whether the solution is proven to be the global optimum of its problem."""
        return self.least_eigenvalue >= LEAST_EIGENVALUE and abs(self.stationarity) <= STATIONARITY


class SolverEstimate(NamedTuple):
    """What a solver found: X (4, 4), and what else it knows.

    Z (4, 4) where the method estimates it; ``inliers`` (n,) in canonical order, all where none are left out;
    ``covariance`` (6, 6) of X's perturbation; ``notes`` on what was done.
    """

    X: Array
    Z: Array | None = None
    notes: tuple[str, ...] = ()
    inliers: NDArray[np.bool_] | None = None
    certificate: Certificate | None = None
    covariance: Array | None = None
    noise: Noise | None = None


@dataclass(frozen=True, eq=False)
class HandEyeResult:
    """A calibration: X and Z (4, 4) of H X P = Z, with everything needed to believe or refuse it.

    X is the camera in the hand (eye in hand) or in the base (eye to hand); Z the target in the base or in
    the hand. Per sample, in the caller's order: ``residuals`` (n, 6) = [translation m; rotation rad] of the
    camera's measurement minus prediction in camera axes, ``inliers`` (n,), ``names``. ``covariance`` (6, 6)
    of X's perturbation [δp; δθ] in the axes of its outer frame (``se3.retract``); ``of_lens`` is the part of
    it that the camera matrix's own error makes, where that was reckoned in.
    """

    method: str
    setup: Setup
    X: Array
    Z: Array
    names: tuple[str, ...]
    residuals: Array
    inliers: NDArray[np.bool_]
    observability: Observability
    certificate: Certificate | None = None
    covariance: Array | None = None
    noise: Noise | None = None
    notes: tuple[str, ...] = field(default=())
    of_lens: Array | None = None

    def residual_noise(self) -> Noise:
        """The noise a component as the used samples' residuals show it, all of it as the camera's."""
        r = self.residuals[self.inliers]
        # twelve unknowns were fitted to them
        squares = np.mean(r**2, axis=0) * 6.0 * len(r) / max(6.0 * len(r) - 12.0, 1.0)
        turn, shift = float(np.sqrt(squares[3:].mean())), float(np.sqrt(squares[:3].mean()))
        return Noise(max(turn, _LEAST), max(shift, _LEAST))
