"""Arms left alone for ten minutes: whether the tool stays while SETTLED says so, and how far it moves."""

import math
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import typer
from rich.table import Table

from laboratory.campaigns.campaign import CampaignRequest
from laboratory.campaigns.experiment import Check, Experiment, Finished, at_least, at_most
from laboratory.campaigns.rows import Row, column
from laboratory.campaigns.workforce import Task
from laboratory.experiments.positioning.axes import JSON
from laboratory.experiments.robustness.resting_machines import (
    VALVE_SETS,
    WORLD,
    MachineKinds,
    arrived,
    drawn_machine,
    machines,
    stepped,
)
from protocol.reference_messages import FLAG_SETTLED
from testbed.lockstep.clock import ClosedLoop
from testbed.reporting.console import table

_WAIT_S = 60.0  # for the arm to settle; it is watched after that, settled or not
_SAMPLE_S = 0.05  # ten a swing of the slowest boom


class ParkingOptions(NamedTuple):
    """How long the arm is left alone, and whether the oil behind its valves cools."""

    minutes: Annotated[float, typer.Option("--minutes", min=0.1, help="At rest, once settled.")] = 10.0
    cooling: Annotated[bool, typer.Option("--cooling", help="Oil of 50 °C cools in air of 20 °C.")] = False
    machines: MachineKinds = ",".join(VALVE_SETS)


def parking_tasks(request: CampaignRequest, options: ParkingOptions) -> list[Task]:
    """One task a run, the kinds of machine in turn."""
    oil = "cooling" if options.cooling else "warm"
    own = {"minutes": options.minutes, "cooling": options.cooling}
    return [
        {"key": f"{task['seed']}-{oil}-{options.minutes:g}", **task, **own}
        for task in machines(request.runs, request.seed, options.machines)
    ]


def park_and_watch(config_dir: Path, task: JSON) -> JSON:
    """The row of one machine: ``settled_s`` after the motion's end, NaN if it never settled, and ``watched``.

    Raises MeasurementFailed with the controller's fault.
    """
    machine = drawn_machine(config_dir, task)
    loop = arrived(machine, task["seed"])
    settled_s = math.nan
    for cycles in range(round(_WAIT_S / loop.settings.cycle_s)):
        if loop.view.flags & FLAG_SETTLED:
            settled_s = cycles * loop.settings.cycle_s
            break
        stepped(loop)
    play = machine.settings.plant.errors.backlash
    unseen_mrad = 2.0 * play.half_width_mrad[0] if play.enabled else 0.0
    rested = watched(loop, round(60.0 * task["minutes"] / loop.settings.cycle_s), unseen_mrad)
    return {"mass_kg": machine.mass_kg, "settled_s": settled_s} | rested


def watched(loop: ClosedLoop, cycles: int, unseen_mrad: float = 0.0) -> JSON:
    """What ``cycles`` of rest do to the tool; positions are its true ones.

    ``moved_mm``: furthest from where the tool was when SETTLED was set, while it was; ``allowed_mm``: what
    SETTLED's tolerance is at the tool, and the play of the slew's encoder (``unseen_mrad``), in which nothing
    is seen to move. ``share``: of the time with SETTLED. ``unsettled``: joints, or the tool, that left when
    SETTLED went.
    """
    first = stood = loop.plant.truth().X_BT[:3, 3].copy()
    was_settled, moved, says_so = False, [0.0], list[float]()
    names, every = list[str](), round(_SAMPLE_S / loop.settings.cycle_s)
    for k in range(cycles):
        stepped(loop)
        assert loop.outputs is not None
        names += [event.cause for event in loop.outputs.events if event.name == "unsettled"]
        if k % every == 0:
            tool, says = loop.plant.truth().X_BT[:3, 3].copy(), bool(loop.view.flags & FLAG_SETTLED)
            stood = tool if says and not was_settled else stood
            was_settled = says
            says_so.append(float(says))
            moved.append(float(np.linalg.norm(tool - stood)) if says else 0.0)
    reach_m = float(np.linalg.norm(first))
    return {
        "moved_mm": 1e3 * max(moved),
        "allowed_mm": reach_m * (1e3 * loop.settings.servo.tolerance + unseen_mrad),
        "share": float(np.mean(says_so)),
        "unsettled": " ".join(names),
    }


def _kinds(done: Finished[ParkingOptions]) -> list[tuple[str, str, list[Row]]]:
    """Arm, set of valves and rows of every kind that was run and ended well."""
    kinds = dict.fromkeys((row["arm"], row["valves"]) for row in done.rows if not row["failure"])
    return [
        (*kind, [row for row in done.rows if (row["arm"], row["valves"]) == kind and not row["failure"]])
        for kind in sorted(kinds)
    ]


def parking_tables(done: Finished[ParkingOptions]) -> list[Table]:
    """By arm and set of valves: how long SETTLED was said, and millimetres moved."""
    lines = []
    for arm, valves, rows in _kinds(done):
        moved, settled = column(rows, "moved_mm"), column(rows, "settled_s")
        kept = "met" if np.all(moved <= column(rows, "allowed_mm")) else "NOT met"
        shares = f"{np.nanmedian(settled):.1f}", f"{column(rows, 'share').mean():.2f}"
        lines.append((arm, valves, len(rows), *shares, f"{np.median(moved):.2f}", f"{moved.max():.2f}", kept))
    headings = (
        "arm", "valves", "runs", "settled after s", "SETTLED", "moved in it mm, median", "worst",
        "promise",
    )  # fmt: skip
    oil = "oil that cools" if done.settings.cooling else "oil as warm as it is"
    title = f"{done.settings.minutes:g} minutes at rest, {oil}"
    return [table(title, headings, lines)]


def parking_verdict(done: Finished[ParkingOptions]) -> list[Check]:
    """The tool stays within what SETTLED says while SETTLED is set, in every run; all of them settle."""
    checks = [at_most("runs that failed", float(sum(bool(row["failure"]) for row in done.rows)), 0.0)]
    for arm, valves, rows in _kinds(done):
        settled = float(np.mean(np.isfinite(column(rows, "settled_s"))))
        share = float((column(rows, "moved_mm") / column(rows, "allowed_mm")).max())
        checks += [
            at_least(f"share that settled, {arm}, {valves}", settled, 1.0),
            at_most(f"moved while settled, of what is allowed, {arm}, {valves}", share, 1.0),
        ]
    return checks


PARKING = Experiment(
    name="parking",
    settings=ParkingOptions,
    tasks=parking_tasks,
    run=park_and_watch,
    tables=parking_tables,
    verdict=parking_verdict,
    runs=20,
    seed=43_001,
    world=WORLD,
    eyes="none: the tool's true place",
    workers=1,
)
