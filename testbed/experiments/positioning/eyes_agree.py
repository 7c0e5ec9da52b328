"""`longreach experiment eyes-agree`: do runs without pictures end as runs with them do, seed by seed?"""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from testbed.campaigns.campaign import run_campaign
from testbed.experiments.positioning.corrected import BRANCHES, quantile, tasks_of, worst_mm
from testbed.experiments.positioning.corrected_run import one_run
from testbed.reporting.console import out, table, write_json
from vision_pc.core.se3 import Array

JSON = dict[str, Any]
LEAST_P = 0.05  # below it two samples of one distribution would seldom differ as much as these


def run_experiment(
    config_dir: Path,
    first_seed: int,
    runs: int,
    harder: bool,
    directory: Path,
    scheduler: str | None,
    json_file: Path | None,
) -> bool:
    """Whether the final errors agree in distribution on every branch, by both tests."""
    rows = {}
    for eyes in ("pixels", "model"):
        tasks = tasks_of(first_seed, runs, "plant", harder, eyes, [])
        title = f"{runs} runs, eyes: {eyes}"
        rows[eyes] = run_campaign(
            directory / eyes, partial(one_run, config_dir), tasks, scheduler=scheduler, title=title
        )
    agreed, shown, figures = True, [], []
    for name, what in BRANCHES.items():
        for quantity, of in (("worse of |x|, |y|", worst_mm), ("odometry − true, x", _apart)):
            pixels, model = (of(rows[eyes], name) for eyes in ("pixels", "model"))
            compared = compare(pixels, model)
            agreed = agreed and compared["agree"]
            figures.append({"after": what, "quantity": quantity} | compared)
            shown.append(_row(what, quantity, pixels, model, compared))
    headings = ["after", "mm", "eyes", "n", "25 %", "50 %", "75 %", "95 %", "KS p", "MW p", ""]
    cells = [line for pair in shown for line in pair]
    out.print(table("final errors with pictures and without", headings, cells))
    out.print("the model agrees with pixels" if agreed else "the model does NOT agree with pixels")
    for eyes, made in rows.items():
        seconds = [float(row["cpu_s"]) for row in made if row.get("cpu_s") is not None]
        if seconds:
            out.print(f"{eyes}: {np.mean(seconds):.1f} CPU seconds a run", highlight=False)
    write_json(json_file, {"agree": agreed, "compared": figures, "rows": rows})
    return agreed


def compare(pixels: Array, model: Array) -> JSON:
    """Two-sample Kolmogorov-Smirnov and Mann-Whitney p-values, and whether both are above ``LEAST_P``."""
    a, b = (values[np.isfinite(values)] for values in (pixels, model))
    if min(len(a), len(b)) < 4:
        return {"ks_p": float("nan"), "mw_p": float("nan"), "agree": False}
    ks_p, mw_p = float(stats.ks_2samp(a, b).pvalue), float(stats.mannwhitneyu(a, b).pvalue)
    return {"ks_p": ks_p, "mw_p": mw_p, "agree": min(ks_p, mw_p) >= LEAST_P}


def _apart(rows: list[JSON], name: str) -> Array:
    """What odometry believes of x, minus the truth, mm."""
    pairs = [(row.get(f"{name}_measured_x_mm"), row.get(f"{name}_true_x_mm")) for row in rows]
    return np.array([np.nan if a is None or b is None else float(a) - float(b) for a, b in pairs])


def _row(what: str, quantity: str, pixels: Array, model: Array, compared: JSON) -> list[list[str]]:
    lines = []
    for eyes, values in (("pixels", pixels), ("model", model)):
        figures = [f"{quantile(values, q):.2f}" for q in (25, 50, 75, 95)]
        tests = [
            f"{compared['ks_p']:.3f}",
            f"{compared['mw_p']:.3f}",
            "agree" if compared["agree"] else "DIFFER",
        ]
        lines.append(
            [what, quantity, eyes, str(int(np.isfinite(values).sum())), *figures]
            + (tests if eyes == "model" else ["", "", ""])
        )
    return lines
