"""`longreach experiment changed-machine`: one thing of the machine changed at a time, and nobody is told.

The first row is the lab as it is. A method that knows its machine by heart shows here: errors grow, and the
errors over the σ told before moving grow with them.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer
from rich.table import Table

from testbed.campaigns.campaign import CampaignRequest, Task
from testbed.campaigns.experiment import Check, Experiment, Finished, at_least, at_most, seeds
from testbed.campaigns.options import Adapting, Assignments, ChosenEyes, Commissioned, EyesKind
from testbed.campaigns.typed_rows import flat
from testbed.experiments.positioning.corrected_figures import (
    LIMIT_MM,
    quantile,
    share,
    told,
    worst_mm,
    worst_ratio,
)
from testbed.experiments.positioning.corrected_run import PositioningRow, one_run
from testbed.experiments.positioning.told import silent_misses
from testbed.experiments.positioning.worlds import ARMS, WorldName
from testbed.reporting.console import table

_MOST_MEDIAN_MM = 1.5
_MOST_RATIO = 3.0

_PLAY = "plant.errors.backlash.half_width_mrad"
_SOFT = (
    "plant.flexibility.boom={vertical_ei_n_m2: 1.67e6, lateral_ei_n_m2: 1.67e6}",
    "plant.flexibility.arm={vertical_ei_n_m2: 4.67e5, lateral_ei_n_m2: 4.67e5}",
)
_RUB_LINEAR = "{coulomb_n: 6000.0, static_n: 7500.0, viscous_n_s_m: 22500.0}"
_RUB_TURNING = "{coulomb_nm: 300.0, static_nm: 375.0, viscous_nm_s_rad: 1200.0}"
_RUBBING = (
    f"plant.actuators.lift.cylinder.friction={_RUB_LINEAR}",
    f"plant.actuators.tilt.cylinder.friction={_RUB_LINEAR}",
    f"plant.actuators.slew.rotary.friction={_RUB_TURNING}",
)
_DOUBLED = f"{_PLAY}=[0.6, 0.1, 0.1, 0.2, 0.2, 0.2]"
_SHORT = "scene.camera.baseline_m=0.11928"
_HUNG = (
    "scene.object_of_interest.markers=["
    + ", ".join(
        f"{{marker_id: {number}, side_m: 0.12, quiet_zone_m: 0.02, centre_m: {centre}, misplaced_m: {off}, "
        f"print_scale_error: {scale}}}"
        for number, centre, off, scale in (
            (1, "[-0.20, 0.0]", "[0.001, -0.001, 0.001]", 0.0008),
            (2, "[0.20, 0.0]", "[0.001, 0.001, -0.001]", -0.0005),
            (3, "[0.0, 0.20]", "[-0.001, 0.001, 0.001]", 0.0004),
        )
    )
    + "]"
)
_ASIDE = "plant.payload.centre_m=[0.0, 0.2, -0.2]"
_LENS = "scene.camera.lens={k1: 0.003, fx_px: 531.1, fy_px: 531.1}"
_PRINT = "scene.tool_marker.print_scale_error=0.003"


class ChangedMachine(NamedTuple):
    """A change of the lab's machine in words, and what is set; nothing of it is told to anybody."""

    words: str
    assignments: tuple[str, ...] = ()


CHANGES = {
    "nothing": ChangedMachine("nothing"),
    "deadband_0.75": ChangedMachine(
        "valve deadband 0.5 → 0.75 % of the spool", ("plant.valves.deadband=0.0075",)
    ),
    "deadband_1": ChangedMachine("… 1 %", ("plant.valves.deadband=0.01",)),
    "deadband_2": ChangedMachine("… 2 %", ("plant.valves.deadband=0.02",)),
    "mobile": ChangedMachine("mobile valves", ("plant.valve_set=mobile",)),
    "several": ChangedMachine(
        "several at once: deadband 1 %, play ×2, friction ×1.5, lens, print",
        ("plant.valves.deadband=0.01", _DOUBLED, *_RUBBING, _LENS, _PRINT),
    ),
    "lenses": ChangedMachine(
        "two eyes with different lenses",
        ("scene.camera.lens_difference={fx_px: 0.27, fy_px: 0.27, k1: 0.0015, p1: -0.0002, p2: 0.0002}",),
    ),
    "lift_tilt_play": ChangedMachine(
        "lift and tilt with 0.3 mrad of play", (f"{_PLAY}=[0.3, 0.3, 0.3, 0.1, 0.1, 0.1]",)
    ),
    "loose_slew": ChangedMachine(
        "the slew loose on the load side", ("plant.errors.loose_slew.enabled=true",)
    ),
    "disparity": ChangedMachine(
        "calibration off by 3.5 px of disparity, 1 px of rows",
        ("scene.camera.rectification={disparity_px: 3.5, vertical_px: 1.0}",),
    ),
    "all_but_valves": ChangedMachine(
        "play ×2, friction ×1.5, bending ×1.5, baseline 0.6 %, markers ±1 mm, payload off the axis",
        (_DOUBLED, *_RUBBING, *_SOFT, _SHORT, _HUNG, _ASIDE),
    ),
}
"""Name → change; numbers are those of the 4 m arm."""


class ChangedSettings(NamedTuple):
    """Which changes, seen how, with what set besides (such as a commissioning file)."""

    only: Annotated[list[str] | None, typer.Option(help="Only this change; repeatable.")] = None
    eyes: ChosenEyes = EyesKind.MODEL
    assignments: Assignments = None
    adapting: Adapting = False
    commissioned: Commissioned = False


class ChangedRow(NamedTuple):
    """A run of best mode, and what was changed."""

    change: str
    run: PositioningRow
    failure: str
    cpu_s: float


Tried = Finished[ChangedSettings, ChangedRow]


def changed_tasks(request: CampaignRequest, settings: ChangedSettings) -> list[Task]:
    """The same seeds with every change. Raises BadParameter for a change that is not known."""
    if unknown := sorted(set(settings.only or ()) - set(CHANGES)):
        raise typer.BadParameter(f"no change '{unknown[0]}'; known: {', '.join(CHANGES)}")
    asked = {name: True for name in ("adapting", "commissioned") if getattr(settings, name)}
    return [
        {
            "key": f"{name}-{seed}",
            "change": name,
            "seed": seed,
            "arm": ARMS[0],
            "world": str(WorldName.LAB),
            "eyes": str(settings.eyes),
            "assignments": [*CHANGES[name].assignments, *(settings.assignments or ())],
        }
        | asked
        for name in settings.only or CHANGES
        for seed in seeds(request)
    ]


def changed_run(config_dir: Path, task: Task) -> dict[str, Any]:
    """The row of a best-mode run with one change, in columns that ``ChangedRow`` reads."""
    row = flat(one_run(config_dir, task))
    columns = {f"run_{name}": value for name, value in row.items()}
    return {"change": task["change"], "failure": row.get("failure", ""), **columns}


def _runs(done: Tried) -> dict[str, list[PositioningRow]]:
    """Change → its rows, in the order of the table."""
    names = [name for name in CHANGES if any(row.change == name for row in done.rows)]
    return {name: [row.run for row in done.rows if row.change == name] for name in names}


def changed_table(done: Tried) -> list[Table]:
    """The errors after one look and two, a row a change, beside the σ told before moving."""
    headings = ["what was changed, told to nobody", "runs", "one look mm", "up to", "within 5 mm"]
    headings += ["error / told σ", "silent", "two looks mm", "up to", "stopped"]
    return [table("worse of true |x| and |y|, lab world, 4 m arm", headings, map(_cells, *_named(done)))]


def _named(done: Tried) -> tuple[Sequence[str], Sequence[list[PositioningRow]]]:
    runs = _runs(done)
    return [CHANGES[name].words for name in runs], list(runs.values())


def _cells(words: str, rows: list[PositioningRow]) -> list[str]:
    one, two = worst_mm(rows, "look1"), worst_mm(rows, "look2")
    stopped = sum(bool(row.failure or row.look1.failure or row.look2.failure) for row in rows)
    return [
        words,
        str(len(rows)),
        *(f"{quantile(one, q):.2f}" for q in (50, 100)),
        f"{share(one, LIMIT_MM):.0%}",
        f"{worst_ratio(rows, 'look1'):.1f}",
        str(silent_misses(told(rows, "look1", "before"), one)),
        *(f"{quantile(two, q):.2f}" for q in (50, 100)),
        str(stopped),
    ]


def changed_verdict(done: Tried) -> list[Check]:
    """Of every row: all within 5 mm after one look, the median, and the errors over the σ told."""
    checks = []
    for name, rows in _runs(done).items():
        one = worst_mm(rows, "look1")
        checks += [
            at_least(f"{name}: share within 5 mm", share(one, LIMIT_MM), 1.0),
            at_most(f"{name}: median", quantile(one, 50), _MOST_MEDIAN_MM, "mm"),
            at_most(f"{name}: error over told σ, at most", worst_ratio(rows, "look1"), _MOST_RATIO),
        ]
    return checks


CHANGED_MACHINE = Experiment(
    name="changed-machine",
    title="One thing of the machine changed at a time, told to nobody.",
    settings=ChangedSettings,
    row=ChangedRow,
    tasks=changed_tasks,
    run=changed_run,
    table=changed_table,
    verdict=changed_verdict,
    runs=3,
    seed=41_001,
    world="lab, with one change",
)
