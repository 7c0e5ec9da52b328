"""The disparities' offset of a recording: windows of keyframes that agree are believed, others are not."""

import pytest

from vision_pc.core.odometry.keyframes.bundle_adjustment import OffsetTold
from vision_pc.core.odometry.shared_offset import SharedOffset

BELIEVED_PX = 0.3


class Keyframes:
    """In place of a map: a keyframe more at every asking, and what the windows tell of the offset."""

    def __init__(self, offsets: list[float], std_px: float) -> None:
        self.keyframes = [self] * 4
        self.number = 0
        self._told = iter([OffsetTold(std_px**-2.0, offset * std_px**-2.0) for offset in offsets])

    def offset_told(self, window: int) -> OffsetTold:
        return next(self._told)


def learnt(offsets: list[float], std_px: float = 0.01) -> SharedOffset:
    shared, keyframes = SharedOffset(learns=True), Keyframes(offsets, std_px)
    for _ in offsets:
        shared.learn(keyframes)  # type: ignore[arg-type]
    return shared


def test_windows_that_agree_are_believed_to_what_matching_leaves() -> None:
    found = learnt([0.20, 0.22, 0.21]).found(BELIEVED_PX)
    assert found is not None
    assert found.px == pytest.approx(0.21)
    assert 0.03 < found.std_px < 0.05


def test_of_few_windows_more_is_told() -> None:
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
    shared = SharedOffset(learns=False)
    shared.learn(Keyframes([0.2], 0.01))  # type: ignore[arg-type]
    assert shared.found(BELIEVED_PX) is None
