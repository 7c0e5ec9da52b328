"""How long joints take into 0.3 mrad and stay there, by what is known of their valves' deadbands."""

import math
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import typer
from rich.table import Table

from nominal_arm.description import JOINT_NAMES
from testbed.campaigns.campaign import CampaignRequest, Task
from testbed.campaigns.experiment import Check, Experiment, Finished, at_least, at_most
from testbed.experiments.positioning.worlds import ARMS
from testbed.experiments.resting.machines import (
    JSON,
    REAL,
    VALVE_SETS,
    WORLD,
    MachineKind,
    MachineKinds,
    arrived,
    broken_off,
    drawn_machine,
    left,
    machines,
    stepped,
)
from testbed.reporting.console import table

_INSIDE_RAD = 0.3e-3
_STAYS_S = 3.0  # inside at the end of the time, to count as having come in
LAWS = ("joint", "parking")


class SettleOptions(NamedTuple):
    """Shares of the deadbands that are known, and the time that the arm has."""

    known: Annotated[str, typer.Option("--known", help="Percent of each deadband, comma-separated.")] = (
        "80,100,120"
    )
    seconds: Annotated[float, typer.Option("--seconds", min=5.0, help="After the motion's end.")] = 20.0
    machines: MachineKinds = ",".join(VALVE_SETS)


class SettleRow(NamedTuple):
    """One motion's end. Times in s after it until a joint is inside 0.3 mrad for good, nan: never.

    ``rest_mrad``: rms of the joint that moves most about its mean, over the later half of the time.
    """

    failure: str
    seed: int
    machine: MachineKind
    known_percent: float
    slew_s: float
    lift_s: float
    tilt_s: float
    wrist1_s: float
    wrist2_s: float
    wrist3_s: float
    all_s: float
    end_mrad: float
    rest_mrad: float
    cpu_s: float


SettledRows = Finished[SettleOptions, SettleRow]


def settle_tasks(request: CampaignRequest, options: SettleOptions) -> list[Task]:
    """Every machine with each share known, with the joint law and with parking."""
    shares = [float(part) / 100.0 for part in options.known.split(",")]
    return [
        {
            "key": f"{task['seed']}-{law}-{100 * share:g}-{options.seconds:g}",
            **task,
            "law": law,
            "parks": law == "parking",
            "known": share,
            "seconds": options.seconds,
        }
        for task in machines(request.runs, request.seed, options.machines)
        for share in shares
        for law in LAWS
    ]


def settle(config_dir: Path, task: JSON) -> JSON:
    """The row of one motion's end. Raises MeasurementFailed with the controller's fault."""
    machine = drawn_machine(config_dir, task)
    loop = arrived(machine, task["seed"])
    errors = []
    for _ in range(round(task["seconds"] / loop.settings.cycle_s)):
        stepped(loop)
        errors.append(left(loop))
    outside = np.asarray(np.abs(errors) > _INSIDE_RAD)
    times = [came_in(column, loop.settings.cycle_s) for column in outside.T]
    return {
        "seed": task["seed"],
        "machine": MachineKind(task["arm"], task["valves"], task["law"], machine.mass_kg),
        "known_percent": 100.0 * task["known"],
        **{f"{name}_s": time for name, time in zip(JOINT_NAMES, times, strict=True)},
        "all_s": came_in(np.asarray(outside.any(axis=1)), loop.settings.cycle_s),
        "end_mrad": 1e3 * float(np.abs(errors[-1]).max()),
        "rest_mrad": 1e3 * float(np.std(errors[len(errors) // 2 :], axis=0).max()),
    }


def came_in(outside: np.ndarray, cycle_s: float) -> float:
    """When (s) a joint was ``outside`` for the last time, nan when that was within 3 s of the end."""
    last = int(np.flatnonzero(outside)[-1]) + 1 if outside.any() else 0
    return last * cycle_s if (len(outside) - last) * cycle_s >= _STAYS_S else math.nan


def settle_table(done: SettledRows) -> list[Table]:
    """By arm, valves, law and share known: median times of the joints, and how many arms came in."""
    lines = []
    for arm, valves, percent, law in _kinds(done):
        rows = _of(done, arm, valves, percent, law)
        times = np.array([[getattr(row, f"{name}_s") for name in JOINT_NAMES] for row in rows])
        came = np.array([row.all_s for row in rows])
        lines.append(
            (arm, valves, f"{percent:g}", law, len(rows), *(_median(column) for column in times.T),
             _median(came), int(np.isfinite(came).sum()), f"{max(row.end_mrad for row in rows):.2f}",
             f"{np.median([row.rest_mrad for row in rows]):.3f}", f"{max(row.rest_mrad for row in rows):.3f}")
        )  # fmt: skip
    headings = (
        "arm", "valves", "% known", "law", "runs", *(f"{name} s" for name in JOINT_NAMES), "all s",
        "came in", "left mrad, worst", "rms at rest mrad", "worst",
    )  # fmt: skip
    return [table("into 0.3 mrad for good, median; –: most never", headings, lines), *broken_off(done.rows)]


def _kinds(done: SettledRows) -> list[tuple[str, str, float, str]]:
    percents = sorted({row.known_percent for row in done.rows if not row.failure})
    kinds = [(a, v, p, law) for a in ARMS for v in (*VALVE_SETS, REAL) for p in percents for law in LAWS]
    return [kind for kind in kinds if _of(done, *kind)]


def _of(done: SettledRows, arm: str, valves: str, percent: float, law: str) -> list[SettleRow]:
    kind = (arm, valves, law, percent)
    return [row for row in done.rows if not row.failure and (*row.machine[:3], row.known_percent) == kind]


def _median(times: np.ndarray) -> str:
    """The median with those that never came in as the longest."""
    middle = float(np.median(np.where(np.isfinite(times), times, np.inf)))
    return f"{middle:.1f}" if math.isfinite(middle) else "–"


def settle_verdict(done: SettledRows) -> list[Check]:
    """With parking and the deadbands known, every arm comes into 0.3 mrad; the rest is for information."""
    checks = [at_most("runs that failed", float(sum(bool(row.failure) for row in done.rows)), 0.0)]
    for arm, valves, percent, law in _kinds(done):
        came = [math.isfinite(row.all_s) for row in _of(done, arm, valves, percent, law)]
        limit = 1.0 if law == "parking" and percent == 100.0 else None
        checks.append(
            at_least(f"share in position, {arm}, {valves}, {percent:g} %, {law}", float(np.mean(came)), limit)
        )
        moves = float(np.median([row.rest_mrad for row in _of(done, arm, valves, percent, law)]))
        checks.append(
            at_most(f"rms at rest, median, {arm}, {valves}, {percent:g} %, {law}", moves, None, "mrad")
        )
    return checks


SETTLE = Experiment(
    name="settle",
    title="Into 0.3 mrad and there for good.",
    settings=SettleOptions,
    row=SettleRow,
    tasks=settle_tasks,
    run=settle,
    table=settle_table,
    verdict=settle_verdict,
    runs=20,
    seed=43_001,
    world=WORLD,
    eyes="none: the encoders",
    workers=1,
)
