"""One entrance to all hand-eye solvers: checked samples in, a calibration with its verdict out."""

import math

import numpy as np

from vision_pc.config.choices import Method
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.samples import PosePairs
from vision_pc.core.hand_eye.solvers import chordal, classical, dual_quaternion, robust
from vision_pc.core.hand_eye.solvers import maximum_likelihood as ml
from vision_pc.core.hand_eye.solvers import noise as noise_model
from vision_pc.core.hand_eye.solvers.classical import Classical
from vision_pc.core.hand_eye.solvers.maximum_likelihood import Equations, Noise
from vision_pc.core.hand_eye.solvers.motions import Motions, all_motions, dual_quaternions
from vision_pc.core.hand_eye.solvers.noise import NoiseSource
from vision_pc.core.hand_eye.solvers.observability import Observability, ObservabilityLimits, verdict
from vision_pc.core.hand_eye.solvers.result import HandEyeResult, SolverEstimate
from vision_pc.core.hand_eye.solvers.robust import RobustSettings
from vision_pc.core.se3 import Array

CLASSICAL = {Method(c.value): c for c in Classical}


def solve(
    pairs: PosePairs,
    method: Method = Method.ROBUST,
    settings: RobustSettings | None = None,
    limits: ObservabilityLimits | None = None,
) -> HandEyeResult:
    """The calibration of ``pairs`` by ``method``; the order of the samples does not change it by a bit.

    ``settings`` concern ``robust``, ``maximum-likelihood`` and ``chordal``. Raises MeasurementFailed when X
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
        found = robust.solve(pairs, motions, settings)
        if method is Method.ROBUST:
            assert found.inliers is not None
            seen = verdict(int(found.inliers.sum()), all_motions(pairs.subset(found.inliers)), limits)
            seen.demand()
    elif method is Method.CHORDAL:
        noise = settings.noise or Noise(*noise_model.USUAL_RATIO)
        X, Z, certificate = chordal.solve(chordal.problem(pairs.H, pairs.P, np.ones(len(pairs)), noise))
        found = SolverEstimate(X, Z, certificate=certificate)
    elif method in CLASSICAL:
        found = classical.from_poses(pairs, motions, CLASSICAL[method])
    else:
        found = _by_dual_quaternions(motions, method)
    return _result(pairs, method, seen, found)


def _whatever_the_noise(limits: ObservabilityLimits | None) -> ObservabilityLimits:
    return (limits or ObservabilityLimits())._replace(above_noise=0.0, uncertainty=math.inf)


def solve_motions(motions: Motions, method: Method, noise: Noise | None = None) -> Array:
    """X (4, 4) from bare relative motions A X = X B, each camera motion with its own noise.

    ``maximum-likelihood`` and ``robust`` are the same here: maximum likelihood from the joint
    dual-quaternion optimum. Raises MeasurementFailed like ``solve``, ValueError for methods that need
    poses.
    """
    verdict(len(motions.A) + 1, motions).demand()
    if method in (Method.MAXIMUM_LIKELIHOOD, Method.ROBUST):
        equations = Equations(stacks.inverse(motions.A), motions.B, np.ones(len(motions.A)), tied=True)
        start = dual_quaternion.joint(dual_quaternion.forms(dual_quaternions(motions)))[0]
        first = noise or Noise(*noise_model.USUAL_RATIO)
        if noise is None:
            return noise_model.estimated(equations, start, start, first, NoiseSource.CAMERA)[0].X
        return ml.maximize(equations, start, start, first).X
    if method in CLASSICAL:
        return classical.from_motions(motions, CLASSICAL[method])
    return _by_dual_quaternions(motions, method).X


def _by_dual_quaternions(motions: Motions, method: Method) -> SolverEstimate:
    forms = dual_quaternion.forms(dual_quaternions(motions))
    if method is Method.DQCR:
        X, certificate = dual_quaternion.closed_form(forms)
        return SolverEstimate(X, certificate=certificate)
    if method is Method.JOINT:
        X, certificate = dual_quaternion.joint(forms)
        return SolverEstimate(X, certificate=certificate)
    if method is Method.DQCR_PUBLISHED:
        found = dual_quaternion.published(forms)
        note = (
            "ranks of the moment matrices of order 1 and 2: "
            f"rotation {found.rotation.rank_lower} and {found.rotation.rank_upper}, "
            f"translation {found.translation.rank_lower} and {found.translation.rank_upper}"
        )
        return SolverEstimate(found.X, notes=(note,), certificate=found.certificate)
    raise ValueError(f"{method} needs poses")


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
