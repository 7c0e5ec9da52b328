"""An experiment as data: what it measures, from which tasks, what is asked of its rows; and how it is run."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Generic, NamedTuple, TypeVar

import numpy as np
from rich.table import Table
from typer import Option

from foundation.configuration import BASE_FILE
from laboratory.campaigns.campaign import CampaignRequest, run_campaign
from laboratory.campaigns.rows import typed
from laboratory.campaigns.workforce import Task
from testbed.reporting.console import out, table, write_json

if TYPE_CHECKING:
    from matplotlib.figure import Figure


S = TypeVar("S")  # settings beyond the request's
R = TypeVar("R")  # a row

_STYLES = {True: "green", False: "bold red", None: "dim"}
_DPI = 110  # of a picture
_VERDICTS = {True: "met", False: "NOT met", None: ""}


class Check(NamedTuple):
    """One line of a verdict: what was found, what was asked, whether it is met (None: for information)."""

    what: str
    found: str
    asked: str
    met: bool | None


def at_least(what: str, value: float, limit: float | None, unit: str = "") -> Check:
    """A figure that is to be ``limit`` or more; None: for information."""
    asked = "" if limit is None else f"≥ {limit:g} {unit}".rstrip()
    return Check(what, f"{value:.3f} {unit}".rstrip(), asked, None if limit is None else bool(value >= limit))


def at_most(what: str, value: float, limit: float | None, unit: str = "") -> Check:
    """A figure that is to be ``limit`` or less; None: for information."""
    asked = "" if limit is None else f"≤ {limit:g} {unit}".rstrip()
    return Check(what, f"{value:.3f} {unit}".rstrip(), asked, None if limit is None else bool(value <= limit))


def inside(what: str, value: float, band: tuple[float, float] | None) -> Check:
    """A figure that is to lie in ``band``; None: for information. NaN was not measured, so it is not met."""
    if not np.isfinite(value):
        return Check(what, "not measured", "" if band is None else f"{band[0]:.3f} to {band[1]:.3f}", False)
    if band is None:
        return Check(what, f"{value:.3f}", "", None)
    return Check(what, f"{value:.3f}", f"{band[0]:.3f} to {band[1]:.3f}", bool(band[0] <= value <= band[1]))


class NoSettings(NamedTuple):
    """Of an experiment that is asked for nothing of its own."""


class Finished(NamedTuple, Generic[S, R]):
    """What was asked for and came out: a row a task, ``reused`` of them from earlier runs of the command."""

    request: CampaignRequest
    settings: S
    tasks: Sequence[Task]
    rows: Sequence[R]
    reused: int


def nothing(done: Finished[Any, Any]) -> dict[str, Any]:
    """No figures, no pictures."""
    return {}


@dataclass(frozen=True)
class Experiment(Generic[S, R]):
    """``tasks`` makes the runs asked for, ``run`` measures one (a task to a row), the others judge all rows.

    ``settings``: a NamedTuple of options, annotated for the command line. ``run`` is called with the
    configuration directory and a task, or with the task alone where it is not ``configured``. ``table``,
    ``plot`` (name → figure) and ``figures`` (for JSON) show the rows, ``verdict`` compares them with limits.
    All go into one page beside the rows; not ``page``: ``plot`` writes one of its own.
    ``runs``, ``seed``: the defaults; 0 runs: the tasks do not depend on them.
    ``world``, ``eyes``: where the settings do not say. ``workers``: 0 where a run is shorter than the start
    of a worker. ``out``: where rows are kept, if not in ``runs/NAME``.
    """

    name: str
    title: str
    settings: type[S]
    row: type[R]
    tasks: Callable[[CampaignRequest, S], Sequence[Task]]
    run: Callable[..., Any]
    table: Callable[[Finished[S, R]], Sequence[Table]]
    verdict: Callable[[Finished[S, R]], Sequence[Check]]
    plot: Callable[[Finished[S, R]], "Mapping[str, Figure]"] = nothing
    figures: Callable[[Finished[S, R]], Mapping[str, Any]] = nothing
    runs: int = 0
    seed: int = 1
    world: str = ""
    eyes: str = ""
    configured: bool = True
    workers: int = 2
    out: Path | None = None

    @property
    def directory(self) -> Path:
        """Where the rows are kept, unless the request says otherwise."""
        return self.out or Path("runs") / self.name


def perform(experiment: Experiment[S, R], request: CampaignRequest, settings: S) -> bool:
    """Whether every limit was met; tables and verdict are printed, rows and pictures in ``request.out``."""
    tasks = experiment.tasks(request, settings)
    function = partial(experiment.run, request.config_dir) if experiment.configured else experiment.run
    campaign = run_campaign(request, function, tasks, experiment.name)
    rows = [typed(experiment.row, row) for row in campaign.rows]
    done = Finished(request, settings, tasks, rows, campaign.reused)
    tables = [*experiment.table(done), *_failures(campaign.rows)]
    for made in tables:
        out.print(made)
    checks = experiment.verdict(done)
    show_checks(checks)
    drawn, told = experiment.plot(done), _conditions(experiment, done)
    out.print(told, highlight=False, soft_wrap=True)
    _draw(request, drawn)
    passed = all(check.met is not False for check in checks)
    figures = {
        "experiment": experiment.name,
        "passed": passed,
        "checks": [check._asdict() for check in checks],
        "conditions": told,
        "reused": campaign.reused,
        "rows": campaign.rows,
    }
    write_json(request.json, figures | dict(experiment.figures(done)))
    return passed


def _conditions(experiment: Experiment[S, R], done: Finished[S, R]) -> str:
    """Runs, seeds, world, eyes and settings, reused rows, time: what a figure must not be quoted without."""
    request, chosen = done.request, done.settings._asdict()  # type: ignore[attr-defined]
    parts = [f"{len(done.rows)} runs"]
    if experiment.runs:
        parts[0] += f", seeds {request.seed} to {request.seed + request.runs - 1}"
    parts += [
        f"{name}: {words}"
        for name, words in (("world", experiment.world), ("eyes", experiment.eyes))
        if words
    ]
    if (request.config_dir / BASE_FILE).is_file():
        parts.append(f"configuration: {request.config_dir}")
    parts += [
        f"{name.replace('_', ' ')}: {_words(value)}"
        for name, value in chosen.items()
        if value not in (None, [])
    ]
    parts.append(f"{done.reused} rows reused, {len(done.rows) - done.reused} measured now, in {request.out}")
    seconds = [float(row.cpu_s) for row in done.rows if hasattr(row, "cpu_s") and np.isfinite(row.cpu_s)]
    if seconds:
        parts.append(f"{np.mean(seconds):.1f} CPU s a run")
    return "; ".join(parts)


def _words(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return " ".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)


def _failures(rows: Sequence[Mapping[str, Any]]) -> list[Table]:
    """The causes of failed runs, how often each, and the key of one of them; no table where none failed."""
    failed = [row for row in rows if row.get("failure")]
    causes = Counter(str(row["failure"]).partition(" ")[0].rstrip(":") for row in failed)
    cells = []
    for cause, count in sorted(causes.items()):
        first = next(row for row in failed if str(row["failure"]).startswith(cause))
        cells.append((cause, count, first["key"], str(first["failure"]).splitlines()[0]))
    headings = ("cause", "runs", "such as", "")
    return [table("runs that failed, and count as failed above", headings, cells)] if cells else []


def show_checks(checks: Sequence[Check]) -> None:
    """Print the verdict: of each figure what was found, what was asked, met or not."""
    made = table("verdict", ("figure", "found", "asked", ""), ())
    for check in checks:
        verdict = f"[{_STYLES[check.met]}]{_VERDICTS[check.met]}[/]"
        made.add_row(check.what, check.found, check.asked or "–", verdict)
    if checks:
        out.print(made)


def _draw(request: CampaignRequest, drawn: "Mapping[str, Figure]") -> None:
    """Every figure into the rows' directory."""
    for name, figure in drawn.items():
        path = request.out / f"{name}.png"
        figure.savefig(path, dpi=_DPI)
        out.print(f"picture: {path}", style="dim", highlight=False, soft_wrap=True)


def seeds(request: CampaignRequest) -> range:
    """The seeds of the runs."""
    return range(request.seed, request.seed + request.runs)


# Options that several experiments share, worded once.
Assignments = Annotated[
    list[str] | None, Option("--set", help="Override one key, such as plant.payload.mass_kg=30; repeatable.")
]
Scenario = Annotated[str, Option(help="Which of CONFIG_DIR/scenarios to draw the world from.")]


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
