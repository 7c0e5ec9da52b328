"""The front of a control cabinet, drawn: painted sheet metal with a knob, a switch and a key hole.

The same drawing, as a picture file, is what a vision system gets from the cabinet's maker.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from plant_emulator.config.surroundings import (
    AnyBoardConfig,
    CabinetConfig,
    CalibrationMarkerConfig,
    CharucoConfig,
    CheckerboardConfig,
)
from plant_emulator.core.camera.plates import Plate, grid_plate, picture_plate, plain_plate
from plant_emulator.core.mechanics.geometry import rotation_from_vector, transform

Grey = NDArray[np.uint8]

_FRACTION = 4  # binary digits of sub-texel places
_SHEET, _DARK, _PALE, _STEEL = 150, 35, 225, 110


def cabinet_front(config: CabinetConfig) -> Grey:
    """The front (rows, columns) uint8, texels of ``texel_mm``, sides multiples of 8 texels."""
    columns, rows = (
        8 * round(1000.0 * side / config.texel_mm / 8.0) for side in (config.width_m, config.height_m)
    )
    front = _painted_sheet(config.seed, rows, columns)
    pen = _Pen(front, config.texel_mm)
    pen.label((0.0, 0.5 * config.height_m - 0.022), "FEEDER 12  630 A", 0.011)
    _rivets(pen, config)
    _knob(pen, config.knob_m)
    _switch(pen, config.switch_m)
    _key_hole(pen, config.key_hole_m)
    return np.asarray(cv2.GaussianBlur(front, (0, 0), 0.6), dtype=np.uint8)


class _Pen:
    """Draws in the front's axes, metres from its middle, x right and y up."""

    def __init__(self, front: Grey, texel_mm: float) -> None:
        self._front = front
        self._per_m = 1000.0 / texel_mm

    def _place(self, x: float, y: float) -> tuple[int, int]:
        rows, columns = self._front.shape
        column, row = 0.5 * columns - 0.5 + x * self._per_m, 0.5 * rows - 0.5 - y * self._per_m
        return round(column * (1 << _FRACTION)), round(row * (1 << _FRACTION))

    def disc(self, centre: tuple[float, float], radius: float, grey: int) -> None:
        size = round(radius * self._per_m * (1 << _FRACTION))
        cv2.circle(self._front, self._place(*centre), size, grey, cv2.FILLED, cv2.LINE_AA, _FRACTION)

    def polygon(self, points: list[tuple[float, float]], grey: int) -> None:
        places = np.array([self._place(*point) for point in points], dtype=np.int32)
        cv2.fillConvexPoly(self._front, places, grey, cv2.LINE_AA, _FRACTION)

    def box(self, centre: tuple[float, float], width: float, height: float, grey: int) -> None:
        x, y, a, b = *centre, 0.5 * width, 0.5 * height
        self.polygon([(x - a, y - b), (x + a, y - b), (x + a, y + b), (x - a, y + b)], grey)

    def label(self, centre: tuple[float, float], text: str, height: float) -> None:
        scale = height * self._per_m / 22.0  # OpenCV's simplex capitals are 22 texels high at scale 1
        (width, tall), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, 2)
        x, y = (value / (1 << _FRACTION) for value in self._place(*centre))
        corner = round(x - 0.5 * width), round(y + 0.5 * tall)
        cv2.putText(self._front, text, corner, cv2.FONT_HERSHEY_SIMPLEX, scale, _DARK, 2, cv2.LINE_AA)


def _painted_sheet(seed: int, rows: int, columns: int) -> Grey:
    """Hammered paint: grain of several sizes, some scratches."""
    generator = np.random.default_rng(seed)
    field = np.zeros((rows, columns), dtype=np.float32)
    for texels, strength in ((2, 5.0), (6, 7.0), (24, 6.0)):
        coarse = generator.standard_normal((rows // texels + 2, columns // texels + 2), dtype=np.float32)
        field += strength * cv2.resize(coarse, (columns, rows), interpolation=cv2.INTER_CUBIC)
    sheet = np.clip(_SHEET + field, 0.0, 255.0).astype(np.uint8)
    for _ in range(40):
        start = generator.uniform((0.0, 0.0), (columns, rows))
        end = start + generator.uniform(-60.0, 60.0, 2)
        tone = int(generator.integers(90, 200))
        cv2.line(sheet, tuple(map(int, start)), tuple(map(int, end)), tone, 1, cv2.LINE_AA)
    return sheet


def _rivets(pen: _Pen, config: CabinetConfig) -> None:
    for x in (-0.5, -0.17, 0.17, 0.5):
        for y in (-0.5, 0.5):
            pen.disc((x * (config.width_m - 0.024), y * (config.height_m - 0.024)), 0.005, _STEEL)
            pen.disc(
                (x * (config.width_m - 0.024) - 0.001, y * (config.height_m - 0.024) + 0.001), 0.002, _PALE
            )


def _knob(pen: _Pen, centre: tuple[float, float]) -> None:
    x, y = centre
    pen.disc(centre, 0.034, _PALE)
    pen.disc(centre, 0.024, _DARK)
    pen.polygon([(x - 0.003, y), (x + 0.003, y), (x + 0.002, y + 0.022), (x - 0.002, y + 0.022)], _PALE)
    for degrees in range(-120, 121, 30):
        a = np.radians(90.0 - degrees)
        pen.disc((x + 0.030 * float(np.cos(a)), y + 0.030 * float(np.sin(a))), 0.0018, _DARK)
    pen.label((x, y - 0.045), "0  I  II", 0.008)


def _switch(pen: _Pen, centre: tuple[float, float]) -> None:
    x, y = centre
    pen.box(centre, 0.036, 0.056, _PALE)
    pen.box(centre, 0.028, 0.048, _DARK)
    pen.box((x, y + 0.010), 0.020, 0.022, _STEEL)
    pen.box((x, y - 0.012), 0.020, 0.014, 60)
    pen.label((x, y - 0.040), "OFF", 0.008)


def _key_hole(pen: _Pen, centre: tuple[float, float]) -> None:
    x, y = centre
    pen.disc(centre, 0.017, _STEEL)
    pen.disc(centre, 0.013, 185)
    pen.disc((x, y + 0.002), 0.0042, _DARK)
    pen.polygon([(x - 0.0016, y), (x + 0.0016, y), (x + 0.0026, y - 0.009), (x - 0.0026, y - 0.009)], _DARK)
    pen.label((x + 0.042, y), "LOCK", 0.008)


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
            _marker(config, X_OP @ _translation(x - 0.5 * width, 0.5 * height - y), config.dictionary, number,
                    config.marker_m)
            for number, (x, y, _) in zip(np.ravel(board.getIds()).tolist(), middles, strict=True)
        ]  # fmt: skip
        return sheet, squares, *markers
    return (picture_plate(X_OP, 1e-3 * config.texel_mm, cabinet_front(config), lit_by_wall=True),)


def charuco_board(config: CharucoConfig) -> cv2.aruco.CharucoBoard:
    """OpenCV's object of that board."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, config.dictionary))
    return cv2.aruco.CharucoBoard((config.columns, config.rows), config.square_m, config.marker_m, dictionary)


def _printed(config: CalibrationMarkerConfig) -> float:
    return config.side_m * (1.0 + config.print_scale_error)


def _translation(x: float, y: float) -> Matrix:
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
