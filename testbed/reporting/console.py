"""What all commands of ``longreach`` share: consoles, progress bars, tables, JSON files."""

import json
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from string import Formatter
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.segment import Segment
from rich.table import Table
from typer import Exit

from protocol.errors import ConfigurationError

LINE_S = 60.0
"""How often progress is told where there is no terminal to draw a bar in."""
_PLAIN_WIDTH = 130  # of a pipe or file, which has no width of its own
Columns = Mapping[str, str | Callable[[Any], object]]
"""Of ``listed``: heading → how its cells are made."""


class Verbosity:
    """How much a command tells beside its results, as -q and -v have it; set anew by every command line."""

    quiet = False  # no bars, no progress, no notes
    verbose = False  # of a refusal also where it was raised


_CONTROL = {code: "?" for code in (*range(32), *range(127, 160)) if chr(code) != "\n"}


class PlainConsole(Console):
    """Prints no control character of a text: names in other people's files must not command the terminal."""

    def render(self, renderable: Any, options: Any = None) -> Iterator[Segment]:
        """The segments of ``renderable``, with a sign for each control character."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else segment._replace(text=segment.text.translate(_CONTROL))


# A closed stream: its number would be that of the next file, and what is printed there would go into that.
sys.stdout = sys.stdout or open(os.devnull, "w")  # noqa: SIM115
sys.stderr = sys.stderr or open(os.devnull, "w")  # noqa: SIM115
out = PlainConsole(width=None if sys.stdout.isatty() else _PLAIN_WIDTH)
err = PlainConsole(stderr=True, width=None if sys.stderr.isatty() else _PLAIN_WIDTH)


def plain(value: Any) -> Any:
    """``value`` with arrays, tuples and paths turned into what JSON can hold; NaN becomes None."""
    import numpy as np  # here, so that a command which only shows its help need not wait for it

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


def write_json(path: Path | None, results: Mapping[str, Any]) -> None:
    """Write ``results`` to the file at ``path``, where one was asked for.

    Raises ConfigurationError when the file cannot be written.
    """
    if path is None:
        return
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(plain(results), indent=2, allow_nan=False) + "\n", encoding="utf-8")
    except OSError as error:
        raise ConfigurationError("output.unwritable", f"{path}: {error.strerror}") from error
    if not Verbosity.quiet:
        out.print(f"figures written to {path}", style="dim", highlight=False, soft_wrap=True)


_promised: list[Path] = []


def promised(path: Path) -> Path:
    """``path``, to be made by this command line: where it was not there, a failure leaves none of it."""
    if not path.exists():
        _promised.append(path)
    return path


@contextmanager
def nothing_half_made() -> Iterator[None]:
    """What was ``promised`` within this block is removed again where the block fails, or Ctrl-C ends it."""
    _promised.clear()
    try:
        yield
    except Exit:
        raise  # a verdict, not a failure
    except (Exception, KeyboardInterrupt):
        for path in _promised:
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)
        raise


def noted(lines: Iterable[str]) -> None:
    """Print what a person must know beside the results, a line each."""
    for line in lines:
        out.print(line, style="yellow", highlight=False, soft_wrap=True)


def writable(path: Path | None) -> Path | None:
    """``path``, to which a file can be written later. Raises ConfigurationError now, not after the work."""
    if path is not None:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            there = promised(path).exists()
            path.open("a").close()
            if not there:
                path.unlink()
        except OSError as error:
            raise ConfigurationError("output.unwritable", f"{path}: {error.strerror}") from error
    return path


def table(title: str, columns: Iterable[str], rows: Iterable[Iterable[object]]) -> Table:
    """A table with the first column to the left and all others, being figures, to the right."""
    made = Table(title=title, title_justify="left")
    for index, column in enumerate(columns):
        made.add_column(column, justify="left" if index == 0 else "right")
    for row in rows:
        made.add_row(*(str(cell) for cell in row))
    return made


def listed(title: str, columns: Columns, rows: Iterable[Any]) -> Table:
    """A table with a line for each typed row.

    ``columns``: heading → how the cell is made, by a function or by the row's fields as ``str.format`` has
    them: ``{error_mm:.2f}``. The cell is a dash where such a field is None.
    """
    return table(title, columns, ([_cell(row, made) for made in columns.values()] for row in rows))


def _cell(row: Any, made: str | Callable[[Any], object]) -> object:
    if callable(made):
        return made(row)
    fields = {name: getattr(row, name) for _, name, _, _ in Formatter().parse(made) if name}
    return "–" if None in fields.values() else made.format_map(fields)


class Bar:
    """One line of a progress display; where there is no terminal, a line of text every ``LINE_S`` seconds."""

    def __init__(self, progress: Progress, label: str, quiet: bool) -> None:
        self._progress, self._label, self._quiet = progress, label, quiet
        self.task = progress.add_task(label, total=1.0, note="")
        self._line_s = time.monotonic()

    def update(self, fraction: float, note: str = "") -> None:
        """Show ``fraction`` (0…1) with the time left, and ``note`` beside it."""
        done, now_s = min(max(fraction, 0.0), 1.0), time.monotonic()
        self._progress.update(self.task, completed=done, note=note)
        if self._progress.disable and not self._quiet and now_s - self._line_s >= LINE_S:
            self._line_s = now_s
            text = ", ".join(filter(None, (f"{100.0 * done:.0f} %", note)))
            err.print(f"{self._label}: {text}", highlight=False, soft_wrap=True, markup=False)


class Bars:
    """Progress bars, one for each step of a long piece of work."""

    def __init__(self, progress: Progress, quiet: bool) -> None:
        self._progress, self._quiet = progress, quiet

    @contextmanager
    def step(self, label: str) -> Iterator[Bar]:
        """A bar for one step; it is full when the block ends well, and stays where it was when it fails."""
        bar = Bar(self._progress, label, self._quiet)
        yield bar
        self._progress.update(bar.task, completed=1.0)


@contextmanager
def bars(*, quiet: bool = False) -> Iterator[Bars]:
    """A display of progress bars that lives as long as the block; on stderr, so that stdout stays figures."""
    quiet = quiet or Verbosity.quiet
    columns = (
        SpinnerColumn(finished_text="✓"),
        TextColumn("{task.description:<32}"),
        BarColumn(bar_width=28),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}", style="dim"),
    )
    with Progress(*columns, console=err, disable=quiet or not sys.stderr.isatty()) as progress:
        yield Bars(progress, quiet)


INTERRUPTED = 130  # as a shell has it for SIGINT


@contextmanager
def kept_on_ctrl_c(text: Callable[[], str]) -> Iterator[None]:
    """Where Ctrl-C ends the block, ``told`` is asked what is kept, and it is said; empty: nothing is."""
    try:
        yield
    except KeyboardInterrupt:
        if kept := text():
            err.print(kept, markup=False, highlight=False, soft_wrap=True)
        raise
