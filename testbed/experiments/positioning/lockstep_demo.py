"""Many demonstrations in lockstep: how many end under 10 and under 5 mm, after one look and after more."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer
from rich.table import Table

from foundation.configuration import merged, parse_overrides
from plant_emulator.shell.installed_faults import installed_faults
from testbed.campaigns.campaign import CampaignRequest, Task
from testbed.campaigns.experiment import Check, Experiment, Finished, seeds
from testbed.campaigns.options import Assignments, Scenario
from testbed.campaigns.provenance import sources_hash
from testbed.campaigns.typed_rows import XYZ
from testbed.demonstration.lockstep import run_lockstep
from testbed.reporting import outcome as outcomes
from testbed.reporting.console import Columns, bars, listed, table
from testbed.reporting.outcome import Outcome
from testbed.reporting.presentation import Choice
from testbed.scenarios.named_requests import fault_orders, named_request
from testbed.scenarios.scenario import load_scenario
from testbed.scenarios.settings import load_settings
from vision_pc.shell.installed_programs import installed_programs

LIMITS_MM = (10.0, 5.0)
WANTED_SHARE = 0.9  # of the runs, under LIMITS_MM[0] after the last look: 18 of 20


def row_of(outcome: Outcome, world: dict[str, Any]) -> dict[str, Any]:
    """One run as a flat row: what was drawn, true errors after each look, and what stopped it."""
    row: dict[str, Any] = {"seed": outcome.seed}
    row["payload_kg"] = world.get("plant", {}).get("payload", {}).get("mass_kg", float("nan"))
    mount = world.get("scene", {}).get("mount", {}).get("rotation_deg", (0.0, 0.0, 0.0))
    row["mount_deg"] = float(np.linalg.norm(mount))
    for number in range(1, outcome.looks + 1):
        stage = outcome.after_look(number)
        p_mm = np.full(3, np.nan) if stage is None else 1e3 * stage.true.p_m
        image_mm = np.full(3, np.nan) if stage is None or stage.image is None else 1e3 * stage.image.p_m
        for axis, true, seen in zip("xyz", p_mm, image_mm, strict=True):
            row[f"look{number}_true_{axis}_mm"] = float(true)
            row[f"look{number}_image_{axis}_mm"] = float(seen)
        row[f"look{number}_worst_mm"] = float(np.abs(p_mm[:2]).max())
    row["failure"] = outcome.details.get("failure", "")
    row["simulated_s"] = outcome.simulated_s
    row["wall_s"] = outcome.wall_s
    row["event_log_sha256"] = outcome.details["event_log_sha256"]
    return row


def one_run(config_dir: Path, task: dict[str, Any]) -> dict[str, Any]:
    """The row of one seeded demonstration; ``task`` names its scenario, seed, looks and assignments."""
    scenario, seed = task["scenario"], task["seed"]
    world = merged(load_scenario(config_dir, scenario).world(seed), parse_overrides(task["assignments"]))
    programs = tuple(named_request(word) for word in task.get("program", ()))
    choice = Choice(scenario, seed, task["looks"], False, programs, fault_orders(task.get("fault", ())))
    with bars(quiet=True) as shown:
        done = run_lockstep(config_dir, world, choice, shown)
    return row_of(done.outcome, world)


class DemoSettings(NamedTuple):
    """What is demonstrated."""

    looks: Annotated[int, typer.Option(min=1, max=9, help="How many look-then-moves.")] = 2
    scenario: Scenario = "standard"
    assignments: Assignments = None
    program: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME[,KEY=VALUE]",
            help="Run this program, of ours or of an installed package, in place of calibration and looks; "
            "repeatable.",
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


class LookErrors(NamedTuple):
    """True errors after one look."""

    true_mm: XYZ
    worst_mm: float


class DemoRow(NamedTuple):
    """One demonstration; after a look that was not reached the errors are NaN."""

    seed: int
    payload_kg: float
    mount_deg: float
    look1: LookErrors
    look2: LookErrors
    look3: LookErrors
    look4: LookErrors
    look5: LookErrors
    look6: LookErrors
    look7: LookErrors
    look8: LookErrors
    look9: LookErrors
    failure: str
    cpu_s: float

    def after(self, look: int) -> LookErrors:
        """The errors after look 1, 2, …"""
        found: LookErrors = getattr(self, f"look{look}")
        return found


class LookCount(NamedTuple):
    """How many runs ended with true x and y under each limit after so many looks; a failure is none."""

    looks: int
    runs: int
    under_10_mm: int
    under_5_mm: int
    median_mm: float
    p95_mm: float
    not_reached: int


Demonstrated = Finished[DemoSettings, DemoRow]


def counts(rows: Sequence[DemoRow], looks: int) -> list[LookCount]:
    """One for each number of looks."""
    made = []
    for number in range(1, looks + 1):
        worst = np.array([row.after(number).worst_mm for row in rows])
        finite = worst[np.isfinite(worst)]
        made.append(
            LookCount(
                number,
                len(rows),
                int(np.count_nonzero(worst < LIMITS_MM[0])),
                int(np.count_nonzero(worst < LIMITS_MM[1])),
                float(np.percentile(finite, 50)) if len(finite) else float("nan"),
                float(np.percentile(finite, 95)) if len(finite) else float("nan"),
                int(np.count_nonzero(~np.isfinite(worst))),
            )
        )
    return made


def demo_tasks(request: CampaignRequest, settings: DemoSettings) -> list[Task]:
    """One task a seed. Raises ConfigurationError when the first world's configuration is wrong."""
    world = load_scenario(request.config_dir, settings.scenario).world(request.seed)
    assignments = settings.assignments or []
    load_settings(request.config_dir, merged(world, parse_overrides(assignments)))
    asked = {"scenario": settings.scenario, "looks": settings.ends, "assignments": assignments}
    asked |= _own(settings)
    return [{"key": f"seed-{seed}", "seed": seed} | asked for seed in seeds(request)]


def _own(settings: DemoSettings) -> Task:
    """What is run and broken, with the sources of whatever installed packages add to that."""
    words = {"program": settings.program or [], "fault": settings.fault or []}
    fault_orders(words["fault"])
    names = {named_request(word).name for some in words.values() for word in some}
    own = [(name, program.run.__module__) for name, program in installed_programs().found.items()]
    own += [(name, kind.__module__) for name, kind in installed_faults().found.items()]
    sources = {f"sources of {name}": sources_hash(module) for name, module in own if name in names}
    return {name: some for name, some in words.items() if some} | sources


def demo_table(done: Demonstrated) -> list[Table]:
    """Every run's true errors, and the counts by looks."""
    looks = range(1, done.settings.ends + 1)
    headings = [
        "seed",
        "payload kg",
        "mount °",
        *(f"look {number} {axis}" for number in looks for axis in "xyz"),
    ]
    shown = [
        [
            row.seed,
            f"{row.payload_kg:.0f}",
            f"{row.mount_deg:.1f}",
            *(f"{value:+.1f}" for number in looks for value in row.after(number).true_mm),
            row.failure,
        ]
        for row in done.rows
    ]
    columns: Columns = {
        "looks": "{looks}",
        "under 10 mm": "{under_10_mm}",
        "under 5 mm": "{under_5_mm}",
        "of": "{runs}",
        "median mm": "{median_mm:.2f}",
        "95 % mm": "{p95_mm:.2f}",
        "not reached": "{not_reached}",
    }
    return [
        table("true errors, mm, camera axes", [*headings, "stopped by"], shown),
        listed("worse of |x| and |y|, true", columns, counts(done.rows, done.settings.ends)),
    ]


def demo_verdict(done: Demonstrated) -> list[Check]:
    """Whether enough runs ended under the first limit after the last look."""
    last = counts(done.rows, done.settings.ends)[-1]
    wanted = WANTED_SHARE * last.runs
    return [
        Check(
            f"runs under {LIMITS_MM[0]:g} mm after look {last.looks}",
            f"{last.under_10_mm} of {last.runs}",
            f"≥ {wanted:g}",
            last.under_10_mm >= wanted,
        )
    ]


def demo_figures(done: Demonstrated) -> dict[str, Any]:
    """The counts."""
    return {
        "scenario": done.settings.scenario,
        "limit_mm": 1e3 * outcomes.LIMIT_M,
        "counts": counts(done.rows, done.settings.ends),
    }


LOCKSTEP_DEMO = Experiment(
    name="lockstep-demo",
    title="Demonstrations in lockstep over many seeds.",
    settings=DemoSettings,
    row=DemoRow,
    tasks=demo_tasks,
    run=one_run,
    table=demo_table,
    verdict=demo_verdict,
    figures=demo_figures,
    runs=20,
    eyes="rendered pictures",
)
