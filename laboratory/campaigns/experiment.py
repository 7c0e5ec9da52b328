"""An experiment as data: what it measures, from which tasks, what is asked of its rows; and how it is run."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any, Generic, NamedTuple, TypeVar

import numpy as np
from rich.table import Table
from typer import Option

from laboratory.campaigns.campaign import CampaignRequest, run_campaign
from laboratory.campaigns.rows import Row
from laboratory.campaigns.workforce import Run, Task
from protocol.errors import MeasurementFailed
from testbed.reporting.console import out, table, write_json

if TYPE_CHECKING:
    from matplotlib.figure import Figure


S = TypeVar("S")  # settings beyond the request's

_DPI = 110  # of a picture
_VERDICTS = {True: "[green]met[/]", False: "[bold red]NOT met[/]", None: ""}


class Check(NamedTuple):
    """One line of a verdict: what was found, what was asked, whether it is met (None: for information)."""

    what: str
    found: str
    goal: str
    met: bool | None


def at_least(what: str, value: float, limit: float | None, unit: str = "") -> Check:
    """A figure that is to be ``limit`` or more; None: for information."""
    goal = "" if limit is None else f"≥ {limit:g} {unit}".rstrip()
    return Check(what, f"{value:.3f} {unit}".rstrip(), goal, None if limit is None else bool(value >= limit))


def at_most(what: str, value: float, limit: float | None, unit: str = "") -> Check:
    """A figure that is to be ``limit`` or less; None: for information."""
    goal = "" if limit is None else f"≤ {limit:g} {unit}".rstrip()
    return Check(what, f"{value:.3f} {unit}".rstrip(), goal, None if limit is None else bool(value <= limit))


def inside(what: str, value: float, band: tuple[float, float]) -> Check:
    """A figure that is to lie in ``band``; NaN was not measured, so it is not met."""
    found = f"{value:.3f}" if np.isfinite(value) else "not measured"
    return Check(what, found, f"{band[0]:.3f} to {band[1]:.3f}", bool(band[0] <= value <= band[1]))


class NoSettings(NamedTuple):
    """Of an experiment that is asked for nothing of its own."""


class Finished(NamedTuple, Generic[S]):
    """What was asked for and came out: a row a task, ``reused`` of them from earlier runs of the command."""

    request: CampaignRequest
    settings: S
    tasks: Sequence[Task]
    rows: Sequence[Row]
    reused: int


@dataclass(frozen=True)
class Experiment(Generic[S]):
    """``tasks`` makes the runs asked for, ``run`` measures one, the others judge all rows.

    ``settings``: a NamedTuple of options, annotated for the command line. ``tables`` and ``plot`` (name →
    figure) show the rows, ``verdict`` compares them with limits. ``runs``,
    ``seed``: the defaults. ``world``, ``eyes``: where the settings do not say. ``workers``: 0 where a run is
    shorter than the start of a worker.
    """

    name: str
    settings: type[S]
    tasks: Callable[[CampaignRequest, S], Sequence[Task]]
    run: Run
    tables: Callable[[Finished[S]], Sequence[Table]]
    verdict: Callable[[Finished[S]], Sequence[Check]]
    runs: int
    plot: Callable[[Finished[S]], "Mapping[str, Figure]"] = lambda _: {}
    seed: int = 1
    world: str = ""
    eyes: str = ""
    workers: int = 2


def perform(experiment: Experiment[S], request: CampaignRequest, settings: S) -> bool:
    """Whether every limit was met; tables and verdict are printed, rows and pictures in ``request.out``."""
    tasks = experiment.tasks(request, settings)
    done = Finished(request, settings, tasks, *run_campaign(request, experiment.run, tasks, experiment.name))
    for made in (*experiment.tables(done), *_failures(done.rows)):
        out.print(made)
    checks, conditions = experiment.verdict(done), _conditions(experiment, done)
    lines = [(check.what, check.found, check.goal or "–", _VERDICTS[check.met]) for check in checks]
    out.print(table("verdict", ("figure", "found", "asked", ""), lines))
    out.print(conditions, highlight=False, soft_wrap=True)
    for name, figure in experiment.plot(done).items():
        path = request.out / f"{name}.png"
        figure.savefig(path, dpi=_DPI)
        out.print(f"picture: {path}", style="dim", highlight=False, soft_wrap=True)
    passed = all(check.met is not False for check in checks)
    results = {
        "experiment": experiment.name,
        "passed": passed,
        "checks": checks,
        "conditions": conditions,
        "reused": done.reused,
        "rows": done.rows,
    }
    write_json(request.json_file, results)
    return passed


def _conditions(experiment: Experiment[S], done: Finished[S]) -> str:
    """Runs, seeds, world, eyes and settings, reused rows: what a figure must not be quoted without."""
    request, reused = done.request, done.reused
    own: dict[str, Any] = {"world": experiment.world, "eyes": experiment.eyes}
    own |= {"configuration": request.config_dir} | done.settings._asdict()  # type: ignore[attr-defined]
    parts = [f"{len(done.rows)} runs, seeds {request.seed} to {request.seed + request.runs - 1}"]
    for name, value in own.items():
        if value not in (None, [], "", False):
            text = " ".join(map(str, value)) if isinstance(value, list) else "yes" if value is True else value
            parts.append(f"{name.replace('_', ' ')}: {text}")
    counts = f"{reused} rows reused, {len(done.rows) - reused} measured now, in {request.out}"
    return "; ".join([*parts, counts])


def _failures(rows: Sequence[Row]) -> list[Table]:
    """The causes of failed runs, and how often each; no table where none failed."""
    cells = failure_counts(row["failure"] for row in rows)
    return [table("runs that failed, and count as failed above", ("cause", "runs"), cells)] if cells else []


def failure_counts(failures: Iterable[str | None]) -> list[tuple[str, int]]:
    """Cause → how often it is that of a failure, sorted; nothing and no text are none."""
    return sorted(Counter(text.partition(" ")[0].rstrip(":") for text in failures if text).items())


def demand_all(rows: Iterable[Row]) -> None:
    """Raise MeasurementFailed with the cause of the first run that failed."""
    if failed := next((row["failure"] for row in rows if row["failure"]), None):
        raise MeasurementFailed("measurement.run_failed", failed)


def seeds(request: CampaignRequest) -> range:
    """The seeds of the runs."""
    return range(request.seed, request.seed + request.runs)


# Options that several experiments share, worded once.


class EyesKind(StrEnum):
    """What vision measures with."""

    PIXELS = "pixels"
    MODEL = "model"


ChosenEyes = Annotated[EyesKind, Option(help="Rendered pictures, or the model measured from them.")]
Adapting = Annotated[
    bool,
    Option("--adapting", help="Vision that learns, CONFIG_DIR/vision_adapting.yaml laid over its own."),
]
Commissioned = Annotated[
    bool,
    Option(
        "--commissioned", help="The controller has the valves' numbers, drawn around the truth with their σ."
    ),
]
