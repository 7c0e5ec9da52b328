"""The page that an experiment leaves beside its rows: verdict, tables and figures in one HTML file."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from rich.table import Table
from rich.text import Text

from testbed.reporting.plots import svg
from testbed.reporting.report import rendered
from testbed.reporting.run_record import KeptRun, beginning

_PIXELS_PER_INCH = 100  # of a figure at its natural width


def write_experiment_page(
    directory: Path,
    heading: tuple[str, str],
    conditions: str,
    checks: Sequence[Any],
    tables: Sequence[Table],
    figures: Mapping[str, Figure],
) -> Path:
    """Write ``directory/NAME.html`` and return its path.

    ``heading``: the experiment's name and title; ``checks``: of the verdict, each with what, found, asked
    and met; ``tables``: as they are printed.
    """
    name, title = heading
    html = rendered(
        "experiment.html.j2",
        name=name,
        title=title,
        conditions=conditions.split("; "),
        checks=checks,
        failed=sum(check.met is False for check in checks),
        tables=[_as_words(made) for made in tables],
        figures=[
            (each, svg(figure, each), round(_PIXELS_PER_INCH * figure.get_figwidth()))
            for each, figure in figures.items()
        ],
        run=KeptRun(directory, beginning()),
    )
    path = directory / f"{name}.html"
    path.write_text(html, encoding="utf-8")
    return path


def _as_words(made: Table) -> tuple[str, list[str], list[tuple[str, ...]], list[bool]]:
    """Title, headings, rows, and of each column whether it holds words."""
    headings = [_word(column.header) for column in made.columns]
    columns = [[_word(cell) for cell in column.cells] for column in made.columns]
    are_words = [column.justify == "left" for column in made.columns]
    return _word(made.title), headings, list(zip(*columns, strict=True)), are_words


def _word(cell: Any) -> str:
    return Text.from_markup(cell).plain if isinstance(cell, str) else str(cell or "")
