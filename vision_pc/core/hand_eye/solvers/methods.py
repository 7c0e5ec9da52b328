"""One entrance to all hand-eye solvers: checked samples in, a calibration with its verdict out.

The robust solver agrees on the good samples, proves the global optimum, then maximises the likelihood:

1. Graduated non-convexity finds the samples that agree (``consensus``), with a robust guess of the noise.
2. The chordal problem over those samples is solved globally and certified (``chordal``).
3. Maximum likelihood from there, noise by the restricted likelihood (``noise``), and the covariance.
4. With that better noise the samples are tested again; 2 to 4 repeat until the set stays the same.
5. Where two-fold hold-out contradicts the estimate, the estimator that predicts best takes its place
   (``held_out``).
"""

import math
from typing import NamedTuple

import numpy as np

from protocol.errors import MeasurementFailed
from vision_pc.config.choices import Method
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.samples import PosePairs
from vision_pc.core.hand_eye.solvers import chordal, classical, consensus, held_out
from vision_pc.core.hand_eye.solvers import maximum_likelihood as ml
from vision_pc.core.hand_eye.solvers import noise as noise_model
from vision_pc.core.hand_eye.solvers.classical import Classical, dqcr, forms
from vision_pc.core.hand_eye.solvers.consensus import parts
from vision_pc.core.hand_eye.solvers.maximum_likelihood import Equations, Noise
from vision_pc.core.hand_eye.solvers.motions import Motions, all_motions, dual_quaternions
from vision_pc.core.hand_eye.solvers.noise import NoiseSource
from vision_pc.core.hand_eye.solvers.result import (
    Certificate,
    HandEyeResult,
    Observability,
    ObservabilityLimits,
    SolverEstimate,
    verdict,
)
from vision_pc.core.se3 import Array

CLASSICAL = {Method(c.value): c for c in Classical}


_THRESHOLD = 24.1  # 99.95 % of χ² with 6 degrees of freedom
_PASSES = 4


class RobustSettings(NamedTuple):
    """``noise`` if it is known (else it is estimated), whose it is, whether bad samples are left out.

    ``least_share`` of the samples must agree, else there is no result.
    """

    noise: Noise | None = None
    source: NoiseSource = NoiseSource.BOTH
    reject: bool = True
    least_share: float = 0.5


def robust(pairs: PosePairs, motions: Motions, settings: RobustSettings) -> SolverEstimate:
    """The calibration by the module's four steps.

    Raises MeasurementFailed: ``measurement.hand_eye.no_consensus`` when too few samples agree, ``.sdp``,
    ``.no_solution``, ``.singular`` from the steps.
    """
    n = len(pairs)
    p = parts(pairs, motions)
    notes: list[str] = []
    reject = settings.reject and n >= consensus.LEAST_FOR_OUTLIERS
    if settings.reject and not reject:
        notes.append(f"{n} samples are too few to tell a bad one; all are used")
    noise, weights = settings.noise, np.ones(n)
    if noise is None:
        noise = consensus.guessed_noise(p, pairs.setup) if reject else Noise(*noise_model.USUAL_RATIO)
    if reject:
        weights = consensus.graduated(p, pairs.setup, noise, _THRESHOLD).weights
        _demand_consensus(weights, settings, pairs)
    for _ in range(_PASSES):
        estimate, noise, certificate = _certified(pairs, weights, noise, settings)
        squares = consensus.normalised_squares(p, pairs.setup, noise, estimate.X, estimate.Z)
        again = (squares <= _THRESHOLD).astype(float) if reject else weights
        if (again == weights).all():
            break
        _demand_consensus(again, settings, pairs)
        weights = again
    else:
        estimate, noise, certificate = _certified(pairs, weights, noise, settings)
    if not certificate.holds:
        notes.append("the global optimum is not proven: the relaxation is not tight for these samples")
    if settings.noise is not None:
        degrees = 6.0 * weights.sum() - 12.0
        notes += _noise_notes(estimate.cost, degrees)
    if settings.noise is None and settings.reject and settings.source is NoiseSource.BOTH:
        estimate, noise, more = _by_hold_out(pairs.subset(weights > 0.5), estimate, noise)
        notes += more
    covariance = ml.covariance_of_X(estimate)
    if settings.noise is None:
        few = noise_model.few_sample_note(int(weights.sum()))
        if few is not None and settings.source is NoiseSource.BOTH:
            notes.append(few)
        covariance = covariance * noise_model.few_sample_factor(int(weights.sum()))
    return SolverEstimate(estimate.X, estimate.Z, tuple(notes), weights > 0.5, certificate, covariance, noise)


def _by_hold_out(
    agreeing: PosePairs, estimate: ml.Estimate, noise: Noise
) -> tuple[ml.Estimate, Noise, list[str]]:
    """``estimate`` with its ``noise``, or that of an estimator that predicts held-out samples better.

    The information in the latter counts by the square of how far the former was behind: what misled the one
    is no smaller for the other.
    """
    choice = held_out.choose_estimator(agreeing, estimate.X, estimate.Z, noise)
    if choice.estimator is None:
        return estimate, noise, []
    equations = Equations(agreeing.H, agreeing.P, np.ones(len(agreeing)), agreeing.setup)
    if isinstance(choice.estimator, NoiseSource):
        estimate, noise = noise_model.estimated(equations, estimate.X, estimate.Z, noise, choice.estimator)
        words = f"all noise taken as the {choice.estimator}'s"
    else:
        X, Z = held_out.by_classical(agreeing, choice.estimator)
        estimate = ml.maximize(equations, X, Z, noise, steps=0)
        words = f"solved by {choice.estimator}"
    wider = max(choice.behind, 1.0) ** 2
    note = (
        f"two-fold hold-out puts the split into camera and robot noise {choice.behind:.2f} times behind the "
        f"best classical method, limit {held_out.BEHIND:g}: {words}"
    )
    return estimate._replace(information=estimate.information / wider), noise, [note]


def _certified(
    pairs: PosePairs, weights: Array, noise: Noise, settings: RobustSettings
) -> tuple[ml.Estimate, Noise, Certificate]:
    X, Z, certificate = chordal.solve(chordal.problem(pairs.H, pairs.P, weights, noise))
    equations = Equations(pairs.H, pairs.P, weights, pairs.setup)
    if settings.noise is None:
        return *noise_model.estimated(equations, X, Z, noise, settings.source), certificate
    return ml.maximize(equations, X, Z, noise), noise, certificate


def _demand_consensus(weights: Array, settings: RobustSettings, pairs: PosePairs) -> None:
    agree, n = int(weights.sum()), len(weights)
    if agree < max(3, settings.least_share * n):
        good = ", ".join(name for name, w in zip(pairs.names, weights, strict=True) if w > 0.5) or "none"
        raise MeasurementFailed(
            "measurement.hand_eye.no_consensus",
            f"only {agree} of {n} samples agree on one calibration ({good}); "
            "check units, frames (eye in hand or to hand) and that hand and camera poses belong together",
        )


def _noise_notes(cost: float, degrees: float) -> list[str]:
    ratio = float(np.sqrt(cost / max(degrees, 1.0)))
    if 0.5 < ratio < 2.0:
        return []
    return [
        f"residuals are {ratio:.2g} times what the given noise explains; the covariance is off by as much"
    ]


def solve(
    pairs: PosePairs,
    method: Method = Method.ROBUST,
    settings: RobustSettings | None = None,
    limits: ObservabilityLimits | None = None,
) -> HandEyeResult:
    """The calibration of ``pairs`` by ``method``; the order of the samples does not change it by a bit.

    ``settings`` concern ``robust`` and ``maximum-likelihood``. Raises MeasurementFailed when X
    is not observable (``measurement.hand_eye.too_few_samples``, ``.too_little_rotation``,
    ``.parallel_axes``, ``.motions_differ``) or the solver has no proper answer (``.no_solution``,
    ``.left_handed``, ``.no_consensus``, ``.sdp``, ``.singular``).
    """
    settings = settings or RobustSettings()
    motions = all_motions(pairs)
    if method is Method.ROBUST:  # bad samples look like noise, which can be judged only without them
        verdict(len(pairs), motions, _whatever_the_noise(limits)).demand()
    else:
        seen = verdict(len(pairs), motions, limits)
        seen.demand()
    if method in (Method.ROBUST, Method.MAXIMUM_LIKELIHOOD):
        settings = settings if method is Method.ROBUST else settings._replace(reject=False)
        found = robust(pairs, motions, settings)
        if method is Method.ROBUST:
            assert found.inliers is not None
            seen = verdict(int(found.inliers.sum()), all_motions(pairs.subset(found.inliers)), limits)
            seen.demand()
    elif method in CLASSICAL:
        found = classical.from_poses(pairs, motions, CLASSICAL[method])
    else:
        X, certificate = dqcr(forms(dual_quaternions(motions)))
        found = SolverEstimate(X, certificate=certificate)
    return _result(pairs, method, seen, found)


def _whatever_the_noise(limits: ObservabilityLimits | None) -> ObservabilityLimits:
    return (limits or ObservabilityLimits())._replace(above_noise=0.0, uncertainty=math.inf)


def solve_motions(motions: Motions, method: Method, noise: Noise | None = None) -> Array:
    """X (4, 4) from bare relative motions A X = X B, each camera motion with its own noise.

    ``maximum-likelihood`` and ``robust`` are the same here: maximum likelihood from DQCR's
    answer. Raises MeasurementFailed like ``solve``, ValueError for methods that need
    poses.
    """
    verdict(len(motions.A) + 1, motions).demand()
    if method in (Method.MAXIMUM_LIKELIHOOD, Method.ROBUST):
        equations = Equations(stacks.inverse(motions.A), motions.B, np.ones(len(motions.A)), tied=True)
        start = dqcr(forms(dual_quaternions(motions)))[0]
        first = noise or Noise(*noise_model.USUAL_RATIO)
        if noise is None:
            return noise_model.estimated(equations, start, start, first, NoiseSource.CAMERA)[0].X
        return ml.maximize(equations, start, start, first).X
    if method in CLASSICAL:
        return classical.from_motions(motions, CLASSICAL[method])
    return dqcr(forms(dual_quaternions(motions)))[0]


def _result(
    pairs: PosePairs,
    method: Method,
    observability: Observability,
    found: SolverEstimate,
) -> HandEyeResult:
    """The result in the caller's order; Z is the samples' mean where the method does not give it."""
    X, Z = found.X, found.Z
    Z = stacks.mean_pose(pairs.H @ X @ pairs.P) if Z is None else Z
    back = np.argsort(np.array(pairs.order))
    inliers = np.ones(len(pairs), dtype=bool) if found.inliers is None else found.inliers
    residuals = ml.residuals(pairs.H, pairs.P, X, Z)
    names = tuple(pairs.names[k] for k in back)
    return HandEyeResult(
        method.value,
        pairs.setup,
        X,
        Z,
        names,
        residuals[back],
        inliers[back],
        observability,
        found.certificate,
        found.covariance,
        found.noise,
        found.notes,
    )
