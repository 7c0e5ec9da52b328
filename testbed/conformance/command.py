"""``longreach conformance``: the suites at the terminal."""

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import Progress
from rich.table import Table

from protocol.errors import ConfigurationError
from testbed.conformance.case import Outcome
from testbed.conformance.records import as_json, write_records
from testbed.conformance.runner import Result, Summary, reference_cases, run_reference

app = typer.Typer(help="Numbered questions to any controller, each citing a clause of docs/protocol.md.")

_STYLES = {Outcome.PASS: "green", Outcome.FAIL: "bold red", Outcome.UNSUPPORTED: "yellow"}


@app.callback()
def conformance() -> None:
    """Numbered questions to any controller, each citing a clause of docs/protocol.md."""


@app.command(epilog="Example: longreach conformance reference --host 127.0.0.1 --port 47000 --records out")
def reference(
    host: Annotated[str, typer.Option(help="Where the controller is.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=1, max=65535, help="Its UDP port.")] = 47000,
    case: Annotated[list[int] | None, typer.Option(help="Only this case; repeatable.")] = None,
    motion: Annotated[
        bool, typer.Option("--motion", help="Also enable the group and move by 20 mm.")
    ] = False,
    list_cases: Annotated[bool, typer.Option("--list", help="List the cases and end.")] = False,
    records: Annotated[
        Path | None, typer.Option(help="Write JUnit, JSON and the bytes of every case into this directory.")
    ] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the results to this file.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Start of nonces and ids; 0: from the clock.")] = 0,
) -> None:
    """Ask a controller on the reference link; exit status 1 unless every supported case passes."""
    console = Console()
    if list_cases:
        _list(console)
        return
    wanted = set(case) if case else {c.number for c in reference_cases()}
    unknown = wanted - {c.number for c in reference_cases()}
    if unknown:
        raise ConfigurationError("conformance.unknown_case", f"--case {min(unknown)}: see --list")
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task("asking", total=len(wanted))

        def show(result: Result) -> None:
            progress.advance(task)
            if result.outcome is Outcome.FAIL:
                progress.console.print(_line(result))

        summary = run_reference(host, port, numbers=wanted, motion=motion, seed=seed, on_result=show)
    _print(console, summary)
    if records is not None:
        write_records(summary, records)
    if json_file is not None:
        json_file.write_text(json.dumps(as_json(summary), indent=1) + "\n")
    raise typer.Exit(0 if summary.passed else 1)


def _list(console: Console) -> None:
    table = Table("case", "clause", "moves", "question")
    for case in reference_cases():
        table.add_row(str(case.number), case.clause, "yes" if case.motion else "", escape(case.title))
    console.print(table)


def _line(result: Result) -> str:
    style = _STYLES[result.outcome]
    what = f"{result.case.number} (clause {result.case.clause}) {result.case.title}: {result.detail}"
    return f"[{style}]{result.outcome.value}[/] {escape(what)}"


def _print(console: Console, summary: Summary) -> None:
    table = Table("case", "clause", "outcome", "question", "why not")
    for result in summary.results:
        style = _STYLES[result.outcome]
        table.add_row(
            str(result.case.number),
            result.case.clause,
            f"[{style}]{result.outcome.value}[/]",
            escape(result.case.title),
            escape(result.detail),
        )
    console.print(table)
    counts = ", ".join(f"{summary.count(outcome)} {outcome.value}" for outcome in Outcome)
    console.print(f"{summary.host}:{summary.port}: {counts}")
