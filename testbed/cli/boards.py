"""Which board a command was asked for."""

from testbed.camera.boards import read_april_grid
from testbed.cli.options import PicturedBoard
from testbed.pictures.target_page import dictionary_number
from vision_pc.core.perception.april_grid import Board
from vision_pc.core.perception.zhang_intrinsics import Charuco, Checkerboard


def asked_board(asked: PicturedBoard) -> Board:
    """The board that the command line describes. Raises RequestRefused for an unknown dictionary, and as
    ``read_april_grid``.
    """
    if asked.target is not None:
        return read_april_grid(asked.target)
    square_m = 1e-3 * asked.square_mm
    if not asked.charuco:
        return Checkerboard(asked.columns, asked.rows, square_m)
    dictionary = dictionary_number(asked.dictionary)
    return Charuco(asked.columns, asked.rows, square_m, 1e-3 * asked.marker_mm, dictionary)
