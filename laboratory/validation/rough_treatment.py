"""Rough treatment of the plant at random poses: sudden stop, payload drop, end-stop impact, pump loss.

Each run is ten simulated seconds of the plant's own steps with the books of oil mass and energy kept beside.
The books close only as far as a step resolves the kinks of valves and stops: to 2e-6 of the oil at 0.5 ms, to
a twentieth of that at 0.25 ms.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer
from numpy.typing import NDArray
from rich.table import Table

from laboratory.campaigns.campaign import CampaignRequest, Task
from laboratory.campaigns.experiment import Check, Experiment, Finished, seeds
from laboratory.validation.ledger import Balance, Ledger
from laboratory.validation.plant_balances import resting_arm
from laboratory.validation.plant_rig import Stand
from plant_emulator.config.actuators import BAR
from plant_emulator.core import layout as col
from plant_emulator.core.layout import N_COORDINATES, RATE
from plant_emulator.core.model import put_payload
from protocol.errors import ConfigurationError
from testbed.reporting.console import table

Array = NDArray[np.float64]

SECONDS = 10.0
ENERGY_LIMIT = 1e-3  # of the energy turned over
MASS_LIMIT = 1e-6  # of the oil in the chamber


class Roughness(NamedTuple):
    """What a run begins with: a pose (°, six joints), a load (kg), openings (6,) of the valves, -1 to 1."""

    pose_deg: list[float]
    load_kg: float
    valves: Array


def draw(rng: np.random.Generator) -> Roughness:
    """A pose anywhere in the workspace, a load of 50 to 200 kg, any openings, small ones of the wrist."""
    low, high = [-110.0, -5.0, -140.0, -80.0, -80.0, -80.0], [110.0, 95.0, -25.0, 80.0, 80.0, 80.0]
    pose = [float(angle) for angle in rng.uniform(low, high)]
    load, valves = float(rng.uniform(50.0, 200.0)), rng.uniform(-1.0, 1.0, 6)
    valves[3:] *= 0.2  # at 5 rad/s a wide open wrist would stand at its end when the event comes
    return Roughness(pose, load, valves)


def drawn_arm(config_dir: Path, seed: int) -> tuple[Stand, Roughness]:
    """The arm at rest at the first pose of ``seed`` whose load the supply can carry, and what was drawn."""
    rng = np.random.default_rng(seed)
    while True:
        rough = draw(rng)
        try:
            return resting_arm(config_dir, rough.pose_deg, rough.load_kg), rough
        except ConfigurationError as error:
            if error.cause not in ("configuration.overload", "configuration.outside_stroke"):
                raise


Phase = tuple[float, Array]  # seconds, valve openings (6,)
Plot = Callable[[Stand, Roughness], Iterator[Phase]]


def sudden_stop(stand: Stand, rough: Roughness) -> Iterator[Phase]:
    """Moves for a second, then all valves shut."""
    yield 1.0, rough.valves
    yield SECONDS - 1.0, np.zeros(6)


def payload_drop(stand: Stand, rough: Roughness) -> Iterator[Phase]:
    """The load is let go in full motion, which lasts half a second longer."""
    yield 1.0, rough.valves
    put_payload(stand.model, stand.tool, 0.0, stand.config, stand.chain)
    yield 0.5, rough.valves
    yield SECONDS - 1.5, np.zeros(6)


def end_stop_impact(stand: Stand, rough: Roughness) -> Iterator[Phase]:
    """Every valve full open, each to its side, until the joints stand at their ends."""
    yield SECONDS - 2.0, np.sign(rough.valves)
    yield 2.0, np.zeros(6)


def pump_loss(stand: Stand, rough: Roughness) -> Iterator[Phase]:
    """The pump stops and its line is dumped; the valves stay open for a second."""
    yield 1.0, rough.valves
    stand.model.circuit[col.C_RUNNING] = 0.0
    yield 1.0, rough.valves
    yield SECONDS - 2.0, np.zeros(6)


EVENTS: dict[str, Plot] = {
    "sudden stop": sudden_stop,
    "payload drop": payload_drop,
    "end-stop impact": end_stop_impact,
    "pump loss": pump_loss,
}


def treat(config_dir: Path, task: dict[str, Any]) -> dict[str, Any]:
    """The row of one run: ``task`` names its ``event``, ``seed`` and ``step_ms``."""
    stand, rough = drawn_arm(config_dir, task["seed"])
    ledger, books = Ledger(stand), list[Balance]()
    for seconds, valves in EVENTS[task["event"]](stand, rough):
        stand.command[:] = valves
        books.append(ledger.run(seconds, 1e-3 * task["step_ms"]))
    given, dissipated = (
        abs(sum(values)) for values in zip(*((b.given, b.dissipated) for b in books), strict=True)
    )
    missing = abs(sum(b.given - b.accounted for b in books))
    return {
        "event": task["event"],
        "seed": task["seed"],
        "load_kg": rough.load_kg,
        "pose_deg": " ".join(f"{angle:.2f}" for angle in rough.pose_deg),
        "finite": bool(np.isfinite(stand.state).all()),
        "least_bar": min(b.least_pressure for b in books) / BAR,
        "greatest_bar": max(b.greatest_pressure for b in books) / BAR,
        "energy_error": missing / max(given, dissipated),
        "mass_error": max(b.mass_error for b in books),
        "stop_met": any(b.stop_met for b in books),
        "end_mrad_s": 1e3 * float(np.abs(stand.state[RATE : RATE + N_COORDINATES]).max()),
    }


class TreatmentRow(NamedTuple):
    """One run of rough treatment: extreme pressures, and what is missing in the books."""

    event: str
    finite: bool
    least_bar: float
    greatest_bar: float
    energy_error: float
    mass_error: float
    stop_met: bool
    end_mrad_s: float
    failure: str
    cpu_s: float


class EventSummary(NamedTuple):
    """The worst figures of an event's runs; one that is missing or not finite counts as infinite."""

    event: str
    runs: int
    not_finite: int
    least_bar: float
    greatest_bar: float
    energy_error: float
    mass_error: float
    stops_met: int
    end_mrad_s: float

    @property
    def kept(self) -> bool:
        """Whether all figures are inside their limits."""
        books = self.energy_error <= ENERGY_LIMIT and self.mass_error <= MASS_LIMIT
        return self.not_finite == 0 and self.least_bar > 0.0 and books


def summary(rows: Sequence[TreatmentRow]) -> list[EventSummary]:
    """One for each event that has rows."""
    return [
        EventSummary(
            event,
            len(mine),
            sum(not row.finite for row in mine),
            min(_or(row.least_bar, -math.inf) for row in mine),
            max(_or(row.greatest_bar, math.inf) for row in mine),
            max(_or(row.energy_error, math.inf) for row in mine),
            max(_or(row.mass_error, math.inf) for row in mine),
            sum(row.stop_met for row in mine),
            max(_or(row.end_mrad_s, math.inf) for row in mine),
        )
        for event in EVENTS
        if (mine := [row for row in rows if row.event == event])
    ]


def _or(value: float, missing: float) -> float:
    return value if math.isfinite(value) else missing


class TreatmentSettings(NamedTuple):
    """The step of the integration."""

    step_ms: Annotated[float, typer.Option(min=0.01, max=0.5, help="Of the integration.")] = 0.25


Treated = Finished[TreatmentSettings, TreatmentRow]


def treatment_tasks(request: CampaignRequest, settings: TreatmentSettings) -> list[Task]:
    """One task a seed, the events in turn."""
    names = list(EVENTS)
    return [
        {"key": f"{seed}", "event": names[k % len(names)], "seed": seed, "step_ms": settings.step_ms}
        for k, seed in enumerate(seeds(request))
    ]


def treatment_table(done: Treated) -> list[Table]:
    """The worst figures of each event."""
    columns = (
        "event", "runs", "not finite", "least bar", "greatest bar", "energy missing %", "oil missing",
        "end stops met", "verdict",
    )  # fmt: skip
    lines: list[tuple[object, ...]] = [
        ("limit", "", 0, "> 0", "", f"≤ {100 * ENERGY_LIMIT:g}", f"≤ {MASS_LIMIT:g}", "", "")
    ]
    lines += [
        (e.event, e.runs, e.not_finite, f"{e.least_bar:.3f}", f"{e.greatest_bar:.1f}",
         f"{100 * e.energy_error:.2g}", f"{e.mass_error:.1e}", e.stops_met, "passed" if e.kept else "FAILED")
        for e in summary(done.rows)
    ]  # fmt: skip
    return [table("rough treatment, 10 simulated s each: the worst of each event", columns, lines)]


def treatment_verdict(done: Treated) -> list[Check]:
    """Every event inside its limits, no run failed."""
    failed = sum(bool(row.failure) for row in done.rows)
    missing = set(list(EVENTS)[: len(done.rows)]) - {row.event for row in done.rows}
    events = summary(done.rows)
    kept = sum(event.kept for event in events)
    return [
        Check("runs that failed", f"{failed}", "0", failed == 0),
        Check(
            "events within all limits", f"{kept} of {len(events)}", "all", kept == len(events) and not missing
        ),
    ]


ROUGH = Experiment(
    name="rough",
    title="Rough treatment of the plant at random poses.",
    settings=TreatmentSettings,
    row=TreatmentRow,
    tasks=treatment_tasks,
    run=treat,
    table=treatment_table,
    verdict=treatment_verdict,
    runs=500,
    world="the plant alone",
    eyes="none",
)
