"""Cases and results as a terminal shows them."""

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from conformance.case import CaseOutcome, ConformanceCase
from conformance.first_hour import FirstHourStep
from conformance.outcome import Result, Summary
from conformance.records import transcript

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
            console.print("Every step passes: now ask all cases, without --first-hour.")
        return
    hint = next(step.hint for step in steps if step.number == failed.case.number)
    console.print()
    console.print(
        transcript(failed, summary.suite, _NEWEST_SHOWN), markup=False, highlight=False, soft_wrap=True
    )
    place = len(summary.results)
    console.print(f"Step {place} of {len(steps)}. To write next: {hint}", markup=False, highlight=False)
    console.print(f"Then: --case {failed.case.number}, or --first-hour again.", highlight=False)


def print_cases(cases: tuple[ConformanceCase, ...]) -> None:
    """The list of cases."""
    table = Table("case", "clause", "moves", "question")
    for case in cases:
        table.add_row(str(case.number), case.clause, "yes" if case.motion else "", escape(case.title))
    Console().print(table)


def result_line(result: Result) -> str:
    """One case on one line."""
    style = _STYLES[result.outcome]
    what = f"{result.case.number} (clause {result.case.clause}) {result.case.title}: {result.detail}"
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
    flaky = [str(r.case.number) for r in summary.results if r.outcome is CaseOutcome.FLAKY]
    if flaky:
        console.print(f"flaky, passed when asked again: {', '.join(flaky)}")
    late = summary.lateness
    figures = f"p50 {late.p50_ms:.1f}, p99 {late.p99_ms:.1f}, max {late.max_ms:.1f} ms"
    console.print(f"the tester itself was late by {figures}")
