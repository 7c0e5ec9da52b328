"""Hua et al. 2024, Fig. 4: intrinsics by Zhang's method, 8×6 checkerboard of 24 mm, with the truth known.

The paper gives a camera and 0.43 px per view, but no error: nobody knew the truth. Here the emulator gets its
lens and is shown a checkerboard and a ChArUco board, so the error of each corner detector can be stated; then
the same code runs on OpenCV's real pictures.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np

from protocol.errors import MeasurementFailed
from testbed.experiments.hand_eye.boards import BoardCamera, BoardRenderer, random_board_pose
from vision_pc.config.choices import Detector
from vision_pc.core.perception import zhang_intrinsics as zhang
from vision_pc.core.perception.zhang_intrinsics import BoardView, Charuco, Checkerboard, Intrinsics
from vision_pc.core.types import Image

PAPER_CAMERA = BoardCamera(  # section 5.2; the distortion in OpenCV's order, as the ROS tool prints it
    K=np.array([[881.21, 0.0, 215.64], [0.0, 884.22, 274.45], [0.0, 0.0, 1.0]]),
    distortion=np.array([-0.02078, 0.01459, 0.00450, -0.01552, 0.0]),
    width=640,
    height=480,
)
PAPER_BOARD = Checkerboard(8, 6, 0.024)
PAPER_RMS_PX = 0.43
CHARUCO = Charuco(9, 7, 0.024, 0.018, cv2.aruco.DICT_5X5_100)


class IntrinsicsRow(NamedTuple):
    """One detector on one set of pictures. ``*_error`` need the truth, ``std_fx_px`` is the fit's word.

    ``outlying`` names views whose error stands out, ``empty_cells_percent`` the part of the picture without
    corners.
    """

    pictures: str
    detector: str
    views: int
    missed: tuple[str, ...]
    rms_px: float
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    std_fx_px: float
    fx_error_percent: float | None
    centre_error_px: float | None
    outlying: tuple[str, ...]
    empty_cells_percent: float


def detect(
    pictures: Sequence[tuple[str, Image]],
    board: Checkerboard | Charuco,
    detector: Detector = Detector.SECTORS,
) -> tuple[list[BoardView], tuple[str, ...]]:
    """The views in which the board was found, and the names of the others."""
    views, missed = [], []
    for name, image in pictures:
        try:
            if isinstance(board, Charuco):
                views.append(zhang.find_charuco(image, board, name))
            else:
                views.append(zhang.find_checkerboard(image, board, detector, name))
        except MeasurementFailed:
            missed.append(name)
    return views, tuple(missed)


def row(
    pictures: str, detector: str, found: Intrinsics, missed: tuple[str, ...], truth: BoardCamera | None = None
) -> IntrinsicsRow:
    """One line of the table."""
    K = found.K
    return IntrinsicsRow(
        pictures,
        detector,
        len(found.names),
        missed,
        found.rms_px,
        float(K[0, 0]),
        float(K[1, 1]),
        float(K[0, 2]),
        float(K[1, 2]),
        float(found.std_px[0]),
        None if truth is None else 100.0 * float(K[0, 0] / truth.K[0, 0] - 1.0),
        None if truth is None else float(np.hypot(K[0, 2] - truth.K[0, 2], K[1, 2] - truth.K[1, 2])),
        found.outlying,
        100.0 * float((found.coverage == 0).mean()),
    )


def paper_camera(runs: int = 2, views: int = 15, seed: int = 1) -> tuple[IntrinsicsRow, ...]:
    """The paper's camera, emulated, with ``views`` of each board for each of ``runs`` calibrations."""
    return tuple(row for run in range(runs) for row, _ in _calibrations(run, views, seed))


def calibration_row(task: dict[str, Any]) -> dict[str, Any]:
    """A campaign's row: calibration number ``run`` with both boards and all detectors."""
    made = _calibrations(int(task["run"]), int(task["views"]), int(task["seed"]))
    return {
        "rows": [row for row, _ in made],
        "maps": [
            {
                "detector": row.detector,
                "coverage": found.coverage.tolist(),
                "names": list(found.names),
                "view_rms_px": found.view_rms_px.tolist(),
            }
            for row, found in made
        ],
    }


def rows_of(campaign: Sequence[dict[str, Any]]) -> list[IntrinsicsRow]:
    """What the rows of ``calibration_row`` have kept."""
    kept = (row for made in campaign for row in made["rows"])
    return [IntrinsicsRow(**row | {k: tuple(row[k]) for k in ("missed", "outlying")}) for row in kept]


def _calibrations(run: int, views: int, seed: int) -> list[tuple[IntrinsicsRow, Intrinsics]]:
    renderer = BoardRenderer(PAPER_CAMERA)
    made = []
    for board in (PAPER_BOARD, CHARUCO):
        rng = np.random.default_rng([seed, run, isinstance(board, Charuco)])
        pictures: list[tuple[str, Image]] = []
        for k in range(views):
            X_CB = random_board_pose(PAPER_CAMERA, board, rng)
            pictures.append((f"{k + 1:02d}", renderer.render(board, X_CB, rng)))
        for name in [d.value for d in Detector] if board is PAPER_BOARD else ["charuco"]:
            detector = Detector.SECTORS if name == "charuco" else Detector(name)
            seen, missed = detect(pictures, board, detector)
            found = zhang.calibrate(seen, PAPER_CAMERA.width, PAPER_CAMERA.height)
            title = f"paper's camera, emulated ({run + 1})"
            made.append((row(title, name, found, missed, PAPER_CAMERA), found))
    return made
