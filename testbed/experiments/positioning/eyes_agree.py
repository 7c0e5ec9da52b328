"""`longreach experiment eyes-agree`: do runs without pictures end as runs with them do, seed by seed?

Both eyes run the same drawn world, so runs are compared in pairs: the ratio of their errors, pictures over
model. The model stands in for pictures only where the confidence interval of the mean ratio lies inside
``FACTOR`` either way. Few runs have wide intervals: they show nothing, and the verdict says so.
"""

import math
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer
from rich.table import Table
from scipy import stats

from testbed.campaigns.campaign import CampaignRequest, Task
from testbed.campaigns.experiment import Check, Experiment, Finished
from testbed.campaigns.options import Adapting, Commissioned, EyesKind
from testbed.experiments.positioning.corrected import (
    BOTH_ARMS,
    BRANCHES,
    ChosenWorld,
    DrawnSettings,
    positioning_tasks,
)
from testbed.experiments.positioning.corrected_figures import quantile, worst_mm
from testbed.experiments.positioning.corrected_run import Branch, one_run
from testbed.experiments.positioning.worlds import WorldName
from testbed.reporting.console import table
from vision_pc.core.se3 import Array

FACTOR = 1.5  # by which errors may differ on average and the model still stand in for pictures
_LEVEL = 0.05  # of both one-sided tests, and of the tests for a difference
_POWER = 0.8


class AgreeSettings(NamedTuple):
    """Which scenarios."""

    world: ChosenWorld = WorldName.LAB
    arm: Annotated[str, typer.Option(help="Which arm runs; both: in turn.")] = BOTH_ARMS
    adapting: Adapting = False
    commissioned: Commissioned = False


class EyesRow(NamedTuple):
    """A run of best mode with one of both eyes."""

    seed: int
    arm: str
    eyes: str
    one_shot: Branch
    look1: Branch
    look2: Branch
    failure: str
    cpu_s: float


class Pairs(NamedTuple):
    """Runs of one branch that ended with both eyes, and how many stopped with one of them only."""

    pixels: Array
    model: Array
    pixels_stopped: int
    model_stopped: int


class Comparison(NamedTuple):
    """Ratio of the geometric means, pictures over model: found, and the ends of its 90 % interval.

    ``seen``: the least ratio that this many pairs, scattered as these are, show in 80 of 100 campaigns.
    ``stopped_p``: exact p that as unequal numbers stop with one eye only by chance. NaN: too few pairs.
    """

    ratio: float
    low: float
    high: float
    seen: float
    stopped_p: float

    @property
    def agree(self) -> bool:
        """Whether the interval lies within ``FACTOR`` either way, and as many stop with either; NaN: no."""
        return bool(self.low >= 1.0 / FACTOR and self.high <= FACTOR and self.stopped_p >= _LEVEL)


Seen = Finished[AgreeSettings, EyesRow]


def agree_tasks(request: CampaignRequest, settings: AgreeSettings) -> list[Task]:
    """The same seeds with both eyes, pair by pair: a campaign that is broken off has whole pairs."""
    world, arm, *machine = settings
    drawn = [DrawnSettings(world, arm, eyes, None, *machine) for eyes in EyesKind]
    pairs = zip(*(positioning_tasks(request, each) for each in drawn), strict=True)
    return [task | {"key": f"{task['eyes']}-{task['key']}"} for pair in pairs for task in pair]


def seen_run(config_dir: Path, task: Task) -> dict[str, Any]:
    """The row of a best-mode run, with its eyes."""
    return {"eyes": task["eyes"]} | one_run(config_dir, task)


def paired(rows: list[EyesRow], name: str) -> tuple[Pairs, Pairs]:
    """Final errors of one branch, and what odometry was off by at its end, mm; seeds with both eyes only."""
    by_eyes = {eyes: {(r.arm, r.seed): r for r in rows if r.eyes == eyes} for eyes in EyesKind}
    both = sorted(set(by_eyes[EyesKind.PIXELS]) & set(by_eyes[EyesKind.MODEL]))
    chosen = {eyes: [of[key] for key in both] for eyes, of in by_eyes.items()}
    return _pairs(chosen, name, worst_mm), _pairs(chosen, name, _apart_mm)


def _pairs(rows: dict[EyesKind, list[EyesRow]], name: str, of: Any) -> Pairs:
    pixels, model = (np.asarray(of(rows[eyes], name), float) for eyes in (EyesKind.PIXELS, EyesKind.MODEL))
    ended = np.isfinite(pixels), np.isfinite(model)
    whole = ended[0] & ended[1]
    one_only = [int(np.count_nonzero(~ended[i] & ended[1 - i])) for i in (0, 1)]
    return Pairs(pixels[whole], model[whole], one_only[0], one_only[1])


def _apart_mm(rows: list[EyesRow], name: str) -> Array:
    """How far odometry's belief is from the truth across the view."""
    branches = [getattr(row, name) for row in rows]
    return np.array([math.hypot(*np.subtract(b.measured_mm, b.true_mm)[:2]) for b in branches])


def compare(pairs: Pairs) -> Comparison:
    """The paired comparison; NaN with fewer than four pairs."""
    stopped = pairs.pixels_stopped + pairs.model_stopped
    p = float(stats.binomtest(pairs.pixels_stopped, stopped).pvalue) if stopped else 1.0
    n = len(pairs.pixels)
    if n < 4:
        return Comparison(math.nan, math.nan, math.nan, math.nan, p)
    logs = np.log(pairs.pixels / pairs.model)
    mean, error = float(logs.mean()), float(logs.std(ddof=1)) / math.sqrt(n)
    half = float(stats.t.ppf(1.0 - _LEVEL, n - 1)) * error
    seen = (float(stats.t.ppf(1.0 - _LEVEL / 2.0, n - 1)) + float(stats.t.ppf(_POWER, n - 1))) * error
    return Comparison(math.exp(mean), math.exp(mean - half), math.exp(mean + half), math.exp(seen), p)


def _compared(done: Seen) -> list[tuple[str, str, str, Pairs, Comparison]]:
    """Arm, after, quantity, the pairs, and how they compare; of all arms together last."""
    rows = list(done.rows)
    arms = sorted({row.arm for row in rows})
    groups = {arm: [row for row in rows if row.arm == arm] for arm in arms}
    groups |= {"all": rows} if len(arms) > 1 else {}
    made = []
    for arm, of_arm in groups.items():
        for name, what in BRANCHES.items():
            for quantity, pairs in zip(("worse of |x|, |y|", "odometry"), paired(of_arm, name), strict=True):
                made.append((arm, what, quantity, pairs, compare(pairs)))
    return made


def agree_table(done: Seen) -> list[Table]:
    """Quantiles of both eyes' final errors, their ratio, and what would have been seen."""
    headings = ["arm", "after", "mm", "eyes", "pairs", "stopped", "50 %", "95 %", "ratio", "90 %", "seen"]
    cells = [line for compared in _compared(done) for line in _lines(*compared)]
    return [table("final errors with pictures and without; ratio: pictures over model", headings, cells)]


def _lines(arm: str, what: str, quantity: str, pairs: Pairs, found: Comparison) -> list[list[str]]:
    lines = []
    told = [f"{found.ratio:.2f}", f"{found.low:.2f} to {found.high:.2f}", f"from {found.seen:.2f}"]
    eyes = (("pixels", pairs.pixels, pairs.pixels_stopped), ("model", pairs.model, pairs.model_stopped))
    for name, values, stopped in eyes:
        figures = [f"{quantile(values, q):.2f}" for q in (50, 95)]
        last = told if name == "model" else [""] * 3
        lines.append([arm, what, quantity, name, str(len(values)), str(stopped), *figures, *last])
    return lines


def agree_verdict(done: Seen) -> list[Check]:
    """Over all arms the mean ratio is known to lie within ``FACTOR`` either way, on every branch."""
    compared = _compared(done)
    last = compared[-1][0] if compared else ""
    return [
        Check(
            f"{arm}, {what}: {quantity}",
            f"{c.low:.2f} to {c.high:.2f}, stopped p {c.stopped_p:.2f}",
            f"{1.0 / FACTOR:.2f} to {FACTOR:g}, p ≥ {_LEVEL:g}" if arm == last else "",
            c.agree if arm == last else None,
        )
        for arm, what, quantity, _, c in compared
    ]


def agree_figures(done: Seen) -> dict[str, Any]:
    """The comparisons."""
    compared = [
        {"arm": arm, "after": what, "quantity": quantity, "pairs": len(pairs.pixels)}
        | c._asdict()
        | {"agree": c.agree}
        for arm, what, quantity, pairs, c in _compared(done)
    ]
    return {"compared": compared}


EYES_AGREE = Experiment(
    name="eyes-agree",
    title="The same seeds with pictures and with the eye model.",
    settings=AgreeSettings,
    row=EyesRow,
    tasks=agree_tasks,
    run=seen_run,
    table=agree_table,
    verdict=agree_verdict,
    figures=agree_figures,
    runs=30,
    eyes="pixels and model",
)
