"""`longreach experiment positioning`: how often one look ends within ±5 mm, over drawn scenarios."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, NamedTuple

import matplotlib
import numpy as np
import typer
from matplotlib.figure import Figure
from rich.table import Table

from laboratory.campaigns.campaign import CampaignRequest
from laboratory.campaigns.experiment import (
    Adapting,
    Assignments,
    Check,
    ChosenEyes,
    Commissioned,
    Experiment,
    EyesKind,
    Finished,
    seeds,
)
from laboratory.campaigns.workforce import Task
from laboratory.experiments.positioning.corrected_run import PositioningRow, one_run
from laboratory.experiments.positioning.results import (
    LIMIT_MM,
    checks_of,
    predictions,
    quantile,
    reliability_plot,
    reliability_table,
    vectors,
    worst_mm,
)
from laboratory.experiments.positioning.worlds import ARMS, WORLDS, DrawnWorld, WorldName
from testbed.reporting.console import table
from testbed.reporting.plots import AXIS_COLOURS, STYLE

_REACH_MM = 8.0  # of the picture's axes
BRANCHES = {"one_shot": "one shot, no correction", "look1": "one look", "look2": "two looks"}
BOTH_ARMS = "both"
ChosenWorld = Annotated[WorldName, typer.Option(help="What differs from one machine to the next.")]


class DrawnSettings(NamedTuple):
    """What drawn scenarios are run, and how they are seen."""

    world: ChosenWorld = WorldName.LAB
    arm: Annotated[
        str | None,
        typer.Option(help="Of CONFIG_DIR/arms, or a directory; in place of the world's own; both: in turn."),
    ] = None
    eyes: ChosenEyes = EyesKind.MODEL
    assignments: Assignments = None
    adapting: Adapting = False
    commissioned: Commissioned = False
    own_file: Annotated[
        bool,
        typer.Option("--own-file", help="The machine commissions itself first: six joints, its own file."),
    ] = False


Positioned = Finished[DrawnSettings, PositioningRow]


def positioning_tasks(request: CampaignRequest, settings: DrawnSettings) -> list[Task]:
    """One task a run; with both arms, seeds take them in turn."""
    asked: dict[str, Any] = {"world": str(settings.world), "eyes": str(settings.eyes)}
    asked |= {"assignments": settings.assignments or []}
    asked |= {name: True for name in ("adapting", "commissioned", "own_file") if getattr(settings, name)}
    if settings.own_file:
        asked["commissioned"] = True
    one = WORLDS[settings.world].arm if settings.arm is None else settings.arm
    chosen = ARMS if settings.arm == BOTH_ARMS else (one,)
    return [
        {"key": f"{chosen[seed % len(chosen)]}-{seed}", "seed": seed, "arm": chosen[seed % len(chosen)]}
        | asked
        for seed in seeds(request)
    ]


def positioning_table(done: Positioned) -> list[Table]:
    """For each arm the errors after each branch, and what refused or failed."""
    tables = _axes(WORLDS[done.settings.world])
    for arm, rows in by_arm(done.rows).items():
        title = "refused or failed, counted as failed above"
        tables += [_errors(arm, rows), *stops_table(title, "at", rows, BRANCHES)]
        title = f"arm {arm}, one look: probability predicted before moving"
        tables.append(reliability_table(title, predictions(rows, "look1", "before"), worst_mm(rows, "look1")))
    return [*tables, _draw_counts(done.rows)]


def _axes(world: DrawnWorld) -> list[Table]:
    """What the world draws beside payload, mount, object and the arm's usual errors; none: no table."""
    cells = [[axis.name.replace("_", " "), axis.width, axis.source] for axis in world.axes]
    return [table("drawn beside the lab's own", ["axis", "width", "why so wide"], cells)] if cells else []


def _draw_counts(rows: Sequence[PositioningRow]) -> Table:
    """How many of the draws were kept, and why not the others."""
    unreachable, unseen = (sum(getattr(row, name) or 0 for row in rows) for name in ("unreachable", "unseen"))
    kept = sum(row.unseen is not None for row in rows)
    drawn = kept + unreachable + unseen
    cells = [[drawn, unreachable, unseen, kept, f"{kept / max(kept + unseen, 1):.0%}"]]
    headings = [
        "drawn",
        "out of the arm's reach",
        "a marker not whole in view",
        "kept",
        "kept of those in reach",
    ]
    return table("draws that make a task", headings, cells)


def positioning_verdict(done: Positioned) -> list[Check]:
    """What is asked of each arm, and of both together."""
    arms = by_arm(done.rows)
    groups = {**arms, "all": done.rows} if len(arms) > 1 else arms
    return [
        check._replace(what=f"{arm}: {check.what}")
        for arm, rows in groups.items()
        for check in checks_of(rows, WORLDS[done.settings.world].demands)
    ]


def positioning_plot(done: Positioned) -> dict[str, Figure]:
    """How many of the runs end within which error."""
    title = f"{len(done.rows)} runs, world: {done.settings.world}, eyes: {done.settings.eyes}"
    worst = worst_mm(done.rows, "look1")
    groups = {"before moving": "before", "by odometry": "after"}
    honest = {words: (predictions(done.rows, "look1", when), worst) for words, when in groups.items()}
    return {
        "errors": errors_plot(by_arm(done.rows), title),
        "reliability": reliability_plot(honest, f"one look, {title}"),
    }


def by_arm(rows: Sequence[PositioningRow]) -> dict[str, list[PositioningRow]]:
    """Arm → its rows."""
    return {arm: [row for row in rows if row.arm == arm] for arm in sorted({row.arm for row in rows})}


def _errors(arm: str, rows: Sequence[PositioningRow]) -> Table:
    shown = []
    for name, what in BRANCHES.items():
        worst = worst_mm(rows, name)
        z = np.abs(np.array([getattr(row, name).true_mm.z for row in rows]))
        apart = vectors(rows, name, "measured_mm") - vectors(rows, name, "true_mm")
        figures = [quantile(worst, q) for q in (50, 95, 100)] + [quantile(z, q) for q in (50, 95)]
        figures.append(float(np.sqrt(np.nanmean(apart**2))) if np.isfinite(apart).any() else float("nan"))
        within = f"{np.count_nonzero(worst <= LIMIT_MM)} of {len(rows)}"
        shown.append([what, within, *(f"{figure:.2f}" for figure in figures)])
    headings = ["after", "within 5 mm", "median", "95 %", "worst", "|z| median", "95 %", "measured − true"]
    return table(f"arm {arm}, {len(rows)} runs: worse of true |x| and |y|, mm", headings, shown)


def stops_table(title: str, first: str, rows: Sequence[Any], words: Mapping[str, str]) -> list[Table]:
    """What ended parts of the runs (field → ``words``), by its cause; no table where nothing did."""
    causes = Counter(
        (what, failure.split(" ")[0].rstrip(":"))
        for row in rows
        for name, what in words.items()
        if (failure := getattr(row, name).failure)
    )
    cells = [[what, cause, count] for (what, cause), count in sorted(causes.items())]
    return [table(title, [first, "cause", "runs"], cells)] if cells else []


def errors_plot(arms: Mapping[str, Sequence[PositioningRow]], title: str) -> Figure:
    """For each arm the share of runs (all of them, also the failed) within an error, one line a branch."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(4.6 * len(arms), 3.6), layout="constrained")
        faces = np.atleast_1d(figure.subplots(1, len(arms), sharey=True))
        for axes, (arm, rows) in zip(faces, arms.items(), strict=True):
            for (name, words), colour in zip(BRANCHES.items(), AXIS_COLOURS, strict=True):
                worst = np.array([getattr(row, name).worst_mm for row in rows])
                worst = np.sort(worst[np.isfinite(worst)])
                share = 100.0 * np.arange(1, len(worst) + 1) / len(rows)
                axes.step(
                    np.append(0.0, worst), np.append(0.0, share), where="post", color=colour, label=words
                )
            axes.axvspan(0.0, LIMIT_MM, color="0.5", alpha=0.2, linewidth=0, zorder=0)
            axes.set(xlabel="worse of true |x|, |y| / mm", xlim=(0.0, _REACH_MM), ylim=(0.0, 101.0))
            axes.set_title(f"{arm}: {len(rows)} runs")
        faces[0].set_ylabel("runs within / %")
        faces[0].legend(loc="lower right")
        figure.suptitle(title)
        return figure


CORRECTED = Experiment(
    name="positioning",
    title="One look, then within 5 mm.",
    settings=DrawnSettings,
    row=PositioningRow,
    tasks=positioning_tasks,
    run=one_run,
    table=positioning_table,
    verdict=positioning_verdict,
    plot=positioning_plot,
    runs=200,
)
