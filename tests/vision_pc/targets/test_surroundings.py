"""What lies around a place that looks like others contradicts whoever takes a wrong one."""

import functools

import numpy as np
import pytest

from laboratory.experiments.targets.drawn_walls import Aspect, DrawnWall, drawn_wall
from tests.support.paths import CONFIGS
from vision_pc.core.targets.measuring import at_click
from vision_pc.core.targets.sighting import Click
from vision_pc.core.targets.target import Candidate, TargetObservation, TargetRefused


@functools.cache
def board(seed: int, square_m: float, distance_m: float) -> DrawnWall:
    """A chessboard on a wall; its rim and the wall beside it are in the picture."""
    return drawn_wall(CONFIGS, seed, Aspect(distance_m, (0.0, 35.0), None), {"square_m": square_m})


def candidates(wall: DrawnWall) -> tuple[Candidate, ...]:
    with pytest.raises(TargetRefused) as caught:
        at_click(wall.seen, Click("left", wall.pixel))
    assert caught.value.cause == "target.ambiguous"
    return caught.value.candidates


def taken(wall: DrawnWall, candidate: Candidate) -> TargetObservation | TargetRefused:
    try:
        return at_click(wall.seen, Click("left", wall.pixel, other=np.array(candidate.right_px)))
    except TargetRefused as refused:
        return refused


@pytest.mark.parametrize(("seed", "square_m", "distance_m"), [(701, 0.028, 1.0), (721, 0.016, 0.66)])
def test_of_a_boards_candidates_the_right_one_alone_is_believed(
    seed: int, square_m: float, distance_m: float
) -> None:
    wall = board(seed, square_m, distance_m)
    offered = candidates(wall)
    assert len(offered) >= 4
    answers = [taken(wall, candidate) for candidate in offered]
    believed = [answer for answer in answers if isinstance(answer, TargetObservation)]
    assert [answer.X_CO[2, 3] for answer in believed] == [pytest.approx(wall.aim[2, 3], rel=0.02)]
    refused = [answer for answer in answers if isinstance(answer, TargetRefused)]
    assert all(answer.candidates for answer in refused if answer.cause == "target.contradicted")
    assert sum(answer.cause == "target.contradicted" for answer in refused) >= 3
    told = next(str(answer) for answer in refused if answer.cause == "target.contradicted")
    assert f"they fit at {1e3 * np.linalg.norm(wall.aim[:3, 3]):.0f}"[:14] in told


def test_a_place_in_the_other_eye_that_looks_like_nothing_there_is_refused() -> None:
    wall = board(721, 0.016, 0.66)
    first, second = sorted(each.right_px[0] for each in candidates(wall))[:2]
    between = np.array([0.5 * (first + second), candidates(wall)[0].right_px[1]])
    with pytest.raises(TargetRefused):
        at_click(wall.seen, Click("left", wall.pixel, other=between))


def test_a_black_square_of_a_board_is_no_hole_farther_away() -> None:
    wall = board(739, 0.02454, 1.0)
    with pytest.raises(TargetRefused) as caught:
        at_click(wall.seen, Click("left", wall.pixel))
    assert caught.value.cause == "target.contradicted"
    assert caught.value.candidates
