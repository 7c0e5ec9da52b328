"""Commissioning on drawn machines: what was found against what was drawn, and whether σ is honest."""

from itertools import product
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import typer
from rich.table import Table

from foundation.configuration import merged
from laboratory.campaigns.campaign import CampaignRequest
from laboratory.campaigns.experiment import Check, Experiment, Finished, at_least, at_most, inside, seeds
from laboratory.campaigns.rows import Row, column
from laboratory.campaigns.workforce import Task
from laboratory.experiments.positioning import axes, axes_of_sight
from laboratory.experiments.positioning.axes import JSON
from laboratory.experiments.positioning.own_commissioning import excited
from laboratory.experiments.positioning.results import chance_band
from laboratory.experiments.positioning.scenarios import draw
from laboratory.experiments.positioning.worlds import ARMS, WORLDS, WorldName
from nominal_arm.description import JOINT_NAMES
from plant_emulator.config.plant import PlantConfig
from plant_emulator.config.valves import JOINT_NAMES as VALVE_NAMES
from testbed.commissioning.findings import joint_findings
from testbed.commissioning.ramp_rows import Uncertain
from testbed.reporting.console import table
from testbed.scenarios.scenario import load_settings
from vision_pc.core.se3 import Array

_STREAM = 0x636F6D6D
_AXES = (axes.friction, axes.bending, axes.play, axes_of_sight.stamps)
_OF_REAL = (axes.oil, axes.supply, axes.rocking_base)  # of degraded machines, beside those
_SETS = ("servo", "mobile")
MINUTES_LIMIT = 15.0  # of arm time, for all six joints


def drawn_machine(config_dir: Path, seed: int) -> JSON:
    """Overrides of one machine: even seeds have servo valves, odd ones mobile valves; the arms in pairs.

    Every spool's four edges, loop, delay and bandwidth are drawn, and with them flow, friction, bending,
    play, oil, pump, a rocking base, what is left at the empty tool and how late pictures are stamped, over a
    scenario of the lab's (pose, camera's mount, geometry). The controller knows the kind of the valves alone.
    """
    rng = np.random.default_rng([seed, _STREAM])
    kind, arm = _SETS[seed % 2], ARMS[seed // 2 % 2]
    overrides = draw(config_dir, seed, arm, WORLDS[WorldName.LAB]).overrides  # a wall before the camera
    usual = load_settings(config_dir, overrides)
    valves = {name: _drawn_valve(rng, kind) for name in JOINT_NAMES}
    plates = {"name": kind, "pressure_compensated": kind == "mobile"}
    own = {
        "plant": {
            "valve_set": kind,
            "valves": {"joints": valves},
            "actuators": {
                name: {"rated_flow_l_min": actuator.rated_flow_l_min * rng.uniform(0.9, 1.1)}
                for name, actuator in usual.plant.actuators
            },
            "payload": {"mass_kg": rng.uniform(0.0, 10.0)},
        },
        "controller": {"valves": plates},
    }
    for axis in (*_AXES, *_OF_REAL):
        own = merged(own, axis.draw(rng, usual))
    return merged(overrides, own)


def _drawn_valve(rng: np.random.Generator, kind: str) -> JSON:
    """A servo valve with 0.3 to 3 % of deadband, a mobile one with 5 to 12 % and 2 to 7 % of hysteresis."""
    low, high = (0.003, 0.03) if kind == "servo" else (0.05, 0.12)
    supply = rng.uniform(low, high, 2)
    back = supply * rng.uniform(0.75, 1.25, 2)  # return edges open first, or last
    loop = rng.uniform(0.0, 0.1) * supply.min() if kind == "servo" else rng.uniform(0.02, 0.07)
    return {
        "deadband": {
            "supply_a": float(supply[0]),
            "return_b": float(back[0]),
            "supply_b": float(supply[1]),
            "return_a": float(back[1]),
        },
        "hysteresis": float(min(loop, supply.min())),
        "delay_ms": rng.uniform(0.5, 3.0) if kind == "servo" else rng.uniform(6.0, 20.0),
        "bandwidth_hz": rng.uniform(20.0, 50.0) if kind == "servo" else rng.uniform(4.0, 8.0),
    }


def true_edges(plant: PlantConfig, joint: int) -> tuple[Array, Array, float]:
    """Spools at which the supply edges (2,) and the return edges (2,) of a joint open, raising and lowering,
    and the width of its loop.
    """
    name = VALVE_NAMES[joint]
    valve = plant.valves.of(name, getattr(plant.actuators, name).rated_flow_l_min)
    supply_a, return_b, supply_b, return_a = valve.deadband
    return np.array([supply_a, supply_b]), np.array([return_b, return_a]), valve.hysteresis


def commission_joint(config_dir: Path, task: JSON) -> JSON:
    """The row of one joint of one machine; errors in per cent of the truth, ``z`` over σ.

    ``later``: in how many senses the return edge opens last. Raises MeasurementFailed with the cause that
    broke it off.
    """
    seed, joint = task["seed"], task["joint"]
    settings = load_settings(config_dir, drawn_machine(config_dir, seed))
    (recorded,), arm_s = excited(settings, [joint], seed)
    found = joint_findings(recorded, settings.controller.valves.pressure_compensated)
    supply, outlet, loop = true_edges(settings.plant, joint)
    # both edges of a sense must be open for oil to pass, unless the load runs ahead: then the outlet's alone
    by_outlet = [found.raising.by_outlet, found.lowering.by_outlet]
    up, down = np.where(by_outlet, outlet, np.maximum(supply, outlet))
    raising, lowering = found.raising.deadband, found.lowering.deadband
    return {
        "later": int((outlet > supply).sum()),
        "raising_percent": 100.0 * (raising.value / up - 1.0),
        "lowering_percent": 100.0 * (lowering.value / down - 1.0),
        "raising_z": _z(raising, up),
        "lowering_z": _z(lowering, down),
        "hysteresis_z": _z(found.hysteresis, loop),
        "arm_s": arm_s,
    }


def _z(found: Uncertain, true: float) -> float:
    return (found.value - true) / found.std


class CommissioningOptions(NamedTuple):
    """How many of a machine's joints are tried out."""

    joints: Annotated[
        int, typer.Option("--joints", min=1, max=6, help="Joints of a machine, drawn; 6: all.")
    ] = 6


def commissioning_tasks(request: CampaignRequest, options: CommissioningOptions) -> list[Task]:
    """One task a joint of a machine."""
    tasks: list[Task] = []
    for seed in seeds(request):
        order = np.random.default_rng([seed, _STREAM, 1]).permutation(len(JOINT_NAMES))
        machine = {"seed": seed, "arm": ARMS[seed // 2 % 2], "valves": _SETS[seed % 2]}
        tasks += [
            {"key": f"{seed}-{JOINT_NAMES[joint]}", "joint": int(joint)} | machine
            for joint in sorted(order[: options.joints])
        ]
    return tasks


def commissioning_tables(done: Finished[CommissioningOptions]) -> list[Table]:
    """By arm and set of valves: errors of what was found."""
    lines = []
    for arm, kind in product(ARMS, _SETS):
        rows = [row for row in _found(done) if (row["arm"], row["valves"]) == (arm, kind)]
        if rows:
            errors, later = np.abs(_both_senses(rows, "percent")), int(column(rows, "later").sum())
            seconds = f"{column(rows, 'arm_s').mean():.0f}"
            statistics = f"{np.median(errors):.2f}", f"{errors.max():.2f}", seconds
            lines.append((arm, kind, len(rows), later, *statistics))
    headings = (
        "arm", "valves", "joints", "return edge last", "deadband, median %", "worst %", "s a joint",
    )  # fmt: skip
    return [table("commissioning against what was drawn", headings, lines)]


def _found(done: Finished[CommissioningOptions]) -> list[Row]:
    return [row for row in done.rows if not row["failure"]]


def _both_senses(rows: list[Row], what: str) -> Array:
    return np.concatenate([column(rows, f"{sense}_{what}") for sense in ("raising", "lowering")])


def commissioning_verdict(done: Finished[CommissioningOptions]) -> list[Check]:
    """Deadbands within 5 %, reported spreads inside their bands, under 15 minutes."""
    rows = _found(done)
    if not rows:
        return [at_least("joints that were found", 0.0, 1.0)]
    errors = np.abs(_both_senses(rows, "percent"))
    minutes = len(JOINT_NAMES) * float(column(rows, "arm_s").mean()) / 60.0
    z_of = {"deadbands": _both_senses(rows, "z"), "hysteresis": column(rows, "hysteresis_z")}
    return [
        at_most("joints that failed", float(len(done.rows) - len(rows)), 0.0),
        at_least("deadbands within 5 % of the truth", float(np.mean(errors <= 5.0)), 1.0),
        *(inside(f"NEES of {name}", float(np.mean(z**2)), chance_band(len(z))) for name, z in z_of.items()),
        at_most("arm time for six joints, mean", minutes, MINUTES_LIMIT, "min"),
    ]


COMMISSIONING = Experiment(
    name="commissioning",
    settings=CommissioningOptions,
    tasks=commissioning_tasks,
    run=commission_joint,
    tables=commissioning_tables,
    verdict=commissioning_verdict,
    runs=50,
    seed=41_001,
    world="the drawn machines of commissioning",
    eyes="none",
    workers=1,
)
