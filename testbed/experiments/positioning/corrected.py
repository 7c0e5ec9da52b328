"""`longreach experiment best-mode`: how often one look brings the tool within ±5 mm, over drawn scenarios."""

from collections import Counter
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from scipy import stats

from testbed.campaigns.campaign import run_campaign
from testbed.experiments.positioning.corrected_plot import errors_plot
from testbed.experiments.positioning.corrected_run import one_run
from testbed.experiments.positioning.scenarios import ARMS
from testbed.reporting.console import out, table, write_json
from testbed.reporting.outcome import LIMIT_M
from vision_pc.core.se3 import Array

JSON = dict[str, Any]
BRANCHES = {"one_shot": "one shot, no correction", "look1": "one look", "look2": "two looks"}


class Demand(NamedTuple):
    """One line of the verdict: ``value`` is to be at least, or at most, ``limit`` (None: for information)."""

    what: str
    value: float
    sense: Literal["≥", "≤", "in"]
    limit: float | tuple[float, float] | None
    unit: str

    @property
    def met(self) -> bool | None:
        """Whether it is; None where nothing is asked."""
        if self.limit is None:
            return None
        if isinstance(self.limit, tuple):
            return bool(self.limit[0] <= self.value <= self.limit[1])
        return bool(self.value >= self.limit if self.sense == "≥" else self.value <= self.limit)


def tasks_of(
    first_seed: int, runs: int, arm: str, harder: bool, eyes: str, assignments: list[str]
) -> list[JSON]:
    """One task a run; with both arms, seeds take them in turn."""
    seeds = range(first_seed, first_seed + runs)
    asked = {"harder": harder, "eyes": eyes, "assignments": assignments}
    chosen = ARMS if arm == "both" else (arm,)
    return [
        {"key": f"{chosen[seed % len(chosen)]}-{seed}", "seed": seed, "arm": chosen[seed % len(chosen)]}
        | asked
        for seed in seeds
    ]


def run_experiment(
    config_dir: Path,
    tasks: list[JSON],
    directory: Path,
    scheduler: str | None,
    json_file: Path | None,
) -> bool:
    """Whether every demand was met; rows and a picture go to ``directory``: rows.csv, errors.png."""
    harder = bool(tasks[0]["harder"])
    title = f"best mode, {len(tasks)} {'harder' if harder else 'usual'} runs, eyes: {tasks[0]['eyes']}"
    rows = run_campaign(directory, partial(one_run, config_dir), tasks, scheduler=scheduler, title=title)
    demands = []
    arms = {
        arm: [row for row, task in zip(rows, tasks, strict=True) if task["arm"] == arm]
        for arm in sorted({task["arm"] for task in tasks})
    }
    for arm, own in arms.items():
        _show_errors(f"{title}, arm {arm}", own)
        _show_stops(own)
        demands += [(arm, demand) for demand in demands_of(own, harder)]
    if len(arms) > 1:
        demands += [("all", demand) for demand in demands_of(rows, harder)]
    shown = [
        [arm, d.what, f"{d.value:.3f} {d.unit}", _limit(d), {True: "met", False: "NOT met", None: ""}[d.met]]
        for arm, d in demands
    ]
    out.print(table("verdict", ["arm", "figure", "found", "asked", ""], shown))
    seconds = [float(row["cpu_s"]) for row in rows if row.get("cpu_s") is not None]
    out.print(f"{np.mean(seconds):.1f} CPU seconds a run" if seconds else "", highlight=False)
    plot = directory / "errors.png"
    plot.write_bytes(errors_plot(arms, BRANCHES, 1e3 * LIMIT_M, title))
    out.print(f"picture: {plot}", style="dim", highlight=False, soft_wrap=True)
    figures = [{"arm": arm, **d._asdict(), "met": d.met} for arm, d in demands]
    write_json(json_file, {"title": title, "demands": figures, "rows": rows})
    return all(demand.met is not False for _, demand in demands)


def demands_of(rows: list[JSON], harder: bool) -> list[Demand]:
    """What is asked of the rows of one arm. A run that stopped counts as failed in every share."""
    one, shot, two = (worst_mm(rows, name) for name in ("look1", "one_shot", "look2"))
    floor = np.abs(_columns(rows, "look2_servo_{}_mm")).max(axis=1)
    limit = 1e3 * LIMIT_M
    (nees, band), (shot_nees, _) = (normalised(rows, name) for name in ("look1", "one_shot"))
    return [
        Demand("one look: share within 5 mm", share(one, limit), "≥", 0.95 if harder else 0.98, ""),
        Demand("one shot: share within 5 mm", share(shot, limit), "≥", None if harder else 0.90, ""),
        Demand("two looks: share within 5 mm", share(two, limit), "≥", None, ""),
        Demand("two looks: median", quantile(two, 50), "≤", None if harder else 1.5, "mm"),
        Demand("two looks: 95 %", quantile(two, 95), "≤", None if harder else 3.0, "mm"),
        Demand("the servo's floor alone after two: median", quantile(floor, 50), "≤", None, "mm"),
        Demand("the servo's floor alone after two: 95 %", quantile(floor, 95), "≤", None, "mm"),
        Demand("one look: error² over predicted variance, mean", nees, "in", None if harder else band, ""),
        Demand("one look: share inside the predicted 95 % ellipse", covered(rows, "look1"), "≥", None, ""),
        Demand("one shot: error² over predicted variance, mean", shot_nees, "in", None, ""),
        Demand("one shot: share inside the predicted 95 % ellipse", covered(rows, "one_shot"), "≥", None, ""),
    ]


def worst_mm(rows: list[JSON], name: str) -> Array:
    """The larger of |x| and |y|, one a run; NaN where the run stopped."""
    return np.array([_number(row, f"{name}_worst_mm") for row in rows])


def share(values: Array, limit: float) -> float:
    """How many of all ``values`` are inside ``limit``; NaN, a run that stopped, is not."""
    return float(np.mean(np.nan_to_num(values, nan=np.inf) <= limit))


def quantile(values: Array, percent: float) -> float:
    """Of those that came to an end; NaN when none did."""
    finite = values[np.isfinite(values)]
    return float(np.percentile(finite, percent)) if len(finite) else float("nan")


def normalised(rows: list[JSON], name: str) -> tuple[float, tuple[float, float]]:
    """Mean of (x/σx)² and (y/σy)², 1 when the prediction made before moving is honest, and its 95 % band.

    The band is that of χ² with two degrees of freedom a run, divided by their number.
    """
    ratios = _ratios(rows, name)
    freedom = max(2 * len(ratios), 1)
    low, high = (float(stats.chi2.ppf(side, freedom)) / freedom for side in (0.025, 0.975))
    return float(ratios.mean()) if len(ratios) else float("nan"), (low, high)


def covered(rows: list[JSON], name: str) -> float:
    """How many of the runs that came to an end lie inside their predicted 95 % ellipse; NaN without any."""
    inside = _ratios(rows, name).sum(axis=1) <= stats.chi2.ppf(0.95, 2)
    return float(inside.mean()) if len(inside) else float("nan")


def _ratios(rows: list[JSON], name: str) -> Array:
    """(x/σx)² and (y/σy)² (n, 2) of the runs that came to an end."""
    errors, stds = _columns(rows, f"{name}_true_{{}}_mm"), _columns(rows, f"{name}_std_{{}}_mm")
    ratios = (errors / stds) ** 2
    return np.asarray(ratios[np.isfinite(ratios).all(axis=1)])


def _columns(rows: list[JSON], pattern: str) -> Array:
    return np.array([[_number(row, pattern.format(axis)) for axis in "xy"] for row in rows])


def _number(row: JSON, column: str) -> float:
    value = row.get(column)
    return float("nan") if value is None else float(value)


def _show_errors(title: str, rows: list[JSON]) -> None:
    shown = []
    for name, what in BRANCHES.items():
        worst = worst_mm(rows, name)
        z = np.abs(np.array([_number(row, f"{name}_true_z_mm") for row in rows]))
        apart = _columns(rows, f"{name}_measured_{{}}_mm") - _columns(rows, f"{name}_true_{{}}_mm")
        figures = [quantile(worst, q) for q in (50, 95, 100)] + [quantile(z, q) for q in (50, 95)]
        figures.append(float(np.sqrt(np.nanmean(apart**2))) if np.isfinite(apart).any() else float("nan"))
        within = f"{np.count_nonzero(worst <= 1e3 * LIMIT_M)} of {len(rows)}"
        shown.append([what, within, *(f"{figure:.2f}" for figure in figures)])
    headings = ["after", "within 5 mm", "median", "95 %", "worst", "|z| median", "95 %", "measured − true"]
    out.print(table(f"{title}: worse of true |x| and |y|, mm", headings, shown))


def _show_stops(rows: list[JSON]) -> None:
    stops = Counter(
        (
            BRANCHES.get(name.removesuffix("_stopped"), "before the look"),
            str(row[name]).split(" ")[0].rstrip(":"),
        )
        for row in rows
        for name in ("stopped", *(f"{branch}_stopped" for branch in BRANCHES), "failure")
        if row.get(name)
    )
    if stops:
        cells = [[what, cause, count] for (what, cause), count in sorted(stops.items())]
        out.print(table("refused or failed, counted as failures above", ["at", "cause", "runs"], cells))


def _limit(demand: Demand) -> str:
    if demand.limit is None:
        return "–"
    if isinstance(demand.limit, tuple):
        return f"{demand.limit[0]:.3f} to {demand.limit[1]:.3f}"
    return f"{demand.sense} {demand.limit:g} {demand.unit}"
