"""Which error source makes which figure of the paper: each switched off by itself, every mean tabulated."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from testbed.console import out, table, write_json
from testbed.experiments.comparison import TABLES, values
from testbed.experiments.paper import Asked, print_cost, run_tasks, seeds, task
from testbed.row_file import Row


class Variant(NamedTuple):
    """A change of the world or of the programs: what is set, and other eyes where they are the change."""

    words: str
    assignments: tuple[str, ...] = ()
    eyes: str | None = None


VARIANTS = {
    "": Variant("as it is"),
    # error sources of the world, each off
    "no_play": Variant("no play in the joints", ("plant.errors.backlash.enabled=false",)),
    "no_bending": Variant("stiff booms", ("plant.flexibility.enabled=false",)),
    "true_geometry": Variant(
        "encoders and geometry as drawn",
        (
            "plant.errors.encoder_offsets.enabled=false",
            "plant.errors.geometry.enabled=false",
            "plant.errors.base_tilt.enabled=false",
        ),
    ),
    "parallel_mount": Variant("camera parallel to the tool", ("scene.mount.rotation_deg=[0.0, 0.0, 0.0]",)),
    "true_marker": Variant(
        "tool marker true",
        ("scene.tool_marker.misalignment_deg=[0.0, 0.0, 0.0]", "scene.tool_marker.offset_m=[0.0, 0.0, 0.0]"),
    ),
    "true_rectification": Variant(
        "no offset between the eyes",
        (
            "scene.camera.rectification.vertical_px=0.0",
            "scene.camera.rectification.disparity_px=0.0",
            "scene.camera.rectification.right_eye_rotation_deg=[0.0, 0.0, 0.0]",
        ),
    ),
    "no_noise": Variant("pictures without noise", ("scene.camera.noise_grey=0.0",)),
    "tight_servo": Variant("joints settled to 0.15 mrad", ("controller.settled.tolerance_mrad=0.15",)),
    # what Longreach does otherwise
    "refined_markers": Variant("Longreach's own markers", (), "pixels"),
    "frame_true": Variant("orientation, frame-true", ("vision.programs.orientation.form=frame_true",)),
    "fitted_minimum": Variant("line equation, fitted", ("vision.programs.line_equation.minimum=fit",)),
    "points_in_time": Variant(
        "match of points, in time",
        ("vision.programs.trajectory.method=points", "vision.programs.trajectory.association=time"),
    ),
}
"""Name → change; the first is what the tables themselves measure, and shares their rows."""


def run_ablation(asked: Asked, only: list[str], json_file: Path | None) -> bool:
    """Whether every variant could be measured; the means are printed, a row for each variant."""
    chosen = {name: VARIANTS[name] for name in VARIANTS if not only or name in only or name == ""}
    kinds = ("line", "match")
    tasks, places = [], []
    for name, variant in chosen.items():
        with_eyes = asked._replace(eyes=variant.eyes or asked.eyes)
        for kind in kinds:
            for seed in seeds(asked):
                tasks.append(task(kind, with_eyes, seed, name, variant.assignments))
                places.append((name, kind))
    done: dict[tuple[str, str], list[Row]] = {(name, kind): [] for name in chosen for kind in kinds}
    for place, row in zip(places, run_tasks(asked, tasks, "ablation"), strict=True):
        done[place].append(row)
    means = {name: _means(done, name) for name in chosen}
    _print(chosen, means, {name: _failed(done, name) for name in chosen})
    print_cost({kind: [row for (_, k), rows in done.items() if k == kind for row in rows] for kind in kinds})
    write_json(json_file, {"means": means, "runs": asked.runs})
    return all(rows for rows in done.values())


def _columns() -> list[tuple[str, str, str]]:
    """Kind, column and heading of every figure that is tabulated: x and y of every table's means."""
    return [
        (paper_table.kind, ours, f"{name.replace('table', 'T')} {_heading(ours)}")
        for name, paper_table in TABLES.items()
        for part in paper_table.parts
        if "greatest" not in part.title
        for ours in part.ours[:2]
    ]


def _heading(column: str) -> str:
    stage, axis, unit = column.rsplit("_", 2)
    short = {"oriented": "turn", "input1": "1st", "input2": "2nd", "residual": "match"}[stage]
    return f"{short} {axis[-1]} {'°' if unit == 'deg' else unit}"


def _means(done: dict[tuple[str, str], list[Row]], name: str) -> dict[str, float]:
    made = {}
    for kind, column, heading in _columns():
        ours = np.abs(values(done[name, kind], column))
        made[heading] = float(ours.mean()) if len(ours) else float("nan")
    error = values(done[name, "match"], "rotation_error_deg")
    return made | {"rotation error °": float(error.mean()) if len(error) else float("nan")}


def _failed(done: dict[tuple[str, str], list[Row]], name: str) -> int:
    return sum(bool(row["failure"]) for (variant, _), rows in done.items() if variant == name for row in rows)


def _print(chosen: dict[str, Variant], means: dict[str, dict[str, float]], failed: dict[str, int]) -> None:
    headings = list(next(iter(means.values())))
    pairs = list(zip(headings[:-1:2], headings[1:-1:2], strict=True))  # x and y of each block in one cell
    cells = [
        [
            variant.words,
            *(f"{means[name][x]:.1f} / {means[name][y]:.1f}" for x, y in pairs),
            f"{means[name][headings[-1]]:.1f}",
            str(failed[name]),
        ]
        for name, variant in chosen.items()
    ]
    title = "means of absolute errors, x / y, one thing changed at a time"
    columns = [x.replace(" x ", " ") for x, _ in pairs]
    out.print(table(title, ["", *columns, headings[-1], "failed"], cells))
