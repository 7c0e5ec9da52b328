"""Do the samples' own hold-out errors contradict the estimate? Maximum likelihood beside rotations first.

The noise that the residuals show weighs rotations against translations through the lever arm. Where errors
are neither (a robot's geometry, a lens), translations turn X so as to be explained. The samples themselves
show that: X from some of them predicts the others worse than one whose rotation comes from rotations alone,
as the classical methods' does.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from protocol.errors import MeasurementFailed
from vision_pc.core.hand_eye.samples import PosePairs
from vision_pc.core.hand_eye.solvers import maximum_likelihood as ml
from vision_pc.core.hand_eye.solvers import noise as noise_model
from vision_pc.core.hand_eye.solvers.consensus import parts, start_of, turn_like_all
from vision_pc.core.hand_eye.solvers.maximum_likelihood import Equations, Noise
from vision_pc.core.hand_eye.solvers.motions import all_motions
from vision_pc.core.se3 import Array

BEHIND = 1.02  # [D] of the error of rotations first: more, and they are taken
LEAST = 5  # [D] samples: four others determine X, its rotation and their noise
_FOLDS = 5  # [D] a fold's estimate has nearly as many samples as the one that is judged
_SURE = 2.0  # [D] standard deviations beyond chance


def behind(pairs: PosePairs, X: Array, Z: Array, noise: Noise) -> float:
    """How many times that of rotations first the hold-out error of maximum likelihood is, which gave X, Z
    (4, 4) and ``noise``: the worse of rotation and translation; 1 unless it is more than 2 % and beyond
    chance.

    Folds whose hands turn about one axis only leave X free, and then nothing is asked.
    """
    folds = np.arange(len(pairs)) % _FOLDS
    if len(pairs) < LEAST or not all(turn_like_all(pairs.H, folds != fold) for fold in set(folds.tolist())):
        return 1.0

    def likely(some: PosePairs) -> tuple[Array, Array]:
        equations = Equations(some.H, some.P, np.ones(len(some)), some.setup)
        return noise_model.estimated(equations, X, Z, noise)[0][:2]

    try:
        mine, first = (_squared_errors(pairs, folds, estimate) for estimate in (likely, rotations_first))
    except MeasurementFailed:
        return 1.0
    further = mine - first
    sure = further.mean(axis=0) > _SURE * further.std(axis=0, ddof=1) / np.sqrt(len(pairs))
    times = np.sqrt(mine.mean(axis=0) / np.maximum(first.mean(axis=0), 1e-24))
    return float(np.max(times, where=sure & (times > BEHIND), initial=1.0))


def rotations_first(pairs: PosePairs) -> tuple[Array, Array]:
    """X and Z (4, 4): rotations from the rotations alone, then translations by least squares."""
    return start_of(parts(pairs, all_motions(pairs)), np.ones(len(pairs)))


def _squared_errors(
    pairs: PosePairs, folds: NDArray[np.int64], estimate: Callable[[PosePairs], tuple[Array, Array]]
) -> Array:
    """Squared errors (n, 2) of predicting each sample from the other folds: translation m², rotation rad²."""
    errors = np.zeros((len(pairs), 2))
    for fold in set(folds.tolist()):
        out = pairs.subset(folds == fold)
        r = ml.residuals(out.H, out.P, *estimate(pairs.subset(folds != fold)))
        errors[folds == fold] = np.sum(r.reshape(-1, 2, 3) ** 2, axis=-1)
    return errors
