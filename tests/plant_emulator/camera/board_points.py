"""Where the points of a board are that a calibration finds."""

import numpy as np
from numpy.typing import NDArray

from plant_emulator.config.surroundings import (
    AnyBoardConfig,
    CalibrationMarkerConfig,
    CheckerboardConfig,
)


def board_points(config: AnyBoardConfig) -> NDArray[np.float64]:
    """Known points (n, 3) of a board in its own frame, metres.

    A marker's corners in ArUco's order; a checkerboard's and a ChArUco board's inner corners row by row from
    the top left.
    """
    if isinstance(config, CalibrationMarkerConfig):
        h = 0.5 * config.side_m * (1.0 + config.print_scale_error)
        return np.array([[-h, h, 0.0], [h, h, 0.0], [h, -h, 0.0], [-h, -h, 0.0]])
    inner = isinstance(config, CheckerboardConfig)
    columns, rows = (config.columns, config.rows) if inner else (config.columns - 1, config.rows - 1)
    down, across = np.mgrid[0:rows, 0:columns]
    x = (across.ravel() - 0.5 * (columns - 1)) * config.square_m
    y = (0.5 * (rows - 1) - down.ravel()) * config.square_m
    return np.stack([x, y, np.zeros(x.size)], axis=1)
