"""Markdown tables for the generated parts of pages."""

from collections.abc import Iterable

from conformance.case import ConformanceCase


def table(head: str, rows: Iterable[Iterable[object]]) -> str:
    """A Markdown table."""
    columns = [cell.strip() for cell in head.split("|")]
    head, *body = ("| " + " | ".join(map(str, line)) + " |" for line in (columns, *rows))
    return "\n".join([head, "|---" * len(columns) + "|", *body])


def cases_by_clause(cases: Iterable[ConformanceCase]) -> str:
    """The numbers of the cases that cite each clause; ``*``: it moves the arm, or writes outputs."""
    numbers: dict[str, list[str]] = {}
    for case in cases:
        numbers.setdefault(case.clause, []).append(f"{case.number}{'*' if case.motion else ''}")
    order = sorted(numbers, key=lambda clause: [int(part) for part in clause.split(".")])
    return "\n".join(["```text", *(f"{clause:>5}  {' '.join(numbers[clause])}" for clause in order), "```"])
