"""How every demonstration ends: a table, a verdict, a report, and figures as JSON."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from rich.table import Table
from rich.text import Text

from plant_emulator.core.faults.schedule import FaultOrder
from testbed.reporting import outcome as outcomes
from testbed.reporting.console import out, write_json
from testbed.reporting.outcome import Outcome
from testbed.reporting.plots import Traces
from testbed.reporting.report import Picture, write_report
from testbed.reporting.run_record import note
from testbed.scenarios.named_requests import NamedRequest


class Choice(NamedTuple):
    """What a demonstration is asked for; ``holes``: to drive to three drill holes, not to the object.

    ``programs``: to run after the orientation adjustment, in place of calibration and looks. ``faults``: what
    breaks, counted from the start.
    """

    scenario: str
    seed: int
    looks: int
    holes: bool = False
    programs: tuple[NamedRequest, ...] = ()
    faults: tuple[FaultOrder, ...] = ()


def outcome_table(outcome: Outcome) -> Table:
    """The stages with image-based and true errors."""
    table = Table(
        title=f"error of the tool at the object, mm and degrees ({outcome.mode})", title_justify="left"
    )
    for index, heading in enumerate(outcomes.HEADINGS):
        table.add_column(heading, justify="left" if index == 0 else "right", no_wrap=True)
    for row in outcomes.rows(outcome.stages):
        table.add_row(*row)
    return table


def present(
    directory: Path,
    outcome: Outcome,
    traces: Traces,
    pictures: Sequence[Picture],
    events: Sequence[Mapping[str, Any]],
    json_file: Path | None,
) -> bool:
    """Whether ``outcome`` has passed; its table, verdict and report are out."""
    known = ("mode", "scenario", "seed", "passed", "simulated_s")
    told = {name: getattr(outcome, name) for name in known}
    note(directory, **told, verdict=outcomes.verdict(outcome))
    report = write_report(directory, outcome, traces, pictures, events)
    out.print(outcome_table(outcome))
    for stage in outcome.stages:
        if stage.note:
            out.print(Text(f"{stage.label}: {stage.note}", style="dim"))
    for fault in outcome.details.get("faults", ()):
        out.print(Text(f"fault in the plant: {fault['name']} {fault['fault']}", style="bold yellow"))
    if "overload" in outcome.details:
        out.print(Text(outcome.details["overload"], style="bold yellow"))
    if "failure" in outcome.details:
        out.print(Text(f"stopped by: {outcome.details['failure']}", style="bold red"))
    out.print(Text(outcomes.verdict(outcome), style="bold green" if outcome.passed else "bold red"))
    speed = outcome.simulated_s / outcome.wall_s
    out.print(f"{outcome.simulated_s:.1f} s of arm time in {outcome.wall_s:.1f} s ({speed:.2f} × real time)")
    out.print(f"report: {report}", highlight=False, soft_wrap=True)
    write_json(json_file, outcomes.figures(outcome))
    return outcome.passed


def read_events(directory: Path) -> list[dict[str, Any]]:
    """The events that a service recorded into ``directory``; none where it could not."""
    path = directory / "events.jsonl"
    if not path.is_file():
        return []
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
