"""Samples written in every convention: right, or the mistake is named; copies of a moment count once."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import permutations, product

import numpy as np
import pytest

from protocol.errors import MeasurementFailed
from tests.vision_pc.hand_eye.data import noisy_pairs
from vision_pc.config.choices import Method
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.samples import PosePairs, distinct
from vision_pc.core.hand_eye.solvers import judgement
from vision_pc.core.se3 import Array

pytestmark = pytest.mark.slow("a hundred calibrations")
AXES = [
    np.diag(signs)[:, order] for order in permutations(range(3)) for signs in product((1.0, -1.0), repeat=3)
]


def rolled(X: Array, step: int) -> Array:
    q = np.roll(stacks.quaternion_from_rotation(X[:, :3, :3]), step, axis=-1)
    return stacks.transform(stacks.rotation_from_quaternion(q), X[:, :3, 3])


def transposed(X: Array) -> Array:
    return stacks.transform(np.swapaxes(X[:, :3, :3], -1, -2), X[:, :3, 3])


def mistakes(pairs: PosePairs) -> Iterator[tuple[str, PosePairs]]:
    """Every signed order of the axes of positions, and of whole left-handed poses; inverses, transposes,
    orders of the quaternion, on the hand, the camera and both.
    """
    for k, A in enumerate(AXES[1:], 1):
        for side in "HP":
            X = getattr(pairs, side)
            yield (
                f"{side} positions {k}",
                replace(pairs, **{side: stacks.transform(X[:, :3, :3], X[:, :3, 3] @ A.T)}),
            )
            if np.linalg.det(A) < 0.0 and k % 7 == 0:
                mirrored = stacks.transform(A @ X[:, :3, :3] @ A.T, X[:, :3, 3] @ A.T)
                yield f"{side} left-handed {k}", replace(pairs, **{side: mirrored})
    for words, how in (
        ("transposed", transposed),
        ("inverse", stacks.inverse),
        ("w last", lambda X: rolled(X, 1)),
        ("w first", lambda X: rolled(X, -1)),
    ):
        yield f"camera {words}", replace(pairs, P=how(pairs.P))
        yield f"hand {words}", replace(pairs, H=how(pairs.H))
        if words != "inverse":  # both inverted is the same problem with X and Z exchanged
            yield f"both {words}", replace(pairs, H=how(pairs.H), P=how(pairs.P))


def test_each_convention_but_the_right_one_is_named() -> None:
    pairs, scene = noisy_pairs(71, 12, 0.05, 0.3)
    silent, count = [], 0
    for words, wrong in mistakes(pairs):
        count += 1
        try:
            result, found = judgement.believed(wrong, Method.ROBUST)
        except MeasurementFailed as refused:
            silent += [] if refused.cause == "measurement.hand_eye.misread" else [f"{words}: {refused}"]
            continue
        off_m = float(np.linalg.norm(result.X[:3, 3] - scene.X[:3, 3]))
        if off_m > 5e-3:
            silent.append(f"{words}: {found.verdict}, X {1e3 * off_m:.1f} mm off")
    print(f"{count} conventions, {len(silent)} wrong and not named")
    assert not silent, "\n".join(silent)
    assert judgement.believed(pairs, Method.ROBUST)[1].verdict == "good"


def test_samples_of_one_moment_are_one() -> None:
    """Hand at rest, and the camera's noise alone differs; a sample apart by 2 mm is one of its own."""
    pairs, _ = noisy_pairs(72, 8)
    rng = np.random.default_rng(73)
    H, P = (np.repeat(X, 6, axis=0) for X in (pairs.X_BT, pairs.P))
    P[:, :3, 3] += rng.normal(0.0, 5e-5, (48, 3))
    assert distinct(H, P).tolist() == ([True] + [False] * 5) * 8
    H[7, 0, 3] += 2e-3
    assert distinct(H, P).sum() == 9
