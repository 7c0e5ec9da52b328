"""Which board a command was asked for."""

from testbed.camera.boards import read_april_grid
from testbed.cli.options import PicturedBoard
from testbed.pictures.target_page import dictionary_number
from vision_pc.core.perception.april_grid import Board
from vision_pc.core.perception.zhang_intrinsics import Charuco, Checkerboard


def described_board(described: PicturedBoard) -> Board:
    """The board that the command line describes. Raises RequestRefused for an unknown dictionary, and as
    ``read_april_grid``.
    """
    if described.target is not None:
        return read_april_grid(described.target)
    square_m = 1e-3 * described.square_mm
    if not described.charuco:
        return Checkerboard(described.columns, described.rows, square_m)
    dictionary = dictionary_number(described.dictionary)
    return Charuco(described.columns, described.rows, square_m, 1e-3 * described.marker_mm, dictionary)
