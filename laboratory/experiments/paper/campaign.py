"""The paper's tables and figures over many seeded runs: measured, compared, drawn.

All of them share one directory of rows. A table or a figure asks for the measurements it is made of, ``line``
or ``match``, and those that are there are not measured again.
"""

import math
from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import Annotated, NamedTuple

import typer
from matplotlib.figure import Figure
from rich import table as rich

from laboratory.campaigns.campaign import CampaignRequest
from laboratory.campaigns.experiment import Check, Experiment, Finished, seeds
from laboratory.campaigns.rows import Row
from laboratory.campaigns.workforce import Task
from laboratory.experiments.paper import comparison, figures
from laboratory.experiments.paper.comparison import FACTOR, TABLES, Compared
from laboratory.experiments.paper.measurement import SCENARIO, measure, trace
from testbed.reporting.console import table
from testbed.scenarios.scenario import load_scenario, load_settings


class PaperEyes(StrEnum):
    """What measures the markers."""

    OPENCV = "opencv"
    PIXELS = "pixels"
    MODEL = "model"


PaperPart = StrEnum("PaperPart", {name: name for name in (*TABLES, *figures.KINDS)})  # type: ignore[misc]


class PaperSettings(NamedTuple):
    """What of the paper, and what measures."""

    part: Annotated[
        list[PaperPart] | None, typer.Option(help="Only this table or figure; repeatable. Usually all.")
    ] = None
    eyes: Annotated[
        PaperEyes,
        typer.Option(
            help="opencv: rendered pictures, markers as in the paper; pixels: rendered pictures, Longreach's "
            "markers; model: no pictures, errors as measured from them."
        ),
    ] = PaperEyes.OPENCV

    @property
    def tables(self) -> list[str]:
        """The tables that are wanted."""
        return [name for name in TABLES if not self.part or name in self.part]

    @property
    def figures(self) -> list[str]:
        """The figures that are wanted."""
        return [name for name in figures.KINDS if not self.part or name in self.part]


def paper_task(config_dir: Path, settings: PaperSettings, kind: str, seed: int) -> Task:
    """The task of one measurement. Raises ConfigurationError when its configuration is wrong."""
    load_settings(config_dir, load_scenario(config_dir, SCENARIO).world(seed))
    return {
        "key": f"{kind}-{settings.eyes}-{seed}",
        "kind": kind,
        "seed": seed,
        "eyes": str(settings.eyes),
    }


def by_kind(done: Finished[PaperSettings]) -> dict[str, list[Row]]:
    """Kind of measurement → rows."""
    kinds = dict.fromkeys(row["kind"] for row in done.rows)
    return {kind: [row for row in done.rows if row["kind"] == kind] for kind in kinds}


def paper_tasks(request: CampaignRequest, settings: PaperSettings) -> list[Task]:
    """One task for each kind of measurement and seed."""
    kinds = [TABLES[name].kind for name in settings.tables] + [figures.KINDS[f] for f in settings.figures]
    return [
        paper_task(request.config_dir, settings, kind, seed)
        for kind in dict.fromkeys(kinds)
        for seed in seeds(request)
    ]


def _comparisons(done: Finished[PaperSettings]) -> dict[str, list[Compared]]:
    rows = by_kind(done)
    return {name: comparison.compared(name, rows[TABLES[name].kind]) for name in done.settings.tables}


def paper_tables(done: Finished[PaperSettings]) -> list[rich.Table]:
    """The paper's figures and ours, side by side."""
    headings = (
        "",
        "",
        "paper, σ",
        "ours, σ",
        "runs",
        "ratio",
        "means",
    )
    return [
        table(TABLES[name].title, headings, comparison_cells(beside))
        for name, beside in _comparisons(done).items()
    ]


def paper_verdict(done: Finished[PaperSettings]) -> list[Check]:
    """Means within a factor of the paper's, and the paper's conclusions."""
    checks, band, rows = [], f"{1.0 / FACTOR:g} to {FACTOR:g}", by_kind(done)
    for name, beside in _comparisons(done).items():
        title = TABLES[name].title.partition(":")[0]
        checks += [
            Check(f"{title}, {c.part}, {c.axis}: mean over the paper's", f"{c.ratio:.2f}", band, c.reached)
            for c in beside
            if c.judged
        ]
        checks += comparison.conclusions(name, rows[TABLES[name].kind])
    return checks or [Check("measurements", str(len(done.rows)), "some", bool(done.rows))]


def paper_plot(done: Finished[PaperSettings]) -> Mapping[str, Figure]:
    """The paper's figures with ours: one measurement that is traced for each."""
    rows = by_kind(done)
    return {name: _draw_figure(name, done, rows[figures.KINDS[name]]) for name in done.settings.figures}


def _draw_figure(name: str, done: Finished[PaperSettings], rows: list[Row]) -> Figure:
    """A figure, traced with the first seed whose measurement ended well."""
    whole = next((row["seed"] for row in rows if not row["failure"]), done.request.seed)
    task = paper_task(done.request.config_dir, done.settings, figures.KINDS[name], int(whole))
    return figures.draw(name, trace(done.request.config_dir, task))


def comparison_cells(beside: list[Compared]) -> list[list[str]]:
    """One row of text for each figure."""
    return [
        [
            made.part if index == 0 or made.part != beside[index - 1].part else "",
            made.axis,
            f"{made.paper:g}" + ("" if math.isnan(made.paper_std) else f" ± {made.paper_std:.2g}"),
            f"{made.mean:.1f} ± {made.std:.1f}",
            str(made.runs),
            f"{made.ratio:.2f}",
            ("within 2" if made.reached else "OUTSIDE 2") if made.judged else "",
        ]
        for index, made in enumerate(beside)
    ]


PAPER = Experiment(
    name="paper",
    settings=PaperSettings,
    tasks=paper_tasks,
    run=measure,
    tables=paper_tables,
    verdict=paper_verdict,
    plot=paper_plot,
    runs=20,
)
