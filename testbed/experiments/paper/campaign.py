"""The paper's tables and figures over many seeded runs: measured, compared, drawn, reported.

All of them share one directory of rows. A table or a figure asks for the measurements it is made of, ``line``
or ``match``, and those that are there are not measured again: what `table4` measured serves `table3`, `fig9`.
"""

from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer
from matplotlib.figure import Figure
from rich import table as rich

from foundation.configuration import merged, parse_overrides
from testbed.campaigns.campaign import CampaignRequest, Task, run_campaign
from testbed.campaigns.experiment import Check, Experiment, Finished, seeds
from testbed.campaigns.options import Assignments, Scenario
from testbed.campaigns.row_file import Row
from testbed.experiments.catalogue import PAPER as ALL_PARTS
from testbed.experiments.catalogue import PAPER_PARTS
from testbed.experiments.paper import comparison, figures, published
from testbed.experiments.paper.comparison import FACTOR, TABLES, Compared
from testbed.experiments.paper.measurement import measure, trace
from testbed.experiments.paper.report import write_comparison
from testbed.reporting.console import out, table
from testbed.scenarios.scenario import load_scenario
from testbed.scenarios.settings import load_settings

OUT = Path("runs/paper")
Measured = dict[str, list[Row]]


class PaperEyes(StrEnum):
    """What measures the markers."""

    OPENCV = "opencv"
    PIXELS = "pixels"
    MODEL = "model"


class PaperSettings(NamedTuple):
    """The world that is measured in, and what measures."""

    eyes: Annotated[
        PaperEyes,
        typer.Option(
            help="opencv: rendered pictures, markers as in the paper; pixels: rendered pictures, Longreach's "
            "markers; model: no pictures, errors as measured from them."
        ),
    ] = PaperEyes.OPENCV
    scenario: Scenario = "paper"
    assignments: Assignments = None


Paper = Finished[PaperSettings, Row]


def paper_task(
    config_dir: Path,
    settings: PaperSettings,
    kind: str,
    seed: int,
    variant: str = "",
    assignments: Sequence[str] = (),
) -> Task:
    """The task of one measurement. Raises ConfigurationError when its configuration is wrong."""
    chosen = [*(settings.assignments or []), *assignments]
    drawn = load_scenario(config_dir, settings.scenario).world(seed)
    load_settings(config_dir, merged(drawn, parse_overrides(chosen)))
    return {
        "key": "-".join(filter(None, (kind, settings.eyes, variant, str(seed)))),
        "kind": kind,
        "scenario": settings.scenario,
        "seed": seed,
        "eyes": str(settings.eyes),
        "variant": variant,
        "assignments": chosen,
    }


def kinds_of(names: Sequence[str]) -> list[str]:
    """The kinds of measurement that tables and figures are made of."""
    return list(dict.fromkeys(TABLES[name].kind if name in TABLES else figures.KINDS[name] for name in names))


def by_kind(done: Finished[Any, Row]) -> Measured:
    """Kind of measurement → rows."""
    rows: Measured = {}
    for asked, row in zip(done.tasks, done.rows, strict=True):
        rows.setdefault(asked["kind"], []).append(row)
    return rows


def paper_tasks(names: Sequence[str], request: CampaignRequest, settings: PaperSettings) -> list[Task]:
    """One task for each kind of measurement and seed."""
    return [
        paper_task(request.config_dir, settings, kind, seed)
        for kind in kinds_of(names)
        for seed in seeds(request)
    ]


def paper_tables(names: Sequence[str], done: Paper) -> list[rich.Table]:
    """The paper's figures and ours, side by side, and what the runs took."""
    rows = by_kind(done)
    columns = ("", "", "paper", "5 %", "median", "95 %", "ours", "σ", "5 %", "95 %", "runs", "ratio", "means")
    tables = [
        table(
            TABLES[name].title, columns, comparison_cells(comparison.compared(name, rows[TABLES[name].kind]))
        )
        for name in names
        if name in TABLES
    ]
    cost = [[line] for line in costs(rows)]
    return [*tables, table("what it took", ("",), cost)]


def paper_verdict(names: Sequence[str], done: Paper) -> list[Check]:
    """Means within a factor of the paper's, and the paper's conclusions."""
    rows, checks = by_kind(done), []
    for name in filter(TABLES.__contains__, names):
        for c in comparison.compared(name, rows[TABLES[name].kind]):
            if c.wanted:
                what = f"{c.table.partition(':')[0]}, {c.part}, {c.name}: mean over the paper's"
                checks.append(Check(what, f"{c.ratio:.2f}", f"{1.0 / FACTOR:g} to {FACTOR:g}", c.reached))
        concluded = comparison.conclusions(name, rows[TABLES[name].kind])
        checks += [Check(each.statement, each.here, "the same", each.holds) for each in concluded]
    return checks or [Check("measurements", f"{sum(map(len, rows.values()))}", "some", all(rows.values()))]


def paper_plot(names: Sequence[str], done: Paper) -> Mapping[str, Figure]:
    """The paper's figures with ours; they and the tables are in one HTML file too."""
    rows = by_kind(done)
    drawn = {name: _drawn(name, done, rows[figures.KINDS[name]]) for name in names if name in figures.KINDS}
    tables = [name for name in names if name in TABLES]
    beside = {name: comparison.compared(name, rows[TABLES[name].kind]) for name in tables}
    concluded = {name: comparison.conclusions(name, rows[TABLES[name].kind]) for name in tables}
    for name in drawn:
        out.print(f"{name}: {published.FIGURES[name]}", highlight=False)
    report = write_comparison(done.request, done.settings, (beside, concluded), drawn, rows)
    out.print(f"report: {report}", highlight=False, soft_wrap=True)
    return drawn


def paper_figures(names: Sequence[str], done: Paper) -> dict[str, Any]:
    """Comparisons and conclusions."""
    rows = by_kind(done)
    tables = [name for name in names if name in TABLES]
    return {
        "compared": {name: comparison.compared(name, rows[TABLES[name].kind]) for name in tables},
        "conclusions": {name: comparison.conclusions(name, rows[TABLES[name].kind]) for name in tables},
        "rows": rows,
    }


def _drawn(name: str, done: Paper, rows: list[Row]) -> Figure:
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
            ("within 2" if made.reached else "OUTSIDE 2") if made.wanted else "",
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


def _experiment(name: str, title: str, names: Sequence[str]) -> Experiment[PaperSettings, Row]:
    def of(function: Callable[..., Any]) -> Callable[..., Any]:
        return partial(function, names)

    return Experiment(
        name=name,
        title=title,
        settings=PaperSettings,
        row=dict,
        tasks=of(paper_tasks),
        run=measure,
        table=of(paper_tables),
        verdict=of(paper_verdict),
        plot=of(paper_plot),
        page=False,
        figures=of(paper_figures),
        runs=20,
        out=OUT,
    )


PAPER = _experiment("paper", ALL_PARTS, tuple(PAPER_PARTS))
TABLE2, TABLE3, TABLE4, FIG5, FIG6, FIG7, FIG8, FIG9 = (
    _experiment(name, title, (name,)) for name, title in PAPER_PARTS.items()
)
