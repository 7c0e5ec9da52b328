"""`longreach experiment positioning`: how often one look ends within ±5 mm, over drawn scenarios."""

from collections.abc import Sequence
from typing import Annotated, Any, NamedTuple

import matplotlib
import numpy as np
import typer
from matplotlib.figure import Figure
from rich.table import Table

from laboratory.campaigns.campaign import CampaignRequest
from laboratory.campaigns.experiment import (
    Adapting,
    Check,
    ChosenEyes,
    Commissioned,
    Experiment,
    EyesKind,
    Finished,
    failure_counts,
    seeds,
)
from laboratory.campaigns.rows import Row, column
from laboratory.campaigns.workforce import Task
from laboratory.experiments.positioning.corrected_run import one_run
from laboratory.experiments.positioning.results import LIMIT_MM, checks_of, quantile, worst_mm
from laboratory.experiments.positioning.worlds import ARMS, WORLDS, WorldName
from testbed.cli.options import Settings as Assignments
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
        bool, typer.Option("--own-file", help="The machine commissions itself first: its own file.")
    ] = False


def positioning_tasks(request: CampaignRequest, settings: DrawnSettings) -> list[Task]:
    """One task a run; with both arms, seeds take them in turn."""
    choice: dict[str, Any] = {"world": str(settings.world), "eyes": str(settings.eyes),
                              "assignments": settings.assignments or []}  # fmt: skip
    choice |= {name: True for name in ("adapting", "commissioned", "own_file") if getattr(settings, name)}
    arms = ARMS if settings.arm == BOTH_ARMS else (settings.arm or WORLDS[settings.world].arm,)
    return [
        {"key": f"{arm}-{seed}", "seed": seed, "arm": arm} | choice
        for seed in seeds(request)
        for arm in [arms[seed % len(arms)]]
    ]


def positioning_tables(done: Finished[DrawnSettings]) -> list[Table]:
    """For each arm the errors after each branch, and what refused or failed."""
    tables: list[Table] = []
    for arm, rows in by_arm(done.rows).items():
        tables += [_errors(arm, rows), *_stops(rows)]
    return tables


def positioning_verdict(done: Finished[DrawnSettings]) -> list[Check]:
    """What is asked of each arm, and of both together."""
    arms = by_arm(done.rows)
    groups = {**arms, "all": done.rows} if len(arms) > 1 else arms
    return [
        check._replace(what=f"{arm}: {check.what}")
        for arm, rows in groups.items()
        for check in checks_of(rows, WORLDS[done.settings.world].demands)
    ]


def by_arm(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Arm → its rows."""
    arms = sorted({row["arm"] for row in rows})
    return {arm: [row for row in rows if row["arm"] == arm] for arm in arms}


def _errors(arm: str, rows: Sequence[Row]) -> Table:
    shown = []
    for name, what in BRANCHES.items():
        worst, z = worst_mm(rows, name), np.abs(column(rows, f"{name}_true_z_mm"))
        statistics = [quantile(worst, q) for q in (50, 95, 100)] + [quantile(z, q) for q in (50, 95)]
        within = f"{np.count_nonzero(worst <= LIMIT_MM)} of {len(rows)}"
        shown.append([what, within, *(f"{figure:.2f}" for figure in statistics)])
    headings = ["after", "within 5 mm", "median", "95 %", "worst", "|z| median", "95 %"]
    return table(f"arm {arm}, {len(rows)} runs: worse of true |x| and |y|, mm", headings, shown)


def _stops(rows: Sequence[Row]) -> list[Table]:
    """What ended branches, by its cause; no table where nothing did."""
    cells = [
        (what, cause, count)
        for name, what in BRANCHES.items()
        for cause, count in failure_counts(row.get(f"{name}_failure") for row in rows)
    ]
    title = "refused or failed, counted as failed above"
    return [table(title, ["at", "cause", "runs"], cells)] if cells else []


def errors_plot(done: Finished[DrawnSettings]) -> dict[str, Figure]:
    """For each arm the share of runs (all of them, also the failed) within an error, one line a branch."""
    arms = by_arm(done.rows)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(4.6 * len(arms), 3.6), layout="constrained")
        panels = np.atleast_1d(figure.subplots(1, len(arms), sharey=True))
        for axes, (arm, rows) in zip(panels, arms.items(), strict=True):
            for (name, words), colour in zip(BRANCHES.items(), AXIS_COLOURS, strict=True):
                worst = np.sort(worst_mm(rows, name))
                worst = np.append(0.0, worst[np.isfinite(worst)])
                share = 100.0 * np.arange(len(worst)) / len(rows)
                axes.step(worst, share, where="post", color=colour, label=words)
            axes.axvspan(0.0, LIMIT_MM, color="0.5", alpha=0.2, linewidth=0, zorder=0)
            axes.set(xlabel="worse of true |x|, |y| / mm", xlim=(0.0, _REACH_MM), ylim=(0.0, 101.0))
            axes.set_title(f"{arm}: {len(rows)} runs")
        panels[0].set_ylabel("runs within / %")
        panels[0].legend(loc="lower right")
        figure.suptitle(f"{len(done.rows)} runs, world: {done.settings.world}, eyes: {done.settings.eyes}")
    return {"errors": figure}


CORRECTED = Experiment(
    name="positioning",
    settings=DrawnSettings,
    tasks=positioning_tasks,
    run=one_run,
    tables=positioning_tables,
    verdict=positioning_verdict,
    plot=errors_plot,
    runs=200,
)
