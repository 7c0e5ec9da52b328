"""Camera intrinsics from pictures of a flat board (Zhang 2000), with what is needed to judge them.

Three ways to find the corners of a checkerboard: ``classic`` as OpenCV's own sample does it (sub-pixel
window of 11 px, whatever the size of the squares), ``fitted`` with the window kept inside the squares, and
``sectors``, which fits each corner's four sectors. A ChArUco board may be partly hidden.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from protocol.errors import MeasurementFailed, RequestRefused
from vision_pc.config.choices import Detector
from vision_pc.core import se3
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image

_CLASSIC_WINDOW = 11
_SUBPIXEL_UNTIL = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-4)
_LEAST_VIEWS = 3
_LEAST_CORNERS = 6
_OUTLYING = 3.0  # times the median view's error
_UNDETERMINED = 0.05  # relative standard deviation of the focal length
_PARALLEL_COS = math.cos(math.radians(5.0))
_CELLS = (6, 8)


class Checkerboard(NamedTuple):
    """``columns`` × ``rows`` inner corners, ``square_m`` apart."""

    columns: int
    rows: int
    square_m: float


class Charuco(NamedTuple):
    """``columns`` × ``rows`` squares, markers of ``marker_m`` from OpenCV's ``dictionary``
    (cv2.aruco.DICT_…).
    """

    columns: int
    rows: int
    square_m: float
    marker_m: float
    dictionary: int


PlainBoard = Checkerboard | Charuco


class BoardView(NamedTuple):
    """Corners of one picture: ``points_m`` (k, 3) on the board and ``pixels`` (k, 2); ``second``: what found
    them where the first finder failed.
    """

    name: str
    points_m: Array
    pixels: Array
    second: str = ""


class Intrinsics(NamedTuple):
    """``K`` (3, 3) px, ``distortion`` (5,) k1 k2 p1 p2 k3; ``std_px`` (4,) of fx, fy, cx, cy.

    ``rms_px`` over all corners; per view in ``names``' order ``view_rms_px`` (n,) and ``X_CB`` (n, 4, 4),
    the board in the camera; ``coverage`` (6, 8) counts corners by picture cell; ``outlying`` names views
    worth dropping.
    """

    K: Array
    distortion: Array
    std_px: Array
    rms_px: float
    names: tuple[str, ...]
    view_rms_px: Array
    X_CB: Array
    coverage: NDArray[np.int64]
    outlying: tuple[str, ...]


def find_checkerboard(image: Image, board: Checkerboard, detector: Detector, name: str) -> BoardView:
    """All inner corners of the board in one grey picture.

    Raises MeasurementFailed (``measurement.intrinsics.no_board``) naming the view when the board is not
    found whole.
    """
    size = (board.columns, board.rows)
    if detector is Detector.SECTORS:
        found, corners = cv2.findChessboardCornersSB(image, size, flags=cv2.CALIB_CB_ACCURACY)
    else:
        found, corners = cv2.findChessboardCorners(
            image, size, flags=cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
        )
    if not found:
        raise MeasurementFailed(
            "measurement.intrinsics.no_board",
            f"view {name}: no board of {size[0]}x{size[1]} corners ({detector})",
        )
    if detector is not Detector.SECTORS:
        window = (
            _CLASSIC_WINDOW
            if detector is Detector.CLASSIC
            else _window(_doubles(corners).reshape(-1, 2), board)
        )
        corners = cv2.cornerSubPix(image, corners, (window, window), (-1, -1), _SUBPIXEL_UNTIL)
    return BoardView(name, board_points(board), np.asarray(corners, dtype=np.float64).reshape(-1, 2))


def board_points(board: PlainBoard) -> Array:
    """All corners (n, 3) of the board, m, row by row."""
    if isinstance(board, Charuco):
        return np.asarray(charuco_board(board).getChessboardCorners(), dtype=np.float64)
    rows, columns = np.mgrid[0 : board.rows, 0 : board.columns]
    flat = [columns.ravel(), rows.ravel(), np.zeros(rows.size)]
    return np.stack(flat, axis=1).astype(np.float64) * board.square_m


def _window(corners: Array, board: Checkerboard) -> int:
    """Half the width of a sub-pixel window that stays within the smallest square."""
    grid = corners.reshape(board.rows, board.columns, 2)
    sides = [np.linalg.norm(np.diff(grid, axis=axis), axis=-1).min() for axis in (0, 1)]
    return int(np.clip(0.35 * min(sides), 2, _CLASSIC_WINDOW))


def charuco_board(board: Charuco, old_pattern: bool = False) -> cv2.aruco.CharucoBoard:
    """OpenCV's object of that board; its picture is what must be printed. ``old_pattern``: as before 4.6."""
    dictionary = cv2.aruco.getPredefinedDictionary(board.dictionary)
    size = (board.columns, board.rows)
    made = cv2.aruco.CharucoBoard(size, board.square_m, board.marker_m, dictionary)
    made.setLegacyPattern(old_pattern)
    return made


def find_charuco(image: Image, board: Charuco, name: str, old_pattern: bool = False) -> BoardView:
    """The corners of a ChArUco board that are visible in one grey picture.

    Raises MeasurementFailed (``measurement.intrinsics.no_board``) naming the view when fewer than 6 are
    found.
    """
    target = charuco_board(board, old_pattern)
    corners, ids, _, _ = cv2.aruco.CharucoDetector(target).detectBoard(image)
    count = 0 if ids is None else len(ids)
    if count < _LEAST_CORNERS:
        raise MeasurementFailed(
            "measurement.intrinsics.no_board", f"view {name}: {count} ChArUco corners, 6 are needed"
        )
    return BoardView(
        name,
        board_points(board)[np.asarray(ids).ravel()],
        np.asarray(corners, dtype=np.float64).reshape(-1, 2),
    )


def calibrate(views: Sequence[BoardView], width: int, height: int) -> Intrinsics:
    """The camera that explains the views best, and how well it is determined.

    Raises RequestRefused (``refused.intrinsics.too_few_views``) under 3 views, MeasurementFailed
    (``measurement.intrinsics.undetermined``) when the views leave the focal length open, as parallel boards
    do.
    """
    if len(views) < _LEAST_VIEWS:
        raise RequestRefused(
            "refused.intrinsics.too_few_views", f"{len(views)} views, at least {_LEAST_VIEWS} are needed"
        )
    points = [v.points_m.astype(np.float32) for v in views]
    pixels = [v.pixels.astype(np.float32) for v in views]
    try:
        rms, K, distortion, turns, shifts, std, _, per_view = cv2.calibrateCameraExtended(
            points, pixels, (width, height), np.eye(3), np.zeros(5)
        )
    except cv2.error as error:
        reason = " ".join(str(error).split())
        raise MeasurementFailed(
            "measurement.intrinsics.undetermined", f"the views determine no camera: {reason}"
        ) from error
    std_px = _doubles(std).ravel()[:4]
    R_CB = [cv2.Rodrigues(_doubles(turn))[0] for turn in turns]
    X_CB = np.stack([se3.transform(R, np.ravel(t)) for R, t in zip(R_CB, shifts, strict=True)])
    _require_focal_length(_doubles(K), std_px, X_CB)
    view_rms = _doubles(per_view).ravel()
    limit = _OUTLYING * float(np.median(view_rms))
    return Intrinsics(
        _doubles(K),
        _doubles(distortion).ravel()[:5],
        std_px,
        float(rms),
        tuple(v.name for v in views),
        view_rms,
        X_CB,
        coverage(np.concatenate([v.pixels for v in views]), (width, height), _CELLS),
        tuple(v.name for v, e in zip(views, view_rms, strict=True) if e > limit),
    )


def _require_focal_length(K: Array, std_px: Array, X_CB: Array) -> None:
    cosines = X_CB[:, :3, 2] @ X_CB[:, :3, 2].T
    if cosines.min() > _PARALLEL_COS:  # the fit's own standard deviation does not notice
        raise MeasurementFailed(
            "measurement.intrinsics.undetermined",
            "the boards are parallel, which leaves the focal length open; tilt them differently",
        )
    if not np.isfinite(std_px).all() or std_px[0] > _UNDETERMINED * K[0, 0]:
        raise MeasurementFailed(
            "measurement.intrinsics.undetermined",
            f"focal length {K[0, 0]:.1f} px is known to {std_px[0]:.1f} px only; tilt the board more",
        )


def _doubles(values: Any) -> Array:
    return np.asarray(values, dtype=np.float64)


def coverage(pixels: Array, size: tuple[int, int], cells: tuple[int, int]) -> NDArray[np.int64]:
    """How many of ``pixels`` (n, 2) fell into each of ``cells`` (rows, columns) of pictures of ``size``,
    width and height: empty ones are extrapolated.
    """
    reach = ((0, size[1]), (0, size[0]))
    return np.asarray(np.histogram2d(pixels[:, 1], pixels[:, 0], cells, reach)[0], dtype=np.int64)
