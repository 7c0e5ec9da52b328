"""Where runs are kept: a new directory for each, with its record, and an index page of all of them."""

import os
import re
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from protocol.errors import ConfigurationError, LongreachError
from testbed.reporting import run_record as record
from testbed.reporting.ctrl_c import kept_on_ctrl_c
from testbed.reporting.report import rendered
from testbed.reporting.run_record import RECORD_FILE, KeptRun

INDEX = "index.html"
_STAMP = re.compile(r"\d{8}-\d{6}(-\d+)?")


@contextmanager
def run_directory(runs: Path) -> Iterator[Path]:
    """A new directory below ``runs``, named by the time of day, with ``run.json`` in it.

    How the block ended is added to it, and the index page made anew. One that holds nothing else by then is
    removed. Raises ConfigurationError where none can be made.
    """
    there = runs.exists()
    known = record.beginning()
    directory = _new_directory(runs)
    began_s, ended_by = time.monotonic(), ""
    try:
        record.note(directory, **known)
        with kept_on_ctrl_c(lambda: f"what was recorded is kept in {directory}" if _kept(directory) else ""):
            yield directory
    except BaseException as error:
        ended_by = f"{error.cause}: {error}" if isinstance(error, LongreachError) else type(error).__name__
        raise
    finally:
        if _kept(directory):
            record.note(directory, took_s=time.monotonic() - began_s, ended_by=ended_by)
            with suppress(OSError):  # the run itself is kept
                write_index(runs)
        else:
            shutil.rmtree(directory)
            with suppress(OSError):  # others are there
                if not there:
                    runs.rmdir()


def _kept(directory: Path) -> bool:
    """Whether there is anything in it beside its record."""
    files = (path for path in directory.rglob("*") if path.is_file())
    return not all(file.name.startswith(RECORD_FILE) for file in files)


def _new_directory(runs: Path) -> Path:
    stamp = time.strftime("%Y%m%d-%H%M%S")
    for attempt in range(100):
        directory = runs / (stamp if attempt == 0 else f"{stamp}-{attempt}")
        try:
            directory.mkdir(parents=True)
        except FileExistsError:
            continue
        except OSError as error:
            raise ConfigurationError("output.unwritable", f"{directory}: {error.strerror}") from error
        return directory
    raise ConfigurationError("output.unwritable", f"{runs / stamp}: a hundred runs in one second")


def all_runs(runs: Path) -> list[KeptRun]:
    """The runs below ``runs``, the newest first; nothing else that is there.

    Raises ConfigurationError where there is no such directory.
    """
    if not runs.is_dir():
        raise ConfigurationError("runs.no_directory", f"{runs}: no such directory; --out names another")
    found = (path for path in runs.iterdir() if path.is_dir() and _STAMP.fullmatch(path.name))
    return [record.read(path) for path in sorted(found, key=lambda path: path.name, reverse=True)]


def one_run(runs: Path, name: str) -> KeptRun:
    """The run called ``name``, or the only one whose name begins so; ``last`` is the newest.

    Raises ConfigurationError where there is none, or more than one.
    """
    known = all_runs(runs)
    if name == "last" and known:
        return known[0]
    fitting = [run for run in known if run.directory.name == name] or [
        run for run in known if name and run.directory.name.startswith(name)
    ]
    if len(fitting) != 1:
        which = ", ".join(run.directory.name for run in (fitting or known)[:5]) or "none"
        kind = "several runs begin so" if fitting else "no such run"
        raise ConfigurationError("runs.not_found", f"{name}: {kind} in {runs}: {which}")
    return fitting[0]


def write_index(runs: Path) -> Path:
    """The page of all runs below ``runs``, with links to their reports, written there.

    Raises ConfigurationError where there is no such directory, OSError where it cannot be written.
    """
    rows = [
        {
            "name": run.directory.name,
            "report": (run.directory / "report.html").is_file(),
            "ending": run.ending,
            "command": run.command,
            "code": run.code,
            "took": f"{run.facts['took_s']:.0f}" if "took_s" in run.facts else "–",
            "mb": f"{run.size_mb:.1f}",
        }
        for run in all_runs(runs)
    ]
    partial = runs / f"{INDEX}.{os.getpid()}"
    partial.write_text(rendered("index.html.j2", runs=rows), encoding="utf-8")
    return partial.replace(runs / INDEX)
