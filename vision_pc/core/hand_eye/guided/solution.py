"""X of a guided session: the certified robust solver, and the errors of the arm beside it.

With the arm's nominal model and its uncertainties the samples tell the joints' zeros from a turned camera, as
far as they can:

1. The robust solver finds the samples that agree, on the poses as reported.
2. Shared errors of arm and camera are fitted with X and Z (``shared_errors``).
3. The robust solver once more on the poses without them: bad samples stand out better, and the certificate
   is that of the poses corrected.
4. The fit over the samples that agree now is the answer.

Without them, the arm's zeros are one constant turn of the wrist that the covariance takes in.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from vision_pc.config.choices import Method
from vision_pc.config.hand_eye import ArmUncertainty, GuidedSettings
from vision_pc.core.hand_eye.guided import nominal_model, shared_errors
from vision_pc.core.hand_eye.guided.nominal_model import Links
from vision_pc.core.hand_eye.guided.sampling import arm_zero_covariance
from vision_pc.core.hand_eye.guided.session import Sample, Session
from vision_pc.core.hand_eye.guided.shared_errors import Doubts, SharedFit
from vision_pc.core.hand_eye.samples import PosePairs
from vision_pc.core.hand_eye.solvers import maximum_likelihood as ml
from vision_pc.core.hand_eye.solvers import methods
from vision_pc.core.hand_eye.solvers.result import HandEyeResult
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraModel


class ArmFound(NamedTuple):
    """What the samples, and what was said of it before, tell of the arm.

    ``zeros`` (6,) to be added to what the encoders say, and their ``std`` (6,), rad. ``camera_noise`` and
    ``play``: the samples' noise over what was said of it.
    """

    zeros: Array
    std: Array
    camera_noise: float
    play: float


class GuidedSolution(NamedTuple):
    """``result``, whose covariance is by the samples' noise alone; ``covariance`` (6, 6) with arm and camera.

    ``pairs`` as the result rests on them, shared errors taken off; ``arm``: None without its nominal model.
    """

    result: HandEyeResult
    covariance: Array
    pairs: PosePairs
    arm: ArmFound | None


def solve(session: Session) -> GuidedSolution:
    """The session's calibration. Raises MeasurementFailed as ``methods.solve``."""
    pairs = session.pairs()
    result = methods.solve(pairs, Method.ROBUST)
    arm, why = _usable(session)
    if arm is None:
        result = replace(result, notes=(*result.notes, f"{why}: its zeros count as one turn of the wrist"))
        assert result.covariance is not None
        zero_std = 1e-3 * session.settings.arm_zero_std_mrad
        whole = result.covariance + arm_zero_covariance(result.X, session.wrist_to_tool, zero_std)
        return GuidedSolution(result, whole, pairs, None)
    samples = [session.samples[k] for k in pairs.order]
    errors_of_arm = arm_errors(session.links, arm, samples)
    doubts = doubts_of(samples, errors_of_arm, session.settings, session.around.camera.left)
    first = _fit(pairs, result, doubts)
    corrected = replace(pairs, H=first.H, P=first.P)
    agreed = methods.solve(corrected, Method.ROBUST)
    found = _fit(pairs, agreed, doubts)
    corrected = replace(pairs, H=found.H, P=found.P)
    back = np.argsort(np.array(pairs.order))
    residuals = ml.residuals(found.H, found.P, found.X, found.Z)[back]
    result = replace(agreed, X=found.X, Z=found.Z, residuals=residuals, covariance=found.by_noise)
    scale = 1e-3 * arm.zero_std_mrad
    std = np.sqrt(np.diag(found.covariance)[12:][nominal_model.ZEROS])
    zeros = ArmFound(scale * found.errors[nominal_model.ZEROS], scale * std, *found.factors)
    return GuidedSolution(result, found.covariance[:6, :6], corrected, zeros)


class ArmErrors(NamedTuple):
    """What the arm's errors do to the hand in each sample, one standard deviation a column (n, 6, k)."""

    shared: Array
    backlash: Array


def arm_errors(links: Links, arm: ArmUncertainty, samples: Sequence[Sample]) -> ArmErrors:
    """The errors of the arm in ``samples``, which all have their joints' angles."""
    q = np.stack([s.q for s in samples if s.q is not None])
    return ArmErrors(nominal_model.shared_errors(links, arm, q), nominal_model.backlash(links, arm, q))


def doubts_of(
    samples: Sequence[Sample], arm: ArmErrors, settings: GuidedSettings, eye: CameraModel
) -> Doubts:
    """What may be wrong with ``samples``, the ``arm``'s errors among it."""
    of_arm = arm.shared
    of_camera = _lens_errors(np.stack([s.X_CP for s in samples]), settings, eye)
    nothing = np.zeros_like(of_arm[..., :1])
    hand = np.concatenate([of_arm, np.repeat(nothing, of_camera.shape[-1], axis=2)], axis=2)
    camera = np.concatenate([np.repeat(nothing, of_arm.shape[-1], axis=2), of_camera], axis=2)
    return Doubts(hand, camera, arm.backlash, np.stack([s.covariance for s in samples]))


def _lens_errors(X_CP: Array, settings: GuidedSettings, eye: CameraModel) -> Array:
    """Principal point (two) and focal length: how they move the target, by its distance (n, 6, 3)."""
    p = X_CP[:, :3, 3]
    columns = np.zeros((len(p), 6, 3))
    columns[:, 0, 0] = settings.principal_point_std_px / eye.K[0, 0] * p[:, 2]
    columns[:, 1, 1] = settings.principal_point_std_px / eye.K[1, 1] * p[:, 2]
    columns[:, :3, 2] = settings.focal_std * p
    return columns


def _fit(pairs: PosePairs, result: HandEyeResult, doubts: Doubts) -> SharedFit:
    weights = result.inliers[np.array(pairs.order)].astype(float)
    return shared_errors.fit(pairs.H, pairs.P, weights, doubts, result.X, result.Z)


def _usable(session: Session) -> tuple[ArmUncertainty | None, str]:
    """The arm's uncertainties if its nominal model can be used, else why not."""
    arm = session.settings.arm
    if arm is None:
        return None, "the arm's uncertainties are not configured (hand_eye.arm)"
    if not session.links:
        return None, "the session's file has no nominal model of the arm"
    without = [s.name for s in session.samples if s.q is None]
    if without:
        return None, f"joint angles of sample {', '.join(without)} are not known"
    q = np.stack([s.q for s in session.samples if s.q is not None])
    way, turn = nominal_model.mismatch(session.links, q, np.stack([s.X_BT for s in session.samples]))
    worst = int(np.argmax(np.maximum(way / arm.fit_m, 1e3 * turn / arm.fit_mrad)))
    if way[worst] > arm.fit_m or 1e3 * turn[worst] > arm.fit_mrad:
        return None, (
            f"the nominal model is not this arm's: it puts the hand of sample {session.samples[worst].name} "
            f"{1e3 * way[worst]:.1f} mm and {1e3 * turn[worst]:.1f} mrad off where the controller reports it"
        )
    return arm, ""
