"""The paper's methods over payload, mount angle, distance, noise, texture, play, bending and delay."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from testbed.campaigns.row_file import Row
from testbed.experiments.paper.campaign import Asked, print_cost, run_tasks, seeds, task
from testbed.experiments.paper.comparison import SUB_CENTIMETRE_MM, worst
from testbed.experiments.paper.report import EYES
from testbed.reporting.console import out, table, write_json
from testbed.reporting.plots import AXIS_COLOURS, STYLE, png
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


def run_sweep(names: Sequence[str], asked: Asked, json_file: Path | None) -> bool:
    """Whether every condition could be measured; medians are printed, and plotted for each condition."""
    scenario = load_scenario(asked.config_dir, asked.scenario)
    tasks, places = [], []
    for name in names:
        for value in SWEEPS[name].values:
            for kind in ("line", "match"):
                for seed in seeds(asked):
                    changed = SWEEPS[name].assignments(value, scenario.world(seed))
                    tasks.append(task(kind, asked, seed, f"{name}_{value:g}", changed))
                    places.append((name, value, kind))
    done: Swept = {place: [] for place in places}
    for place, row in zip(places, run_tasks(asked, tasks, "sweep"), strict=True):
        done[place].append(row)
    figures = {name: _figures(name, done) for name in names}
    for name in names:
        _print(name, figures[name])
        path = asked.directory / f"sweep-{name}.png"
        path.write_bytes(_plot(name, figures[name]))
        out.print(f"  plot: {path}", style="dim", highlight=False, soft_wrap=True)
    kinds = ("line", "match")
    print_cost(
        {kind: [row for (_, _, k), rows in done.items() if k == kind for row in rows] for kind in kinds}
    )
    out.print(f"eyes: {EYES[asked.eyes]}", highlight=False, soft_wrap=True)
    write_json(json_file, {"sweeps": figures, "eyes": asked.eyes, "runs": asked.runs})
    return all(done.values())


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


def _print(name: str, records: list[dict[str, Any]]) -> None:
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
    out.print(table(f"worse of |x| and |y| in the picture, by {SWEEPS[name].label}", headings, cells))


def _plot(name: str, records: list[dict[str, Any]]) -> bytes:
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(6.0, 4.2), layout="constrained")
        axes = figure.subplots()
        at = [record["value"] for record in records]
        for (_, _, words), colour in zip(_STAGES, AXIS_COLOURS, strict=True):
            median, p95 = ([record[words][of] for record in records] for of in ("median_mm", "p95_mm"))
            axes.plot(at, median, "o-", color=colour, label=words)
            axes.plot(at, p95, ":", color=colour)
        axes.axhspan(0.0, SUB_CENTIMETRE_MM, color="0.92", zorder=0)
        axes.set(xlabel=SWEEPS[name].label, ylabel="worse of |x|, |y| / mm", ylim=(0.0, None))
        axes.set_title("line: median; dotted: 95 %")
        axes.legend()
        return png(figure)
