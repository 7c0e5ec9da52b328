"""The paper's tables and figures over many seeded runs: measured, compared, drawn, reported.

All of them share one directory of rows. A table or a figure asks for the measurements it is made of, ``line``
or ``match``, and those that are there are not measured again: what `table4` measured serves `table3`, `fig9`.
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

from rich.text import Text

from foundation.configuration import merged, parse_overrides
from testbed.campaigns.campaign import run_campaign
from testbed.campaigns.row_file import Row
from testbed.experiments.paper import comparison, figures, published
from testbed.experiments.paper.comparison import TABLES, Compared, Conclusion
from testbed.experiments.paper.measurement import measure, trace
from testbed.experiments.paper.report import EYES, write_comparison
from testbed.reporting.console import out, table, write_json
from testbed.scenarios.scenario import load_scenario
from testbed.scenarios.settings import load_settings

SCENARIO = "paper"
Measured = dict[str, list[Row]]


class Asked(NamedTuple):
    """What the command line asks for; ``directory`` holds rows and reports."""

    config_dir: Path
    scenario: str
    runs: int
    seed: int
    eyes: str
    assignments: list[str]
    directory: Path
    scheduler: str | None
    workers: int


def show(names: Sequence[str], asked: Asked, json_file: Path | None) -> bool:
    """Whether all that is wanted of the tables and figures called ``names`` came out; printed and reported.

    Raises ConfigurationError, or LinkLost for a scheduler that is not there.
    """
    tables = [name for name in names if name in TABLES]
    drawn = [name for name in names if name in figures.KINDS]
    kinds = dict.fromkeys([TABLES[name].kind for name in tables] + [figures.KINDS[name] for name in drawn])
    rows = {kind: measured(kind, asked) for kind in kinds}
    beside = {name: comparison.compared(name, rows[TABLES[name].kind]) for name in tables}
    concluded = {name: comparison.conclusions(name, rows[TABLES[name].kind]) for name in tables}
    pictures = {name: _drawn(name, asked, rows[figures.KINDS[name]]) for name in drawn}
    for name in tables:
        print_compared(TABLES[name].title, beside[name], concluded[name])
    for name, picture in pictures.items():
        path = asked.directory / f"{name}.png"
        path.write_bytes(picture)
        out.print(f"{name}: {published.FIGURES[name]}", highlight=False)
        out.print(f"  ours: {path}", style="dim", highlight=False, soft_wrap=True)
    print_cost(rows)
    out.print(f"eyes: {EYES[asked.eyes]}", highlight=False, soft_wrap=True)
    report = write_comparison(asked, beside, concluded, pictures, rows)
    out.print(f"report: {report}", highlight=False, soft_wrap=True)
    passed = all(_reached(beside[name], concluded[name]) for name in tables) and all(rows.values())
    write_json(json_file, {"passed": passed, "compared": beside, "conclusions": concluded, "rows": rows})
    return passed


def measured(kind: str, asked: Asked) -> list[Row]:
    """The rows of ``asked.runs`` measurements of a kind."""
    return run_tasks(asked, [task(kind, asked, seed) for seed in seeds(asked)], kind)


def run_tasks(asked: Asked, tasks: Sequence[Row], title: str) -> list[Row]:
    """The rows of measurements, in order."""
    return run_campaign(
        asked.directory,
        partial(measure, asked.config_dir),
        tasks,
        scheduler=asked.scheduler,
        workers=asked.workers,
        title=title,
    )


def seeds(asked: Asked) -> range:
    """The seeds of the runs."""
    return range(asked.seed, asked.seed + asked.runs)


def task(kind: str, asked: Asked, seed: int, variant: str = "", assignments: Sequence[str] = ()) -> Row:
    """The task of one measurement. Raises ConfigurationError when its configuration is wrong."""
    chosen = [*asked.assignments, *assignments]
    drawn = load_scenario(asked.config_dir, asked.scenario).world(seed)
    load_settings(asked.config_dir, merged(drawn, parse_overrides(chosen)))
    return {
        "key": "-".join(filter(None, (kind, asked.eyes, variant, str(seed)))),
        "kind": kind,
        "scenario": asked.scenario,
        "seed": seed,
        "eyes": asked.eyes,
        "variant": variant,
        "assignments": chosen,
    }


def _drawn(name: str, asked: Asked, rows: list[Row]) -> bytes:
    """A figure, from one measurement that is traced for it; the first seed whose measurement ends well."""
    whole = next((row["seed"] for row in rows if not row["failure"]), asked.seed)
    kind = figures.KINDS[name]
    traced = task(kind, asked, int(whole))
    (row,) = run_campaign(
        asked.directory,
        partial(trace, asked.config_dir),
        [traced | {"key": f"trace-{traced['key']}"}],
        scheduler=asked.scheduler,
        workers=1,
        title=f"{kind}, traced",
    )
    return figures.draw(name, figures.load_trace(asked.directory / row["trace.npz"]), rows)


def _reached(beside: list[Compared], concluded: list[Conclusion]) -> bool:
    return all(c.reached for c in beside if c.wanted) and all(c.holds for c in concluded)


def print_compared(title: str, beside: list[Compared], concluded: list[Conclusion]) -> None:
    """Print the paper's figures and ours, side by side."""
    columns = ["", "figure", "paper", "std", "5 %", "95 %", "ours", "std", "5 %", "95 %", "runs", "ratio", ""]
    out.print(table(title, columns, comparison_cells(beside)))
    for conclusion in concluded:
        out.print(
            Text(
                f"{'as in the paper' if conclusion.holds else 'NOT AS IN THE PAPER'}: "
                f"{conclusion.statement}: {conclusion.here}",
                style="green" if conclusion.holds else "bold red",
            ),
            soft_wrap=True,
        )


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


def print_cost(rows: Measured) -> None:
    """Print how long the runs took, and what stopped those that failed."""
    for line in costs(rows):
        out.print(line, highlight=False, soft_wrap=True)


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
