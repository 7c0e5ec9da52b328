"""`longreach runs`: what runs there are, what made them, how two of them differ; and away with the old."""

import json
import shutil
import webbrowser
from collections.abc import Mapping
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


@app.command(epilog="Example: longreach runs compare 20261122-2101 last")
def compare(first: Run, second: Run, runs: Runs = DEFAULT_RUNS, json_file: JsonFile = None) -> None:
    """How two runs differ: in what made them, in configuration, and in the error after each stage."""
    from testbed.reporting.run_directory import one_run

    one, other = one_run(runs, first), one_run(runs, second)
    facts = _differences(_comparable(one), _comparable(other))
    settings = _differences(
        *({key: pair[1] for key, pair in run.facts.get("changed", {}).items()} for run in (one, other))
    )
    names = (one.directory.name, other.directory.name)
    out.print(_words("what made them", ("what", *names), facts))
    out.print(_words("configuration; – is as shipped", ("key", *names), settings))
    stages = _stages(one, other)
    if stages:
        out.print(table("true error after each stage, x y z in mm", ("stage", *names), stages))
    keys = ("key", "first", "second")
    document = {"facts": facts, "settings": settings, "stages": stages}
    write_json(
        json_file,
        {name: [dict(zip(keys, row, strict=True)) for row in rows] for name, rows in document.items()},
    )


@app.command(epilog="Example: longreach runs clean --keep 20 --yes")
def clean(
    keep: Annotated[int, typer.Option(min=0, help="So many of the newest stay.")] = 10,
    yes: Annotated[bool, typer.Option("--yes", help="Remove them; without, only say which.")] = False,
    runs: Runs = DEFAULT_RUNS,
    json_file: JsonFile = None,
) -> None:
    """Remove all runs but the newest. One that is still running stays, and so does whatever is no run."""
    from testbed.reporting.run_directory import all_runs, write_index

    old = [run for run in all_runs(runs)[keep:] if not run.is_running]
    room_mb = sum(run.size_mb for run in old)
    if yes:
        for run in old:
            shutil.rmtree(run.directory)
        if old:
            write_index(runs)
    done = "removed" if yes else "would be removed; --yes removes them"
    out.print(f"{len(old)} runs, {room_mb:.0f} MB, {done}", highlight=False)
    for run in old:
        out.print(f"  {run.directory}", highlight=False, soft_wrap=True)
    write_json(json_file, {"removed": yes, "runs": [str(run.directory) for run in old], "mb": room_mb})


@app.command("open", epilog="Example: longreach runs open last")
def open_command(run: Run = "last", runs: Runs = DEFAULT_RUNS) -> None:
    """Open a run's report in the browser, or with `all` the page of all runs, and print where it is."""
    from testbed.reporting.run_directory import one_run, write_index

    if run == "all":
        report = write_index(runs)
    else:
        found = one_run(runs, run)
        report = found.directory / "report.html"
        if not report.is_file():
            why = f"{found.directory}: no report.html; it {found.ending}"
            raise ConfigurationError("runs.no_report", why)
    out.print(str(report), highlight=False, soft_wrap=True)
    webbrowser.open(report.resolve().as_uri())


def _facts(run: "KeptRun") -> dict[str, Any]:
    return {**run.facts, "run": run.directory.name, "ending": run.ending, "mb": run.size_mb}


def _comparable(run: "KeptRun") -> dict[str, Any]:
    kept = {key: value for key, value in run.facts.items() if key not in _SHOWN}
    return {"command": run.command, "code": run.code, **run.facts.get("machine", {}), **kept}


def _differences(one: Mapping[str, Any], other: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    keys = [*one, *(key for key in other if key not in one)]
    return [
        (key, _short(one.get(key)), _short(other.get(key))) for key in keys if one.get(key) != other.get(key)
    ]


def _stages(one: "KeptRun", other: "KeptRun") -> list[tuple[str, str, str]]:
    first, second = _errors(one), _errors(other)
    return [(label, first.get(label, "–"), second.get(label, "–")) for label in {**first, **second}]


def _errors(run: "KeptRun") -> dict[str, str]:
    try:
        stages = json.loads((run.directory / "figures.json").read_text(encoding="utf-8"))["stages"]
    except (OSError, ValueError, KeyError):
        return {}
    return {each["label"]: _millimetres(each["true"]) for each in stages}


def _millimetres(error: Mapping[str, float | None]) -> str:
    places = (error[f"{axis}_mm"] for axis in "xyz")
    return " ".join("–" if place is None else f"{place:+.2f}" for place in places)


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
