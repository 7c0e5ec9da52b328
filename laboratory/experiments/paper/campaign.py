"""The paper's tables and figures over many seeded runs: measured, compared, drawn, reported.

All of them share one directory of rows. A table or a figure asks for the measurements it is made of, ``line``
or ``match``, and those that are there are not measured again.
"""

from collections.abc import Mapping, Sequence
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer
from matplotlib.figure import Figure
from rich import table as rich

from foundation.configuration import merged, parse_overrides
from laboratory.campaigns.campaign import CampaignRequest, run_campaign
from laboratory.campaigns.experiment import Assignments, Check, Experiment, Finished, Scenario, seeds
from laboratory.campaigns.rows import Row
from laboratory.campaigns.workforce import Task
from laboratory.experiments.paper import comparison, figures
from laboratory.experiments.paper.comparison import FACTOR, TABLES, Compared, Conclusion
from laboratory.experiments.paper.measurement import measure, trace
from testbed.reporting.console import out, table
from testbed.reporting.plots import svg
from testbed.reporting.report import rendered
from testbed.reporting.run_record import KeptRun, beginning
from testbed.scenarios.scenario import load_scenario, load_settings

Measured = dict[str, list[Row]]


class PaperEyes(StrEnum):
    """What measures the markers."""

    OPENCV = "opencv"
    PIXELS = "pixels"
    MODEL = "model"


EYES = {
    PaperEyes.OPENCV: "rendered pictures, markers by OpenCV from the left lens as in the paper",
    PaperEyes.PIXELS: "rendered pictures, markers by Longreach's own stereo edges",
    PaperEyes.MODEL: "no pictures: an eye model whose noise and failures were measured from pictures",
}
PaperPart = StrEnum("PaperPart", {name: name for name in (*TABLES, *figures.KINDS)})  # type: ignore[misc]


class PaperSettings(NamedTuple):
    """What of the paper, the world that is measured in, and what measures."""

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
    scenario: Scenario = "paper"
    assignments: Assignments = None

    @property
    def tables(self) -> list[str]:
        """The tables that are wanted."""
        return [name for name in TABLES if not self.part or name in self.part]

    @property
    def figures(self) -> list[str]:
        """The figures that are wanted."""
        return [name for name in figures.KINDS if not self.part or name in self.part]


Paper = Finished[PaperSettings, Row]


def paper_task(config_dir: Path, settings: PaperSettings, kind: str, seed: int) -> Task:
    """The task of one measurement. Raises ConfigurationError when its configuration is wrong."""
    chosen = settings.assignments or []
    drawn = load_scenario(config_dir, settings.scenario).world(seed)
    load_settings(config_dir, merged(drawn, parse_overrides(chosen)))
    return {
        "key": f"{kind}-{settings.eyes}-{seed}",
        "kind": kind,
        "scenario": settings.scenario,
        "seed": seed,
        "eyes": str(settings.eyes),
        "assignments": chosen,
    }


def by_kind(done: Finished[Any, Row]) -> Measured:
    """Kind of measurement → rows."""
    rows: Measured = {}
    for asked, row in zip(done.tasks, done.rows, strict=True):
        rows.setdefault(asked["kind"], []).append(row)
    return rows


def paper_tasks(request: CampaignRequest, settings: PaperSettings) -> list[Task]:
    """One task for each kind of measurement and seed."""
    kinds = [TABLES[name].kind for name in settings.tables] + [figures.KINDS[f] for f in settings.figures]
    return [
        paper_task(request.config_dir, settings, kind, seed)
        for kind in dict.fromkeys(kinds)
        for seed in seeds(request)
    ]


def _comparisons(done: Paper) -> dict[str, list[Compared]]:
    rows = by_kind(done)
    return {name: comparison.compared(name, rows[TABLES[name].kind]) for name in done.settings.tables}


def _conclusions(done: Paper) -> dict[str, list[Conclusion]]:
    rows = by_kind(done)
    return {name: comparison.conclusions(name, rows[TABLES[name].kind]) for name in done.settings.tables}


def paper_tables(done: Paper) -> list[rich.Table]:
    """The paper's figures and ours, side by side, and what the runs took."""
    columns = ("", "", "paper", "5 %", "median", "95 %", "ours", "σ", "5 %", "95 %", "runs", "ratio", "means")
    tables = [
        table(TABLES[name].title, columns, comparison_cells(beside))
        for name, beside in _comparisons(done).items()
    ]
    rows = by_kind(done)
    if "table3" in done.settings.tables and (
        sentence := comparison.residuals_tell(rows[TABLES["table3"].kind])
    ):
        tables.append(table("do residuals reveal the rotation's error (our question)", ("",), [[sentence]]))
    return [*tables, table("what it took", ("",), [[line] for line in costs(rows)])]


def paper_verdict(done: Paper) -> list[Check]:
    """Means within a factor of the paper's, and the paper's conclusions."""
    rows, concluded, checks = by_kind(done), _conclusions(done), []
    for name, beside in _comparisons(done).items():
        for c in beside:
            if c.judged:
                what = f"{c.table.partition(':')[0]}, {c.part}, {c.name}: mean over the paper's"
                checks.append(Check(what, f"{c.ratio:.2f}", f"{1.0 / FACTOR:g} to {FACTOR:g}", c.reached))
        checks += [Check(each.statement, each.here, "the same", each.holds) for each in concluded[name]]
    return checks or [Check("measurements", f"{sum(map(len, rows.values()))}", "some", all(rows.values()))]


def paper_plot(done: Paper) -> Mapping[str, Figure]:
    """The paper's figures with ours; they and the tables are in one HTML file too."""
    rows = by_kind(done)
    drawn = {name: _draw_figure(name, done, rows[figures.KINDS[name]]) for name in done.settings.figures}
    for name in drawn:
        out.print(f"{name}: {figures.FIGURES[name]}", highlight=False)
    report = write_comparison(done, drawn)
    out.print(f"report: {report}", highlight=False, soft_wrap=True)
    return drawn


def write_comparison(done: Paper, drawn: Mapping[str, Figure]) -> Path:
    """The HTML file in the request's ``out``: tables side by side, conclusions, figures, and every run."""
    concluded, beside = _conclusions(done), _comparisons(done)
    html = rendered(
        "comparison.html.j2",
        request=done.request,
        settings=done.settings,
        eyes=EYES[done.settings.eyes],
        tables=[(TABLES[name].title, beside[name], concluded[name]) for name in beside],
        figures=[(name, figures.FIGURES[name], svg(figure, name)) for name, figure in drawn.items()],
        kinds=[(kind, _columns(rows), rows) for kind, rows in by_kind(done).items()],
        run=KeptRun(done.request.out, beginning()),
    )
    path: Path = done.request.out / f"{'-'.join([*beside, *drawn])}.html"
    path.write_text(html, encoding="utf-8")
    return path


def _columns(rows: Sequence[Row]) -> list[str]:
    """What is told of every run: its seed, its errors after each input, and what stopped it."""
    wanted = ["seed", "configuration", "payload_kg", "mount_deg", "rotation_error_deg"]
    wanted += [f"{stage}_{axis}_mm" for stage in ("input1", "input2") for axis in "xyz"]
    wanted += ["run_s", "failure"]
    return [column for column in wanted if any(row.get(column) is not None for row in rows)]


def _draw_figure(name: str, done: Paper, rows: list[Row]) -> Figure:
    """A figure, from one measurement that is traced for it; the first seed whose measurement ends well."""
    request = done.request
    whole = next((row["seed"] for row in rows if not row["failure"]), request.seed)
    kind = figures.KINDS[name]
    traced = paper_task(request.config_dir, done.settings, kind, int(whole))
    made = run_campaign(
        request,
        partial(trace, request.config_dir),
        [traced | {"key": f"trace-{traced['key']}"}],
        f"{kind}, traced",
    )
    return figures.draw(name, figures.load_trace(request.out / made.rows[0]["trace.npz"]), rows)


def comparison_cells(beside: list[Compared]) -> list[list[str]]:
    """One row of text for each figure."""
    return [
        [
            made.part if index == 0 or made.part != beside[index - 1].part else "",
            made.name,
            f"{made.paper.mean:g}",
            *(("–",) * 3 if made.paper.spread is None else (f"{value:.1f}" for value in made.paper.spread)),
            *(f"{value:.1f}" for value in (made.mean, made.std, made.p5, made.p95)),
            str(made.runs),
            f"{made.ratio:.2f}",
            ("within 2" if made.reached else "OUTSIDE 2") if made.judged else "",
        ]
        for index, made in enumerate(beside)
    ]


def costs(rows: Measured) -> list[str]:
    """Sentences on time and failures."""
    told = []
    for kind, done in rows.items():
        run_s, cpu_s = (comparison.values(done, column) for column in ("run_s", "cpu_s"))
        failed = [row for row in done if row["failure"]]
        told.append(
            f"{kind}: {len(done)} runs, {run_s.mean():.1f} s and {cpu_s.mean():.1f} CPU s a run, "
            f"{len(failed)} failed"
        )
        told += [f"  seed {row['seed']}: {row['failure']}" for row in failed]
    return told


PAPER = Experiment(
    name="paper",
    title="Tables and figures of Mäkinen et al. 2023.",
    settings=PaperSettings,
    row=dict,
    tasks=paper_tasks,
    run=measure,
    table=paper_tables,
    verdict=paper_verdict,
    plot=paper_plot,
    figures=lambda done: {
        "compared": _comparisons(done),
        "conclusions": _conclusions(done),
        "rows": by_kind(done),
    },
    runs=20,
)
