"""What all commands of ``longreach`` share: consoles, progress bars, tables, JSON files."""

import json
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Table

from protocol.errors import ConfigurationError

_PLAIN_WIDTH = 130  # of a pipe or file, which has no width of its own
out = Console(width=None if sys.stdout.isatty() else _PLAIN_WIDTH)
err = Console(stderr=True, width=None if sys.stderr.isatty() else _PLAIN_WIDTH)


def plain(value: Any) -> Any:
    """``value`` with arrays, tuples and paths turned into what JSON can hold; NaN becomes None."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if hasattr(value, "_asdict"):
        return plain(value._asdict())
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, (np.bool_, np.integer)):
        return value.item()
    if isinstance(value, (float, np.floating)):
        return float(value) if np.isfinite(value) else None
    return str(value) if isinstance(value, Path) else value


def write_json(path: Path | None, figures: Mapping[str, Any]) -> None:
    """Write ``figures`` to the file at ``path``, where one was asked for.

    Raises ConfigurationError when the file cannot be written.
    """
    if path is None:
        return
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(plain(figures), indent=2, allow_nan=False) + "\n", encoding="utf-8")
    except OSError as error:
        raise ConfigurationError("output.unwritable", f"{path}: {error.strerror}") from error
    out.print(f"figures written to {path}", style="dim", highlight=False, soft_wrap=True)


def table(title: str, columns: Iterable[str], rows: Iterable[Iterable[object]]) -> Table:
    """A table with the first column to the left and all others, being figures, to the right."""
    made = Table(title=title, title_justify="left")
    for index, column in enumerate(columns):
        made.add_column(column, justify="left" if index == 0 else "right")
    for row in rows:
        made.add_row(*(str(cell) for cell in row))
    return made


class Bar:
    """One line of a progress display."""

    def __init__(self, progress: Progress, task: TaskID) -> None:
        self._progress = progress
        self._task = task

    def update(self, fraction: float, note: str = "") -> None:
        """Set the bar to ``fraction`` (0…1) with ``note`` beside it."""
        self._progress.update(self._task, completed=min(max(fraction, 0.0), 1.0), note=note)


class Bars:
    """Progress bars, one for each step of a long piece of work."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress

    @contextmanager
    def step(self, label: str) -> Iterator[Bar]:
        """A bar for one step; it is full when the block ends well, and stays where it was when it fails."""
        task = self._progress.add_task(label, total=1.0, note="")
        yield Bar(self._progress, task)
        self._progress.update(task, completed=1.0)


@contextmanager
def bars(*, quiet: bool = False) -> Iterator[Bars]:
    """A display of progress bars that lives as long as the block; on stderr, so that stdout stays figures."""
    columns = (
        SpinnerColumn(finished_text="✓"),
        TextColumn("{task.description:<32}"),
        BarColumn(bar_width=28),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        TextColumn("{task.fields[note]}", style="dim"),
    )
    with Progress(*columns, console=err, disable=quiet or not sys.stderr.isatty()) as progress:
        yield Bars(progress)
