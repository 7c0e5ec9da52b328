"""Other ways to read the same samples, and how well each one fits: which mistake the file holds, if any.

A solver fits whatever it is given: with the setup, a side's direction or a unit mistaken, the chordal optimum
is still a proven one, of the wrong problem. So the samples are also read as if one thing had been mistaken,
and for each reading the noise that its samples would have is guessed as ``consensus`` does it, robustly and
in the same way for all. A reading that leaves several times less noise than the given one is likely
the truth.

Three mistakes look the same: the other setup, inverted poses of the hand, inverted poses of the camera (they
differ by X and Z exchanged). Two cannot be told at all, because H X P = Z is also P Z⁻¹ H = X⁻¹ and
H⁻¹ Z P⁻¹ = X: hand and camera exchanged, and both sides inverted.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from protocol.errors import MeasurementFailed
from vision_pc.config.choices import Setup
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.samples import PosePairs
from vision_pc.core.hand_eye.solvers import consensus, scale, separable
from vision_pc.core.hand_eye.solvers.maximum_likelihood import Noise
from vision_pc.core.hand_eye.solvers.motions import all_motions
from vision_pc.core.se3 import Array

_LEAST_TO_SHIFT = 4  # samples: a shifted list is one shorter
_NEARLY = 2.0  # in rotation noise
_LARGEST_SCALE = 1e5  # or its reciprocal: beyond, the fit has made one side vanish


class Reading(NamedTuple):
    """The samples read in one way, and the noise (rad, m) that they would then have.

    ``mistake`` says what would be wrong with the file, empty for the reading as given; camera lengths are
    multiplied by ``scale`` (1: as they are).
    """

    mistake: str
    scale: float
    noise: Noise

    @property
    def misfit(self) -> float:
        """The geometric mean of rotation and translation noise, √(rad m): what readings are compared by."""
        return math.sqrt(self.noise.camera_rotation * self.noise.camera_translation)


def given(pairs: PosePairs) -> Reading | None:
    """The samples as they are given; None where they fit nothing."""
    return _read("", pairs)


def others(pairs: PosePairs) -> tuple[Reading, ...]:
    """Every other reading that fits at all, best first: a mistake, a scale between the sides, or both.

    The scale is freed where rotations, which know none, fit nearly as well as in the best reading.
    """
    read = [(pairs, given(pairs)), *((other, _read(mistake, other)) for mistake, other in _mistaken(pairs))]
    turned = [(other, reading) for other, reading in read if reading is not None]
    least = min((reading.noise.camera_rotation for _, reading in turned), default=0.0)
    scaled = [
        _read(reading.mistake, other, free=True)
        for other, reading in turned
        if reading.noise.camera_rotation <= _NEARLY * least
    ]
    found = [r for r in (*(reading for _, reading in turned if reading.mistake), *scaled) if r is not None]
    return tuple(sorted(found, key=lambda r: r.misfit))


def _mistaken(pairs: PosePairs) -> Iterator[tuple[str, PosePairs]]:
    """The samples with each mistake undone, and its name."""
    other = Setup.EYE_TO_HAND if pairs.setup is Setup.EYE_IN_HAND else Setup.EYE_IN_HAND
    yield f"the setup is {other} or hand poses are inverted", replace(pairs, H=stacks.inverse(pairs.H))
    yield "camera poses are inverted", replace(pairs, P=stacks.inverse(pairs.P))
    for words, how in (
        ("rotations are transposed", _transposed),
        ("quaternions are xyzw, read as wxyz", lambda X: _rolled(X, 1)),
        ("quaternions are wxyz, read as xyzw", lambda X: _rolled(X, -1)),
    ):
        yield f"camera {words}", replace(pairs, P=how(pairs.P))
        yield f"hand {words}", replace(pairs, H=_on_the_hand(pairs, how))
    if len(pairs) >= _LEAST_TO_SHIFT:
        for step, where in ((1, "next"), (-1, "previous")):
            shifted = f"sides are shifted by one: each hand pose belongs to the {where} camera pose"
            yield shifted, _shifted(pairs, step)


def _transposed(X: Array) -> Array:
    return stacks.transform(np.swapaxes(X[:, :3, :3], -1, -2), X[:, :3, 3])


def _rolled(X: Array, step: int) -> Array:
    q = np.roll(stacks.quaternion_from_rotation(X[:, :3, :3]), step, axis=-1)
    return stacks.transform(stacks.rotation_from_quaternion(q), X[:, :3, 3])


def _on_the_hand(pairs: PosePairs, how: Callable[[Array], Array]) -> Array:
    X_BT = how(pairs.X_BT)
    return X_BT if pairs.setup is Setup.EYE_IN_HAND else stacks.inverse(X_BT)


def _shifted(pairs: PosePairs, step: int) -> PosePairs:
    """Hand poses beside the camera poses ``step`` later in the caller's order; the ends fall away."""
    back = np.argsort(np.array(pairs.order))
    hands, cameras = (back[:-1], back[1:]) if step > 0 else (back[1:], back[:-1])
    names = tuple(pairs.names[k] for k in cameras)
    return PosePairs(pairs.setup, pairs.H[hands], pairs.P[cameras], names, tuple(range(len(names))))


def _read(mistake: str, pairs: PosePairs, free: bool = False) -> Reading | None:
    """The samples so read, with camera lengths as they are or scaled; None where nothing fits."""
    parts = separable.parts(pairs, all_motions(pairs))
    try:
        factor = scale.rough(parts) if free else 1.0
        if not 1.0 / _LARGEST_SCALE < factor < _LARGEST_SCALE:
            return None
        P = stacks.transform(pairs.P[:, :3, :3], factor * pairs.P[:, :3, 3])
        return Reading(mistake, factor, consensus.guessed_noise(parts._replace(P=P), pairs.setup))
    except (MeasurementFailed, np.linalg.LinAlgError):
        return None
