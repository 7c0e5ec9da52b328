"""The paper's methods over payload, mount angle, distance, noise, texture, play, bending and delay."""

from collections.abc import Callable, Mapping
from typing import Annotated, Any, NamedTuple

import matplotlib
import numpy as np
import typer
from matplotlib.figure import Figure
from rich.table import Table

from protocol.errors import ConfigurationError
from testbed.campaigns.campaign import CampaignRequest, Task
from testbed.campaigns.experiment import Check, Experiment, Finished, seeds
from testbed.campaigns.options import Assignments, Scenario
from testbed.campaigns.row_file import Row
from testbed.experiments.paper.campaign import OUT, PaperEyes, PaperSettings, paper_task
from testbed.experiments.paper.comparison import SUB_CENTIMETRE_MM, worst
from testbed.experiments.paper.measurement import measure
from testbed.reporting.console import table
from testbed.reporting.plots import AXIS_COLOURS, STYLE
from testbed.scenarios.scenario import load_scenario

World = Mapping[str, Any]
_STAGES = (
    ("line", "input1", "line equation"),
    ("match", "input1", "match, 1st"),
    ("match", "input2", "match, 2nd"),
)
_START_X_M = 3.894  # of the tool at the start pose


class Sweep(NamedTuple):
    """One condition: its name with the unit, its values, and what is set for one of them in a drawn world."""

    label: str
    values: tuple[float, ...]
    assignments: Callable[[float, World], list[str]]


def _key(key: str) -> Callable[[float, World], list[str]]:
    return lambda value, world: [f"{key}={value}"]


def _mount(angle_deg: float, world: World) -> list[str]:
    """The mount that was drawn, turned by this angle about the axis it was drawn with."""
    drawn = np.array(world["scene"]["mount"]["rotation_deg"])
    turned = angle_deg * drawn / np.linalg.norm(drawn)
    return [f"scene.mount.rotation_deg={turned.tolist()}"]


def _distance(depth_m: float, world: World) -> list[str]:
    """The object that was drawn, at this distance in front of the tool at its start."""
    _, y, z = world["scene"]["object_of_interest"]["position_m"]
    return [f"scene.object_of_interest.position_m=[{_START_X_M + depth_m}, {y}, {z}]"]


def _play(half_width_mrad: float, world: World) -> list[str]:
    """The slew's play; that of the other joints as in plant.yaml."""
    return [f"plant.errors.backlash.half_width_mrad=[{half_width_mrad}, 0.05, 0.05, 0.1, 0.1, 0.1]"]


def _bending(times: float, world: World) -> list[str]:
    """Booms that bend so many times as much; 0: not at all."""
    if times == 0.0:
        return ["plant.flexibility.enabled=false"]
    stiff = {"boom": 2.51e6, "arm": 7.0e5}  # plant.yaml
    return [
        f"plant.flexibility.{part}.{way}_ei_n_m2={value / times}"
        for part, value in stiff.items()
        for way in ("vertical", "lateral")
    ]


SWEEPS = {
    "payload": Sweep("payload / kg", (0.0, 50.0, 100.0, 150.0), _key("plant.payload.mass_kg")),
    "mount": Sweep("mount angle / °", (0.0, 2.5, 5.0, 10.0), _mount),
    "distance": Sweep("distance / m", (0.3, 0.45, 0.6, 0.8), _distance),
    "noise": Sweep("picture noise / grey levels", (0.0, 2.0, 5.0, 10.0), _key("scene.camera.noise_grey")),
    "texture": Sweep(
        "wall's contrast / grey levels", (22.0, 10.0, 4.0, 2.0), _key("scene.wall.contrast_grey")
    ),
    "play": Sweep("half the slew's play / mrad", (0.0, 0.3, 0.6, 1.0), _play),
    "flexibility": Sweep("bending / times as much", (0.0, 1.0, 2.0, 4.0), _bending),
    "latency": Sweep("valve delay / ms", (1.0, 10.0, 20.0, 30.0), _key("plant.valves.delay_ms")),
}
"""Name → condition."""

Swept = dict[tuple[str, float, str], list[Row]]


class ConditionSettings(NamedTuple):
    """Which conditions, in the world and with the eyes of the paper's tables."""

    names: Annotated[list[str] | None, typer.Argument(help="Which conditions; none: all.")] = None
    eyes: Annotated[PaperEyes, typer.Option(help="What measures the markers.")] = PaperEyes.OPENCV
    scenario: Scenario = "paper"
    assignments: Assignments = None

    @property
    def chosen(self) -> list[str]:
        """The conditions."""
        return self.names or list(SWEEPS)


Conditions = Finished[ConditionSettings, Row]


def sweep_tasks(request: CampaignRequest, settings: ConditionSettings) -> list[Task]:
    """One task for each value of each condition, kind and seed. ConfigurationError: unknown one."""
    for name in settings.chosen:
        if name not in SWEEPS:
            raise ConfigurationError("configuration.unknown_sweep", f"'{name}'; known: {', '.join(SWEEPS)}")
    scenario = load_scenario(request.config_dir, settings.scenario)
    paper = PaperSettings(settings.eyes, settings.scenario, settings.assignments)
    return [
        paper_task(
            request.config_dir,
            paper,
            kind,
            seed,
            f"{name}_{value:g}",
            SWEEPS[name].assignments(value, scenario.world(seed)),
        )
        for name in settings.chosen
        for value in SWEEPS[name].values
        for kind in ("line", "match")
        for seed in seeds(request)
    ]


def _swept(done: Conditions) -> Swept:
    """(Condition, value, kind) → rows."""
    places = {
        f"{name}_{value:g}": (name, value) for name in done.settings.chosen for value in SWEEPS[name].values
    }
    rows: Swept = {}
    for asked, row in zip(done.tasks, done.rows, strict=True):
        rows.setdefault((*places[asked["variant"]], asked["kind"]), []).append(row)
    return rows


def sweep_table(done: Conditions) -> list[Table]:
    """The medians, a table for each condition."""
    return [_table(name, _figures(name, _swept(done))) for name in done.settings.chosen]


def sweep_verdict(done: Conditions) -> list[Check]:
    """Every condition has been measured."""
    measured = _swept(done)
    return [Check("conditions measured", f"{len(measured)}", "all", all(measured.values()))]


def sweep_plot(done: Conditions) -> dict[str, Figure]:
    """A picture for each condition."""
    return {f"sweep-{name}": _plot(name, _figures(name, _swept(done))) for name in done.settings.chosen}


def sweep_figures(done: Conditions) -> dict[str, Any]:
    """The records of each condition."""
    swept = {name: _figures(name, _swept(done)) for name in done.settings.chosen}
    return {"sweeps": swept, "eyes": done.settings.eyes, "runs": done.request.runs}


def _figures(name: str, done: Swept) -> list[dict[str, Any]]:
    """One record for each value: of each method the worse of |x| and |y| at the median, 95 %, its misses."""
    made = []
    for value in SWEEPS[name].values:
        record: dict[str, Any] = {"value": value}
        for kind, stage, words in _STAGES:
            errors = np.array([worst(row, stage) for row in done[name, value, kind]])
            there = errors[np.isfinite(errors)]
            record[words] = {
                "median_mm": float(np.median(there)) if len(there) else float("nan"),
                "p95_mm": float(np.percentile(there, 95)) if len(there) else float("nan"),
                "not_reached": int(len(errors) - len(there)),
            }
        made.append(record)
    return made


def _table(name: str, records: list[dict[str, Any]]) -> Table:
    headings = [SWEEPS[name].label]
    for _, _, words in _STAGES:
        headings += [f"{words}: median mm", "95 %", "not reached"]
    cells = [
        [f"{record['value']:g}"]
        + [
            text
            for _, _, words in _STAGES
            for text in (
                f"{record[words]['median_mm']:.1f}",
                f"{record[words]['p95_mm']:.1f}",
                str(record[words]["not_reached"]),
            )
        ]
        for record in records
    ]
    return table(f"worse of |x| and |y| in the picture, by {SWEEPS[name].label}", headings, cells)


def _plot(name: str, records: list[dict[str, Any]]) -> Figure:
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(6.0, 4.2), layout="constrained")
        axes = figure.subplots()
        at = [record["value"] for record in records]
        for (_, _, words), colour in zip(_STAGES, AXIS_COLOURS, strict=True):
            median, p95 = ([record[words][of] for record in records] for of in ("median_mm", "p95_mm"))
            axes.plot(at, median, "o-", color=colour, label=words)
            axes.plot(at, p95, ":", color=colour)
        axes.axhspan(0.0, SUB_CENTIMETRE_MM, color="0.5", alpha=0.2, linewidth=0, zorder=0)
        axes.set(xlabel=SWEEPS[name].label, ylabel="worse of |x|, |y| / mm", ylim=(0.0, None))
        axes.set_title("line: median; dotted: 95 %")
        axes.legend()
        return figure


SWEEP = Experiment(
    name="sweep",
    title="Both of the paper's methods over eight conditions.",
    settings=ConditionSettings,
    row=dict,
    tasks=sweep_tasks,
    run=measure,
    table=sweep_table,
    verdict=sweep_verdict,
    plot=sweep_plot,
    figures=sweep_figures,
    runs=6,
    out=OUT,
)
