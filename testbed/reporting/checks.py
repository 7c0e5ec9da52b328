"""What `longreach arm check` tells: one line for each thing that was looked at."""

from collections.abc import Iterable
from typing import Literal, NamedTuple

from rich.table import Table
from rich.text import Text

Verdict = Literal["ok", "warning", "failed"]
_STYLES = {"ok": "green", "warning": "yellow", "failed": "bold red"}


class HealthCheck(NamedTuple):
    """One line: what was looked at, the verdict, what was found, what to do about what is wrong."""

    name: str
    verdict: Verdict
    found: str
    advice: str = ""


def checks_table(title: str, checks: Iterable[HealthCheck]) -> Table:
    """A line for each check, its verdict in colour."""
    made = Table(title=title, title_justify="left")
    for heading in ("check", "verdict", "found", "advice"):
        made.add_column(heading, overflow="fold")
    for one in checks:
        made.add_row(one.name, Text(one.verdict, _STYLES[one.verdict]), one.found, one.advice)
    return made
