"""The disparities' offset of a recording: pairs that agree are believed, others are not."""

import numpy as np
import pytest

from vision_pc.core.odometry.keyframes.keyframe_map import HeldViews
from vision_pc.core.odometry.shared_offset import SharedOffset

BELIEVED_PX = 0.3


def learnt(offsets: list[float], std_px: float = 0.01, learns: bool = True) -> SharedOffset:
    """After pairs one view of which tells each of ``offsets``."""
    shared, seen = SharedOffset(learns), np.zeros((2, 1, 2))
    seen[1, 0, 0] = 1.0  # an offset moves the right eye's columns
    for offset in offsets:
        shared.learn(seen, HeldViews(offset * seen, np.ones((2, 1)), np.zeros((2, 1, 2))), std_px)
    return shared


def test_pairs_that_agree_are_believed_to_what_matching_leaves() -> None:
    found = learnt([0.20, 0.22, 0.21]).found(BELIEVED_PX)
    assert found is not None
    assert found.px == pytest.approx(0.21)
    assert 0.03 < found.std_px < 0.05


def test_of_few_pairs_more_is_told() -> None:
    """An open road has three or four (8805: 0.13 px off, told 0.057)."""
    few, many = (learnt([0.20, 0.22, 0.21] * n).found(BELIEVED_PX) for n in (1, 10))
    assert few is not None
    assert many is not None
    assert few.std_px > 1.25 * many.std_px


@pytest.mark.parametrize(
    ("offsets", "std_px"),
    [([], 0.01), ([0.2], 0.1), ([-0.4, 0.1, 0.7], 0.01), ([4.0, 4.0, 4.0], 0.01)],
    ids=["none", "too vague", "at odds", "no rectified pair"],
)
def test_what_is_not_known_better_is_left_as_it_was(offsets: list[float], std_px: float) -> None:
    assert learnt(offsets, std_px).found(BELIEVED_PX) is None


def test_of_a_camera_that_is_known_exactly_nothing_is_learnt() -> None:
    assert learnt([0.2, 0.2, 0.2], learns=False).found(BELIEVED_PX) is None
