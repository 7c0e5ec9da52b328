"""Where runs are kept: a new directory for each, with its record, and an index page of all of them."""

import json
import re
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

from rich.table import Table
from rich.text import Text

from plant_emulator.core.faults.schedule import FaultOrder
from protocol.errors import ConfigurationError, LongreachError
from testbed.choices import ControllerKind
from testbed.reporting import outcome as outcomes
from testbed.reporting import run_record as record
from testbed.reporting.console import kept_on_ctrl_c, out, write_json
from testbed.reporting.outcome import Outcome
from testbed.reporting.plots import Traces
from testbed.reporting.report import Picture, write_report
from testbed.reporting.run_record import RECORD_FILE, KeptRun, note
from testbed.scenarios.scenario import NamedRequest
from vision_pc.config.choices import PositioningMethod


class Choice(NamedTuple):
    """What a demonstration is asked for; ``holes``: to drive to three drill holes, not to the object.

    ``programs``: to run after the orientation adjustment, in place of calibration and looks. ``faults``: what
    breaks, counted from the start. ``controller``: which one drives the arm.
    """

    scenario: str
    seed: int
    looks: int
    holes: bool = False
    programs: tuple[NamedRequest, ...] = ()
    faults: tuple[FaultOrder, ...] = ()
    method: PositioningMethod = PositioningMethod.CORRECTED
    controller: ControllerKind = ControllerKind.PYTHON


def outcome_table(outcome: Outcome) -> Table:
    """The stages with image-based and true errors."""
    table = Table(
        title=f"error of the tool at the object, mm and degrees ({outcome.mode})", title_justify="left"
    )
    for index, heading in enumerate(outcomes.HEADINGS):
        table.add_column(heading, justify="left" if index == 0 else "right", no_wrap=True)
    for row in outcomes.rows(outcome.stages):
        table.add_row(*row)
    return table


def present(
    directory: Path,
    outcome: Outcome,
    traces: Traces,
    pictures: Sequence[Picture],
    events: Sequence[Mapping[str, Any]],
    json_file: Path | None,
) -> bool:
    """Whether ``outcome`` has passed; its table, verdict and report are out."""
    known = ("mode", "scenario", "seed", "passed", "simulated_s")
    told = {name: getattr(outcome, name) for name in known}
    note(directory, **told, verdict=outcomes.verdict(outcome))
    report = write_report(directory, outcome, traces, pictures, events)
    out.print(outcome_table(outcome))
    for stage in outcome.stages:
        if stage.note:
            out.print(Text(f"{stage.label}: {stage.note}", style="dim"))
    for warning in warnings_in(events):
        out.print(Text(warning, style="bold yellow"))
    for fault in outcome.details.get("faults", ()):
        out.print(Text(f"fault in the plant: {fault['name']} {fault['fault']}", style="bold yellow"))
    if "overload" in outcome.details:
        out.print(Text(outcome.details["overload"], style="bold yellow"))
    if "failure" in outcome.details:
        out.print(Text(f"stopped by: {outcome.details['failure']}", style="bold red"))
    out.print(Text(outcomes.verdict(outcome), style="bold green" if outcome.passed else "bold red"))
    speed = outcome.simulated_s / outcome.wall_s
    out.print(f"{outcome.simulated_s:.1f} s of arm time in {outcome.wall_s:.1f} s ({speed:.2f} × real time)")
    out.print(f"report: {report}", highlight=False, soft_wrap=True)
    write_json(json_file, outcomes.figures(outcome))
    return outcome.passed


def warnings_in(events: Sequence[Mapping[str, Any]]) -> list[str]:
    """What ``events`` ask a person to do, each once: a marker that hangs elsewhere."""
    doubted = (event["misplaced_marker"] for event in events if event.get("misplaced_marker"))
    return list(dict.fromkeys(marker["detail"] for marker in doubted))


def read_events(directory: Path) -> list[dict[str, Any]]:
    """The events that a service recorded into ``directory``; none where it could not."""
    path = directory / "events.jsonl"
    if not path.is_file():
        return []
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]


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
        with kept_on_ctrl_c(
            lambda: f"what was recorded is kept in {directory}" if _has_results(directory) else ""
        ):
            yield directory
    except BaseException as error:
        ended_by = f"{error.cause}: {error}" if isinstance(error, LongreachError) else type(error).__name__
        raise
    finally:
        if _has_results(directory):
            record.note(directory, took_s=time.monotonic() - began_s, ended_by=ended_by)
        else:
            shutil.rmtree(directory)
            with suppress(OSError):  # others are there
                if not there:
                    runs.rmdir()


def _has_results(directory: Path) -> bool:
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
    """The runs below ``runs``, the newest first by when they began; nothing else that is there.

    Raises ConfigurationError where there is no such directory.
    """
    if not runs.is_dir():
        raise ConfigurationError("runs.no_directory", f"{runs}: no such directory; --out names another")
    found = (path for path in runs.iterdir() if path.is_dir() and _STAMP.fullmatch(path.name))
    records = map(record.read, found)
    return sorted(records, key=lambda run: (run.began, run.directory.name), reverse=True)


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
