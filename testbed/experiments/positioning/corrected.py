"""`longreach experiment best-mode`: how often one look brings the tool within ±5 mm, over drawn scenarios."""

from collections import Counter
from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer
from rich.table import Table

from testbed.campaigns.campaign import CampaignRequest, Task
from testbed.campaigns.experiment import Check, Experiment, Finished, at_least, at_most, seeds
from testbed.campaigns.options import Assignments, ChosenEyes, EyesKind
from testbed.experiments.positioning.corrected_plot import errors_plot
from testbed.experiments.positioning.corrected_run import PositioningRow, one_run
from testbed.experiments.positioning.scenarios import ARMS
from testbed.experiments.positioning.told import Told, reliability_plot, reliability_table, told_checks
from testbed.reporting.console import table
from testbed.reporting.outcome import LIMIT_M
from vision_pc.core.se3 import Array

BRANCHES = {"one_shot": "one shot, no correction", "look1": "one look", "look2": "two looks"}


class ChosenArm(StrEnum):
    """Which arm runs."""

    PLANT = "plant"
    LONG_CRANE = "plant_long_crane"
    BOTH = "both"


class DrawnSettings(NamedTuple):
    """What drawn scenarios are run, and how they are seen."""

    harder: Annotated[
        bool, typer.Option("--harder", help="Scale, drift, lens, print and play errors on top.")
    ] = False
    arm: Annotated[ChosenArm, typer.Option(help="Which arm runs; both: in turn.")] = ChosenArm.PLANT
    eyes: ChosenEyes = EyesKind.MODEL
    assignments: Assignments = None


Positioned = Finished[DrawnSettings, PositioningRow]


def positioning_tasks(request: CampaignRequest, settings: DrawnSettings) -> list[Task]:
    """One task a run; with both arms, seeds take them in turn."""
    asked = {"harder": settings.harder, "eyes": str(settings.eyes), "assignments": settings.assignments or []}
    chosen = ARMS if settings.arm is ChosenArm.BOTH else (str(settings.arm),)
    return [
        {"key": f"{chosen[seed % len(chosen)]}-{seed}", "seed": seed, "arm": chosen[seed % len(chosen)]}
        | asked
        for seed in seeds(request)
    ]


def positioning_table(done: Positioned) -> list[Table]:
    """For each arm the errors after each branch, and what refused or failed."""
    tables = []
    for arm, rows in by_arm(done.rows).items():
        title = "refused or failed, counted as failed above"
        tables += [_errors(arm, rows), *stops_table(title, "at", rows, BRANCHES)]
        title = f"arm {arm}, one look: probability told before moving"
        tables.append(reliability_table(title, told(rows, "look1", "before"), worst_mm(rows, "look1")))
    return tables


def positioning_verdict(done: Positioned) -> list[Check]:
    """What is asked of each arm, and of both together."""
    arms = by_arm(done.rows)
    groups = {**arms, "all": done.rows} if len(arms) > 1 else arms
    return [
        check._replace(what=f"{arm}: {check.what}")
        for arm, rows in groups.items()
        for check in checks_of(rows, done.settings.harder)
    ]


def positioning_plot(done: Positioned) -> dict[str, bytes]:
    """How many of the runs end within which error."""
    title = (
        f"{len(done.rows)} {'harder' if done.settings.harder else 'usual'} runs, eyes: {done.settings.eyes}"
    )
    worst = worst_mm(done.rows, "look1")
    groups = {"before moving": "before", "by odometry": "after"}
    honest = {words: (told(done.rows, "look1", when), worst) for words, when in groups.items()}
    return {
        "errors": errors_plot(by_arm(done.rows), BRANCHES, 1e3 * LIMIT_M, title),
        "reliability": reliability_plot(honest, f"one look, {title}"),
    }


def by_arm(rows: Sequence[PositioningRow]) -> dict[str, list[PositioningRow]]:
    """Arm → its rows."""
    return {arm: [row for row in rows if row.arm == arm] for arm in sorted({row.arm for row in rows})}


def checks_of(rows: Sequence[PositioningRow], harder: bool) -> list[Check]:
    """What is asked of the rows of one arm. A run that failed counts as failed in every share."""
    one, shot, two = (worst_mm(rows, name) for name in ("look1", "one_shot", "look2"))
    floor = np.abs(_vectors(rows, "look2", "servo_mm")).max(axis=1)
    limit = 1e3 * LIMIT_M
    return [
        at_least("one look: share within 5 mm", share(one, limit), 0.95 if harder else 0.98),
        at_least("one shot: share within 5 mm", share(shot, limit), None if harder else 0.90),
        at_least("two looks: share within 5 mm", share(two, limit), None),
        at_most("two looks: median", quantile(two, 50), None if harder else 1.5, "mm"),
        at_most("two looks: 95 %", quantile(two, 95), None if harder else 3.0, "mm"),
        at_most("the servo's floor alone after two: median", quantile(floor, 50), None, "mm"),
        at_most("the servo's floor alone after two: 95 %", quantile(floor, 95), None, "mm"),
        *told_checks("one look", told(rows, "look1", "before"), one, not harder),
        *told_checks("one look, by odometry", told(rows, "look1", "after"), one, False),
        *told_checks("one shot", told(rows, "one_shot", "before"), shot, False),
    ]


def told(rows: Sequence[PositioningRow], name: str, when: str) -> list[Told]:
    """What was told of a branch, ``before`` moving or ``after`` it by odometry."""
    return [getattr(getattr(row, name), when) for row in rows]


def worst_mm(rows: Sequence[Any], name: str) -> Array:
    """The larger of |x| and |y| of a branch, one a run; NaN where the run failed."""
    return np.array([getattr(row, name).worst_mm for row in rows])


def share(values: Array, limit: float) -> float:
    """How many of all ``values`` are inside ``limit``; NaN, a run that stopped, is not."""
    return float(np.mean(np.nan_to_num(values, nan=np.inf) <= limit))


def quantile(values: Array, percent: float) -> float:
    """Of those that came to an end; NaN when none did."""
    finite = values[np.isfinite(values)]
    return float(np.percentile(finite, percent)) if len(finite) else float("nan")


def _vectors(rows: Sequence[PositioningRow], branch: str, quantity: str) -> Array:
    """x and y (n, 2) of a branch's quantity."""
    return np.array([getattr(getattr(row, branch), quantity)[:2] for row in rows])


def _errors(arm: str, rows: Sequence[PositioningRow]) -> Table:
    shown = []
    for name, what in BRANCHES.items():
        worst = worst_mm(rows, name)
        z = np.abs(np.array([getattr(row, name).true_mm.z for row in rows]))
        apart = _vectors(rows, name, "measured_mm") - _vectors(rows, name, "true_mm")
        figures = [quantile(worst, q) for q in (50, 95, 100)] + [quantile(z, q) for q in (50, 95)]
        figures.append(float(np.sqrt(np.nanmean(apart**2))) if np.isfinite(apart).any() else float("nan"))
        within = f"{np.count_nonzero(worst <= 1e3 * LIMIT_M)} of {len(rows)}"
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


BEST_MODE = Experiment(
    name="best-mode",
    title="One look, then within 5 mm.",
    shows="how often one look, corrected on the way, brings the tool within 5 mm over drawn scenarios",
    cost="30 CPU s",
    settings=DrawnSettings,
    row=PositioningRow,
    tasks=positioning_tasks,
    run=one_run,
    table=positioning_table,
    verdict=positioning_verdict,
    plot=positioning_plot,
    runs=200,
    world="payload, mount, camera, object, geometry drawn from the seed",
)
