"""Of the pictures of one place the first few teach; a new keyframe's points are to be learnt anew."""

import numpy as np

from vision_pc.core import se3
from vision_pc.core.odometry.keyframes.keyframe import TeachingPictures
from vision_pc.core.se3 import Array

POINTS = np.array([[0.2, 0.1, 1.4], [-0.3, 0.0, 1.5], [0.0, 0.2, 1.6]])


def at(x_m: float) -> Array:
    return se3.inverse(se3.transform(np.eye(3), (x_m, 0.0, 0.0)))


def test_the_first_few_of_a_place_teach_though_the_base_rocks() -> None:
    teaching = TeachingPictures(3)
    rocking = [at(1e-3 * (-1) ** k) for k in range(6)]
    assert [teaching.teaches(X, POINTS, 1) for X in rocking] == [True] * 3 + [False] * 3


def test_another_place_and_a_new_keyframe_teach_anew() -> None:
    teaching = TeachingPictures(1)
    seen = [(0.0, 1), (0.0, 1), (0.03, 1), (0.03, 1), (0.03, 2), (0.03, 2)]
    assert [teaching.teaches(at(x), POINTS, made) for x, made in seen] == [True, False] * 3


def test_all_teach_where_nothing_is_asked() -> None:
    teaching = TeachingPictures(0)
    assert all(teaching.teaches(at(0.0), POINTS, 1) for _ in range(50))
