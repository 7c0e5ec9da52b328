"""What has moved since the picture that was clicked is no target; what stands still is one."""

import functools

import cv2
import numpy as np
import pytest

from tests.vision_pc.rendering import facing
from tests.vision_pc.targets.wall_scene import rock, scene
from vision_pc.core.targets.keeper import refuse_moved
from vision_pc.core.targets.target import TargetRefused

AT = np.array([500.0, 300.0])


@functools.cache
def seen(noise: int) -> np.ndarray:
    """A wall, with the noise of one picture."""
    return scene(rock(contrast=8.0), facing(0.0, 0.0, 1.0), seed=noise).pair.left


def shifted(by: tuple[float, float], about: int = 90) -> np.ndarray:
    """The newest picture, where a piece about the click has gone elsewhere."""
    u, v = AT.astype(int)
    picture = seen(2).copy()
    went = cv2.warpAffine(picture, np.array([[1.0, 0.0, by[0]], [0.0, 1.0, by[1]]]), picture.shape[::-1])
    piece = slice(v - about, v + about), slice(u - about, u + about)
    picture[piece] = went[piece]
    return picture


def test_what_stands_still_is_taken_also_at_the_rim_and_while_the_arm_sinks_a_little() -> None:
    for at in (AT, np.array([40.0, 40.0]), np.array([1239.0, 679.0]), np.array([640.4, 360.6])):
        refuse_moved(seen(1), seen(2), at)
    refuse_moved(seen(1), shifted((1.2, -0.8)), AT)


@pytest.mark.parametrize("by", [(5.0, 0.0), (0.0, -7.0), (-11.0, 9.0)])
def test_what_has_moved_is_refused_with_how_far(by: tuple[float, float]) -> None:
    with pytest.raises(TargetRefused, match=rf"moved by {np.hypot(*by):.0f} px") as refused:
        refuse_moved(seen(1), shifted(by), AT)
    assert refused.value.cause == "target.moves"


def test_what_has_gone_farther_is_something_else() -> None:
    with pytest.raises(TargetRefused, match="something else is there") as refused:
        refuse_moved(seen(1), shifted((60.0, 0.0), about=150), AT)
    assert refused.value.cause == "target.moves"
