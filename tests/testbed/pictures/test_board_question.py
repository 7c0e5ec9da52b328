"""Boards that are not the one asked for, and boards without an up and a down."""

import numpy as np
import pytest

from protocol.errors import RequestRefused
from testbed.camera.checking import counts_shown, question
from vision_pc.core.perception.zhang_intrinsics import Charuco, Checkerboard
from vision_pc.core.types import Image

BARE = np.full((360, 640), 200, np.uint8)


def board(columns: int, rows: int) -> Image:
    """A picture of so many inner corners, seen from the front, squares of 30 px."""
    y, x = np.mgrid[0 : rows + 1, 0 : columns + 1]
    squares = np.where((x + y) % 2 == 0, 20, 235).astype(np.uint8)
    picture = BARE.copy()
    picture[40 : 40 + 30 * (rows + 1), 60 : 60 + 30 * (columns + 1)] = np.kron(squares, np.ones((30, 30)))
    return picture


def test_what_pictures_show_is_counted_and_they_must_agree() -> None:
    assert counts_shown([board(9, 6)] * 2 + [BARE]) == (9, 6)
    assert counts_shown([BARE]) is None
    assert counts_shown([board(9, 6), board(8, 5)]) is None


def test_squares_taken_for_corners_are_refused_and_fewer_corners_are_told(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(RequestRefused, match="show a board of 9x6 inner corners, asked for are 10x7") as no:
        question([board(9, 6)], Checkerboard(10, 7, 0.025), 0)
    assert no.value.cause == "refused.board.counts"
    question([board(9, 6)], Checkerboard(10, 5, 0.025), 1)
    assert "9x6 inner corners, asked for are 10x5" in capsys.readouterr().out
    for fine in (Checkerboard(9, 6, 0.025), Checkerboard(6, 9, 0.025), Charuco(9, 7, 0.025, 0.018, 0)):
        question([board(9, 6)], fine, 1)
    assert not capsys.readouterr().out
    question([BARE], Checkerboard(10, 7, 0.025), 0)  # nothing there: whoever asked says so


@pytest.mark.parametrize("asked", [(8, 5), (9, 5), (6, 8)])
def test_a_board_is_not_taken_for_a_part_of_it(asked: tuple[int, int]) -> None:
    with pytest.raises(RequestRefused, match="show a board of 9x6 inner corners, asked for are") as no:
        question([board(9, 6)], Checkerboard(*asked, 0.025), 12)
    assert no.value.cause == "refused.board.counts"


def test_a_board_without_an_up_is_questioned(capsys: pytest.CaptureFixture[str]) -> None:
    question([board(8, 6)], Checkerboard(8, 6, 0.025), 1)
    assert "8x6 corners looks the same half a turn on" in " ".join(capsys.readouterr().out.split())
