"""`longreach experiment hole-drives`: drawn machines and drill holes, one look each."""

import contextlib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from rich.table import Table
from typer import Option

from laboratory.campaigns.campaign import CampaignRequest
from laboratory.campaigns.experiment import (
    Adapting,
    Assignments,
    Check,
    Commissioned,
    Experiment,
    Finished,
    at_least,
    at_most,
    seeds,
)
from laboratory.campaigns.workforce import Task
from laboratory.experiments.positioning.corrected_run import operate, settings_of
from laboratory.experiments.positioning.results import LIMIT_MM, quantile, share
from laboratory.experiments.positioning.worlds import ARMS, WorldName
from plant_emulator.core.camera.wall.bores import hole_places
from protocol.errors import LongreachError, MeasurementFailed
from testbed.lockstep.clock import RunLog, run
from testbed.lockstep.rig import LockstepRig
from testbed.reporting.console import table
from testbed.scenarios.scenario import Settings
from vision_pc.core.se3 import Array
from vision_pc.core.targets.sighting import Click
from vision_pc.core.targets.target import TargetRefused

NAN = float("nan")
_INSIDE = 0.98
ASKED = 200  # machines whose share inside is asked for: of fewer no limit is called met
_MOST = 9
_STREAM = 0x686F6C65
_AVERAGED = 25  # truths at 50 Hz: half a second at rest
JSON = dict[str, Any]


class HoleDriveSettings(NamedTuple):
    """Which world and arm, and how many of the nine holes are driven to."""

    world: Annotated[WorldName, Option(help="What differs from machine to machine.")] = WorldName.LAB
    arm: Annotated[str, Option("--drawn-arm", help="Which arm the scenarios are drawn for.")] = ARMS[0]
    holes: Annotated[int, Option(min=1, max=_MOST, help="Holes in one visit, the middle one first.")] = 1
    assignments: Assignments = None
    adapting: Adapting = False
    commissioned: Commissioned = False


class HoleEnd(NamedTuple):
    """The tool at a hole: true error in camera axes, the probability told, arm's time for it, failure.

    ``known``: how the hole's place was known at the end, and how far odometry had carried it.
    """

    x_mm: float = NAN
    y_mm: float = NAN
    worst_mm: float = NAN
    told: float = NAN
    seconds: float = NAN
    known: str = ""
    carried_mm: float = NAN
    failure: str = ""


class HoleDriveRow(NamedTuple):
    """One machine and its holes, the first driven to first; those after the last wanted are empty."""

    seed: int
    world: str
    arm: str
    holes: int
    seen: int
    hole1: HoleEnd
    hole2: HoleEnd
    hole3: HoleEnd
    hole4: HoleEnd
    hole5: HoleEnd
    hole6: HoleEnd
    hole7: HoleEnd
    hole8: HoleEnd
    hole9: HoleEnd
    failure: str
    cpu_s: float

    @property
    def ends(self) -> list[HoleEnd]:
        """Of the holes that were wanted."""
        return [getattr(self, f"hole{number}") for number in range(1, int(self.holes or 0) + 1)]


Driven = Finished[HoleDriveSettings, HoleDriveRow]


def hole_drive_tasks(request: CampaignRequest, settings: HoleDriveSettings) -> list[Task]:
    """One task a seed."""
    world = str(settings.world)
    return [
        {
            "key": f"{world}-{settings.arm}-{settings.holes}-{seed}",
            "seed": seed,
            "world": world,
            "arm": settings.arm,
            "holes": settings.holes,
            "assignments": settings.assignments or [],
            **{name: True for name in ("adapting", "commissioned") if getattr(settings, name)},
        }
        for seed in seeds(request)
    ]


def hole_drive(config_dir: Path, task: JSON) -> JSON:
    """The row of one machine. Raises MeasurementFailed where it sees no hole."""
    settings = hole_scenario(config_dir, task)
    rig = LockstepRig(settings, task["seed"], RunLog())
    rig.command("enable")
    places = hole_places(settings.scene.wall)
    row = {name: task[name] for name in ("seed", "world", "arm", "holes")}
    ends: dict[int, HoleEnd] = {}
    targets = _click_holes(rig, places, task["holes"], set())
    while targets:
        target, hole = targets.pop(0)
        ends[hole] = _drive_to_hole(rig, target, places[hole])
        targets += _click_holes(rig, places, task["holes"], {*ends, *(hole for _, hole in targets)})
    if not ends:
        raise MeasurementFailed("target.no_hole", "hole-drives: no hole is seen from the start pose")
    every = [*ends.values(), *[HoleEnd(failure="target.no_hole")] * (task["holes"] - len(ends))]
    return row | {"seen": len(ends)} | {f"hole{number}": end for number, end in enumerate(every, 1)}


def hole_scenario(config_dir: Path, task: JSON) -> Settings:
    """The scenario of a seed of `positioning`, nine holes where its markers would be.

    The arm reaches those that are driven to with the tool as it stands: a visit does not turn it first.
    """
    rng = np.random.default_rng([task["seed"], _STREAM])
    grid = [(0.0, 0.0)] + [
        (x, y) for y in (0.17, 0.0, -0.17) for x in (-0.2, 0.0, 0.2) if (x, y) != (0.0, 0.0)
    ]
    holes = [
        {
            "centre_m": (np.array(place) + rng.uniform(-0.02, 0.02, 2)).tolist(),
            "diameter_mm": 45.0,
            "depth_m": rng.uniform(0.2, 1.5),
            "broken": rng.uniform(0.0, 0.15),
            "seed": int(rng.integers(2**31)),
        }
        for place in grid
    ]
    scene = {"object_of_interest": {"markers": []}, "wall": {"drill_holes": holes}}
    wanted = np.array([[*hole["centre_m"], 0.0] for hole in holes[: task["holes"]]])
    return settings_of(config_dir, task, {"scene": scene}, wanted)


def _click_holes(rig: LockstepRig, places: Array, wanted: int, clicked: set[int]) -> list[tuple[str, int]]:
    """Targets and which holes they are: as many as are wanted and seen, the middle one first.

    None of the holes that were ``clicked``: one that the tool hid is clicked from where it no longer does.
    """
    if len(clicked) == wanted:
        return []
    truth = rig.world.plant.truth()
    true_C = places @ truth.R_CO.T + truth.p_CO
    seen = [(pixel, int(np.linalg.norm(true_C - p_C, axis=1).argmin())) for pixel, p_C in rig.holes()]
    new = sorted((hole for hole in seen if hole[1] not in clicked), key=lambda hole: hole[1])
    targets = []
    for pixel, hole in new[: wanted - len(clicked)]:
        with contextlib.suppress(TargetRefused):  # such as beside the tool: clicked later
            targets.append((run(rig.camera.target_at(Click("left", pixel, "hole"), None)).id, hole))
    return targets


def _drive_to_hole(rig: LockstepRig, target: str, place_O: Array) -> HoleEnd:
    """The end of one drive."""
    began_ns = rig.world.time_ns
    try:
        (visited,) = operate(rig, "visit", {"targets": [target]})
    except LongreachError as error:
        return HoleEnd(failure=f"{error.cause}: {error}")
    clearance = np.array([0.0, 0.0, rig.world.settings.vision.programs.positioning.clearance_m])
    errors = [
        truth.p_CO + truth.R_CO @ place_O - truth.p_CM - clearance for truth in rig.world.truths[-_AVERAGED:]
    ]
    x, y, _ = 1e3 * np.mean(errors, axis=0)
    return HoleEnd(
        x_mm=float(x),
        y_mm=float(y),
        worst_mm=float(max(abs(x), abs(y))),
        told=visited.result.expected.inside,
        seconds=1e-9 * (rig.world.time_ns - began_ns),
        known=visited.known,
        carried_mm=1e3 * visited.way_m,
    )


def hole_drive_table(done: Driven) -> list[Table]:
    """By the number of the hole in its visit."""
    heads = ["hole", "drives", "within 5 mm", "worse of |x|, |y| mm: median", "95 %", "worst", "s a hole"]
    cells = []
    for number in range(done.settings.holes):
        ends = [end for row in done.rows if len(row.ends) > number for end in row.ends[number : number + 1]]
        cells.append([number + 1, len(ends), *_figures(ends)])
    every = [end for row in done.rows for end in row.ends]
    if done.settings.holes > 1:
        cells.append(["all", len(every), *_figures(every)])
    return [table("true error at drill holes, no marker on the wall, one look each", heads, cells)]


def _figures(ends: Sequence[HoleEnd]) -> list[str]:
    worst, seconds = (np.array([getattr(end, name) for end in ends]) for name in ("worst_mm", "seconds"))
    return [
        f"{share(worst, LIMIT_MM):.0%}",
        *(f"{quantile(worst, percent):.2f}" for percent in (50, 95, 100)),
        f"{quantile(seconds, 50):.0f}",
    ]


def hole_drive_verdict(done: Driven) -> list[Check]:
    """Of the first hole of each run, and of all. A run that failed is outside.

    What is asked is asked of the laboratory's machines, and of 200: fewer that are inside prove nothing yet.
    """
    first = np.array([row.ends[0].worst_mm if row.ends else NAN for row in done.rows])
    lab = done.settings.world is WorldName.LAB
    checks = [
        _within("one look to a hole", first, lab),
        at_most("one look to a hole: 95 %", quantile(first, 95), None, "mm"),
    ]
    if done.settings.holes > 1:
        every = np.array([end.worst_mm for row in done.rows for end in row.ends or [HoleEnd()]])
        seconds = np.array([end.seconds for row in done.rows for end in row.ends])
        checks += [
            _within("all holes of a visit", every, lab),
            at_most("arm's time a hole: median", quantile(seconds, 50), None, "s"),
        ]
    return checks


def _within(what: str, worst: Array, judged: bool) -> Check:
    found = share(worst, LIMIT_MM)
    check = at_least(f"{what}, {len(worst)} driven to: share within 5 mm", found, _INSIDE if judged else None)
    few = len(worst) < ASKED
    return check._replace(
        asked=check.asked and f"{check.asked} of {ASKED}", met=None if few and check.met else check.met
    )


HOLE_DRIVES = Experiment(
    name="hole-drives",
    title="Drill holes driven to, no marker on the wall.",
    settings=HoleDriveSettings,
    row=HoleDriveRow,
    tasks=hole_drive_tasks,
    run=hole_drive,
    table=hole_drive_table,
    verdict=hole_drive_verdict,
    runs=200,
    seed=1,
    eyes="rendered pictures",
    workers=1,
)
