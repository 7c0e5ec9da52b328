"""Families 16 to 18: what a sudden stop does to the oil, where the energy goes, what the pump cannot give."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plant_emulator.config.units import BAR, LITRE_PER_MINUTE
from plant_emulator.core import columns as col
from plant_emulator.core.equilibrium import rest_state
from plant_emulator.core.hydraulics.chambers import bulk_modulus
from plant_emulator.core.layout import N_ACTUATORS, PRESSURE_A, PRESSURE_B, SUPPLY
from plant_emulator.core.model import put_payload
from testbed.validation.case import ValidationCase
from testbed.validation.ledger import Ledger
from testbed.validation.plant_rig import Stand, default_config

Array = NDArray[np.float64]

BOTH = slice(PRESSURE_A, PRESSURE_B + N_ACTUATORS)  # bore pressures, then rod pressures


def resting_arm(config_dir: Path, pose_deg: list[float], payload: float, **changes: Any) -> Stand:
    """The whole flexible arm at rest, carrying ``payload`` (kg)."""
    config = default_config(config_dir, {"start_pose_deg": pose_deg}, changes)
    stand = Stand(config, np.radians(pose_deg))
    put_payload(stand.model, stand.tool, payload, config, stand.chain)
    stand.state[:] = rest_state(stand.model, stand.angles, config.oil.temperature_degc)
    return stand


def sudden_stop(config_dir: Path) -> list[ValidationCase]:
    """Family 16: lowering 200 kg at full speed, then the valves shut: pressures and oil masses."""
    stand = resting_arm(config_dir, [0.0, 60.0, -60.0, 0.0, 0.0, 0.0], 200.0)
    ledger, books = Ledger(stand), []
    for opening, seconds in ((-1.0, 0.8), (0.0, 1.5)):
        stand.command[1] = stand.command[2] = opening
        books.append(ledger.run(seconds, 2.5e-4))
    setting = float(stand.model.circuit[col.C_RELIEF]) / BAR
    least = min(balance.least_pressure for balance in books) / BAR
    most = max(balance.greatest_pressure for balance in books) / BAR
    worst = max(balance.mass_error for balance in books)
    return [
        ValidationCase(16, "least absolute pressure", "bar", 0.0, least, 0.0, "oil cannot pull", "at_least"),
        ValidationCase(
            16, "greatest pressure", "bar", 1.1 * setting, most, 0.0, "relief setting + 10 %", "at_most"
        ),
        ValidationCase(16, "oil mass, worst chamber", "", 0.0, worst, 1e-6, "∫ρQ dt = Δ(ρV)"),
    ]


def energy_balance(config_dir: Path) -> list[ValidationCase]:
    """Family 17: what the supply gives against motion, seals, hinges, orifices, return and compressed oil."""
    stand = resting_arm(config_dir, [0.0, 30.0, -70.0, 0.0, -20.0, 0.0], 50.0)
    ledger, given, accounted = Ledger(stand), 0.0, 0.0
    for command in ([0.3, 0.3, 0.25, 0.2, -0.2, 0.3], [-0.3, 0.2, -0.2, -0.2, 0.2, -0.3], [0.0] * 6):
        stand.command[:] = command
        balance = ledger.run(0.7, 5e-4)
        given += balance.given
        accounted += balance.accounted
    return [
        ValidationCase(
            17,
            "energy from the supply accounted for",
            "J",
            given,
            accounted,
            1e-3 * given,
            "Pinocchio, ∫ p Q dt",
        )
    ]


def pump_saturation(config_dir: Path) -> list[ValidationCase]:
    """Family 18: lift and tilt with their valves full open share what the pump can give."""
    stand = resting_arm(config_dir, [0.0, 0.0, -130.0, 0.0, 0.0, 0.0], 0.0)
    stand.command[1] = stand.command[2] = 1.0
    stand.run(0.4, 5e-4)
    supply = float(stand.state[SUPPLY])

    def drawn(s: Stand, state: Array) -> Array:
        c, table, v = s.model.circuit, s.model.actuators, s.work.flows[:, col.F_VELOCITY]
        softness = 1.0 / bulk_modulus(
            state[SUPPLY], c[col.C_LINE_VOLUME], c[col.C_MODULUS], 0.0, *c[[col.C_AIR, col.C_EXPONENT]]
        )
        return np.array([s.work.flows[:, col.F_SUPPLY].sum(), (table[1:3, col.A_AREA_A] @ v[1:3]), softness])

    seconds = 1.5
    volume, seen = stand.run_with_integrals(seconds, 5e-4, drawn, 3)
    stored = float(stand.state[SUPPLY]) - supply
    refilled = stored * volume[2] / seconds * float(stand.model.circuit[col.C_LINE_VOLUME])
    mean = (float(volume[0]) + refilled) / seconds / LITRE_PER_MINUTE
    limit = float(stand.model.circuit[col.C_FLOW_LIMIT]) / LITRE_PER_MINUTE
    ceiling = stand.config.pump.pressure_bar - stand.config.pump.droop_bar
    bores = float(volume[1]) / seconds / LITRE_PER_MINUTE
    return [
        ValidationCase(
            18, "mean flow drawn and stored in the line", "l/min", limit, mean, 2e-3 * limit, "Q_max"
        ),
        ValidationCase(18, "mean displacement of both bores", "l/min", limit, bores, 0.03 * limit, "Q_max"),
        ValidationCase(
            18,
            "supply sags below",
            "bar",
            ceiling,
            float(seen[:, SUPPLY].max()) / BAR,
            0.0,
            "p_set − droop",
            "at_most",
        ),
    ]
