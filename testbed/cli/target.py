"""`longreach target`: markers and boards to be printed at true scale."""

from pathlib import Path
from typing import Annotated, NamedTuple

import typer

from foundation.command_options import unfolded
from protocol.errors import RequestRefused
from testbed.cli.options import JsonFile
from testbed.reporting.console import writable


class TargetOptions(NamedTuple):
    """What is to be printed."""

    board: Annotated[
        str | None,
        typer.Option(help="COLUMNSxROWS: inner corners of a checkerboard; squares with --charuco."),
    ] = None
    marker: Annotated[int | None, typer.Option(help="The number of a marker.")] = None
    size_mm: Annotated[
        float, typer.Option(min=1.0, max=400.0, help="Side of the marker, or of a board's square.")
    ] = 25.0
    charuco: Annotated[bool, typer.Option("--charuco", help="The board is a ChArUco board.")] = False
    marker_mm: Annotated[
        float | None, typer.Option(help="Side of its markers; three quarters of a square if not given.")
    ] = None
    dictionary: Annotated[
        str, typer.Option(help="As OpenCV names it: DICT_5X5_1000, DICT_APRILTAG_36h11 …")
    ] = "DICT_5X5_1000"


@unfolded
def target(
    page: TargetOptions,
    paper: Annotated[str, typer.Option(help="a4, a3 or letter; turned across where that is needed.")] = "a4",
    to: Annotated[Path, typer.Option("--out", help="The PDF to write.", callback=writable)] = Path(
        "target.pdf"
    ),
    json_file: JsonFile = None,
) -> None:
    """A marker or board as a PDF at true scale, with rulers that tell whether the printer kept it."""
    from testbed.pictures.target_page import board_shape, dictionary_number, marker_shape, run_target
    from vision_pc.core.perception.zhang_intrinsics import Charuco, Checkerboard

    if (page.board is None) == (page.marker is None):
        raise RequestRefused("refused.target.which", "one of --board and --marker is wanted")
    if page.marker is not None:
        shape = marker_shape(page.dictionary, page.marker, page.size_mm)
    else:
        columns, rows = _counts(page.board or "")
        inner = 0.75 * page.size_mm if page.marker_mm is None else page.marker_mm
        board = (
            Charuco(columns, rows, 1e-3 * page.size_mm, 1e-3 * inner, dictionary_number(page.dictionary))
            if page.charuco
            else Checkerboard(columns, rows, 1e-3 * page.size_mm)
        )
        shape = board_shape(board, page.dictionary)
    run_target(shape, paper.lower(), page.size_mm, to, json_file)


def _counts(text: str) -> tuple[int, int]:
    columns, _, rows = text.lower().partition("x")
    if not (columns.isdecimal() and rows.isdecimal()) or not {int(columns), int(rows)} <= {*range(2, 101)}:
        raise RequestRefused(
            "refused.target.board", f"--board {text}: COLUMNSxROWS is wanted, each 2 to 100, such as 9x6"
        )
    return int(columns), int(rows)
