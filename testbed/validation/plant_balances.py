"""Families 16 to 18: what a sudden stop does to the oil, where the energy goes, what the pump cannot give."""

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plant_emulator.core import columns as col
from plant_emulator.core.chambers import ATMOSPHERE, bulk_modulus
from plant_emulator.core.equilibrium import rest_state
from plant_emulator.core.layout import (
    N_ACTUATORS,
    N_COORDINATES,
    PRESSURE_A,
    PRESSURE_B,
    RATE,
    SPOOL,
    SUPPLY,
    Q,
)
from plant_emulator.core.model import put_payload
from plant_emulator.plant_config import BAR, LITRE_PER_MINUTE
from testbed.validation.case import Case
from testbed.validation.oracles import PinocchioArm
from testbed.validation.plant_rig import Stand, default_config

Array = NDArray[np.float64]

BOTH = slice(PRESSURE_A, PRESSURE_B + N_ACTUATORS)  # bore pressures, then rod pressures


def resting_arm(config_dir: Path, pose_deg: list[float], payload: float, **changes: Any) -> Stand:
    """The whole flexible arm at rest, carrying ``payload`` (kg)."""
    config = default_config(config_dir, {"start_pose_deg": pose_deg}, changes)
    stand = Stand(config, np.radians(pose_deg))
    put_payload(stand.model, stand.tool, payload, config, stand.chain)
    stand.state[:] = rest_state(stand.model, stand.state[Q : Q + N_COORDINATES], config.oil.temperature_degc)
    return stand


def volumes(stand: Stand, state: Array) -> Array:
    """Oil volume (12,) of all chambers, bores first, at the positions of the latest evaluation."""
    table, y = stand.model.actuators, stand.work.flows[:, col.F_POSITION]
    bore = table[:, col.A_DEAD_A] + table[:, col.A_AREA_A] * y
    rod = table[:, col.A_DEAD_B] + table[:, col.A_AREA_B] * (table[:, col.A_STROKE] - y)
    return np.concatenate((bore, rod))


def density(stand: Stand, pressure: Array) -> Array:
    """Oil density over that at zero compression, ∫ dp/β of oil with entrained air."""
    c = stand.model.circuit
    air = c[col.C_AIR] * ATMOSPHERE ** (1.0 / c[col.C_EXPONENT]) * pressure ** (-1.0 / c[col.C_EXPONENT])
    return np.asarray(np.exp(pressure / c[col.C_MODULUS] - air))


def net_flows(stand: Stand) -> Array:
    """Net flow (12,) into all chambers, bores first, at the latest evaluation."""
    return np.concatenate((stand.work.flows[:, col.F_NET_A], stand.work.flows[:, col.F_NET_B]))


def sudden_stop(config_dir: Path) -> list[Case]:
    """Family 16: lowering 200 kg at full speed, then the valves shut: pressures and oil masses."""
    stand = resting_arm(config_dir, [0.0, 60.0, -60.0, 0.0, 0.0, 0.0], 200.0)
    stand.rates()
    before = density(stand, stand.state[BOTH]) * volumes(stand, stand.state)

    def inflow(s: Stand, state: Array) -> Array:
        return density(s, state[BOTH]) * net_flows(s)

    taken, least, most = np.zeros(2 * N_ACTUATORS), math.inf, 0.0
    for opening, seconds in ((-1.0, 0.8), (0.0, 1.5)):
        stand.command[1] = stand.command[2] = opening
        mass, seen = stand.run_with_integrals(seconds, 2.5e-4, inflow, 2 * N_ACTUATORS)
        taken += mass
        least, most = min(least, float(seen[:, BOTH].min())), max(most, float(seen[:, BOTH].max()))
    stand.rates()
    after = density(stand, stand.state[BOTH]) * volumes(stand, stand.state)
    worst = float(np.abs((after - before - taken) / before).max())
    setting = float(stand.model.circuit[col.C_RELIEF]) / BAR
    return [
        Case(16, "least absolute pressure", "bar", 0.0, least / BAR, 0.0, "oil cannot pull", "at_least"),
        Case(
            16, "greatest pressure", "bar", 1.1 * setting, most / BAR, 0.0, "relief setting + 10 %", "at_most"
        ),
        Case(16, "oil mass, worst chamber", "", 0.0, worst, 1e-6, "∫ρQ dt = Δ(ρV)"),
    ]


def _stored_energy(stand: Stand) -> tuple[Array, Array]:
    """A table of pressure (Pa) and of the energy ∫ p/(ρβ) dp stored per unit mass (J/kg over density 1)."""
    pressure = np.geomspace(5e3, 4e7, 40001)
    c = stand.model.circuit
    n = c[col.C_EXPONENT]
    softness = 1.0 / c[col.C_MODULUS] + c[col.C_AIR] * (ATMOSPHERE / pressure) ** (1.0 / n) / (n * pressure)
    growth = pressure * softness / density(stand, pressure)
    steps = 0.5 * (growth[1:] + growth[:-1]) * np.diff(pressure)
    return pressure, np.concatenate(([0.0], np.cumsum(steps)))


def energy_balance(config_dir: Path) -> list[Case]:
    """Family 17: what the supply gives against motion, seals, hinges, orifices, return and compressed oil."""
    stand = resting_arm(config_dir, [0.0, 30.0, -70.0, 0.0, -20.0, 0.0], 50.0)
    stand.model.actuators[:, col.A_LEAKAGE] = 0.0
    oracle, mech = PinocchioArm(stand.model.mechanism), stand.model.mechanism
    table = _stored_energy(stand)
    back = float(stand.model.circuit[col.C_RETURN])

    def powers(s: Stand, state: Array) -> Array:
        flows, p_s = s.work.flows, state[SUPPLY]
        p_a, p_b = state[PRESSURE_A : PRESSURE_A + N_ACTUATORS], state[PRESSURE_B : PRESSURE_B + N_ACTUATORS]
        net_a, net_b = flows[:, col.F_NET_A], flows[:, col.F_NET_B]
        extends = state[SPOOL : SPOOL + N_ACTUATORS] >= 0.0
        drawn = flows[:, col.F_SUPPLY]
        from_tank_a, from_tank_b = (
            net_a - np.where(extends, drawn, 0.0),
            net_b - np.where(extends, 0.0, drawn),
        )
        throttled = float(drawn @ (p_s - np.where(extends, p_a, p_b)))
        throttled += float(from_tank_a @ (back - p_a) + from_tank_b @ (back - p_b))
        returned = -back * float((from_tank_a + from_tank_b).sum())
        given = p_s * float(drawn.sum())
        seals = float((flows[:, col.F_FRICTION] - flows[:, col.F_STOP]) @ flows[:, col.F_VELOCITY])
        rate = state[RATE : RATE + N_COORDINATES]
        advected = float((density(s, state[BOTH]) * net_flows(s)) @ np.interp(state[BOTH], *table))
        return np.array([given, returned, throttled, seals, float(mech.damping @ (rate * rate)), advected])

    def stored() -> Array:
        stand.rates()
        q, rate = stand.state[Q : Q + N_COORDINATES], stand.state[RATE : RATE + N_COORDINATES]
        mechanical = sum(oracle.energies(q, rate)) + 0.5 * float(mech.stiffness @ (q * q))
        oil = density(stand, stand.state[BOTH]) * volumes(stand, stand.state)
        return np.array([mechanical, float(oil @ np.interp(stand.state[BOTH], *table))])

    before, total = stored(), np.zeros(6)
    for command in ([0.3, 0.3, 0.25, 0.2, -0.2, 0.3], [-0.3, 0.2, -0.2, -0.2, 0.2, -0.3], [0.0] * 6):
        stand.command[:] = command
        total += stand.run_with_integrals(0.7, 5e-4, powers, 6)[0]
    moved, pressed = stored() - before
    given, returned, throttled, seals, hinges, advected = (float(value) for value in total)
    accounted = returned + throttled + seals + hinges + float(moved) + float(pressed) - advected
    return [
        Case(
            17,
            "energy from the supply accounted for",
            "J",
            given,
            accounted,
            1e-3 * given,
            "Pinocchio, ∫ p Q dt",
        )
    ]


def pump_saturation(config_dir: Path) -> list[Case]:
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
        Case(18, "mean flow drawn and stored in the line", "l/min", limit, mean, 2e-3 * limit, "Q_max"),
        Case(18, "mean displacement of both bores", "l/min", limit, bores, 0.03 * limit, "Q_max"),
        Case(
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
