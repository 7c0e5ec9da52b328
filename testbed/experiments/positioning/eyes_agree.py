"""`longreach experiment eyes-agree`: do runs without pictures end as runs with them do, seed by seed?"""

import math
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer
from rich.table import Table
from scipy import stats

from testbed.campaigns.campaign import CampaignRequest, Task
from testbed.campaigns.experiment import Check, Experiment, Finished
from testbed.campaigns.options import EyesKind
from testbed.experiments.positioning.corrected import (
    BRANCHES,
    DrawnSettings,
    positioning_tasks,
    quantile,
    worst_mm,
)
from testbed.experiments.positioning.corrected_run import Branch, one_run
from testbed.reporting.console import table
from vision_pc.core.se3 import Array

LEAST_P = 0.05  # below it two samples of one distribution would seldom differ as much as these


class AgreeSettings(NamedTuple):
    """Which scenarios."""

    harder: Annotated[
        bool, typer.Option("--harder", help="Scale, drift, lens, print and play errors on top.")
    ] = False


class EyesRow(NamedTuple):
    """A run of best mode with one of both eyes."""

    eyes: str
    one_shot: Branch
    look1: Branch
    look2: Branch
    failure: str
    cpu_s: float


class Comparison(NamedTuple):
    """Two-sample p-values of Kolmogorov-Smirnov and Mann-Whitney."""

    ks_p: float
    mw_p: float

    @property
    def agree(self) -> bool:
        """Whether both are above ``LEAST_P``; NaN is not."""
        return min(self.ks_p, self.mw_p) >= LEAST_P


Seen = Finished[AgreeSettings, EyesRow]


def agree_tasks(request: CampaignRequest, settings: AgreeSettings) -> list[Task]:
    """The same seeds with both eyes."""
    return [
        task | {"key": f"{eyes}-{task['key']}"}
        for eyes in EyesKind
        for task in positioning_tasks(request, DrawnSettings(settings.harder, eyes=eyes))
    ]


def seen_run(config_dir: Path, task: Task) -> dict[str, Any]:
    """The row of a best-mode run, with its eyes."""
    return {"eyes": task["eyes"]} | one_run(config_dir, task)


def _compared(done: Seen) -> list[tuple[str, str, Array, Array, Comparison]]:
    """After, quantity, its values with pictures and by the model, and how they compare."""
    made = []
    rows = {eyes: [row for row in done.rows if row.eyes == eyes] for eyes in EyesKind}
    for name, what in BRANCHES.items():
        for quantity, of in (("worse of |x|, |y|", worst_mm), ("odometry − true, x", _apart)):
            pixels, model = (of(rows[eyes], name) for eyes in (EyesKind.PIXELS, EyesKind.MODEL))
            made.append((what, quantity, pixels, model, compare(pixels, model)))
    return made


def agree_table(done: Seen) -> list[Table]:
    """Quantiles of both eyes' final errors, and the tests' p-values."""
    headings = ["after", "mm", "eyes", "n", "25 %", "50 %", "75 %", "95 %", "KS p", "MW p", ""]
    cells = [line for compared in _compared(done) for line in _row(*compared)]
    return [table("final errors with pictures and without", headings, cells)]


def agree_verdict(done: Seen) -> list[Check]:
    """The final errors agree in distribution on every branch, by both tests."""
    return [
        Check(f"{what}: {quantity}", f"p {c.ks_p:.3f}, {c.mw_p:.3f}", f"p ≥ {LEAST_P:g} of both", c.agree)
        for what, quantity, _, _, c in _compared(done)
    ]


def agree_figures(done: Seen) -> dict[str, Any]:
    """The comparisons."""
    compared = [
        {"after": what, "quantity": quantity} | c._asdict() | {"agree": c.agree}
        for what, quantity, _, _, c in _compared(done)
    ]
    return {"agree": all(c["agree"] for c in compared), "compared": compared}


def compare(pixels: Array, model: Array) -> Comparison:
    """Both tests; NaN with fewer than four values of either."""
    a, b = (values[np.isfinite(values)] for values in (pixels, model))
    if min(len(a), len(b)) < 4:
        return Comparison(math.nan, math.nan)
    return Comparison(float(stats.ks_2samp(a, b).pvalue), float(stats.mannwhitneyu(a, b).pvalue))


def _apart(rows: list[EyesRow], name: str) -> Array:
    """What odometry believes of x, minus the truth, mm."""
    branches = [getattr(row, name) for row in rows]
    return np.array([branch.measured_mm.x - branch.true_mm.x for branch in branches])


def _row(what: str, quantity: str, pixels: Array, model: Array, compared: Comparison) -> list[list[str]]:
    lines = []
    for eyes, values in (("pixels", pixels), ("model", model)):
        figures = [f"{quantile(values, q):.2f}" for q in (25, 50, 75, 95)]
        verdict = "agree" if compared.agree else "DIFFER"
        tests = [f"{compared.ks_p:.3f}", f"{compared.mw_p:.3f}", verdict] if eyes == "model" else [""] * 3
        lines.append([what, quantity, eyes, str(int(np.isfinite(values).sum())), *figures, *tests])
    return lines


EYES_AGREE = Experiment(
    name="eyes-agree",
    title="The same seeds with pictures and with the eye model.",
    shows="whether runs without pictures end as runs with them do, in distribution",
    cost="30 CPU s; 150 with pictures",
    settings=AgreeSettings,
    row=EyesRow,
    tasks=agree_tasks,
    run=seen_run,
    table=agree_table,
    verdict=agree_verdict,
    figures=agree_figures,
    runs=30,
    world="payload, mount, camera, object, geometry drawn from the seed; the 4 m arm",
    eyes="pixels and model",
)
