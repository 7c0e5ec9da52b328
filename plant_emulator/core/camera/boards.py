"""Boards as plates, and the points on them whose places are known: what the camera sees of a board config.

A board's frame is its plate's: origin in the middle, x right, y up, z towards the viewer. OpenCV's own board
frame has its origin at the corner of the picture, y down and z away.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from plant_emulator.config.boards import (
    AnyBoardConfig,
    CabinetConfig,
    CalibrationMarkerConfig,
    CharucoConfig,
    CheckerboardConfig,
)
from plant_emulator.core.camera.cabinet import cabinet_front
from plant_emulator.core.camera.plates import Plate, grid_plate, picture_plate, plain_plate
from plant_emulator.core.mechanics.geometry import rotation_from_vector, transform

Matrix = NDArray[np.float64]

_BORDER = 2  # cells that a marker's black border adds to its code's


def board_pose(config: AnyBoardConfig) -> Matrix:
    """X_OP (4x4): the board's middle in O."""
    return transform(rotation_from_vector(np.radians(config.rotation_deg)), np.array(config.position_m))


def board_plates(config: AnyBoardConfig) -> tuple[Plate, ...]:
    """The plates of a board in O, in painting order."""
    X_OP = board_pose(config)
    if isinstance(config, CalibrationMarkerConfig):
        outer = 0.5 * _printed(config) + config.quiet_zone_m
        sheet = plain_plate(X_OP, (-outer, outer), (-outer, outer), config.white_grey, lit_by_wall=True)
        return sheet, _marker(config, X_OP, config.dictionary, config.marker_id, _printed(config))
    if isinstance(config, CheckerboardConfig):
        return (grid_plate(X_OP, config.square_m, _checkers(config), lit_by_wall=True),)
    if isinstance(config, CharucoConfig):
        rows, columns = np.mgrid[0 : config.rows, 0 : config.columns]
        squares = grid_plate(
            X_OP, config.square_m, _tones(config, (rows + columns) % 2 == 1), lit_by_wall=True
        )
        width, height = config.columns * config.square_m, config.rows * config.square_m
        rim = 0.5 * config.square_m
        across, down = 0.5 * width + rim, 0.5 * height + rim
        sheet = plain_plate(X_OP, (-across, across), (-down, down), config.white_grey, lit_by_wall=True)
        board = charuco_board(config)
        middles = np.asarray(board.getObjPoints(), dtype=np.float64).mean(axis=1)
        markers = [
            _marker(config, X_OP @ _shifted(x - 0.5 * width, 0.5 * height - y), config.dictionary, number,
                    config.marker_m)
            for number, (x, y, _) in zip(np.ravel(board.getIds()).tolist(), middles, strict=True)
        ]  # fmt: skip
        return sheet, squares, *markers
    return (picture_plate(X_OP, 1e-3 * config.texel_mm, cabinet_front(config), lit_by_wall=True),)


def board_points(config: AnyBoardConfig) -> Matrix:
    """Known points (n, 3) of a board in its own frame, metres.

    A marker's corners in ArUco's order; a checkerboard's and a ChArUco board's inner corners row by row from
    the top left; a cabinet's knob, switch and key hole.
    """
    if isinstance(config, CalibrationMarkerConfig):
        h = 0.5 * _printed(config)
        return np.array([[-h, h, 0.0], [h, h, 0.0], [h, -h, 0.0], [-h, -h, 0.0]])
    if isinstance(config, CabinetConfig):
        return np.array([[*place, 0.0] for place in (config.knob_m, config.switch_m, config.key_hole_m)])
    inner = isinstance(config, CheckerboardConfig)
    columns, rows = (config.columns, config.rows) if inner else (config.columns - 1, config.rows - 1)
    down, across = np.mgrid[0:rows, 0:columns]
    x = (across.ravel() - 0.5 * (columns - 1)) * config.square_m
    y = (0.5 * (rows - 1) - down.ravel()) * config.square_m
    return np.stack([x, y, np.zeros(x.size)], axis=1)


def charuco_board(config: CharucoConfig) -> cv2.aruco.CharucoBoard:
    """OpenCV's object of that board."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, config.dictionary))
    return cv2.aruco.CharucoBoard((config.columns, config.rows), config.square_m, config.marker_m, dictionary)


def _printed(config: CalibrationMarkerConfig) -> float:
    return config.side_m * (1.0 + config.print_scale_error)


def _shifted(x: float, y: float) -> Matrix:
    return transform(np.eye(3), np.array([x, y, 0.0]))


def _tones(config: AnyBoardConfig, white: NDArray[np.bool_]) -> NDArray[np.float32]:
    return np.where(white, config.white_grey, config.black_grey).astype(np.float32)


def _checkers(config: CheckerboardConfig) -> NDArray[np.float32]:
    """Squares around the inner corners, dark at the top left, and a white rim of one square."""
    rows, columns = np.mgrid[0 : config.rows + 1, 0 : config.columns + 1]
    return _tones(config, np.pad((rows + columns) % 2 == 1, 1, constant_values=True))


def _marker(config: AnyBoardConfig, X_OP: Matrix, dictionary: str, number: int, side: float) -> Plate:
    """The code of one marker with its black border, its middle at X_OP."""
    codes = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    cells = int(codes.markerSize) + _BORDER
    white = cv2.aruco.generateImageMarker(codes, number, cells) > 127
    return grid_plate(X_OP, side / cells, _tones(config, white), lit_by_wall=True)
