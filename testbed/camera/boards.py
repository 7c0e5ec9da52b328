"""The board that both eyes look at."""

import cv2

from protocol.errors import RequestRefused
from testbed.cli.hand_eye_options import PicturedBoard
from vision_pc.core.perception import stereo_fit
from vision_pc.core.perception import zhang_intrinsics as zhang
from vision_pc.core.perception.stereo_fit import PairView
from vision_pc.core.perception.zhang_intrinsics import Charuco, Checkerboard, Detector
from vision_pc.core.types import StereoPair

AskedBoard = Checkerboard | Charuco


def found_board(pair: StereoPair, board: AskedBoard, name: str) -> PairView:
    """The corners of ``board`` that both eyes see. Raises MeasurementFailed when one of them does not see
    it.
    """
    views = [
        zhang.find_charuco(picture, board, name)
        if isinstance(board, Charuco)
        else zhang.find_checkerboard(picture, board, Detector.SECTORS, name)
        for picture in (pair.left, pair.right)
    ]
    return stereo_fit.paired(views[0], views[1])


def board_of(asked: PicturedBoard) -> AskedBoard:
    """The board that the command line describes. Raises RequestRefused for an unknown dictionary."""
    square_m = 1e-3 * asked.square_mm
    if not asked.charuco:
        return Checkerboard(asked.columns, asked.rows, square_m)
    dictionary = getattr(cv2.aruco, asked.dictionary, None)
    if not asked.dictionary.startswith("DICT_") or not isinstance(dictionary, int):
        raise RequestRefused("refused.camera.dictionary", f"OpenCV has no dictionary {asked.dictionary!r}")
    return Charuco(asked.columns, asked.rows, square_m, 1e-3 * asked.marker_mm, dictionary)
