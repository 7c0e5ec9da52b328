"""`longreach runs`: what runs there are, what made them, how two of them differ; and away with the old."""

import json
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from protocol.errors import ConfigurationError
from testbed.cli.options import DEFAULT_RUNS, JsonFile
from testbed.cli.root import CommandApp
from testbed.reporting.console import listed, out, table, write_json

if TYPE_CHECKING:
    from testbed.reporting.run_record import KeptRun

app = CommandApp(help="Runs that were kept.", no_args_is_help=True)
Runs = Annotated[Path, typer.Option("--out", help="Where directories of runs are.")]
Run = Annotated[str, typer.Argument(metavar="RUN", help="Its name, how that begins, or: last.")]
_CODE = ("version", "commit", "uncommitted", "libraries")
_SHOWN = (*_CODE, "command", "process", "machine", "changed", "format")  # in another form, or not


@app.callback()
def runs_group() -> None:
    """Runs that were kept."""


@app.command("list", epilog="Example: longreach runs list --json runs.json")
def list_command(runs: Runs = DEFAULT_RUNS, json_file: JsonFile = None) -> None:
    """All runs, the newest first: command, code, how each ended, how much room it takes."""
    from testbed.reporting.run_directory import all_runs

    found = all_runs(runs)
    columns = {
        "run": lambda run: run.directory.name,
        "command": lambda run: run.command,
        "code": lambda run: run.code,
        "s": lambda run: f"{run.facts['took_s']:.0f}" if "took_s" in run.facts else "–",
        "MB": lambda run: f"{run.size_mb:.1f}",
        "ended": lambda run: run.ending,
    }
    out.print(listed(f"runs in {runs}", columns, found))
    write_json(json_file, {"runs": [_facts(run) for run in found]})


@app.command(epilog="Example: longreach runs show last")
def show(run: Run = "last", runs: Runs = DEFAULT_RUNS, json_file: JsonFile = None) -> None:
    """One run: what made it, what in its configuration is not as shipped, and its files."""
    from testbed.reporting.run_directory import one_run

    found = one_run(runs, run)
    rows = [("command", found.command), ("code", found.code), ("ended", found.ending)]
    rows += [(key, value) for key, value in found.facts.get("machine", {}).items()]
    rows += [(key, value) for key, value in found.facts.items() if key not in _SHOWN and value != ""]
    out.print(_words(found.directory.name, ("what", ""), rows))
    changed = [(key, *map(_short, pair)) for key, pair in found.facts.get("changed", {}).items()]
    if changed:
        out.print(_words("not as shipped", ("key", "shipped", "here"), changed))
    files = sorted(path for path in found.directory.rglob("*") if path.is_file())
    sizes = [(path.relative_to(found.directory), f"{1e-3 * path.stat().st_size:.0f}") for path in files]
    out.print(table("files", ("file", "kB"), sizes))
    write_json(json_file, _facts(found))


@app.command("open", epilog="Example: longreach runs open last")
def open_command(run: Run = "last", runs: Runs = DEFAULT_RUNS) -> None:
    """Open a run's report in the browser, and print where it is."""
    from testbed.reporting.run_directory import one_run

    found = one_run(runs, run)
    report = found.directory / "report.html"
    if not report.is_file():
        why = f"{found.directory}: no report.html; it {found.ending}"
        raise ConfigurationError("runs.no_report", why)
    out.print(str(report), highlight=False, soft_wrap=True)
    webbrowser.open(report.resolve().as_uri())


def _facts(run: "KeptRun") -> dict[str, Any]:
    return {**run.facts, "run": run.directory.name, "ending": run.ending, "mb": run.size_mb}


def _short(value: Any) -> str:
    text = "–" if value is None else value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "…"


def _words(title: str, columns: tuple[str, ...], rows: list[Any]) -> Table:
    made = Table(title=title, title_justify="left")
    for column in columns:
        made.add_column(column, overflow="fold")
    for row in rows:
        made.add_row(*(_short(cell) if index else str(cell) for index, cell in enumerate(row)))
    return made
