"""A camera's intrinsics from pictures of one board: the views that show it, and a line of figures."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from rich.table import Table

from protocol.errors import MeasurementFailed
from testbed.reporting.console import Columns, listed
from vision_pc.config.choices import Detector
from vision_pc.core.perception import zhang_intrinsics as zhang
from vision_pc.core.perception.zhang_intrinsics import BoardView, Charuco, Checkerboard, Intrinsics
from vision_pc.core.types import Image


class IntrinsicsRow(NamedTuple):
    """One detector on one set of pictures; ``std_fx_px`` is the fit's word.

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


def intrinsics_row(pictures: str, detector: str, found: Intrinsics, missed: tuple[str, ...]) -> IntrinsicsRow:
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
        found.outlying,
        100.0 * float((found.coverage == 0).mean()),
    )


def intrinsics_table(rows: Iterable[IntrinsicsRow]) -> Table:
    """The figures of each."""
    columns: Columns = {
        "pictures": "{pictures}",
        "corners by": "{detector}",
        "views": "{views}",
        "rms px": "{rms_px:.3f}",
        "fx": "{fx_px:.2f}",
        "± px": "{std_fx_px:.2f}",
        "outlying": lambda r: " ".join(r.outlying) or "–",
        "empty": "{empty_cells_percent:.0f} %",
    }
    return listed("intrinsics by Zhang's method", columns, rows)
