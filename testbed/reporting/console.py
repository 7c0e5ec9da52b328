"""What all commands of ``longreach`` share: consoles, progress bars, tables, JSON files."""

import json
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from string import Formatter
from types import MappingProxyType
from typing import Any, NamedTuple

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn
from rich.segment import Segment
from rich.table import Table
from typer import Exit

from protocol.errors import ConfigurationError

LINE_S = 60.0
"""How often progress is told where there is no terminal to draw a bar in."""
_UNKNOWN_S = 2.0  # before which a pace says nothing
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


def words(title: str, columns: Iterable[str], rows: Iterable[Iterable[object]]) -> Table:
    """A table of words: all to the left, long ones over several lines."""
    made = Table(title=title, title_justify="left")
    for column in columns:
        made.add_column(column, overflow="fold")
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

    def __init__(self, progress: Progress, task: TaskID, label: str) -> None:
        self._progress = progress
        self._task = task
        self._label = label
        self._began_s = self._line_s = time.monotonic()

    def update(self, fraction: float, note: str = "") -> None:
        """Show ``fraction`` (0…1) with the time left, by the time it took so far, and ``note`` beside it."""
        done, now_s = min(max(fraction, 0.0), 1.0), time.monotonic()
        left = time_left(done, now_s - self._began_s)
        self._progress.update(self._task, completed=done, left=left, note=note)
        if self._progress.disable and now_s - self._line_s >= LINE_S:
            self._line_s = now_s
            told = ", ".join(filter(None, (f"{100.0 * done:.0f} %", left, note)))
            err.print(f"{self._label}: {told}", highlight=False, soft_wrap=True, markup=False)


def time_left(fraction: float, elapsed_s: float) -> str:
    """The time that the rest will take at the pace so far, in words; nothing before anything is known."""
    if not 0.0 < fraction < 1.0 or elapsed_s < _UNKNOWN_S:
        return ""
    minutes, seconds = divmod(round(elapsed_s * (1.0 - fraction) / fraction), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{seconds:02d} left" if hours else f"{minutes}:{seconds:02d} left"


class Bars:
    """Progress bars, one for each step of a long piece of work."""

    def __init__(self, progress: Progress, quiet: bool) -> None:
        self._progress = progress
        self._quiet = quiet

    @contextmanager
    def step(self, label: str) -> Iterator[Bar]:
        """A bar for one step; it is full when the block ends well, and stays where it was when it fails."""
        task = self._progress.add_task(label, total=1.0, note="", left="")
        yield QuietBar() if self._quiet else Bar(self._progress, task, label)
        self._progress.update(task, completed=1.0, left="")


class QuietBar(Bar):
    """A bar that nobody sees."""

    def __init__(self) -> None:
        pass

    def update(self, fraction: float, note: str = "") -> None:
        """Show nothing."""


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
        TextColumn("{task.fields[left]}"),
        TextColumn("{task.fields[note]}", style="dim"),
    )
    with Progress(*columns, console=err, disable=quiet or not sys.stderr.isatty()) as progress:
        yield Bars(progress, quiet)


INTERRUPTED = 130  # as a shell has it for SIGINT


class Interrupted(NamedTuple):
    """One row: what is kept, what the same command does after it, and the exit status."""

    kept: str
    again: str = "begins anew"
    status: int = INTERRUPTED


_NOTHING = Interrupted("nothing")
_ROWS = Interrupted("every finished row, in `rows.csv`", "goes on from there")
_RUN = Interrupted("logs and recordings, in the run's directory", "begins anew, in another directory")
_SERVED = Interrupted("everything: Ctrl-C is how it is ended", status=0)
LONG: Mapping[str, Interrupted] = MappingProxyType(
    {
        "demo": _RUN,
        "up": _SERVED,
        "experiment": _ROWS,
        "commission": Interrupted("every finished joint, in the session's directory", "goes on from there"),
        "replay": _NOTHING,
        "camera calibrate": _NOTHING,
        "camera emulate": _NOTHING,
        "camera serve": _SERVED,
        "hand-eye session run": Interrupted("every sample taken, in the rig's session", "goes on from there"),
        "odometry": _NOTHING,
        "conformance": _NOTHING,
        "recording": Interrupted("nothing half made"),
        "plc": Interrupted("every row until then", status=0),
    }
)


def long_command(words: Sequence[str]) -> str | None:
    """The long command that ``words``, options among them, begin with; None: one too short to be told of."""
    found = [name for name in LONG if list(words[: name.count(" ") + 1]) == name.split()]
    return max(found, key=len, default=None)


@contextmanager
def kept_on_ctrl_c(told: Callable[[], str]) -> Iterator[None]:
    """Where Ctrl-C ends the block, ``told`` is asked what is kept, and it is said; empty: nothing is."""
    try:
        yield
    except KeyboardInterrupt:
        if kept := told():
            err.print(kept, markup=False, highlight=False, soft_wrap=True)
        raise
