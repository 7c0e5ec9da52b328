"""The board that both eyes look at."""

from vision_pc.config.choices import Detector
from vision_pc.core.perception import stereo_fit
from vision_pc.core.perception import zhang_intrinsics as zhang
from vision_pc.core.perception.stereo_fit import PairView
from vision_pc.core.perception.zhang_intrinsics import Charuco, Checkerboard
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
