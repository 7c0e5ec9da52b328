"""Which estimator predicts samples that it was not given: two-fold hold-out beside the classical methods.

The split of the residuals into camera and robot noise weighs rotations against translations through the lever
arm. Where errors are neither (a robot's geometry, a lens), it can turn X so as to explain translations. The
samples themselves show that: an X from one half predicts the other half worse than a classical one does.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple, TypeVar

import numpy as np

from protocol.errors import MeasurementFailed
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.samples import PosePairs
from vision_pc.core.hand_eye.solvers import maximum_likelihood as ml
from vision_pc.core.hand_eye.solvers import noise as noise_model
from vision_pc.core.hand_eye.solvers.classical import Classical, from_poses
from vision_pc.core.hand_eye.solvers.maximum_likelihood import Equations, Noise
from vision_pc.core.hand_eye.solvers.motions import all_motions
from vision_pc.core.hand_eye.solvers.noise import NoiseSource
from vision_pc.core.se3 import Array

BEHIND = 1.02  # of the best classical method's error: more, and another estimator is taken
_K = TypeVar("_K")
LEAST = 12  # samples: with fewer a half cannot tell camera from robot noise, and estimates as another would


class Held(NamedTuple):
    """Root-mean-square errors of predicting the other half: ``rotation`` rad, ``translation`` m."""

    rotation: float
    translation: float


class Choice(NamedTuple):
    """The estimator that predicts best, None: the one asked about; ``behind``: how many times the best
    classical method's error that one's is, the worse of rotation and translation."""

    estimator: NoiseSource | Classical | None
    behind: float


def chosen(pairs: PosePairs, X: Array, Z: Array, noise: Noise) -> Choice:
    """What to estimate ``pairs`` by, where maximum likelihood with both noises gave X, Z (4, 4), ``noise``.

    It stays unless two-fold hold-out puts it more than 2 % behind the best classical method, in rotation or
    in translation; then the estimator that is least behind is taken.
    """
    if len(pairs) < LEAST:
        return Choice(None, 1.0)
    classical = _errors(pairs, {one: _classical(one) for one in Classical})
    if not classical:
        return Choice(None, 1.0)
    best = Held(*(min(column) for column in zip(*classical.values(), strict=True)))
    by_source = {source: _likely(source, X, Z, noise) for source in NoiseSource}
    likely = _errors(pairs, by_source)
    behind = {one: _behind(held, best) for one, held in (*likely.items(), *classical.items())}
    own = behind.pop(NoiseSource.BOTH, float("inf"))
    first = min(behind, key=behind.__getitem__)
    return Choice(first if own > BEHIND and behind[first] < own else None, own)


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


def _errors(
    pairs: PosePairs, estimators: Mapping[_K, Callable[[PosePairs], tuple[Array, Array]]]
) -> dict[_K, Held]:
    """Estimator → its errors; one that fails on a half is left out."""
    even = np.arange(len(pairs)) % 2 == 0
    held: dict[_K, Held] = {}
    for name, estimate in estimators.items():
        parts = []
        try:
            for fold in (even, ~even):
                other = pairs.subset(~fold)
                parts.append(ml.residuals(other.H, other.P, *estimate(pairs.subset(fold))))
        except MeasurementFailed:
            continue
        r = np.concatenate(parts)
        held[name] = Held(
            *(float(np.sqrt(np.mean(np.sum(part**2, axis=1)))) for part in (r[:, 3:], r[:, :3]))
        )
    return held


def _behind(held: Held, best: Held) -> float:
    return max(held.rotation / max(best.rotation, 1e-12), held.translation / max(best.translation, 1e-12))
