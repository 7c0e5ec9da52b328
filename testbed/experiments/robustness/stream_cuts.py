"""Many cuts of the reference stream at random moments of streamed motions, in lockstep, without pictures."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.table import Table

from protocol.faults import FaultCode
from testbed.campaigns.campaign import CampaignRequest, Task
from testbed.campaigns.experiment import Check, Experiment, Finished, seeds
from testbed.campaigns.options import Assignments, Scenario
from testbed.experiments.robustness.stream_cut_run import COMMAND_MS, CUTS, FLOW_MS, RATES_HZ, one_cut
from testbed.reporting.console import table
from testbed.scenarios.settings import chosen_overrides, load_settings


class CutSettings(NamedTuple):
    """The world that the streams are cut in."""

    scenario: Scenario = "standard"
    assignments: Assignments = None


class CutRow(NamedTuple):
    """One cut: what was drawn, and ms from the last fresh reference to the last command and to zero flow."""

    rate_hz: float
    cut: str
    speed_m_s: float
    command_ms: float
    flow_ms: float
    resumed: bool
    fault: str
    failure: str
    cpu_s: float

    @property
    def passed(self) -> bool:
        """Whether valves and oil stopped in time and for good, for the right cause; a failed run did not."""
        in_time = self.command_ms <= COMMAND_MS and self.flow_ms <= FLOW_MS
        sound = not self.resumed and self.fault == FaultCode.REFERENCE_STALE.name
        return in_time and sound and not self.failure


def cut_tasks(request: CampaignRequest, settings: CutSettings) -> list[Task]:
    """One task a seed."""
    asked = {"scenario": settings.scenario, "assignments": settings.assignments or []}
    return [{"key": f"{seed}", "seed": seed} | asked for seed in seeds(request)]


def one_run(config_dir: Path, task: Task) -> dict[str, Any]:
    """The row of one seeded cut, in the world of its scenario and seed."""
    overrides = chosen_overrides(config_dir, task["scenario"], task["seed"], task["assignments"])
    return one_cut(load_settings(config_dir, overrides), task["seed"])


Cuts = Finished[CutSettings, CutRow]


def cut_table(done: Cuts) -> list[Table]:
    """The distribution of both times, by rate, by kind of cut, and of all."""
    groups: list[tuple[str, list[CutRow]]] = [
        *((f"{rate:g} Hz", [row for row in done.rows if row.rate_hz == rate]) for rate in RATES_HZ),
        *((f"{cut} cut", [row for row in done.rows if row.cut == cut]) for cut in CUTS),
        ("all", list(done.rows)),
    ]
    columns = (
        "", "runs", "speed, m/s",
        "command: p50", "p95", "max",
        "flow: p50", "p95", "max",
        "resumed", "failed", "verdict",
    )  # fmt: skip
    title = "last fresh reference → last valve command that is not neutral, and → zero flow, ms"
    limits = ("limit", "", "", "", "", COMMAND_MS, "", "", FLOW_MS, 0, 0, "")
    return [table(title, columns, [limits, *(_line(name, group) for name, group in groups if group)])]


def _line(name: str, rows: Sequence[CutRow]) -> tuple[object, ...]:
    done = [row for row in rows if not row.failure]
    cells: list[str] = []
    for values in ([row.command_ms for row in done], [row.flow_ms for row in done]):
        cells += [f"{value:.1f}" for value in np.percentile(values or [np.nan], [50, 95, 100])]
    speeds = [row.speed_m_s for row in done] or [np.nan]
    failed = sum(not row.passed for row in rows)
    span = f"{min(speeds):.2f}…{max(speeds):.2f}"
    resumed = sum(row.resumed for row in done)
    return name, len(rows), span, *cells, resumed, failed, "FAIL" if failed else "pass"


def cut_verdict(done: Cuts) -> list[Check]:
    """No valve command and no oil for too long, nothing resumed, the fault named, in every run."""
    ended = [row for row in done.rows if not row.failure]
    command, flow = (
        max([getattr(row, name) for row in ended], default=np.nan) for name in ("command_ms", "flow_ms")
    )
    good = sum(row.passed for row in done.rows)
    return [
        Check(
            "last valve command, worst", f"{command:.1f} ms", f"≤ {COMMAND_MS:g} ms", command <= COMMAND_MS
        ),
        Check("zero flow, worst", f"{flow:.1f} ms", f"≤ {FLOW_MS:g} ms", flow <= FLOW_MS),
        Check(
            "cuts that stopped in time and for good, with the fault REFERENCE_STALE",
            f"{good} of {len(done.rows)}",
            "all",
            good == len(done.rows),
        ),
    ]


def cut_figures(done: Cuts) -> dict[str, Any]:
    """The limits, beside the rows."""
    return {"first_seed": done.request.seed, "command_ms": COMMAND_MS, "flow_ms": FLOW_MS}


STREAM_CUTS = Experiment(
    name="stream-cuts",
    title="Cut the reference stream at random moments.",
    settings=CutSettings,
    row=CutRow,
    tasks=cut_tasks,
    run=one_run,
    table=cut_table,
    verdict=cut_verdict,
    figures=cut_figures,
    runs=459,
    eyes="none",
)
