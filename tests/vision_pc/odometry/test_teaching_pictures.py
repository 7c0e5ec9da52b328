"""Of the pictures of one place the first few teach; a new keyframe's points are to be learnt anew."""

import numpy as np

from vision_pc.core import se3
from vision_pc.core.odometry.keyframes.keyframe import A_PLACE, TeachingPictures
from vision_pc.core.se3 import Array

POINTS = np.array([[0.2, 0.1, 1.4], [-0.3, 0.0, 1.5], [0.0, 0.2, 1.6]])
STAYS = [True] * A_PLACE + [False] * 3


def at(x_m: float, turn_rad: float = 0.0) -> Array:
    return se3.inverse(se3.transform(se3.exp_so3([0.0, turn_rad, 0.0]), (x_m, 0.0, 0.0)))


def taught(X_CC0: list[Array], keyframes: int = 1, teaching: TeachingPictures | None = None) -> list[bool]:
    teaching = teaching or TeachingPictures()
    return [teaching.teaches(X, POINTS, keyframes) for X in X_CC0]


def test_the_first_few_of_a_place_teach_though_the_base_rocks() -> None:
    assert taught([at(1e-3 * (-1) ** k) for k in range(len(STAYS))]) == STAYS


def test_another_place_and_a_turn_alone_and_a_new_keyframe_teach_anew() -> None:
    place, aside, turned = at(0.0), at(0.03), at(0.0, 0.02)
    assert taught([place] * len(STAYS) + [aside] * len(STAYS)) == 2 * STAYS
    assert taught([place] * len(STAYS) + [turned] * len(STAYS)) == 2 * STAYS
    teaching = TeachingPictures()
    assert taught([place] * len(STAYS), 1, teaching) == STAYS
    assert taught([place] * len(STAYS), 2, teaching) == STAYS
