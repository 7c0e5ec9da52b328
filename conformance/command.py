"""``longreach conformance``: the suites at the terminal."""

import json
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, NamedTuple

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import Progress
from rich.table import Table

from conformance.case import CaseOutcome, ConformanceCase, Result, Summary
from conformance.parts import BASE, OptionalPart, profile_from
from conformance.records import (
    COUPLER_STEPS,
    REFERENCE_STEPS,
    FirstHourStep,
    as_json,
    transcript,
    write_records,
)
from conformance.runner import chosen, coupler_cases, reference_cases, run_coupler, run_reference
from foundation.command_options import unfolded
from foundation.secret_source import key_from_file, known_host
from protocol.errors import ConfigurationError

SHOWN_AT_ONCE = (CaseOutcome.FAIL, CaseOutcome.FLAKY)
_STYLES = {
    CaseOutcome.PASS: "green",
    CaseOutcome.FLAKY: "magenta",
    CaseOutcome.FAIL: "bold red",
    CaseOutcome.UNSUPPORTED: "yellow",
}
_NEWEST_SHOWN = 24


def print_step(console: Console, summary: Summary, steps: tuple[FirstHourStep, ...]) -> None:
    """The failed step with its bytes and what to write for it, or what comes after the last one."""
    failed = next((r for r in summary.results if r.outcome is CaseOutcome.FAIL), None)
    if failed is None:
        if summary.results and summary.ended is None:
            console.print(_steps_passed(summary), markup=False, highlight=False)
        return
    hint = next(step.hint for step in steps if step.number == failed.case.number)
    console.print()
    console.print(
        transcript(failed, summary.suite, _NEWEST_SHOWN), markup=False, highlight=False, soft_wrap=True
    )
    place = len(summary.results)
    console.print(f"Step {place} of {len(steps)}. To write next: {hint}", markup=False, highlight=False)
    console.print(f"Then: --case {failed.case.number}, or --first-hour again.", highlight=False)


def _steps_passed(summary: Summary) -> str:
    """How many steps pass, how many were not asked and why, and what comes next."""
    unasked = Counter(r.detail for r in summary.results if r.outcome is CaseOutcome.UNSUPPORTED)
    total, left = len(summary.results), unasked.total()
    if not left:
        return f"All {total} steps pass: now ask all cases, without --first-hour."
    reasons = "; ".join(f"{count}: {why}" for why, count in unasked.most_common())
    return f"{total - left} of {total} steps pass, {left} were not asked ({reasons})."


def print_cases(cases: tuple[ConformanceCase, ...]) -> None:
    """The list of cases."""
    table = Table("case", "clause", "moves", "question")
    for case in cases:
        table.add_row(str(case.number), case.clause, "yes" if case.motion else "", escape(case.title))
    Console().print(table)


def result_line(result: Result) -> str:
    """One case on one line."""
    style = _STYLES[result.outcome]
    what = f"{result.case.number} (clause {result.case.clause}) {result.case.title}"
    if result.detail:
        what += f": {result.detail}"
    return f"[{style}]{result.outcome.value}[/] {escape(what)}"


def print_results(console: Console, summary: Summary) -> None:
    """The table of all cases, and under it what they add up to."""
    table = Table("case", "clause", "outcome", "s", "question", "why not")
    for result in summary.results:
        style = _STYLES[result.outcome]
        table.add_row(
            str(result.case.number),
            result.case.clause,
            f"[{style}]{result.outcome.value}[/]",
            f"{result.seconds:.2f}",
            escape(result.case.title),
            escape(result.detail),
        )
    console.print(table)
    counts = ", ".join(f"{summary.count(outcome)} {outcome.value}" for outcome in CaseOutcome)
    console.print(f"{summary.host}:{summary.port}: {counts}; {summary.seconds:.1f} s")
    console.print(f"the tester itself was late by at most {summary.late_ms:.1f} ms")


app = typer.Typer(help="Numbered questions to any controller or coupler, each citing a written clause.")

_PARTS = ", ".join(part.value for part in OptionalPart)


Host = Annotated[str, typer.Option(help="Where it is.")]


class Asking(NamedTuple):
    """Which cases are asked, and where the answers go."""

    case: Annotated[list[int] | None, typer.Option("--case", help="Only this case; repeatable.")] = None
    list_cases: Annotated[bool, typer.Option("--list", help="List the cases and end.")] = False
    records: Annotated[
        Path | None,
        typer.Option("--out", help="Write JUnit, JSON and the bytes of every case into this directory."),
    ] = None
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the results to this file.")] = None
    profile: Annotated[
        str | None,
        typer.Option(
            help=f"What is claimed, joined by commas, of {_PARTS}; {BASE}: none. "
            "What is claimed and missing fails, what is not claimed is not asked for."
        ),
    ] = None
    first_hour: Annotated[
        bool,
        typer.Option(
            "--first-hour", help="In the order to implement in, up to the first failure, with hints."
        ),
    ] = False


@app.command(epilog="Example: longreach conformance reference --host 127.0.0.1 --port 47000 --out answers")
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
    """Ask a controller on the reference link.

    Exit status 0: every supported case passes; 1: one does not; 2: nobody to ask, or lost on the way.
    """
    known_host(host)
    link_key = None if key is None else key_from_file(key)
    run = partial(run_reference, host, port, motion=motion, seed=seed, key=link_key)
    _ask(run, asking, reference_cases(), REFERENCE_STEPS)


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
    """Ask a bus coupler over Modbus TCP.

    Exit status 0: every supported case passes; 1: one does not; 2: nobody to ask, or lost on the way.
    """
    known_host(host)
    run = partial(run_coupler, host, port, unit=unit, outputs=outputs)
    _ask(run, asking, coupler_cases(), COUPLER_STEPS)


def _case_numbers(chosen: list[int] | None, cases: tuple[ConformanceCase, ...]) -> set[int]:
    numbers = {case.number for case in cases}
    picked = set(chosen) if chosen else numbers
    if picked - numbers:
        raise ConfigurationError("conformance.unknown_case", f"--case {min(picked - numbers)}: see --list")
    return picked


def _ask(
    run: Callable[..., Summary],
    asking: Asking,
    cases: tuple[ConformanceCase, ...],
    in_order: tuple[FirstHourStep, ...],
) -> None:
    """Runs, shows and writes; ends the command with its status, or raises LinkLost if the run broke off."""
    steps = in_order if asking.first_hour else None
    if asking.list_cases:
        print_cases(chosen(cases, None, steps))
        return
    picked = _case_numbers(asking.case, cases)
    profile = None if asking.profile is None else profile_from(asking.profile)
    console = Console()
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("asking", total=len(chosen(cases, picked, steps)))

        def show(result: Result) -> None:
            progress.advance(task)
            if asking.first_hour or result.outcome in SHOWN_AT_ONCE:
                progress.console.print(result_line(result))

        summary = run(numbers=picked, profile=profile, first_hour=asking.first_hour, on_result=show)
    if steps is not None:
        print_step(console, summary, steps)
    elif summary.results:
        print_results(console, summary)
    if asking.records is not None:
        write_records(summary, asking.records)
    if asking.json_file is not None:
        asking.json_file.write_text(json.dumps(as_json(summary), indent=1) + "\n")
    if summary.ended is not None:
        raise summary.ended
    raise typer.Exit(0 if summary.passed else 1)
