"""What lies around a place that looks like others contradicts whoever takes a wrong one."""

import functools
from typing import NamedTuple

import numpy as np
import pytest

from tests.vision_pc.rendering import facing
from tests.vision_pc.targets.wall_scene import SIZE, TEXEL, rock, scene
from vision_pc.core.se3 import Array
from vision_pc.core.targets.measuring import at_click
from vision_pc.core.targets.sighting import Click, Sighted
from vision_pc.core.targets.target import Candidate, TargetObservation, TargetRefused

SQUARES = 40


class Board(NamedTuple):
    """A pair as vision sees it, a pixel in the left eye on the board, and the place (3,) in C behind it."""

    seen: Sighted
    pixel: Array
    p_C: Array


@functools.cache
def board(square_m: float, distance_m: float, middle: bool = False) -> Board:
    """A chessboard on a wall; its rim and the wall beside it are in the picture. ``middle``: of a square."""
    side = round(square_m / TEXEL)
    cells = np.indices((SQUARES * side, SQUARES * side)) // side
    texture, first = rock(), (SIZE - SQUARES * side) // 2
    texture[first : first + SQUARES * side, first : first + SQUARES * side] = np.where(
        cells.sum(axis=0) % 2, 60.0, 180.0
    )
    made = scene(texture, facing(0.05, -0.02, distance_m, (4.0, -6.0, 3.0)), tool=False)
    place = (-0.5 * square_m, 0.5 * square_m) if middle else (0.0, 0.0)
    return Board(made.sighted(), made.pixel(*place), made.point(*place))


def candidates(board: Board) -> tuple[Candidate, ...]:
    with pytest.raises(TargetRefused) as caught:
        at_click(board.seen, Click(board.pixel))
    assert caught.value.cause == "target.ambiguous", caught.value
    return caught.value.candidates


def taken(board: Board, candidate: Candidate) -> TargetObservation | TargetRefused:
    try:
        return at_click(board.seen, Click(board.pixel, other=np.array(candidate.right_px)))
    except TargetRefused as refused:
        return refused


@pytest.mark.parametrize(("square_m", "distance_m"), [(0.028, 1.0), (0.016, 0.66)])
def test_of_a_boards_candidates_the_right_one_alone_is_believed(square_m: float, distance_m: float) -> None:
    wall = board(square_m, distance_m)
    offered = candidates(wall)
    assert len(offered) >= 4
    answers = [taken(wall, candidate) for candidate in offered]
    believed = [answer for answer in answers if isinstance(answer, TargetObservation)]
    assert [answer.X_CO[2, 3] for answer in believed] == [pytest.approx(wall.p_C[2], rel=0.02)]
    refused = [answer for answer in answers if isinstance(answer, TargetRefused)]
    assert all(answer.candidates for answer in refused if answer.cause == "target.contradicted")
    assert sum(answer.cause == "target.contradicted" for answer in refused) >= 3
    told = next(str(answer) for answer in refused if answer.cause == "target.contradicted")
    assert f"they fit at {1e3 * np.linalg.norm(wall.p_C):.0f}"[:14] in told


def test_a_black_square_of_a_board_is_no_hole_farther_away() -> None:
    wall = board(0.025, 1.0, middle=True)
    with pytest.raises(TargetRefused) as caught:
        at_click(wall.seen, Click(wall.pixel))
    assert caught.value.cause in ("target.ambiguous", "target.contradicted")
    assert caught.value.candidates
