"""What a solver is given: every bad sample is refused by name, and the caller's order is forgotten."""

from collections.abc import Callable

import numpy as np
import pytest

from protocol.errors import RequestRefused
from tests.vision_pc.hand_eye.data import random_scene
from vision_pc.core.hand_eye.samples import pose_pairs
from vision_pc.core.se3 import Array

NAMES = tuple(f"pose-{k}" for k in range(8))
Spoil = Callable[[Array, Array], None]


def scale_translation(hand: Array, camera: Array) -> None:
    camera[3, :3, 3] = (600.0, 10.0, 900.0)


def reflect(hand: Array, camera: Array) -> None:
    hand[3, :3, 0] *= -1.0


def shear(hand: Array, camera: Array) -> None:
    camera[3, 0, 1] += 0.01


def poison(hand: Array, camera: Array) -> None:
    hand[3, 1, 3] = np.nan


def break_last_row(hand: Array, camera: Array) -> None:
    camera[3, 3, 0] = 0.5


def repeat(hand: Array, camera: Array) -> None:
    hand[3], camera[3] = hand[5], camera[5]


def freeze_camera(hand: Array, camera: Array) -> None:
    camera[3] = camera[5]


@pytest.mark.parametrize(
    ("spoil", "cause", "named"),
    [
        (scale_translation, "refused.hand_eye.units", "pose-3: camera pose"),
        (reflect, "refused.hand_eye.left_handed", "pose-3: hand pose"),
        (shear, "refused.hand_eye.not_orthonormal", "pose-3: camera pose"),
        (poison, "refused.hand_eye.not_finite", "pose-3: hand pose"),
        (break_last_row, "refused.hand_eye.not_a_pose", "pose-3: camera pose"),
        (repeat, "refused.hand_eye.duplicate", "pose-3 and pose-5"),
        (freeze_camera, "refused.hand_eye.stale_camera", "pose-3 and pose-5"),
    ],
)
def test_a_bad_sample_is_refused_by_name(spoil: Spoil, cause: str, named: str) -> None:
    scene = random_scene(np.random.default_rng(1), 8)
    hand, camera = scene.X_BT.copy(), scene.P()
    spoil(hand, camera)
    with pytest.raises(RequestRefused, match=named) as caught:
        pose_pairs(hand, camera, names=NAMES)
    assert caught.value.cause == cause


def test_rounded_rotations_are_made_exact() -> None:
    scene = random_scene(np.random.default_rng(2), 8)
    pairs = pose_pairs(np.round(scene.X_BT, 4), np.round(scene.P(), 4))
    R = pairs.H[:, :3, :3]
    np.testing.assert_allclose(R @ np.swapaxes(R, -1, -2), np.broadcast_to(np.eye(3), R.shape), atol=1e-14)


def test_order_is_canonical_and_remembered() -> None:
    scene = random_scene(np.random.default_rng(3), 8)
    P = scene.P()
    shuffle = np.random.default_rng(4).permutation(8)
    one = pose_pairs(scene.X_BT, P, names=NAMES)
    other = pose_pairs(scene.X_BT[shuffle], P[shuffle], names=tuple(NAMES[k] for k in shuffle))
    assert one.names == other.names
    assert np.array_equal(one.H, other.H)
    assert np.array_equal(one.P, other.P)
    assert [NAMES[k] for k in one.order] == list(one.names)
