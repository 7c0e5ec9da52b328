"""`longreach experiment looking-and-moving`: the closed loop against look-then-move, from the same start."""

import copy
from collections import Counter
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from protocol.errors import LongreachError
from testbed.campaigns.campaign import run_campaign
from testbed.experiments.positioning.corrected import quantile, share, worst_mm
from testbed.experiments.positioning.corrected_run import operate, prepared, true_error_mm
from testbed.experiments.positioning.scenarios import draw
from testbed.lockstep.rig import LockstepRig
from testbed.reporting.console import out, table, write_json

JSON = dict[str, Any]
LIMIT_MM = 2.0
WANTED_SHARE = 0.95
CORRECTED: tuple[str, JSON] = ("look-then-move", {"method": "corrected", "aim_mm": 0.0})
WORDS = {
    "closed_loop": "looking and moving",
    "corrected": "look then move, corrected",
    "two_looks": "the same, two looks",
}


def one_run(config_dir: Path, task: JSON) -> JSON:
    """The row of one seed: true error and time to the target of each form, from the same world.

    The second of two looks carries on where the corrected one ended.
    """
    row: JSON = {"seed": task["seed"]}
    row |= draw(config_dir, task["seed"], task["arm"], task["harder"]).shown
    try:
        rig = prepared(config_dir, task)
    except LongreachError as error:
        return row | {"stopped": f"{error.cause}: {error}"}
    begin_ns = rig.world.time_ns
    row |= _form(copy.deepcopy(rig), begin_ns, "closed_loop", "looking-and-moving", {})
    row |= _form(rig, begin_ns, "corrected", *CORRECTED)
    if "corrected_stopped" in row:
        return row | {"two_looks_stopped": row["corrected_stopped"]}
    return row | _form(rig, begin_ns, "two_looks", *CORRECTED)


def _form(rig: LockstepRig, begin_ns: int, name: str, kind: str, body: JSON) -> JSON:
    """Columns ``name``_… of an operation: true error, and time to the target since ``begin_ns``."""
    try:
        result = operate(rig, kind, body)
    except LongreachError as error:
        return {f"{name}_stopped": f"{error.cause}: {error}"}
    time_s = 1e-9 * (rig.world.time_ns - begin_ns)
    error_mm = true_error_mm(rig)
    row: JSON = {f"{name}_true_{axis}_mm": float(value) for axis, value in zip("xyz", error_mm, strict=True)}
    row |= {f"{name}_worst_mm": float(np.abs(error_mm[:2]).max()), f"{name}_time_s": time_s}
    if name == "closed_loop":
        row |= {f"{name}_loop_s": result.approach.time_s, f"{name}_missed": result.approach.missed}
    return row


def run_experiment(
    config_dir: Path, tasks: list[JSON], directory: Path, scheduler: str | None, json_file: Path | None
) -> bool:
    """Whether the closed loop ended under 2 mm in enough runs; one that stopped counts as not."""
    title = f"looking and moving, {len(tasks)} runs, eyes: {tasks[0]['eyes']}"
    rows = run_campaign(directory, partial(one_run, config_dir), tasks, scheduler=scheduler, title=title)
    shown = []
    for name, words in WORDS.items():
        worst = worst_mm(rows, name)
        times = np.array([float(row.get(f"{name}_time_s") or np.nan) for row in rows])
        figures = [quantile(worst, 50), quantile(worst, 95), quantile(times, 50), quantile(times, 95)]
        within = f"{np.count_nonzero(worst <= LIMIT_MM)} of {len(rows)}"
        shown.append([words, within, *(f"{figure:.2f}" for figure in figures)])
    headings = ["form", "under 2 mm", "median mm", "95 % mm", "time to rest s", "95 % s"]
    out.print(table(f"{title}: worse of true |x| and |y|", headings, shown))
    stops = Counter(
        (name, str(row[f"{name}_stopped"]).split(":")[0])
        for row in rows
        for name in WORDS
        if row.get(f"{name}_stopped")
    )
    for (name, cause), count in sorted(stops.items()):
        out.print(f"{WORDS[name]}: {count} refused or stopped, {cause}", highlight=False)
    reached = share(worst_mm(rows, "closed_loop"), LIMIT_MM)
    word = "met" if reached >= WANTED_SHARE else "NOT met"
    out.print(f"under 2 mm: {reached:.3f} of all runs, asked ≥ {WANTED_SHARE}: {word}", highlight=False)
    write_json(json_file, {"share": reached, "asked": WANTED_SHARE, "rows": rows})
    return reached >= WANTED_SHARE
