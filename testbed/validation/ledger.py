"""Books of oil mass and energy kept beside a motion: what went in, what came out, what is stored."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plant_emulator.core import columns as col
from plant_emulator.core.chambers import ATMOSPHERE
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
from testbed.validation.oracles import PinocchioArm
from testbed.validation.plant_rig import Stand

Array = NDArray[np.float64]

CHAMBERS = slice(PRESSURE_A, PRESSURE_B + N_ACTUATORS)  # bore pressures, then rod pressures


class Balance(NamedTuple):
    """Energy (J) given by the supply and accounted for; worst relative error of a chamber's oil mass."""

    given: float
    accounted: float
    mass_error: float
    least_pressure: float
    greatest_pressure: float


def volumes(stand: Stand) -> Array:
    """Oil volume (12,) of all chambers, bores first, at the latest evaluation."""
    table, y = stand.model.actuators, stand.work.flows[:, col.F_POSITION]
    bore = table[:, col.A_DEAD_A] + table[:, col.A_AREA_A] * y
    rod = table[:, col.A_DEAD_B] + table[:, col.A_AREA_B] * (table[:, col.A_STROKE] - y)
    return np.concatenate((bore, rod))


def net_flows(stand: Stand) -> Array:
    """Net flow (12,) into all chambers, bores first, at the latest evaluation."""
    return np.concatenate((stand.work.flows[:, col.F_NET_A], stand.work.flows[:, col.F_NET_B]))


def density(circuit: Array, pressure: Array) -> Array:
    """Density of oil with entrained air over that of oil without pressure: exp ∫ dp/β."""
    n = circuit[col.C_EXPONENT]
    air = circuit[col.C_AIR] * ATMOSPHERE ** (1.0 / n) * pressure ** (-1.0 / n)
    return np.asarray(np.exp(pressure / circuit[col.C_MODULUS] - air))


class Ledger:
    """Runs a stand and keeps its books: mechanical energy by Pinocchio, compression by ∫ p/(ρβ) dp."""

    def __init__(self, stand: Stand) -> None:
        self._stand = stand
        c = stand.model.circuit
        self._pressure, n = np.geomspace(1e3, 1e8, 60001), c[col.C_EXPONENT]
        air = c[col.C_AIR] * (ATMOSPHERE / self._pressure) ** (1.0 / n) / (n * self._pressure)
        growth = self._pressure * (1.0 / c[col.C_MODULUS] + air) / density(c, self._pressure)
        steps = 0.5 * (growth[1:] + growth[:-1]) * np.diff(self._pressure)
        self._compression = np.concatenate(([0.0], np.cumsum(steps)))

    def run(self, seconds: float, step: float) -> Balance:
        """Advance the stand by ``seconds`` and balance the books of that time."""
        energy, mass = self._stored()
        total, seen = self._stand.run_with_integrals(seconds, step, self._powers, 6 + 2 * N_ACTUATORS)
        energy_after, mass_after = self._stored()
        given, returned, throttled, seals, hinges, advected = (float(value) for value in total[:6])
        accounted = returned + throttled + seals + hinges + energy_after - energy - advected
        error = float(np.abs((mass_after - mass - total[6:]) / mass).max())
        pressures = seen[:, CHAMBERS]
        return Balance(given, accounted, error, float(pressures.min()), float(pressures.max()))

    def _powers(self, stand: Stand, state: Array) -> Array:
        flows, p_s, back = stand.work.flows, state[SUPPLY], stand.model.circuit[col.C_RETURN]
        p_a, p_b = state[PRESSURE_A : PRESSURE_A + N_ACTUATORS], state[PRESSURE_B : PRESSURE_B + N_ACTUATORS]
        extends, drawn = state[SPOOL : SPOOL + N_ACTUATORS] >= 0.0, flows[:, col.F_SUPPLY]
        # all that did not come from the supply came from, or went to, the return line
        tank_a = flows[:, col.F_NET_A] - np.where(extends, drawn, 0.0)
        tank_b = flows[:, col.F_NET_B] - np.where(extends, 0.0, drawn)
        throttled = (
            drawn @ (p_s - np.where(extends, p_a, p_b)) + tank_a @ (back - p_a) + tank_b @ (back - p_b)
        )
        seals = (flows[:, col.F_FRICTION] - flows[:, col.F_STOP]) @ flows[:, col.F_VELOCITY]
        rate = state[RATE : RATE + N_COORDINATES]
        hinges = stand.model.mechanism.damping @ (rate * rate)
        carried = density(stand.model.circuit, state[CHAMBERS]) * net_flows(stand)
        advected = carried @ np.interp(state[CHAMBERS], self._pressure, self._compression)
        returned = -back * (tank_a + tank_b).sum()
        return np.array([p_s * drawn.sum(), returned, throttled, seals, hinges, advected, *carried])

    def _stored(self) -> tuple[float, Array]:
        """Energy in motion, height, bending and compression, and the oil mass (12,) of each chamber."""
        stand = self._stand
        stand.rates()
        mech, pressures = stand.model.mechanism, stand.state[CHAMBERS]
        q, rate = stand.state[Q : Q + N_COORDINATES], stand.state[RATE : RATE + N_COORDINATES]
        mass = density(stand.model.circuit, pressures) * volumes(stand)
        pressed = mass @ np.interp(pressures, self._pressure, self._compression)
        mechanical = sum(PinocchioArm(mech).energies(q, rate)) + 0.5 * mech.stiffness @ (q * q)
        return float(mechanical + pressed), mass
