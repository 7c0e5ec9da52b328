"""What an experiment was to reach, said beside what it did reach."""

from pathlib import Path
from typing import Any, NamedTuple

from testbed.reporting.console import out, write_json


class Check(NamedTuple):
    """One thing that was wanted: what, what came out, and whether that is enough."""

    what: str
    value: str
    passed: bool


def concluded(checks: list[Check], figures: dict[str, Any], json_file: Path | None) -> bool:
    """Whether all ``checks`` passed; they are printed, and written with the figures."""
    for check in checks:
        out.print(
            f"{'reached' if check.passed else 'MISSED '}  {check.what}: {check.value}",
            style="green" if check.passed else "bold red",
            highlight=False,
            soft_wrap=True,
        )
    passed = all(check.passed for check in checks)
    write_json(json_file, figures | {"checks": [c._asdict() for c in checks], "passed": passed})
    return passed
