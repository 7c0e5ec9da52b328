"""``longreach experiment robustness --method attacks``: what strangers can do to running services."""

import time
from collections.abc import Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np
from rich.table import Table
from typer import Option

from testbed.campaigns.campaign import CampaignRequest, Task
from testbed.campaigns.experiment import Check, Experiment, Finished
from testbed.campaigns.options import Assignments
from testbed.experiments.robustness.attacks.strangers import ATTACKS
from testbed.experiments.robustness.attacks.trial import SECONDS, one_trial
from testbed.reporting.console import table

NONE = "none"
STOP_P99_MS = 250.0  # over HTTP, connection included, on a machine that the attacker shares


class AttackSettings(NamedTuple):
    """Which attacks, and on which services."""

    only: Annotated[list[str] | None, Option("--only", help="This attack alone; repeatable.")] = None
    assignments: Assignments = None


class AttackRow(NamedTuple):
    """What became of a motion, of stops and of the controller's periods while one attack went on.

    ``stop_ms``: each POST /stop, from the connection to the answer. ``answers``: what the attacker got.
    """

    attack: str
    motion: str
    stops: int
    stops_failed: int
    stop_ms: list[float]
    scans: int
    overruns: int
    exchange_failures: int
    answers: dict[str, int]
    failure: str

    def percentile_ms(self, percent: float) -> float:
        """Within how long so many of the stops were answered; NaN where none was asked for."""
        return float(np.percentile(self.stop_ms, percent)) if self.stop_ms else float("nan")


Attacked = Finished[AttackSettings, AttackRow]


def attack_tasks(request: CampaignRequest, settings: AttackSettings) -> list[Task]:
    """One task an attack, that of none first. Real time is never measured already."""
    begun = time.strftime("%Y%m%d-%H%M%S")
    chosen = [name for name in ATTACKS if name == NONE or name in (settings.only or ATTACKS)]
    directory = request.out.absolute() / begun
    asked = {"assignments": settings.assignments or []}
    return [{"key": f"{begun} {n}", "attack": n, "directory": str(directory / n)} | asked for n in chosen]


def attack_table(done: Attacked) -> list[Table]:
    """A line for each attack."""
    lines: list[Sequence[Any]] = []
    for row in done.rows:
        if row.failure:
            continue
        waits = "/".join(f"{row.percentile_ms(p):.0f}" for p in (50, 99, 100))
        got = ", ".join(f"{count} {what}" for what, count in row.answers.items())
        lines.append(
            (row.attack, row.motion, row.stops, row.stops_failed, waits,
             f"{row.overruns} of {row.scans}", row.exchange_failures, got)
        )  # fmt: skip
    columns = ("attack", "motion", "stops", "failed", "stop p50/p99/max ms", "scans late", "exchanges failed",
               "what the attacker got")  # fmt: skip
    return [table(f"{SECONDS:g} s of each attack, from another process of this machine", columns, lines)]


def attack_verdict(done: Attacked) -> list[Check]:
    """No attack ends a motion, fails or delays a stop, or fails an exchange."""
    rows = [row for row in done.rows if not row.failure and row.attack != NONE]
    moved = [row.attack for row in rows if row.motion != "succeeded"]
    unstopped = [row.attack for row in rows if row.stops_failed or not row.stops]
    late = [row.attack for row in rows if not row.percentile_ms(99) <= STOP_P99_MS]
    missed = [row.attack for row in rows if row.exchange_failures]
    return [
        _none("attacks that could not be tried", [row.attack for row in done.rows if row.failure]),
        _none("attacks that ended a motion", moved),
        _none("attacks under which a stop was not accepted", unstopped),
        _none(f"attacks under which the p99 of stops was above {STOP_P99_MS:g} ms", late),
        _none("attacks under which a fieldbus exchange failed", missed),
    ]


def _none(what: str, found: list[str]) -> Check:
    return Check(what, ", ".join(found) or "none", "none", not found)


ATTACKS_EXPERIMENT = Experiment(
    name="attacks",
    title="Attack every listener of the running services, as a stranger can.",
    settings=AttackSettings,
    row=AttackRow,
    tasks=attack_tasks,
    run=one_trial,
    table=attack_table,
    verdict=attack_verdict,
    world="the three services as processes, started anew for every attack",
    eyes="rendered pictures",
    workers=0,
)
