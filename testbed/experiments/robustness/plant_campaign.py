"""Rough treatment of the plant at random poses: sudden stop, payload drop, end-stop impact, pump loss.

Each run is ten simulated seconds of the plant's own steps with the books of oil mass and energy kept beside.
The books close only as far as a step resolves the kinks of valves and stops: to 2e-6 of the oil at 0.5 ms, to
a twentieth of that at 0.25 ms.
"""

import math
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from plant_emulator.config.plant import BAR
from plant_emulator.core import columns as col
from plant_emulator.core.layout import N_COORDINATES, RATE
from plant_emulator.core.model import put_payload
from protocol.errors import ConfigurationError
from testbed.campaigns.campaign import run_campaign
from testbed.reporting.console import out, table, write_json
from testbed.validation.ledger import Balance, Ledger
from testbed.validation.plant_balances import resting_arm
from testbed.validation.plant_rig import Stand

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


def summary(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """For each event the worst figures of its runs; one that is missing or not finite counts as infinite."""
    made = []
    for event in EVENTS:
        mine = [row for row in rows if row.get("event") == event]
        if mine:
            made.append(
                {
                    "event": event,
                    "runs": len(mine),
                    "not_finite": sum(not row["finite"] for row in mine),
                    "least_bar": min(_figure(row, "least_bar", -math.inf) for row in mine),
                    "greatest_bar": max(_figure(row, "greatest_bar", math.inf) for row in mine),
                    "energy_error": max(_figure(row, "energy_error", math.inf) for row in mine),
                    "mass_error": max(_figure(row, "mass_error", math.inf) for row in mine),
                    "stops_met": sum(bool(row["stop_met"]) for row in mine),
                    "end_mrad_s": max(_figure(row, "end_mrad_s", math.inf) for row in mine),
                }
            )
    return made


def _figure(row: dict[str, Any], name: str, missing: float) -> float:
    value = row.get(name)
    return missing if value is None or not math.isfinite(value) else float(value)


def kept(event: dict[str, Any]) -> bool:
    """Whether an event's worst figures are inside all limits."""
    return bool(
        event["not_finite"] == 0
        and event["least_bar"] > 0.0
        and event["energy_error"] <= ENERGY_LIMIT
        and event["mass_error"] <= MASS_LIMIT
    )


def run_experiment(
    config_dir: Path,
    runs: int,
    first_seed: int,
    step_ms: float,
    directory: Path,
    scheduler: str | None,
    json_file: Path | None,
) -> bool:
    """Whether all runs kept to the limits; prints the worst figures of each event."""
    names = list(EVENTS)
    tasks: list[dict[str, Any]] = [
        {"key": f"{seed}", "event": names[k % len(names)], "seed": seed, "step_ms": step_ms}
        for k, seed in enumerate(range(first_seed, first_seed + runs))
    ]
    rows = run_campaign(
        directory,
        partial(treat, config_dir),
        tasks,
        scheduler=scheduler,
        title="rough treatment of the plant",
    )
    failed, events = [row for row in rows if row.get("failure")], summary(rows)
    columns = (
        "event", "runs", "not finite", "least bar", "greatest bar", "energy missing %", "oil missing",
        "end stops met", "verdict",
    )  # fmt: skip
    lines: list[tuple[object, ...]] = [
        ("limit", "", 0, "> 0", "", f"≤ {100 * ENERGY_LIMIT:g}", f"≤ {MASS_LIMIT:g}", "", "")
    ]
    lines += [
        (e["event"], e["runs"], e["not_finite"], f"{e['least_bar']:.3f}", f"{e['greatest_bar']:.1f}",
         f"{100 * e['energy_error']:.2g}", f"{e['mass_error']:.1e}", e["stops_met"],
         "passed" if kept(e) else "FAILED")
        for e in events
    ]  # fmt: skip
    out.print(table("rough treatment, 10 simulated s each: the worst of each event", columns, lines))
    spent = sum(_figure(row, "cpu_s", 0.0) for row in rows)
    out.print(
        f"{len(rows)} runs from seed {first_seed} at {step_ms:g} ms, {len(failed)} failed, "
        f"{spent:.0f} s of processor time"
    )
    for row in failed:
        out.print(f"{row['key']}: {row['failure']}", style="red")
    write_json(
        json_file, {"events": events, "step_ms": step_ms, "failed": len(failed), "cpu_s": spent, "rows": rows}
    )
    return not failed and len(events) == min(len(EVENTS), runs) and all(kept(event) for event in events)
