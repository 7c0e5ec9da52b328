"""What to believe of a calibration: is there a better reading of its samples, a scale, too much noise?

A proof of the global optimum says that nothing fits the problem better, not that it was the right problem.
Here each doubt has a cause, a sentence with the figure and its limit, and says whether X may be used at all.
"""

import math
from typing import NamedTuple

import cv2
import numpy as np

from protocol.errors import MeasurementFailed
from vision_pc.config.choices import Method, Setup
from vision_pc.core import se3
from vision_pc.core.hand_eye.samples import PosePairs
from vision_pc.core.hand_eye.solvers import lens, methods, readings
from vision_pc.core.hand_eye.solvers.maximum_likelihood import Equations, Noise
from vision_pc.core.hand_eye.solvers.noise import few_sample_factor
from vision_pc.core.hand_eye.solvers.readings import Reading, Scale
from vision_pc.core.hand_eye.solvers.result import HandEyeResult

_POSE = 6  # numbers of a pose, which its own corners fit
_RAYLEIGH_MEDIAN = math.sqrt(2.0 * math.log(2.0))  # of a distance in a plane, in deviations a coordinate
_AS_WELL = 1.5  # times the least misfit: chance, not a better reading
_SCALES = {
    1000.0: "camera lengths in m beside a hand in mm",
    1e-3: "camera lengths in mm beside a hand in m",
    100.0: "camera lengths in m beside a hand in cm",
    0.01: "camera lengths in cm beside a hand in m",
    10.0: "camera lengths in cm beside a hand in mm",
    0.1: "camera lengths in mm beside a hand in cm",
    25.4: "camera lengths in inches beside a hand in mm",
    1.0 / 25.4: "camera lengths in mm beside a hand in inches",
    0.0254: "camera lengths in inches beside a hand in m",
    1.0 / 0.0254: "camera lengths in m beside a hand in inches",
    0.3048: "camera lengths in feet beside a hand in m",
}


# Readings are compared from so many samples on: with fewer, chance makes a wrong one fit better.
_LEAST_SAMPLES = 5  # [M] as below
# [M] Right samples with 0.05° to 1.5° of noise never had another reading fit 2 times better (5 samples, 1.5
# from 6 on), mistaken ones 5 times and more.
_BETTER = 3.0  # [M] between the two
_EXPLAINS = 1.5  # the same, where there is no solution
_SCALE_QUESTIONED, _SCALE_REFUSED, _SCALE_SIGMAS = 0.01, 0.05, 5.0  # |λ − 1|, and how many σ it must be off
_NOISE_DEG, _NOISE_SHARE, _CORNER_PX = 2.0, 0.05, 0.3  # a share of the target's median distance
_REFUSE = 5.0  # times as much refuses
_NOISY, _APART = [
    "blurred pictures, another camera's intrinsics, a moved target, or poses that do not belong together",
    "rotations fit and positions do not: one side's are in other axes or units, or were half inverted",
]
_APART_SHARE = 0.01  # [D] of the target's distance: less is no mistake of a convention


class Doubt(NamedTuple):
    """``reason`` is a sentence with figure and limit, ``cause`` its machine name; ``refused``: no X."""

    cause: str
    reason: str
    refused: bool


class Judgement(NamedTuple):
    """All doubts, the gravest first; the ``scale`` between the sides; and ``next_best``: how many times more

    noise the best other reading leaves (None where readings are not compared).
    """

    doubts: tuple[Doubt, ...]
    scale: Scale | None
    next_best: float | None

    @property
    def verdict(self) -> str:
        """One word: good, questioned or refused."""
        if not self.doubts:
            return "good"
        return "refused" if self.doubts[0].refused else "questioned"

    def demand(self) -> None:
        """Raise MeasurementFailed with the first doubt that forbids X."""
        if self.doubts and self.doubts[0].refused:
            raise MeasurementFailed(self.doubts[0].cause, self.doubts[0].reason)


def believed(pairs: PosePairs, method: Method, as_given: bool = False) -> tuple[HandEyeResult, Judgement]:
    """The calibration, the lens's share in its covariance, and what to believe of it.

    Raises MeasurementFailed where that is nothing; ``as_given`` only tells the doubts that would refuse it.
    """
    try:
        result = methods.solve(pairs, method)
    except MeasurementFailed as error:
        raise explained(pairs, error) from error
    found = judged(pairs, result)
    if not as_given:
        found.demand()
    return lens.widened(pairs, result), found


def judged(pairs: PosePairs, result: HandEyeResult) -> Judgement:
    """The doubts about ``result``, which any method has made of ``pairs``."""
    doubts = _noise_doubts(pairs, result) + _exchange_doubts(result) + _corner_doubts(pairs)
    if (pairs.P[:, 2, 3] < 0.0).all():
        behind = "the target is behind the camera in all samples: are its axes OpenGL's, z backwards?"
        doubts.append(Doubt("measurement.hand_eye.behind", behind, refused=False))
    if len(pairs) < _LEAST_SAMPLES:
        few = f"{len(pairs)} samples are too few to tell a mistaken file; {_LEAST_SAMPLES} can"
        doubts.append(Doubt("measurement.hand_eye.few_samples", few, refused=False))
        return Judgement(_gravest_first(doubts), None, None)
    as_given, others = readings.given(pairs), readings.others(pairs)
    misread = _misread(pairs, as_given, others, _BETTER)
    if as_given is not None and misread is not None:
        cause, words = misread
        refusal = Doubt(cause, f"{words}, as given {_fits(as_given)}", refused=True)
        return Judgement((refusal,), None, None)
    found = _scale(pairs, result)
    if (doubt := _scale_doubt(found)) is not None:
        doubts.append(doubt)
    mistaken = [reading.misfit for reading in others if reading.mistake]
    next_best = min(mistaken) / as_given.misfit if mistaken and as_given is not None else None
    return Judgement(_gravest_first(doubts), found, next_best)


def explained(pairs: PosePairs, error: MeasurementFailed) -> MeasurementFailed:
    """``error`` of a solver, or in its place the mistake that explains it: a reading that fits well."""
    if len(pairs) < _LEAST_SAMPLES:
        return error
    as_given, others = readings.given(pairs), readings.others(pairs)
    misread = _misread(pairs, as_given, others, _EXPLAINS)
    if misread is None:
        return error
    cause, words = misread
    return MeasurementFailed(cause, f"{words}, as given no solution ({error.cause})")


def _corner_doubts(pairs: PosePairs) -> list[Doubt]:
    """What the corners' noise, px a coordinate, says of lens and camera matrix: how far the target, at each
    picture's own pose, is from where it was seen.
    """
    if pairs.corners is None:
        return []
    points, views, K, distortion = pairs.corners
    off = []
    for X_CP, seen in zip(pairs.P, views, strict=True):
        shown = np.isfinite(seen).all(axis=1)
        turn, place = se3.log_so3(X_CP[:3, :3]), X_CP[:3, 3].copy()
        expected = cv2.projectPoints(points[shown], turn, place, K, distortion)[0].reshape(-1, 2)
        off.append(np.linalg.norm(expected - seen[shown], axis=1))
    sizes = np.concatenate(off)
    freedom = max(2 * len(sizes) - _POSE * len(views), 1) / (2 * len(sizes))
    noise_px = float(np.median(sizes)) / _RAYLEIGH_MEDIAN / math.sqrt(freedom)
    if noise_px <= _CORNER_PX:
        return []
    reason = (
        f"corner noise is {noise_px:.3f} px, limit {_CORNER_PX:g} px: "
        "camera_matrix or distortion of another camera or picture size, blur, or corners out of order"
    )
    refused = noise_px > _REFUSE * _CORNER_PX
    return [Doubt("measurement.hand_eye.corner_noise", reason, refused)]


def _gravest_first(doubts: list[Doubt]) -> tuple[Doubt, ...]:
    return tuple(sorted(doubts, key=lambda doubt: not doubt.refused))


def _misread(
    pairs: PosePairs, as_given: Reading | None, others: tuple[Reading, ...], better: float
) -> tuple[str, str] | None:
    """Cause and words of the mistake that explains the samples: the simplest of the readings that fit best,
    if they fit several times better than the given one, and well enough to be believed themselves.
    """
    others = tuple(one for one in others if _excess(pairs, one.noise, one.scale) <= 1.0)
    if not others or (as_given is not None and as_given.misfit < better * others[0].misfit):
        return None
    near = [reading for reading in others if reading.misfit <= _AS_WELL * others[0].misfit]
    least = min(_mistakes(reading) for reading in near)
    likely = [reading for reading in near if _mistakes(reading) == least]
    words = " or ".join(_describe_reading(reading) for reading in likely)
    cause = "misread" if all(reading.mistake for reading in likely) else "scale"
    return f"measurement.hand_eye.{cause}", f"likely {words}: {_fits(likely[0])}"


def _mistakes(reading: Reading) -> int:
    return bool(reading.mistake) + (reading.scale != 1.0)


def _describe_reading(reading: Reading) -> str:
    if reading.scale == 1.0:
        return reading.mistake
    lengths = f"camera lengths have to be multiplied by {reading.scale:.4g}{_name_of_factor(reading.scale)}"
    return f"{reading.mistake}, and {lengths}" if reading.mistake else lengths


def _name_of_factor(factor: float) -> str:
    known = [words for value, words in _SCALES.items() if abs(factor / value - 1.0) < 0.03]
    return f" ({known[0] if known else 'a target of another size than said, or a wrong focal length'})"


def _fits(reading: Reading) -> str:
    turn, shift = math.degrees(reading.noise.camera_rotation), 1e3 * reading.noise.camera_translation
    return f"noise {turn:.3g} deg {shift:.3g} mm"


def _scale(pairs: PosePairs, result: HandEyeResult) -> Scale:
    """The scale between the sides by the used samples, with the noise that remains once they are scaled."""
    inliers = pairs.subset(result.inliers[np.array(pairs.order)])
    equations = Equations(inliers.H, inliers.P, np.ones(len(inliers)), inliers.setup)
    noise, found = result.residual_noise(), Scale(1.0, math.inf)
    fitted = math.sqrt(6.0 * len(inliers) / max(6.0 * len(inliers) - 13.0, 1.0))
    for _ in range(2):
        found, shift = readings.refined_scale(equations, result.X, result.Z, noise)
        noise = noise._replace(camera_translation=fitted * shift)
    return found._replace(std=found.std * math.sqrt(few_sample_factor(len(inliers))))


def _scale_doubt(found: Scale) -> Doubt | None:
    off = abs(found.factor - 1.0)
    if off <= max(_SCALE_QUESTIONED, _SCALE_SIGMAS * found.std):
        return None
    reason = (
        f"camera lengths fit when multiplied by {found.factor:.4g} ± {found.std:.2g}, "
        f"limit 1 ± {_SCALE_QUESTIONED:g}{_name_of_factor(found.factor)}"
    )
    return Doubt("measurement.hand_eye.scale", reason, off > _SCALE_REFUSED)


def _distance(pairs: PosePairs) -> float:
    """How far the target was from the camera, in the middle (m)."""
    return float(np.median(np.linalg.norm(pairs.P[:, :3, 3], axis=-1)))


def _excess(pairs: PosePairs, noise: Noise, scale: float) -> float:
    """How many times what is believed without a question ``noise`` is, of camera lengths times ``scale``."""
    shift = noise.camera_translation / (_NOISE_SHARE * scale * _distance(pairs))
    return max(math.degrees(noise.camera_rotation) / _NOISE_DEG, shift)


def _noise_doubts(pairs: PosePairs, result: HandEyeResult) -> list[Doubt]:
    noise = result.residual_noise()
    turn, shift, distance = noise.camera_rotation, noise.camera_translation, _distance(pairs)
    excess, why = _excess(pairs, noise, 1.0), _NOISY
    if readings.apart(pairs, noise) and shift > _APART_SHARE * distance:
        why, excess = _APART, max(excess, 1.1) * (_REFUSE if excess > 1.0 else 1.0)
    if excess <= 1.0:
        return []
    reason = (
        f"noise is {math.degrees(turn):.3g} deg {1e3 * shift:.3g} mm, limit {_NOISE_DEG:g} deg and "
        f"{100.0 * _NOISE_SHARE:g} % of the target's {1e3 * distance:.4g} mm: {why}"
    )
    return [Doubt("measurement.hand_eye.noise", reason, excess > _REFUSE)]


def _exchange_doubts(result: HandEyeResult) -> list[Doubt]:
    """A camera in the hand that is farther from the hand than the target is from the base."""
    reach, away = float(np.linalg.norm(result.X[:3, 3])), float(np.linalg.norm(result.Z[:3, 3]))
    if result.setup is Setup.EYE_TO_HAND or reach <= away:
        return []
    reason = (
        f"the camera is {1e3 * reach:.0f} mm from the hand, but the target only {1e3 * away:.0f} mm from the "
        "base: exchanged sides, or both inverted, fit as well, and nothing in the poses tells them apart"
    )
    return [Doubt("measurement.hand_eye.exchanged", reason, refused=False)]
