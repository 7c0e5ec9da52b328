"""Which error source makes which figure of the paper: each switched off, or made larger, by itself.

Rotations are measured by the orientation adjustment alone and always in pictures, because picture noise
makes them; positions by whatever eyes were asked for.
"""

from typing import Annotated, Any, NamedTuple

import numpy as np
import typer
from rich.table import Table

from protocol.errors import ConfigurationError
from testbed.campaigns.campaign import CampaignRequest, Task
from testbed.campaigns.experiment import Check, Experiment, Finished, seeds
from testbed.campaigns.options import Assignments, Scenario
from testbed.campaigns.row_file import Row
from testbed.experiments.paper.campaign import OUT, PaperEyes, PaperSettings, paper_task
from testbed.experiments.paper.comparison import FACTOR, TABLES, values
from testbed.experiments.paper.measurement import measure
from testbed.reporting.console import table

KINDS = ("turn", "line", "match")
_PICTURES = PaperEyes.OPENCV  # the eyes of the paper


class Variant(NamedTuple):
    """A change of the world or of the programs: what is set, other eyes where they are the change, and the
    measurements that it can bear upon.
    """

    words: str
    assignments: tuple[str, ...] = ()
    kinds: tuple[str, ...] = KINDS
    eyes: PaperEyes | None = None


_SMALL_MARKERS = (
    "scene.tool_marker.side_m=0.05",
    "vision.markers.tool.size_m=0.05",
    "scene.object_of_interest.markers=["
    "{marker_id: 1, side_m: 0.06, quiet_zone_m: 0.01, centre_m: [-0.2, 0.0], print_scale_error: 0.0008}, "
    "{marker_id: 2, side_m: 0.06, quiet_zone_m: 0.01, centre_m: [0.2, 0.0], print_scale_error: -0.0005}, "
    "{marker_id: 3, side_m: 0.06, quiet_zone_m: 0.01, centre_m: [0.0, 0.2], print_scale_error: 0.0004}]",
    "vision.markers.object=[{id: 1, size_m: 0.06, x_m: -0.2, y_m: 0.0}, "
    "{id: 2, size_m: 0.06, x_m: 0.2, y_m: 0.0}, {id: 3, size_m: 0.06, x_m: 0.0, y_m: 0.2}]",
)

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
        ("match",),
    ),
    "no_noise": Variant("pictures without noise", ("scene.camera.noise_grey=0.0",), ("turn",)),
    "tight_servo": Variant("joints settled to 0.15 mrad", ("controller.settled.tolerance_mrad=0.15",)),
    # the same, larger, and what the paper does not tell of its set-up: for figures that are too small
    "more_noise": Variant("noise of 10 grey levels, not 2", ("scene.camera.noise_grey=10.0",), ("turn",)),
    "small_markers": Variant("markers half as large", _SMALL_MARKERS, ("turn",)),
    "large_turn": Variant(
        "object turned by 25°", ("scene.object_of_interest.tilt_deg=[14.0, -14.0, 15.0]",), ("turn",)
    ),
    "loose_wrist": Variant(
        "wrist 3 with 7° of play",
        ("plant.errors.backlash.half_width_mrad=[0.3, 0.05, 0.05, 0.1, 0.1, 60.0]",),
        ("turn",),
    ),
    "ten_pictures": Variant("ten pictures averaged a look", ("vision.look.frames=10",), ("turn", "match")),
    "level_approach": Variant(
        "object at the tool's height, 0.38 m off",
        ("scene.object_of_interest.position_m=[4.385, 0.38, 1.008]",),
        ("line", "match"),
    ),
    "steep_approach": Variant(
        "object 52° above that, 0.38 m off",
        ("scene.object_of_interest.position_m=[4.385, 0.234, 1.307]",),
        ("line", "match"),
    ),
    # what Longreach does otherwise
    "refined_markers": Variant("Longreach's own markers (eye model)", (), KINDS, PaperEyes.MODEL),
    "frame_true": Variant("orientation, frame-true", ("vision.programs.orientation.form=frame_true",)),
    "fitted_minimum": Variant(
        "line equation, fitted", ("vision.programs.line_equation.minimum=fit",), ("line",)
    ),
    "points_in_time": Variant(
        "match of points, in time",
        ("vision.programs.trajectory.method=points", "vision.programs.trajectory.association=time"),
        ("match",),
    ),
}
"""Name → change; the first is what the tables themselves measure, and shares their rows."""

Done = dict[tuple[str, str], list[Row]]


class AblationSettings(NamedTuple):
    """Which variants, in the world and with the eyes of the paper's tables."""

    only: Annotated[list[str] | None, typer.Option(help="Only this variant; repeatable.")] = None
    eyes: Annotated[PaperEyes, typer.Option(help="What measures positions.")] = PaperEyes.OPENCV
    scenario: Scenario = "paper"
    assignments: Assignments = None

    @property
    def paper(self) -> PaperSettings:
        """The settings of the paper's own measurements."""
        return PaperSettings(self.eyes, self.scenario, self.assignments)

    @property
    def chosen(self) -> dict[str, Variant]:
        """The variants, what is as it is first."""
        return {name: VARIANTS[name] for name in VARIANTS if not self.only or name in self.only or name == ""}


Ablated = Finished[AblationSettings, Row]


def ablation_tasks(request: CampaignRequest, settings: AblationSettings) -> list[Task]:
    """One task for each variant, kind and seed. Raises ConfigurationError for an unknown variant."""
    for name in settings.only or []:
        if name not in VARIANTS:
            known = ", ".join(filter(None, VARIANTS))
            raise ConfigurationError("configuration.unknown_variant", f"--only '{name}'; known: {known}")
    return [
        paper_task(
            request.config_dir,
            settings.paper._replace(eyes=_eyes(variant, kind, settings)),
            kind,
            seed,
            name,
            variant.assignments,
        )
        for name, variant in settings.chosen.items()
        for kind in variant.kinds
        for seed in seeds(request)
    ]


def ablated(done: Ablated) -> Done:
    """(Variant, kind) → rows."""
    rows: Done = {}
    for asked, row in zip(done.tasks, done.rows, strict=True):
        rows.setdefault((asked["variant"], asked["kind"]), []).append(row)
    return rows


def ablation_verdict(done: Ablated) -> list[Check]:
    """Every variant could be measured."""
    places = ablated(done)
    good = sum(any(not row["failure"] for row in rows) for rows in places.values())
    return [Check("variants that could be measured", f"{good} of {len(places)}", "all", good == len(places))]


def ablation_figures(done: Ablated) -> dict[str, Any]:
    """Means, failures and eyes, by variant."""
    chosen, rows = done.settings.chosen, ablated(done)
    eyes = {
        name: {kind: _eyes(variant, kind, done.settings) for kind in variant.kinds}
        for name, variant in chosen.items()
    }
    return {
        "means": {name: _means(rows, name) for name in chosen},
        "failed": {name: _failed(rows, name) for name in chosen},
        "eyes": eyes,
        "runs": done.request.runs,
    }


def _eyes(variant: Variant, kind: str, settings: AblationSettings) -> PaperEyes:
    return variant.eyes or (_PICTURES if kind == "turn" else settings.eyes)


class _Column(NamedTuple):
    kind: str
    ours: str
    heading: str
    paper: float


def _columns() -> list[_Column]:
    """Every figure that is tabulated: x and y of every table's means."""
    return [
        _Column(
            "turn" if ours.startswith("oriented") else paper_table.kind,
            ours,
            f"{name.replace('table', 'T')} {_heading(ours)}",
            published.mean,
        )
        for name, paper_table in TABLES.items()
        for part in paper_table.parts
        if "greatest" not in part.title
        for ours, published in zip(part.ours[:2], part.published[:2], strict=True)
    ]


def _heading(column: str) -> str:
    stage, axis, unit = column.rsplit("_", 2)
    short = {"oriented": "turn", "input1": "1st", "input2": "2nd", "residual": "match"}[stage]
    return f"{short} {axis[-1]} {'°' if unit == 'deg' else unit}"


def _means(done: Done, name: str) -> dict[str, float]:
    """Heading → mean of absolute values, NaN for what the variant does not bear upon."""
    made = {}
    for column in _columns():
        ours = np.abs(values(done.get((name, column.kind), []), column.ours))
        made[column.heading] = float(ours.mean()) if len(ours) else float("nan")
    error = values(done.get((name, "match"), []), "rotation_error_deg")
    return made | {"rotation error °": float(error.mean()) if len(error) else float("nan")}


def _failed(done: Done, name: str) -> int:
    return sum(bool(row["failure"]) for (variant, _), rows in done.items() if variant == name for row in rows)


def ablation_table(done: Ablated) -> list[Table]:
    """A row for each variant: x and y of each block in one cell."""
    columns, rows = _columns(), ablated(done)
    pairs = list(zip(columns[::2], columns[1::2], strict=True))
    cells = [["the paper", *(f"{x.paper:g} / {y.paper:g}" for x, y in pairs), "", "", ""]]
    for name, variant in done.settings.chosen.items():
        made = _means(rows, name)
        error = made["rotation error °"]
        cells.append(
            [
                variant.words,
                *(f"{_told(x, made)} / {_told(y, made)}" for x, y in pairs),
                "–" if np.isnan(error) else f"{error:.1f}",
                ", ".join(dict.fromkeys(_eyes(variant, kind, done.settings) for kind in variant.kinds)),
                str(_failed(rows, name)),
            ]
        )
    headings = [x.heading.replace(" x ", " ") for x, _ in pairs]
    title = f"means of absolute errors, x / y, one thing changed at a time, {done.request.runs} seeds; "
    title += f"*: not within {FACTOR:g} of the paper; –: not borne upon"
    return [table(title, ["", *headings, "rotation error °", "eyes", "failed"], cells)]


def _told(column: _Column, made: dict[str, float]) -> str:
    mean = made[column.heading]
    if np.isnan(mean):
        return "–"
    return f"{mean:.1f}" + ("" if 1.0 / FACTOR <= mean / column.paper <= FACTOR else "*")


ABLATION = Experiment(
    name="ablation",
    title="The tables' means with the error sources switched off one at a time.",
    settings=AblationSettings,
    row=dict,
    tasks=ablation_tasks,
    run=measure,
    table=ablation_table,
    verdict=ablation_verdict,
    figures=ablation_figures,
    runs=10,
    out=OUT,
)
