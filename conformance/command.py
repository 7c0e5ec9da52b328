"""``longreach conformance``: the suites at the terminal."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, NamedTuple

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import Progress
from rich.table import Table

from conformance.case import CaseOutcome, ConformanceCase
from conformance.records import as_json, write_records
from conformance.runner import Result, Summary, coupler_cases, reference_cases, run_coupler, run_reference
from foundation.command_options import unfolded
from foundation.hosts import known_host
from foundation.link_key import key_from_file
from protocol.errors import ConfigurationError

app = typer.Typer(help="Numbered questions to any controller or coupler, each citing a written clause.")

_STYLES = {CaseOutcome.PASS: "green", CaseOutcome.FAIL: "bold red", CaseOutcome.UNSUPPORTED: "yellow"}


@app.callback()
def conformance() -> None:
    """Numbered questions to any controller or coupler, each citing a written clause."""


Host = Annotated[str, typer.Option(help="Where it is.")]


class Asking(NamedTuple):
    """Which cases are asked, and where the answers go."""

    case: Annotated[list[int] | None, typer.Option("--case", help="Only this case; repeatable.")] = None
    list_cases: Annotated[bool, typer.Option("--list", help="List the cases and end.")] = False
    records: Annotated[
        Path | None, typer.Option(help="Write JUnit, JSON and the bytes of every case into this directory.")
    ] = None
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the results to this file.")] = None


@app.command(epilog="Example: longreach conformance reference --host 127.0.0.1 --port 47000 --records out")
@unfolded
def reference(
    asking: Asking,
    host: Host = "127.0.0.1",
    port: Annotated[int, typer.Option(min=1, max=65535, help="Its UDP port.")] = 47000,
    motion: Annotated[
        bool, typer.Option("--motion", help="Also enable the group and move by 20 mm.")
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="Start of nonces and ids; 0: from the clock.")] = 0,
    key: Annotated[
        Path | None, typer.Option(help="File with the shared key: every session is authenticated.")
    ] = None,
) -> None:
    """Ask a controller on the reference link; exit status 1 unless every supported case passes."""
    if asking.list_cases:
        _list(reference_cases())
        return
    known_host(host)
    wanted = _wanted(asking.case, reference_cases())
    link_key = None if key is None else key_from_file(key)

    def run(show: Callable[[Result], None]) -> Summary:
        return run_reference(
            host, port, numbers=wanted, motion=motion, seed=seed, key=link_key, on_result=show
        )

    _finish(len(wanted), run, asking)


@app.command(epilog="Example: longreach conformance coupler --host 127.0.0.1 --port 1502 --outputs")
@unfolded
def coupler(
    asking: Asking,
    host: Host = "127.0.0.1",
    port: Annotated[int, typer.Option(min=1, max=65535, help="Its Modbus TCP port.")] = 1502,
    unit: Annotated[int, typer.Option(min=0, max=255, help="The unit id to address.")] = 1,
    outputs: Annotated[
        bool, typer.Option("--outputs", help="Also write outputs and let the watchdog expire.")
    ] = False,
) -> None:
    """Ask a bus coupler over Modbus TCP; exit status 1 unless every supported case passes."""
    if asking.list_cases:
        _list(coupler_cases())
        return
    known_host(host)
    wanted = _wanted(asking.case, coupler_cases())

    def run(show: Callable[[Result], None]) -> Summary:
        return run_coupler(host, port, unit=unit, numbers=wanted, outputs=outputs, on_result=show)

    _finish(len(wanted), run, asking)


def _wanted(chosen: list[int] | None, cases: tuple[ConformanceCase, ...]) -> set[int]:
    numbers = {case.number for case in cases}
    wanted = set(chosen) if chosen else numbers
    if wanted - numbers:
        raise ConfigurationError("conformance.unknown_case", f"--case {min(wanted - numbers)}: see --list")
    return wanted


def _finish(total: int, run: Callable[[Callable[[Result], None]], Summary], asking: Asking) -> None:
    console = Console()
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task("asking", total=total)

        def show(result: Result) -> None:
            progress.advance(task)
            if result.outcome is CaseOutcome.FAIL:
                progress.console.print(_line(result))

        summary = run(show)
    _print(console, summary)
    if asking.records is not None:
        write_records(summary, asking.records)
    if asking.json_file is not None:
        asking.json_file.write_text(json.dumps(as_json(summary), indent=1) + "\n")
    raise typer.Exit(0 if summary.passed else 1)


def _list(cases: tuple[ConformanceCase, ...]) -> None:
    table = Table("case", "clause", "moves", "question")
    for case in cases:
        table.add_row(str(case.number), case.clause, "yes" if case.motion else "", escape(case.title))
    Console().print(table)


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
    counts = ", ".join(f"{summary.count(outcome)} {outcome.value}" for outcome in CaseOutcome)
    console.print(f"{summary.host}:{summary.port}: {counts}")
