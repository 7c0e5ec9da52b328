"""`longreach experiment positioning --method programs`: any programs over drawn machines."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import typer
from rich.table import Table

from foundation.configuration import merged, parse_overrides
from laboratory.campaigns.campaign import CampaignRequest
from laboratory.campaigns.experiment import Check, Experiment, Finished, at_least, seeds
from laboratory.campaigns.rows import Row
from laboratory.campaigns.workforce import Task
from laboratory.experiments.positioning.results import quantile, share
from testbed.cli.options import Scenario
from testbed.cli.options import Settings as Assignments
from testbed.demonstration.runs import run_lockstep
from testbed.reporting.console import bars, table
from testbed.reporting.outcome import Outcome, Stage
from testbed.reporting.run_directory import Choice
from testbed.scenarios.scenario import fault_orders, load_scenario, load_settings, named_request
from vision_pc.config.choices import PositioningMethod
from vision_pc.core.se3 import Array

LIMITS_MM = (10.0, 5.0)
WANTED_SHARE = 0.9  # of the runs, under LIMITS_MM[0] after the last look


def row_of(outcome: Outcome) -> Row:
    """One run as a flat row: true errors after each look, and what stopped it."""
    stages = [outcome.after_look(number) for number in range(1, outcome.looks + 1)]
    reached = [stage for stage in stages if stage is not None]
    return {
        "true_mm": [(1e3 * stage.true.p_m).tolist() for stage in reached],
        "nees": [_nees(stage) for stage in reached],
        "failure": outcome.details.get("failure", ""),
        "simulated_s": outcome.simulated_s,
        "event_log_sha256": outcome.details["event_log_sha256"],
    }


def _nees(stage: Stage) -> float | None:
    """Error² over predicted variance of x and y, a half of it; None where no step was made."""
    if (end := stage.predicted) is None:
        return None
    mean, std = (np.array([end[name][axis] for axis in "xy"]) for name in ("mean_mm", "std_mm"))
    off = (1e3 * stage.true.p_m[:2] - mean) / std
    return float(off @ np.linalg.solve(np.eye(2) + end["correlation_xy"] * (1.0 - np.eye(2)), off)) / 2.0


def one_run(config_dir: Path, task: Task) -> Row:
    """The row of one seeded demonstration; ``task`` names its scenario, seed, looks and assignments."""
    scenario, seed = task["scenario"], task["seed"]
    world = merged(load_scenario(config_dir, scenario).world(seed), parse_overrides(task["assignments"]))
    programs = tuple(named_request(word) for word in task.get("program", ()))
    faults = fault_orders(task.get("fault", ()))
    choice = Choice(scenario, seed, task["looks"], programs, faults, PositioningMethod(task["form"]))
    with bars(quiet=True) as shown:
        return row_of(run_lockstep(config_dir, world, choice, shown)[0])


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


def programs_tasks(request: CampaignRequest, settings: ProgramsSettings) -> list[Task]:
    """One task a seed. Raises ConfigurationError when the first world's configuration is wrong."""
    world = load_scenario(request.config_dir, settings.scenario).world(request.seed)
    assignments = settings.assignments or []
    load_settings(request.config_dir, merged(world, parse_overrides(assignments)))
    chosen: Task = {"scenario": settings.scenario, "looks": settings.ends, "assignments": assignments,
                    "form": str(settings.form)}  # fmt: skip
    fault_orders(settings.fault or [])
    chosen |= {name: some for name in ("program", "fault") if (some := getattr(settings, name))}
    return [{"key": f"seed-{seed}", "seed": seed} | chosen for seed in seeds(request)]


def worst_after(rows: Sequence[Row], look: int) -> Array:
    """The greater of |x| and |y| (n,) after look 1, 2, …, mm; infinite where a run did not get there."""
    errors_mm = [row.get("true_mm") or [] for row in rows]
    return np.array([np.abs(e[look - 1][:2]).max() if len(e) >= look else np.inf for e in errors_mm])


def programs_tables(done: Finished[ProgramsSettings]) -> list[Table]:
    """How many runs ended under each limit after each look, and their errors."""
    cells = []
    for look in range(1, done.settings.ends + 1):
        worst = worst_after(done.rows, look)
        under = [int((worst < limit).sum()) for limit in LIMITS_MM]
        statistics = [f"{quantile(worst, percent):.2f}" for percent in (50, 95)]
        drawn = [row["nees"][look - 1] for row in done.rows if len(row.get("nees") or ()) >= look]
        moved = [nees for nees in drawn if nees is not None]
        honest = f"{np.mean(moved):.2f} of {len(moved)}" if moved else "–"
        cells.append([look, len(worst), *under, *statistics, honest, int(np.isinf(worst).sum())])
    heads = ["look", "runs", *(f"under {limit:g} mm" for limit in LIMITS_MM), "median mm", "95 % mm"]
    heads += ["error² over predicted variance", "not reached"]
    return [table("worse of true |x| and |y|", heads, cells)]


def programs_verdict(done: Finished[ProgramsSettings]) -> list[Check]:
    """Whether enough runs ended under the first limit after the last look."""
    last = done.settings.ends
    found = share(worst_after(done.rows, last), LIMITS_MM[0])
    return [at_least(f"share under {LIMITS_MM[0]:g} mm after look {last}", found, WANTED_SHARE)]


PROGRAMS = Experiment(
    name="programs",
    settings=ProgramsSettings,
    tasks=programs_tasks,
    run=one_run,
    tables=programs_tables,
    verdict=programs_verdict,
    runs=20,
    eyes="rendered pictures",
)
