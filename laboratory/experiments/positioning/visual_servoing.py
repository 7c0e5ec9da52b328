"""`longreach experiment positioning --method visual-servoing`: the closed loop beside look-then-move."""

import copy
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.table import Table

from laboratory.campaigns.campaign import Task
from laboratory.campaigns.experiment import Check, Experiment, Finished, at_least
from laboratory.campaigns.rows import UNKNOWN, XYZ, xyz
from laboratory.experiments.positioning.corrected import DrawnSettings, positioning_tasks, stops_table
from laboratory.experiments.positioning.corrected_run import drawn_by, operate, prepared, true_error_mm
from laboratory.experiments.positioning.results import quantile, share, worst_mm
from protocol.errors import LongreachError
from testbed.lockstep.rig import LockstepRig
from testbed.reporting.console import table

LIMIT_MM = 2.0
WANTED_SHARE = 0.95
CORRECTED: tuple[str, dict[str, Any]] = ("look-then-move", {"method": "corrected", "aim_mm": 0.0})
WORDS = {
    "closed_loop": "looking and moving",
    "corrected": "look then move, corrected",
    "two_looks": "the same, two looks",
}


class Form(NamedTuple):
    """How one form ended: true error, time to the target; of the closed loop its time and missed frames."""

    true_mm: XYZ = UNKNOWN
    worst_mm: float = math.nan
    time_s: float = math.nan
    loop_s: float = math.nan
    missed: int | None = None
    failure: str = ""


class ServoingRow(NamedTuple):
    """One seed: every form from the same world."""

    seed: int
    closed_loop: Form
    corrected: Form
    two_looks: Form
    failure: str
    cpu_s: float


def one_run(config_dir: Path, task: Task) -> dict[str, Any]:
    """The row of one seed: true error and time to the target of each form, from the same world.

    The second of two looks carries on where the corrected one ended.
    """
    row: dict[str, Any] = {"seed": task["seed"]}
    row |= drawn_by(config_dir, task).shown
    try:
        rig = prepared(config_dir, task)
    except LongreachError as error:
        return row | {"failure": f"{error.cause}: {error}"}
    begin_ns = rig.world.time_ns
    closed_loop = _form(copy.deepcopy(rig), begin_ns, "looking-and-moving", {})
    corrected = _form(rig, begin_ns, *CORRECTED)
    two_looks = Form(failure=corrected.failure) if corrected.failure else _form(rig, begin_ns, *CORRECTED)
    return row | {"closed_loop": closed_loop, "corrected": corrected, "two_looks": two_looks}


def _form(rig: LockstepRig, begin_ns: int, kind: str, body: dict[str, Any]) -> Form:
    """An operation, and the time to the target since ``begin_ns``."""
    try:
        result = operate(rig, kind, body)
    except LongreachError as error:
        return Form(failure=f"{error.cause}: {error}")
    error_mm = true_error_mm(rig)
    form = Form(
        true_mm=xyz(error_mm),
        worst_mm=float(np.abs(error_mm[:2]).max()),
        time_s=1e-9 * (rig.world.time_ns - begin_ns),
    )
    if kind != "looking-and-moving":
        return form
    return form._replace(loop_s=result.approach.time_s, missed=result.approach.missed)


Served = Finished[DrawnSettings, ServoingRow]


def servoing_table(done: Served) -> list[Table]:
    """Each form: how many end under the limit, errors and times; and what refused or stopped it."""
    shown = []
    for name, words in WORDS.items():
        worst = worst_mm(done.rows, name)
        times = np.array([getattr(row, name).time_s for row in done.rows])
        figures = [quantile(worst, 50), quantile(worst, 95), quantile(times, 50), quantile(times, 95)]
        within = f"{np.count_nonzero(worst <= LIMIT_MM)} of {len(done.rows)}"
        shown.append([words, within, *(f"{figure:.2f}" for figure in figures)])
    headings = ["form", "under 2 mm", "median mm", "95 % mm", "time to rest s", "95 % s"]
    return [
        table("worse of true |x| and |y|", headings, shown),
        *stops_table("refused or stopped", "form", done.rows, WORDS),
    ]


def servoing_verdict(done: Served) -> list[Check]:
    """Whether the closed loop ended under 2 mm in enough runs; one that failed counts as not."""
    reached = share(worst_mm(done.rows, "closed_loop"), LIMIT_MM)
    return [at_least(f"looking and moving: share under {LIMIT_MM:g} mm", reached, WANTED_SHARE)]


VISUAL_SERVOING = Experiment(
    name="visual-servoing",
    title="Visual servoing beside look-then-move.",
    settings=DrawnSettings,
    row=ServoingRow,
    tasks=positioning_tasks,
    run=one_run,
    table=servoing_table,
    verdict=servoing_verdict,
    runs=60,
)
