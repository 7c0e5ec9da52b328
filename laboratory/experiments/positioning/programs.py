"""`longreach experiment positioning`: any programs, or the closed loop, over drawn machines."""

import copy
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer
from rich.table import Table

from foundation.configuration import merged, parse_overrides
from laboratory.campaigns.campaign import CampaignRequest
from laboratory.campaigns.experiment import (
    Assignments,
    Check,
    Experiment,
    Finished,
    Scenario,
    at_least,
    seeds,
)
from laboratory.campaigns.rows import UNKNOWN, XYZ, xyz
from laboratory.campaigns.workforce import Task
from laboratory.experiments.positioning.corrected import DrawnSettings, positioning_tasks, stops_table
from laboratory.experiments.positioning.corrected_run import drawn_by, operate, prepared, true_error_mm
from laboratory.experiments.positioning.results import quantile, share, worst_mm
from protocol.errors import LongreachError
from testbed.demonstration.runs import run_lockstep
from testbed.lockstep.rig import LockstepRig
from testbed.reporting.console import bars, table
from testbed.reporting.outcome import Outcome, Stage
from testbed.reporting.run_directory import Choice
from testbed.scenarios.scenario import fault_orders, load_scenario, load_settings, named_request
from vision_pc.config.choices import PositioningMethod
from vision_pc.core.se3 import Array

LIMIT_MM = 2.0
LOOP_SHARE = 0.95
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


def one_loop(config_dir: Path, task: Task) -> dict[str, Any]:
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
    return [at_least(f"looking and moving: share under {LIMIT_MM:g} mm", reached, LOOP_SHARE)]


VISUAL_SERVOING = Experiment(
    name="visual-servoing",
    title="Visual servoing beside look-then-move.",
    settings=DrawnSettings,
    row=ServoingRow,
    tasks=positioning_tasks,
    run=one_loop,
    table=servoing_table,
    verdict=servoing_verdict,
    runs=60,
)


LIMITS_MM = (10.0, 5.0)
WANTED_SHARE = 0.9  # of the runs, under LIMITS_MM[0] after the last look


def row_of(outcome: Outcome, world: dict[str, Any]) -> dict[str, Any]:
    """One run as a flat row: what was drawn, true errors after each look, and what stopped it."""
    stages = [outcome.after_look(number) for number in range(1, outcome.looks + 1)]
    true_mm = [(1e3 * stage.true.p_m).tolist() for stage in stages if stage is not None]
    nees = [_nees(stage) for stage in stages if stage is not None]
    mount = world.get("scene", {}).get("mount", {}).get("rotation_deg", (0.0, 0.0, 0.0))
    return {
        "seed": outcome.seed,
        "payload_kg": world.get("plant", {}).get("payload", {}).get("mass_kg", math.nan),
        "mount_deg": float(np.linalg.norm(mount)),
        "true_mm": true_mm,
        "nees": nees,
        "failure": outcome.details.get("failure", ""),
        "simulated_s": outcome.simulated_s,
        "event_log_sha256": outcome.details["event_log_sha256"],
    }


def _nees(stage: Stage) -> float | None:
    """Error² over predicted variance of x and y, a half of it; None where no step was made."""
    if stage.told is None:
        return None
    off = stage.true.p_m[:2] - stage.told.mean_m[:2]
    return float(off @ np.linalg.solve(stage.told.covariance[:2, :2], off)) / 2.0


def one_run(config_dir: Path, task: dict[str, Any]) -> dict[str, Any]:
    """The row of one seeded demonstration; ``task`` names its scenario, seed, looks and assignments."""
    scenario, seed = task["scenario"], task["seed"]
    world = merged(load_scenario(config_dir, scenario).world(seed), parse_overrides(task["assignments"]))
    programs = tuple(named_request(word) for word in task.get("program", ()))
    faults = fault_orders(task.get("fault", ()))
    choice = Choice(scenario, seed, task["looks"], False, programs, faults, PositioningMethod(task["form"]))
    with bars(quiet=True) as shown:
        done = run_lockstep(config_dir, world, choice, shown)
    return row_of(done.outcome, world)


class ProgramsSettings(NamedTuple):
    """What is run."""

    looks: Annotated[int, typer.Option(min=1, max=9, help="How many look-then-moves.")] = 2
    form: Annotated[PositioningMethod, typer.Option(help="As `longreach demo --method`.")] = (
        PositioningMethod.PAPER
    )
    scenario: Scenario = "standard"
    assignments: Assignments = None
    program: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME[,KEY=VALUE]",
            help="Run this program in place of calibration and looks; repeatable.",
        ),
    ] = None
    fault: Annotated[
        list[str] | None,
        typer.Option(metavar="KIND[,KEY=VALUE]", help="Break this at the start; repeatable."),
    ] = None

    @property
    def ends(self) -> int:
        """How many ends of a run count: one of programs, else one a look."""
        return 1 if self.program else self.looks


class ProgramsRow(NamedTuple):
    """One run; ``true_mm``: the true error after each look that was reached."""

    seed: int
    payload_kg: float
    mount_deg: float
    true_mm: list[list[float]]
    nees: list[float | None]
    failure: str
    cpu_s: float

    def worst_mm(self, look: int) -> float:
        """The greater of |x| and |y| after look 1, 2, …; NaN where the run did not get there."""
        reached = len(self.true_mm or ()) >= look
        return float(np.abs(self.true_mm[look - 1][:2]).max()) if reached else math.nan


Ran = Finished[ProgramsSettings, ProgramsRow]


def programs_tasks(request: CampaignRequest, settings: ProgramsSettings) -> list[Task]:
    """One task a seed. Raises ConfigurationError when the first world's configuration is wrong."""
    world = load_scenario(request.config_dir, settings.scenario).world(request.seed)
    assignments = settings.assignments or []
    load_settings(request.config_dir, merged(world, parse_overrides(assignments)))
    asked = {"scenario": settings.scenario, "looks": settings.ends, "assignments": assignments}
    asked |= {"form": str(settings.form)}
    asked |= _own(settings)
    return [{"key": f"seed-{seed}", "seed": seed} | asked for seed in seeds(request)]


def _own(settings: ProgramsSettings) -> Task:
    """What is run and broken."""
    words = {"program": settings.program or [], "fault": settings.fault or []}
    fault_orders(words["fault"])
    return {name: some for name, some in words.items() if some}


def worst_after(rows: Sequence[ProgramsRow], look: int) -> Array:
    """The greater of |x| and |y| (n,) after a look, mm; infinite where a run did not get there."""
    worst: Array = np.nan_to_num(np.array([row.worst_mm(look) for row in rows]), nan=np.inf)
    return worst


def programs_table(done: Ran) -> list[Table]:
    """How many runs ended under each limit after each look, and their errors."""
    cells = []
    for look in range(1, done.settings.ends + 1):
        worst = worst_after(done.rows, look)
        under = [int((worst < limit).sum()) for limit in LIMITS_MM]
        figures = [f"{quantile(worst, percent):.2f}" for percent in (50, 95)]
        drawn = [row.nees[look - 1] for row in done.rows if len(row.nees or ()) >= look]
        moved = [nees for nees in drawn if nees is not None]
        honest = f"{np.mean(moved):.2f} of {len(moved)}" if moved else "–"
        cells.append([look, len(worst), *under, *figures, honest, int(np.isinf(worst).sum())])
    heads = ["look", "runs", *(f"under {limit:g} mm" for limit in LIMITS_MM), "median mm", "95 % mm"]
    heads += ["error² over predicted variance", "not reached"]
    return [table("worse of true |x| and |y|", heads, cells)]


def programs_verdict(done: Ran) -> list[Check]:
    """Whether enough runs ended under the first limit after the last look."""
    last = done.settings.ends
    found = share(worst_after(done.rows, last), LIMITS_MM[0])
    return [at_least(f"share under {LIMITS_MM[0]:g} mm after look {last}", found, WANTED_SHARE)]


PROGRAMS = Experiment(
    name="programs",
    title="Demonstrations in lockstep over many seeds.",
    settings=ProgramsSettings,
    row=ProgramsRow,
    tasks=programs_tasks,
    run=one_run,
    table=programs_table,
    verdict=programs_verdict,
    runs=20,
    eyes="rendered pictures",
)
