"""X of a guided session: the certified robust solver, and the errors of the arm beside it.

With the arm's nominal model and its uncertainties the samples tell the joints' zeros from a turned camera, as
far as they can:

1. The robust solver finds the samples that agree, on the poses as reported.
2. Shared errors of arm and camera are fitted with X and Z (``shared_errors``).
3. The robust solver once more on the poses without them: bad samples stand out better, and the certificate
   is that of the poses corrected.
4. The fit over the samples that agree now is the answer.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from protocol.errors import MeasurementFailed
from vision_pc.config.choices import Method
from vision_pc.config.hand_eye import GuidedSettings
from vision_pc.core.hand_eye.guided import nominal_model, shared_errors
from vision_pc.core.hand_eye.guided.nominal_model import Links
from vision_pc.core.hand_eye.guided.session import Sample, Session
from vision_pc.core.hand_eye.guided.shared_errors import Doubts, SharedFit
from vision_pc.core.hand_eye.samples import PosePairs
from vision_pc.core.hand_eye.solvers import maximum_likelihood as ml
from vision_pc.core.hand_eye.solvers import methods
from vision_pc.core.hand_eye.solvers.result import HandEyeResult
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraModel

_FIT_M, _FIT_RAD = 0.005, 0.003  # [D] the pose is taken at the pictures, the angles just after


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

    ``pairs`` as the result rests on them, shared errors taken off.
    """

    result: HandEyeResult
    covariance: Array
    pairs: PosePairs
    arm: ArmFound


def solve(session: Session) -> GuidedSolution:
    """The session's calibration.

    Raises MeasurementFailed as ``methods.solve``, and ``measurement.hand_eye.another_arm``.
    """
    arm, pairs = session.settings.arm, session.pairs()
    result = methods.solve(pairs, Method.ROBUST)
    _refuse_another_arm(session)
    samples = [session.samples[k] for k in pairs.order]
    doubts = doubts_of(samples, session.links, session.settings, session.around.camera.left)
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


def doubts_of(samples: Sequence[Sample], links: Links, settings: GuidedSettings, eye: CameraModel) -> Doubts:
    """What may be wrong with ``samples``: of an arm of these ``links``, and of the camera."""
    q = np.stack([s.q for s in samples])
    of_arm = nominal_model.shared_errors(links, settings.arm, q)
    of_camera = _lens_errors(np.stack([s.X_CP for s in samples]), settings, eye)
    nothing = np.zeros_like(of_arm[..., :1])
    hand = np.concatenate([of_arm, np.repeat(nothing, of_camera.shape[-1], axis=2)], axis=2)
    camera = np.concatenate([np.repeat(nothing, of_arm.shape[-1], axis=2), of_camera], axis=2)
    play = nominal_model.backlash(links, settings.arm, q)
    return Doubts(hand, camera, play, np.stack([s.covariance for s in samples]))


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


def _refuse_another_arm(session: Session) -> None:
    """Raise MeasurementFailed where the nominal model puts the hand elsewhere than the controller."""
    q, X_BT = (np.stack([getattr(s, name) for s in session.samples]) for name in ("q", "X_BT"))
    apart, turn = nominal_model.mismatch(session.links, q, X_BT)
    worst = int(np.argmax(np.maximum(apart / _FIT_M, turn / _FIT_RAD)))
    if apart[worst] > _FIT_M or turn[worst] > _FIT_RAD:
        raise MeasurementFailed(
            "measurement.hand_eye.another_arm",
            f"the nominal model is not this arm's: it puts the hand of sample {session.samples[worst].name} "
            f"{1e3 * apart[worst]:.1f} mm and {1e3 * turn[worst]:.1f} mrad off where the controller has it",
        )
