"""Commissioning on drawn machines: what was found against what was drawn, and whether σ is honest."""

from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer
from rich.table import Table
from scipy.stats import chi2

from foundation.configuration import merged
from laboratory.campaigns.campaign import CampaignRequest
from laboratory.campaigns.experiment import Check, Experiment, Finished, at_least, at_most, inside, seeds
from laboratory.campaigns.workforce import Task
from laboratory.experiments.positioning import axes, axes_of_sight
from laboratory.experiments.positioning.scenarios import draw
from laboratory.experiments.positioning.worlds import ARMS, WORLDS, WorldName
from nominal_arm.description import JOINT_NAMES
from plant_emulator.config.plant import PlantConfig
from plant_emulator.config.valves import JOINT_NAMES as VALVE_NAMES
from protocol.errors import MeasurementFailed
from testbed.commissioning.findings import JointFindings, joint_findings
from testbed.commissioning.ramp_rows import Uncertain
from testbed.commissioning.recording import JointRecording
from testbed.commissioning.runs import excite_in_lockstep, with_excitation
from testbed.commissioning.valve_fit import EdgeFindings
from testbed.lockstep.clock import RunLog
from testbed.lockstep.simulated_measurements import eyes_with, load_eye_model, simulated_sight
from testbed.lockstep.world import World
from testbed.reporting.console import table
from testbed.scenarios.scenario import Settings, load_settings

_STREAM = 0x636F6D6D
_AXES = (axes.friction, axes.bending, axes.play, axes_of_sight.stamps)
_OF_REAL = (axes.oil, axes.supply, axes.rocking_base)  # of degraded machines, beside those
_SETS = ("servo", "mobile")
PLAY_LIMIT = 0.2  # of itself
MINUTES_LIMIT = 15.0  # of arm time, for all six joints

JSON = dict[str, Any]


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


class TrueValve(NamedTuple):
    """What was drawn: (2,) spools at which the inlet's and the outlet's edge begin to pass oil, raising and
    lowering, and the loop's width."""

    raising: tuple[float, float]
    lowering: tuple[float, float]
    hysteresis: float


def true_valve(plant: PlantConfig, joint: int) -> TrueValve:
    """Of ``joint``. Both edges of a sense must be open for oil to pass, unless the load runs ahead and the
    inlet's chamber is filled from the tank."""
    name = VALVE_NAMES[joint]
    valve = plant.valves.of(name, getattr(plant.actuators, name).rated_flow_l_min)
    supply_a, return_b, supply_b, return_a = valve.deadband
    raising, lowering = (max(supply_a, return_b), return_b), (max(supply_b, return_a), return_a)
    return TrueValve(raising, lowering, valve.hysteresis)


def supplies(plant: PlantConfig, joint: int) -> tuple[float, float]:
    """The spools at which the supply edges of ``joint`` open, raising and lowering."""
    name = VALVE_NAMES[joint]
    supply_a, _, supply_b, _ = plant.valves.of(name, getattr(plant.actuators, name).rated_flow_l_min).deadband
    return supply_a, supply_b


def _true_rim(edges: tuple[float, float], found: EdgeFindings) -> float:
    """Of the edge that ``found`` says it is of."""
    return edges[1] if found.by_outlet else edges[0]


class CommissioningRow(NamedTuple):
    """One joint of one machine; errors in per cent of the truth or of full spool, ``z`` over σ.

    ``by_outlet``: of how many senses the load ran ahead, ``later``: in how many the return edge opens last,
    ``unknown``: of how many one edge alone was seen. ``play_resolved``: 1 where it is reported to 20 %.
    """

    failure: str
    seed: int
    arm: str
    valves: str
    joint: int
    by_outlet: int
    later: int
    unknown: int
    raising_percent: float
    lowering_percent: float
    raising_z: float
    lowering_z: float
    hysteresis_error: float
    hysteresis_z: float
    play_percent: float
    play_z: float
    play_resolved: int
    delay_true_ms: float
    delay_ms: float
    delay_z: float
    arm_s: float
    cpu_s: float


def commission_joint(config_dir: Path, task: JSON) -> JSON:
    """The row of one joint of one machine. Raises MeasurementFailed with the cause that broke it off."""
    seed, joint = task["seed"], task["joint"]
    settings: Settings = load_settings(config_dir, drawn_machine(config_dir, seed))
    kept: list[JointRecording] = []
    world = World(with_excitation(settings, [joint]), seed, RunLog())
    eyes = eyes_with(world, simulated_sight(world, load_eye_model(config_dir), seed))
    ended = excite_in_lockstep(world, kept.append, lambda _progress, _note: None, eyes)
    if ended.trouble is not None:
        trouble = ended.trouble
        raise MeasurementFailed(
            trouble.cause, f"{JOINT_NAMES[trouble.joint]}: {trouble.value:.4g}, limit {trouble.limit:.4g}"
        )
    found = joint_findings(kept[0], settings.controller.valves.pressure_compensated)
    true = true_valve(settings.plant, joint)
    raising, lowering, loop = found.raising.deadband, found.lowering.deadband, found.hysteresis
    up, down = _true_rim(true.raising, found.raising), _true_rim(true.lowering, found.lowering)
    return {
        "seed": seed,
        "arm": ARMS[seed // 2 % 2],
        "valves": _SETS[seed % 2],
        "joint": joint,
        "by_outlet": int(found.raising.by_outlet) + int(found.lowering.by_outlet),
        "later": sum(
            edges[0] > supply for edges, supply in zip(true[:2], supplies(settings.plant, joint), strict=True)
        ),
        "unknown": [found.raising.last, found.lowering.last].count("unknown"),
        "raising_percent": 100.0 * (raising.value / up - 1.0),
        "lowering_percent": 100.0 * (lowering.value / down - 1.0),
        "raising_z": _z(raising, up),
        "lowering_z": _z(lowering, down),
        "hysteresis_error": loop.value - true.hysteresis,
        "hysteresis_z": _z(loop, true.hysteresis),
        **_play_figures(found, settings, joint),
        "arm_s": ended.seconds,
    }


def _play_figures(found: JointFindings, settings: Settings, joint: int) -> JSON:
    """Raises MeasurementFailed (``measurement.play_unseen``) where odometry saw too little."""
    play, true = found.play, 1e-3 * settings.plant.errors.backlash.half_width_mrad[joint]
    if play is None:
        raise MeasurementFailed("measurement.play_unseen", f"{JOINT_NAMES[joint]}: {found.unseen}")
    late_ms = settings.scene.camera.stamps.delay_ms
    return {
        "play_percent": 100.0 * (play.half / true - 1.0),
        "play_z": (play.half - true) / play.half_std,
        "play_resolved": int(found.resolved),
        "delay_true_ms": late_ms,
        "delay_ms": 1e3 * play.delay,
        "delay_z": (1e3 * play.delay - late_ms) / (1e3 * play.delay_std),
    }


def _z(found: Uncertain, true: float) -> float:
    return (found.value - true) / found.std


class CommissioningOptions(NamedTuple):
    """How many of a machine's joints are tried out."""

    joints: Annotated[
        int, typer.Option("--joints", min=1, max=6, help="Joints of a machine, drawn; 6: all.")
    ] = 6


FoundJoints = Finished[CommissioningOptions, CommissioningRow]


def commissioning_tasks(request: CampaignRequest, options: CommissioningOptions) -> list[Task]:
    """One task a joint of a machine."""
    tasks = []
    for seed in seeds(request):
        order = np.random.default_rng([seed, _STREAM, 1]).permutation(len(JOINT_NAMES))
        tasks += [
            {"key": f"{seed}-{JOINT_NAMES[joint]}", "seed": seed, "joint": int(joint)}
            for joint in sorted(order[: options.joints])
        ]
    return tasks


def commissioning_table(done: FoundJoints) -> list[Table]:
    """By arm and set of valves: errors and spreads of what was found; what was broken off."""
    good = [row for row in done.rows if not row.failure]
    groups = [
        (arm, kind, [row for row in good if (row.arm, row.valves) == (arm, kind)])
        for arm in ARMS
        for kind in _SETS
    ]
    lines = [(arm, kind, *_line(rows)) for arm, kind, rows in groups if rows]
    headings = (
        "arm", "valves", "joints", "return edge last", "one edge seen",
        "deadband, median %", "worst %", "NEES", "hysteresis, median %", "NEES",
        "play, median %", "within 20 %", "reported to 20 %", "NEES", "delay, median ms", "NEES", "s a joint",
    )  # fmt: skip
    failed = [(f"{row.failure[:100]}",) for row in done.rows if row.failure]
    shown = [table("commissioning against what was drawn", headings, lines)]
    return [*shown, table("broken off or refused", ("why",), failed)] if failed else shown


def _line(rows: list[CommissioningRow]) -> tuple[object, ...]:
    errors, z = _edges(rows)
    loops = np.array([row.hysteresis_error for row in rows])
    play = np.abs([row.play_percent for row in rows])
    late = np.abs([row.delay_ms - row.delay_true_ms for row in rows])
    return (
        len(rows),
        sum(row.later for row in rows),
        sum(row.unknown for row in rows),
        f"{np.median(np.abs(errors)):.2f}",
        f"{np.abs(errors).max():.2f}",
        f"{np.mean(z**2):.2f}",
        f"{100 * np.median(np.abs(loops)):.3f}",
        f"{_nees([row.hysteresis_z for row in rows]):.2f}",
        f"{np.median(play):.1f}",
        f"{100 * np.mean(play <= 100.0 * PLAY_LIMIT):.0f} %",
        f"{sum(row.play_resolved for row in rows)}",
        f"{_nees([row.play_z for row in rows]):.2f}",
        f"{np.median(late):.2f}",
        f"{_nees([row.delay_z for row in rows]):.2f}",
        f"{np.mean([row.arm_s for row in rows]):.0f}",
    )


def _edges(rows: list[CommissioningRow]) -> tuple[np.ndarray, np.ndarray]:
    errors = [e for row in rows for e in (row.raising_percent, row.lowering_percent)]
    return np.array(errors), np.array([z for row in rows for z in (row.raising_z, row.lowering_z)])


def _resolved_right(rows: list[CommissioningRow]) -> float:
    """The share of plays reported to 20 % (by 2 σ: 95 of 100) that are so; 0 when none is."""
    right = [abs(row.play_percent) <= 100.0 * PLAY_LIMIT for row in rows if row.play_resolved]
    return float(np.mean(right)) if right else 0.0


def _nees(z: list[float]) -> float:
    return float(np.mean(np.square(z)))


def commissioning_verdict(done: FoundJoints) -> list[Check]:
    """Deadbands within 5 %, play within 20 %, reported spreads inside their bands, under 15 minutes."""
    rows = [row for row in done.rows if not row.failure]
    if not rows:
        return [at_least("joints that were found", 0.0, 1.0)]
    errors, z = _edges(rows)
    play = np.abs([row.play_percent for row in rows])
    minutes = len(JOINT_NAMES) * float(np.mean([row.arm_s for row in rows])) / 60.0
    z_of = {
        "deadbands": z.tolist(),
        "deadbands, servo valves": _edges([row for row in rows if row.valves == "servo"])[1].tolist(),
        "deadbands, mobile valves": _edges([row for row in rows if row.valves == "mobile"])[1].tolist(),
        "hysteresis": [row.hysteresis_z for row in rows],
        "play": [row.play_z for row in rows],
        "camera's delay": [row.delay_z for row in rows],
    }
    return [
        at_most("joints that failed", float(len(done.rows) - len(rows)), 0.0),
        at_least("deadbands within 5 % of the truth", float(np.mean(np.abs(errors) <= 5.0)), 1.0),
        at_least("plays within 20 % of the truth", float(np.mean(play <= 100.0 * PLAY_LIMIT)), 1.0),
        at_least("… of those that are reported to 20 %", _resolved_right(rows), 0.95),
        *(
            inside(f"NEES of {name}", _nees(values), _band(len(values)))
            for name, values in z_of.items()
            if values
        ),
        at_most("arm time for six joints, mean", minutes, MINUTES_LIMIT, "min"),
    ]


def _band(count: int) -> tuple[float, float]:
    """Where the mean of so many squared errors over variance lies in 95 of 100 cases, if σ is honest."""
    return float(chi2.ppf(0.025, count)) / count, float(chi2.ppf(0.975, count)) / count


COMMISSIONING = Experiment(
    name="commissioning",
    title="Commissioning of drawn machines.",
    settings=CommissioningOptions,
    row=CommissioningRow,
    tasks=commissioning_tasks,
    run=commission_joint,
    table=commissioning_table,
    verdict=commissioning_verdict,
    runs=50,
    seed=41_001,
    world="the drawn machines of commissioning",
    eyes="none",
    workers=1,
)
