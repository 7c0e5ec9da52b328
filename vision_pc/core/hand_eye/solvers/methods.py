"""One entrance to all hand-eye solvers: checked samples in, a calibration with its verdict out.

The robust solver agrees on the good samples, proves the global optimum, then maximises the likelihood:

1. Graduated non-convexity finds the samples that agree (``consensus``), with a robust guess of the noise.
2. The chordal problem over those samples is solved globally and certified (``chordal``).
3. Maximum likelihood from there, noise by the restricted likelihood (``noise``), and the covariance.
4. With that better noise the samples are tested again; 2 to 4 repeat until the set stays the same.
5. Where hold-out contradicts the estimate, that of rotations first takes its place (``held_out``).
"""

import numpy as np

from protocol.errors import MeasurementFailed
from vision_pc.config.choices import Method
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.samples import PosePairs
from vision_pc.core.hand_eye.solvers import chordal, classical, consensus, held_out
from vision_pc.core.hand_eye.solvers import maximum_likelihood as ml
from vision_pc.core.hand_eye.solvers import noise as noise_model
from vision_pc.core.hand_eye.solvers.classical import dqcr
from vision_pc.core.hand_eye.solvers.consensus import parts
from vision_pc.core.hand_eye.solvers.maximum_likelihood import Equations, Noise
from vision_pc.core.hand_eye.solvers.motions import Motions, all_motions, dual_quaternions
from vision_pc.core.hand_eye.solvers.result import (
    Certificate,
    HandEyeResult,
    Observability,
    SolverEstimate,
    verdict,
)
from vision_pc.core.se3 import Array

CLASSICAL = (*classical.AX_XB, *classical.AX_ZB)
_THRESHOLD = 24.1  # 99.95 % of χ² with 6 degrees of freedom
_PASSES = 4
_LEAST_SHARE = 0.5  # of the samples must agree, else there is no result


def robust(pairs: PosePairs, motions: Motions, reject: bool = True) -> SolverEstimate:
    """The calibration by the module's five steps; without ``reject`` maximum likelihood over all samples.

    Raises MeasurementFailed: ``measurement.hand_eye.no_consensus`` when too few samples agree, ``.sdp``,
    ``.no_solution``, ``.singular`` from the steps.
    """
    n, p = len(pairs), parts(pairs, motions)
    notes: list[str] = []
    noise, weights = Noise(*noise_model.USUAL_RATIO), np.ones(n)
    tells_bad = reject and n >= consensus.LEAST_FOR_OUTLIERS
    if tells_bad:
        noise = consensus.guessed_noise(p, pairs.setup)
        weights = consensus.graduated(p, pairs.setup, noise, _THRESHOLD)
        _demand_consensus(weights, pairs)
    elif reject:
        notes.append(f"{n} samples are too few to tell a bad one; all are used")
    for _ in range(_PASSES):
        estimate, noise, certificate = _certified(pairs, weights, noise)
        squares = consensus.normalised_squares(p, pairs.setup, noise, estimate.X, estimate.Z)
        again = (squares <= _THRESHOLD).astype(float) if tells_bad else weights
        if (again == weights).all():
            break
        _demand_consensus(again, pairs)
        weights = again
    else:
        estimate, noise, certificate = _certified(pairs, weights, noise)
    if not certificate.holds:
        notes.append("the global optimum is not proven: the relaxation is not tight for these samples")
    if reject:
        estimate, more = _by_hold_out(pairs.subset(weights > 0.5), estimate, noise)
        notes += more
    count = int(weights.sum())
    notes += noise_model.few_sample_notes(count)
    covariance = ml.covariance_of_X(estimate) * noise_model.few_sample_factor(count)
    return SolverEstimate(estimate.X, estimate.Z, tuple(notes), weights > 0.5, certificate, covariance, noise)


def _by_hold_out(agreeing: PosePairs, estimate: ml.Estimate, noise: Noise) -> tuple[ml.Estimate, list[str]]:
    """``estimate`` with its ``noise``, or that by rotations first where it predicts held-out samples better.

    The information in the latter counts by the square of how far the former was behind: what misled the one
    is no smaller for the other.
    """
    behind = held_out.behind(agreeing, estimate.X, estimate.Z, noise)
    if behind == 1.0:
        return estimate, []
    equations = Equations(agreeing.H, agreeing.P, np.ones(len(agreeing)), agreeing.setup)
    estimate = ml.maximize(equations, *held_out.rotations_first(agreeing), noise, steps=0)
    note = (
        f"hold-out puts maximum likelihood {behind:.2f} times behind rotations first, "
        f"limit {held_out.BEHIND:g}: the rotation is from rotations alone"
    )
    return estimate._replace(information=estimate.information / behind**2), [note]


def _certified(pairs: PosePairs, weights: Array, noise: Noise) -> tuple[ml.Estimate, Noise, Certificate]:
    X, Z, certificate = chordal.solve(chordal.problem(pairs.H, pairs.P, weights, noise))
    equations = Equations(pairs.H, pairs.P, weights, pairs.setup)
    return *noise_model.estimated(equations, X, Z, noise), certificate


def _demand_consensus(weights: Array, pairs: PosePairs) -> None:
    agree, n = int(weights.sum()), len(weights)
    if agree < max(3, _LEAST_SHARE * n):
        good = ", ".join(name for name, w in zip(pairs.names, weights, strict=True) if w > 0.5) or "none"
        raise MeasurementFailed(
            "measurement.hand_eye.no_consensus",
            f"only {agree} of {n} samples agree on one calibration ({good}); "
            "check units, frames (eye in hand or to hand) and that hand and camera poses belong together",
        )


def solve(pairs: PosePairs, method: Method = Method.ROBUST) -> HandEyeResult:
    """The calibration of ``pairs`` by ``method``; the order of the samples does not change it by a bit.

    Raises MeasurementFailed when X is not observable (``measurement.hand_eye.too_few_samples``,
    ``.too_little_rotation``, ``.parallel_axes``, ``.motions_differ``) or the solver has no proper answer
    (``.no_solution``, ``.left_handed``, ``.no_consensus``, ``.sdp``, ``.singular``).
    """
    motions = all_motions(pairs)
    # Bad samples look like noise, which can be judged only without them.
    seen = verdict(len(pairs), motions, whatever_the_noise=method is Method.ROBUST)
    seen.demand()
    if method in (Method.ROBUST, Method.MAXIMUM_LIKELIHOOD):
        found = robust(pairs, motions, reject=method is Method.ROBUST)
        if method is Method.ROBUST:
            assert found.inliers is not None
            seen = verdict(int(found.inliers.sum()), all_motions(pairs.subset(found.inliers)))
            seen.demand()
    elif method in CLASSICAL:
        found = classical.from_poses(pairs, motions, method)
    else:
        X, certificate = dqcr(dual_quaternions(motions))
        found = SolverEstimate(X, certificate=certificate)
    return _result(pairs, method, seen, found)


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
