"""Other ways to read the same samples, and how well each one fits: which mistake the file holds, if any.

A solver fits whatever it is given: with the setup, a side's direction or a unit mistaken, the chordal optimum
is still a proven one, of the wrong problem. So the samples are also read as if one thing had been mistaken,
and for each reading the noise that its samples would have is guessed as ``consensus`` does it, robustly and
in the same way for all. A reading that leaves several times less noise than the given one is likely
the truth.

Three mistakes look the same: the other setup, inverted poses of the hand, inverted poses of the camera (they
differ by X and Z exchanged). Two cannot be told at all, because H X P = Z is also P Z⁻¹ H = X⁻¹ and
H⁻¹ Z P⁻¹ = X: hand and camera exchanged, and both sides inverted.

The scale between the lengths of camera and hand is 1 if both have the same unit and the target the size that
was said. A mistaken length leaves rotations alone, so any solver fits it, and puts the rest into X.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import permutations, product
from typing import NamedTuple

import numpy as np

from protocol.errors import MeasurementFailed
from vision_pc.config.choices import Setup
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.samples import PosePairs
from vision_pc.core.hand_eye.solvers import consensus
from vision_pc.core.hand_eye.solvers import maximum_likelihood as ml
from vision_pc.core.hand_eye.solvers.consensus import Parts, parts, start_of
from vision_pc.core.hand_eye.solvers.maximum_likelihood import Equations, Noise
from vision_pc.core.hand_eye.solvers.motions import all_motions
from vision_pc.core.hand_eye.solvers.rotation_forms import angles_between, reread
from vision_pc.core.se3 import Array

_LEAST_TO_SHIFT = 4  # samples: a shifted list is one shorter
_NEARLY = 2.0  # in rotation noise
# Translation noise over rotation noise at the target's distance: 0.2 to 1.0 in fourteen sound sets, 71 to 305
# in five with positions in other axes than their rotations.
_POSITIONS_APART = 10.0  # [M]
_POSITIONS_BETTER = 4.0  # [D] times less shift
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
    return _reading_of("", pairs)


def others(pairs: PosePairs) -> tuple[Reading, ...]:
    """Every other reading that fits at all, best first: a mistake, a scale between the sides, or both.

    The scale is freed where rotations, which know none, fit nearly as well as in the best reading.
    """
    as_given = given(pairs)
    moved = as_given is None or apart(pairs, as_given.noise)
    mistaken = [*_mistaken(pairs), *(_moved_otherwise(pairs, as_given) if moved else ())]
    read = [(pairs, as_given), *((other, _reading_of(mistake, other)) for mistake, other in mistaken)]
    turned = [(other, reading) for other, reading in read if reading is not None]
    least = min((reading.noise.camera_rotation for _, reading in turned), default=0.0)
    scaled = [
        _reading_of(reading.mistake, other, free=True)
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
    ways: dict[str, Callable[[Array], Array]] = {
        "rotations are transposed": lambda X: stacks.transform(
            np.swapaxes(X[:, :3, :3], -1, -2), X[:, :3, 3]
        ),
        "quaternions are xyzw, read as wxyz": lambda X: _rolled(X, 1),
        "quaternions are wxyz, read as xyzw": lambda X: _rolled(X, -1),
        "positions are inverted and rotations are not": lambda X: stacks.transform(
            X[:, :3, :3], -np.einsum("nij,nj->ni", X[:, :3, :3], X[:, :3, 3])
        ),
    }
    for words, how in ways.items():
        yield f"camera {words}", replace(pairs, P=how(pairs.P))
        hand = _of_hand(pairs, how(pairs.X_BT))
        yield f"hand {words}", replace(pairs, H=hand)
        yield f"hand and camera {words}", replace(pairs, H=hand, P=how(pairs.P))
    turned = angles_between(np.swapaxes(pairs.P[:, :3, :3], -1, -2))
    for words, R in reread(pairs.X_BT[:, :3, :3], turned):
        hand = stacks.transform(R, pairs.X_BT[:, :3, 3])
        yield f"hand rotations {words}", replace(pairs, H=_of_hand(pairs, hand))
    # of the camera it is the inverses that turn as the hand does
    for words, R in reread(pairs.P[:, :3, :3], angles_between(np.swapaxes(pairs.H[:, :3, :3], -1, -2))):
        yield f"camera rotations {words}", replace(pairs, P=stacks.transform(R, pairs.P[:, :3, 3]))
    if len(pairs) >= _LEAST_TO_SHIFT:
        for step, where in ((1, "next"), (-1, "previous")):
            shifted = f"sides are shifted by one: each hand pose belongs to the {where} camera pose"
            yield shifted, _pairs_shifted(pairs, step)


def apart(pairs: PosePairs, noise: Noise) -> bool:
    """Whether rotations fit and positions do not, by more than rotations' noise at the target's distance.

    Rotations that fit one another tell of nothing that turns or mirrors positions alone.
    """
    distance = float(np.median(np.linalg.norm(pairs.P[:, :3, 3], axis=-1)))
    return noise.camera_translation > _POSITIONS_APART * noise.camera_rotation * distance


def _moved_otherwise(pairs: PosePairs, as_given: Reading | None) -> Iterator[tuple[str, PosePairs]]:
    """The samples with the positions of one side in each other order and sign of its axes, where they fit
    better by far.
    """
    limit = math.inf if as_given is None else as_given.noise.camera_translation / _POSITIONS_BETTER
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            axes = np.diag(signs)[:, order]
            words = " ".join(f"{'-' if signs[k] < 0 else ''}{'xyz'[order.index(k)]}" for k in range(3))
            hand = _with_positions(pairs.X_BT, axes)
            for side, one in (
                ("camera", replace(pairs, P=_with_positions(pairs.P, axes))),
                ("hand", replace(pairs, H=_of_hand(pairs, hand))),
            ):
                p = parts(one, all_motions(one))
                shifts = consensus.misfits(p, *start_of(p, np.ones(len(one))))[1]
                if float(np.median(shifts)) < limit and not np.array_equal(axes, np.eye(3)):
                    yield f"{side} positions are along {words} of the axes of its rotations", one


def _with_positions(X: Array, axes: Array) -> Array:
    return stacks.transform(X[:, :3, :3], X[:, :3, 3] @ axes.T)


def _rolled(X: Array, step: int) -> Array:
    q = np.roll(stacks.quaternion_from_rotation(X[:, :3, :3]), step, axis=-1)
    return stacks.transform(stacks.rotation_from_quaternion(q), X[:, :3, 3])


def _of_hand(pairs: PosePairs, X_BT: Array) -> Array:
    """H of the equation for poses of the hand."""
    return X_BT if pairs.setup is Setup.EYE_IN_HAND else stacks.inverse(X_BT)


def _pairs_shifted(pairs: PosePairs, step: int) -> PosePairs:
    """Hand poses beside the camera poses ``step`` later in the caller's order; the ends fall away."""
    back = np.argsort(np.array(pairs.order))
    hands, cameras = (back[:-1], back[1:]) if step > 0 else (back[1:], back[:-1])
    names = tuple(pairs.names[k] for k in cameras)
    return PosePairs(pairs.setup, pairs.H[hands], pairs.P[cameras], names, tuple(range(len(names))))


def _reading_of(mistake: str, pairs: PosePairs, free: bool = False) -> Reading | None:
    """The samples so read, with camera lengths as they are or scaled; None where nothing fits."""
    p = parts(pairs, all_motions(pairs))
    try:
        factor = rough_scale(p) if free else 1.0
        if not 1.0 / _LARGEST_SCALE < factor < _LARGEST_SCALE:
            return None
        P = stacks.transform(pairs.P[:, :3, :3], factor * pairs.P[:, :3, 3])
        return Reading(mistake, factor, consensus.guessed_noise(p._replace(P=P), pairs.setup))
    except (MeasurementFailed, np.linalg.LinAlgError):
        return None


_BEST = 4  # triples to go on from
_CONCENTRATIONS = 6
_RIDGE = 1e-12
_STEPS = 6
_LARGEST_STEP = 0.5  # of the scale's reciprocal


class Scale(NamedTuple):
    """The factor on camera lengths and its standard deviation; ``std`` is infinite where nothing tells it."""

    factor: float
    std: float


def rough_scale(p: Parts) -> float:
    """The scale of the samples that agree best, whatever it is; not above 0 where no scale makes sense.

    λ R_X t_P + t_X − R_Hᵀ t_Z = −R_Hᵀ t_H is linear in (t_X, t_Z, λ) once R_X is known. All may be spoiled
    by a few bad samples, so it begins with triples and goes on with the better half of the samples.
    """
    n = len(p.H)
    majority = (n + 4) // 2
    factors, misfits = _fit_scale(p, consensus.triple_weights(n))
    score = np.sort(misfits, axis=-1)[..., majority - 1]
    found = []
    for k in np.argsort(score, kind="stable")[:_BEST]:
        factor, misfit = factors[k], misfits[k]
        for _ in range(_CONCENTRATIONS):
            weights = np.zeros(n)
            weights[np.argsort(misfit, kind="stable")[:majority]] = 1.0
            factor, misfit = _fit_scale(p, weights)
        found.append((float(np.sort(misfit)[majority - 1]), float(factor)))
    return min(found)[1]


def _fit_scale(p: Parts, weights: Array) -> tuple[Array, Array]:
    """The scale (...) for sample ``weights`` (..., n), and each sample's misfit (..., n) in rad m."""
    X, Z = start_of(p, weights)
    R_X = X[..., :3, :3]
    shifted = R_X[..., None, :, :] @ p.P[:, :3, 3, None]
    rows = np.concatenate([np.broadcast_to(p.translation_rows, (*shifted.shape[:-1], 6)), shifted], axis=-1)
    right = p.translation_rows[:, :, 3:] @ p.H[:, :3, 3, None]
    squares = np.swapaxes(rows, -1, -2) @ rows
    normal = np.sum(weights[..., None, None] * squares, axis=-3)
    ridge = _RIDGE * np.trace(normal, axis1=-2, axis2=-1)[..., None, None] * np.eye(7)
    gathered = np.sum(weights[..., None, None] * (np.swapaxes(rows, -1, -2) @ right), axis=-3)
    unknown = np.linalg.solve(normal + ridge, gathered)
    shifts = np.linalg.norm((right - rows @ unknown[..., None, :, :])[..., 0], axis=-1)
    turns, _ = consensus.misfits(p, X, Z)
    return unknown[..., 6, 0], turns * shifts


def refined_scale(equations: Equations, X: Array, Z: Array, noise: Noise) -> tuple[Scale, float]:
    """The most likely scale, X and Z as further unknowns, and the rms shift (m, a component) that it leaves.

    The residual is t_P − t_predicted/λ: the camera measures, so its noise does not draw λ towards 0.
    """
    reciprocal, shift = 1.0, noise.camera_translation
    for _ in range(_STEPS):
        P = stacks.transform(equations.P[:, :3, :3], equations.P[:, :3, 3] / reciprocal)
        scaled = equations._replace(P=P)
        r = ml.residuals(scaled.H, P, X, Z)
        by_scale = np.zeros((len(r), 6, 1))
        by_scale[:, :3, 0] = -ml.predicted(scaled.H, X, Z)[:, :3, 3]
        shift = float(np.sqrt(np.mean(r[:, :3] ** 2)))
        W = ml.whitener(scaled, X, Z, noise)
        slope = np.concatenate([ml.jacobian(scaled, X, Z, r), by_scale], axis=-1)
        J = ml.whitened(W, slope).reshape(-1, slope.shape[-1])
        information = J.T @ J
        try:
            covariance = np.linalg.inv(information)
        except np.linalg.LinAlgError:
            return Scale(1.0, math.inf), shift
        step = covariance @ (J.T @ ml.whitened(W, r[..., None]).reshape(-1))
        X, Z = ml.moved(X, Z, -step[:-1])
        reciprocal *= 1.0 - float(np.clip(step[-1], -_LARGEST_STEP, _LARGEST_STEP))
        if step @ information @ step < 1e-12:
            break
    return Scale(1.0 / reciprocal, float(np.sqrt(covariance[-1, -1])) / reciprocal), shift
