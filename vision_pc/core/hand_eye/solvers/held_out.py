"""Which estimator predicts samples that it was not given: two-fold hold-out beside the classical methods.

The split of the residuals into camera and robot noise weighs rotations against translations through the lever
arm. Where errors are neither (a robot's geometry, a lens), it can turn X so as to explain translations. The
samples themselves show that: an X from one half predicts the other half worse than a classical one does.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from protocol.errors import MeasurementFailed
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.samples import PosePairs
from vision_pc.core.hand_eye.solvers import maximum_likelihood as ml
from vision_pc.core.hand_eye.solvers import noise as noise_model
from vision_pc.core.hand_eye.solvers.classical import Classical, from_poses
from vision_pc.core.hand_eye.solvers.consensus import turn_like_all
from vision_pc.core.hand_eye.solvers.maximum_likelihood import Equations, Noise
from vision_pc.core.hand_eye.solvers.motions import all_motions
from vision_pc.core.hand_eye.solvers.noise import NoiseSource
from vision_pc.core.se3 import Array

BEHIND = 1.02  # [D] of the best classical method's error: more, and another estimator is taken
_COMPARED = tuple(
    one for one in Classical if one is not Classical.TSAI
)  # [D] OpenCV's writes on standard error
_K = TypeVar("_K")
_SURE = 3.0  # [D] standard deviations: the best of six is ahead of an equal by one and a half
LEAST = 12  # [D] samples: with fewer a half cannot tell camera from robot noise


class PredictionErrors(NamedTuple):
    """Squared errors (n,) of predicting the other half: ``rotation`` rad², ``translation`` m²."""

    rotation: Array
    translation: Array


class EstimatorChoice(NamedTuple):
    """The estimator that predicts best, None: the one asked about; ``behind``: how many times the best
    classical method's error that one's is, the worse of rotation and translation."""

    estimator: NoiseSource | Classical | None
    behind: float


def choose_estimator(pairs: PosePairs, X: Array, Z: Array, noise: Noise) -> EstimatorChoice:
    """What to estimate ``pairs`` by, where maximum likelihood with both noises gave X, Z (4, 4), ``noise``.

    It stays unless two-fold hold-out puts it more than 2 % behind the best classical method, in rotation or
    in translation, and beyond chance; then the estimator that is least behind is taken. A half whose hands
    turn about one axis only leaves X free, and then nothing is asked.
    """
    halves = _halves(len(pairs))
    if len(pairs) < LEAST or not all(turn_like_all(pairs.H, half) for half in halves):
        return EstimatorChoice(None, 1.0)
    classical = _errors(pairs, {one: _classical(one) for one in _COMPARED})
    if not classical:
        return EstimatorChoice(None, 1.0)
    best = PredictionErrors(*(min(column, key=np.sum) for column in zip(*classical.values(), strict=True)))
    by_source = {source: _likely(source, X, Z, noise) for source in NoiseSource}
    likely = _errors(pairs, by_source)
    if NoiseSource.BOTH not in likely or not _contradicted(likely[NoiseSource.BOTH], best):
        return EstimatorChoice(None, 1.0)
    behind = {one: _behind(errors, best) for one, errors in (*likely.items(), *classical.items())}
    first = min(behind, key=behind.__getitem__)
    return EstimatorChoice(None if first is NoiseSource.BOTH else first, behind[NoiseSource.BOTH])


def by_classical(pairs: PosePairs, method: Classical) -> tuple[Array, Array]:
    """X and Z (4, 4) by ``method``; Z is the samples' mean where it gives none."""
    found = from_poses(pairs, all_motions(pairs), method)
    Z = stacks.mean_pose(pairs.H @ found.X @ pairs.P) if found.Z is None else found.Z
    return found.X, Z


def _classical(method: Classical) -> Callable[[PosePairs], tuple[Array, Array]]:
    return lambda pairs: by_classical(pairs, method)


def _likely(
    source: NoiseSource, X: Array, Z: Array, noise: Noise
) -> Callable[[PosePairs], tuple[Array, Array]]:
    def estimate(pairs: PosePairs) -> tuple[Array, Array]:
        equations = Equations(pairs.H, pairs.P, np.ones(len(pairs)), pairs.setup)
        found = noise_model.estimated(equations, X, Z, noise, source)[0]
        return found.X, found.Z

    return estimate


def _halves(samples: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    even = np.arange(samples) % 2 == 0
    return even, ~even


def _errors(
    pairs: PosePairs, estimators: Mapping[_K, Callable[[PosePairs], tuple[Array, Array]]]
) -> dict[_K, PredictionErrors]:
    """Estimator → its errors; one that fails on a half is left out."""
    errors: dict[_K, PredictionErrors] = {}
    for name, estimate in estimators.items():
        parts = []
        try:
            for fold in _halves(len(pairs)):
                other = pairs.subset(~fold)
                parts.append(ml.residuals(other.H, other.P, *estimate(pairs.subset(fold))))
        except MeasurementFailed:
            continue
        r = np.concatenate(parts)
        errors[name] = PredictionErrors(np.sum(r[:, 3:] ** 2, axis=1), np.sum(r[:, :3] ** 2, axis=1))
    return errors


def _behind(errors: PredictionErrors, best: PredictionErrors) -> float:
    """The worse of rotation and translation, over the best."""
    return max(
        float(np.sqrt(np.mean(mine) / max(float(np.mean(least)), 1e-24)))
        for mine, least in zip(errors, best, strict=True)
    )


def _contradicted(errors: PredictionErrors, best: PredictionErrors) -> bool:
    for mine, least in zip(errors, best, strict=True):
        further = mine - least
        by_chance = float(further.std(ddof=1)) / np.sqrt(len(further))
        behind = float(np.mean(mine)) > BEHIND**2 * float(np.mean(least))
        if behind and float(further.mean()) > _SURE * by_chance:
            return True
    return False
