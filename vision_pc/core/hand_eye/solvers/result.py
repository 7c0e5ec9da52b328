"""What a hand-eye calibration returns."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vision_pc.config.choices import Setup
from vision_pc.core.hand_eye.solvers.maximum_likelihood import Noise
from vision_pc.core.hand_eye.solvers.observability import Observability
from vision_pc.core.se3 import Array

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
