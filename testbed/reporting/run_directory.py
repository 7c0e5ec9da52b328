"""Where runs are kept: a new directory for each, with what made it; and how a demonstration's is shown."""

import itertools
import json
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from rich.text import Text

from plant_emulator.core.faults.schedule import FaultOrder
from protocol.errors import ConfigurationError
from testbed.choices import USUAL_TIMING, ControllerKind, Timing
from testbed.reporting import outcome as outcomes
from testbed.reporting.console import kept_on_ctrl_c, out, table, write_json
from testbed.reporting.outcome import Outcome
from testbed.reporting.plots import ErrorTrace
from testbed.reporting.report import Picture, write_report
from testbed.reporting.run_record import beginning
from testbed.scenarios.scenario import NamedRequest
from vision_pc.config.choices import PositioningMethod


class Choice(NamedTuple):
    """What a demonstration is asked for.

    ``programs``: to run after the orientation adjustment, in place of calibration and looks. ``faults``: what
    breaks, counted from the start. ``controller``: which one drives the arm; ``timing``: of three processes.
    """

    scenario: str
    seed: int
    looks: int
    programs: tuple[NamedRequest, ...] = ()
    faults: tuple[FaultOrder, ...] = ()
    method: PositioningMethod = PositioningMethod.CORRECTED
    controller: ControllerKind = ControllerKind.PYTHON
    timing: Timing = USUAL_TIMING


def present(
    directory: Path,
    outcome: Outcome,
    trace: ErrorTrace,
    pictures: Sequence[Picture],
    events: Sequence[Mapping[str, Any]],
    json_file: Path | None,
) -> bool:
    """Whether ``outcome`` has passed; its table, verdict and report are out."""
    report = write_report(directory, outcome, trace, pictures, events, beginning())
    title = f"error of the tool at the object, mm and degrees ({outcome.mode})"
    out.print(table(title, outcomes.HEADINGS, outcomes.rows(outcome.stages)))
    lines = [(f"{stage.label}: {stage.note}", "dim") for stage in outcome.stages if stage.note]
    faults = (
        f"fault in the plant: {one['name']} {one['fault']}" for one in outcome.details.get("faults", ())
    )
    lines += [(warning, "bold yellow") for warning in (*warnings_in(events), *faults)]
    if "failure" in outcome.details:
        lines.append((f"stopped by: {outcome.details['failure']}", "bold red"))
    lines.append((outcome.verdict, "bold green" if outcome.passed else "bold red"))
    for line, style in lines:
        out.print(Text(line, style))
    speed = outcome.simulated_s / outcome.wall_s
    out.print(f"{outcome.simulated_s:.1f} s of arm time in {outcome.wall_s:.1f} s ({speed:.2f} × real time)")
    out.print(f"report: {report}", highlight=False, soft_wrap=True)
    write_json(json_file, outcomes.results(outcome))
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


@contextmanager
def run_directory(runs: Path) -> Iterator[Path]:
    """A new directory below ``runs``, named by the time of day, with ``run.json`` in it: what makes the run.

    One that holds nothing else at the end is removed. Raises ConfigurationError where none can be made.
    """
    is_new = not runs.exists()
    began = json.dumps(beginning(), indent=2) + "\n"  # takes its time: Ctrl-C would leave an empty directory
    directory = _new_directory(runs)
    record = directory / "run.json"

    def has_results() -> bool:
        return any(path.is_file() and path != record for path in directory.rglob("*"))

    try:
        record.write_text(began, encoding="utf-8")
        with kept_on_ctrl_c(lambda: f"what was recorded is kept in {directory}" if has_results() else ""):
            yield directory
    finally:
        if not has_results():
            shutil.rmtree(directory)
            if is_new and not any(runs.iterdir()):
                runs.rmdir()


def _new_directory(runs: Path) -> Path:
    stamp = time.strftime("%Y%m%d-%H%M%S")
    names = itertools.chain([stamp], (f"{stamp}-{number}" for number in itertools.count(1)))
    directory = next(place for name in names if not (place := runs / name).exists())
    try:
        directory.mkdir(parents=True)
    except OSError as error:
        raise ConfigurationError("output.unwritable", f"{directory}: {error.strerror}") from error
    return directory
