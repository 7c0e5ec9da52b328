"""Boards in the scene: calibration markers, checkerboards and ChArUco boards as plates."""

import cv2
import numpy as np
from numpy.typing import NDArray

from plant_emulator.config.surroundings import (
    AnyBoardConfig,
    CalibrationMarkerConfig,
    CharucoConfig,
    CheckerboardConfig,
)
from plant_emulator.core.camera.plates import WHITE_GREY, Plate, grid_plate, plain_plate, printed_greys
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
        sheet = plain_plate(X_OP, (-outer, outer), (-outer, outer), WHITE_GREY, lit_by_wall=True)
        return sheet, _marker(X_OP, config.dictionary, config.marker_id, _printed(config))
    if isinstance(config, CheckerboardConfig):
        return (grid_plate(X_OP, config.square_m, _checkers(config), lit_by_wall=True),)
    rows, columns = np.mgrid[0 : config.rows, 0 : config.columns]
    squares = grid_plate(X_OP, config.square_m, printed_greys((rows + columns) % 2 == 1), lit_by_wall=True)
    width, height = config.columns * config.square_m, config.rows * config.square_m
    rim = 0.5 * config.square_m
    across, down = 0.5 * width + rim, 0.5 * height + rim
    sheet = plain_plate(X_OP, (-across, across), (-down, down), WHITE_GREY, lit_by_wall=True)
    board = charuco_board(config)
    middles = np.asarray(board.getObjPoints(), dtype=np.float64).mean(axis=1)
    markers = [
        _marker(X_OP @ _translation(x - 0.5 * width, 0.5 * height - y), config.dictionary, number,
                config.marker_m)
        for number, (x, y, _) in zip(np.ravel(board.getIds()).tolist(), middles, strict=True)
    ]  # fmt: skip
    return sheet, squares, *markers


def charuco_board(config: CharucoConfig) -> cv2.aruco.CharucoBoard:
    """OpenCV's object of that board."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, config.dictionary))
    return cv2.aruco.CharucoBoard((config.columns, config.rows), config.square_m, config.marker_m, dictionary)


def _printed(config: CalibrationMarkerConfig) -> float:
    return config.side_m * (1.0 + config.print_scale_error)


def _translation(x: float, y: float) -> Matrix:
    return transform(np.eye(3), np.array([x, y, 0.0]))


def _checkers(config: CheckerboardConfig) -> NDArray[np.float32]:
    """Squares around the inner corners, dark at the top left, and a white rim of one square."""
    rows, columns = np.mgrid[0 : config.rows + 1, 0 : config.columns + 1]
    return printed_greys(np.pad((rows + columns) % 2 == 1, 1, constant_values=True))


def _marker(X_OP: Matrix, dictionary: str, number: int, side: float) -> Plate:
    """The code of one marker with its black border, its middle at X_OP."""
    codes = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    cells = int(codes.markerSize) + _BORDER
    white = cv2.aruco.generateImageMarker(codes, number, cells) > 127
    return grid_plate(X_OP, side / cells, printed_greys(white), lit_by_wall=True)
