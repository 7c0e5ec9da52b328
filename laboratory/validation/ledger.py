"""Books of oil mass and energy kept beside a motion: what went in, what came out, what is stored.

The books repeat the plant's own Runge-Kutta steps stage by stage (bit for bit, a test holds them to it) and
integrate every flow of oil and energy with the same stages, so that a balance shows the model and not the
quadrature. What is stored is computed apart: motion and height by Pinocchio, compression by ∫ p/(ρβ) dp.
"""

import importlib
import math
from types import ModuleType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.compiled import allocation_free
from laboratory.validation.plant_rig import Stand
from plant_emulator.core import layout as col
from plant_emulator.core.hydraulics.oil_rates import ATMOSPHERE
from plant_emulator.core.hydraulics.valve_commands import slew_limited
from plant_emulator.core.layout import (
    N_ACTUATORS,
    PRESSURE_A,
    PRESSURE_B,
    SPOOL,
    SUPPLY,
)
from plant_emulator.core.mechanics.multibody import Mechanism
from plant_emulator.core.model import Model
from plant_emulator.core.right_hand_side import Work, right_hand_side
from protocol.errors import ConfigurationError

Array = NDArray[np.float64]
MISSING_ORACLE = "configuration.missing_oracle"


def oracle(name: str) -> ModuleType:
    """The module of an oracle. Raises ConfigurationError when it is not installed."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ConfigurationError(
            MISSING_ORACLE, f"{name}, an independent oracle, is not installed: make setup-dev"
        ) from error


def _text(values: Array) -> str:
    return " ".join(repr(float(v)) for v in np.ravel(values))


def mujoco_xml(mech: Mechanism, options: str = "") -> str:
    """An MJCF document of ``mech``: nested bodies in base axes; a massless body joins the next one."""
    opened, depth = [], 0
    joints: list[str] = []
    for i in range(len(mech.mass)):
        joints.append(
            f'<joint name="angle {i}" type="hinge" axis="{_text(mech.axis[i])}" pos="{_text(mech.point[i])}"'
            f' stiffness="{float(mech.stiffness[i])!r}" damping="{float(mech.damping[i])!r}"/>'
        )
        if mech.mass[i] == 0.0:
            continue
        inertia = mech.inertia[i]
        full = [inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2]]
        opened.append(
            f"<body>{''.join(joints)}<inertial pos='{_text(mech.centre[i])}' mass='{float(mech.mass[i])!r}'"
            f" fullinertia='{_text(np.array(full))}'/>"
        )
        joints.clear()
        depth += 1
    return (
        "<mujoco><compiler balanceinertia='false' boundmass='0' boundinertia='0' angle='radian'/>"
        f"<option gravity='{_text(mech.gravity)}' {options}>"
        "<flag contact='disable' constraint='disable'/></option>"
        f"<worldbody>{''.join(opened)}{'</body>' * depth}</worldbody></mujoco>"
    )


class MujocoArm:
    """``mech`` in MuJoCo, hinge springs left to the caller's force unless stepped by MuJoCo itself."""

    def __init__(self, mech: Mechanism) -> None:
        self._mujoco = oracle("mujoco")
        rigid = mech._replace(stiffness=np.zeros_like(mech.mass), damping=np.zeros_like(mech.mass))
        self._model = self._mujoco.MjModel.from_xml_string(mujoco_xml(rigid))
        self._data = self._mujoco.MjData(self._model)

    def acceleration(self, q: Array, rate: Array, force: Array) -> Array:
        """Accelerations (n,) at ``q``, ``rate`` under generalised ``force``."""
        self._data.qpos[:], self._data.qvel[:], self._data.qfrc_applied[:] = q, rate, force
        self._mujoco.mj_forward(self._model, self._data)
        return np.array(self._data.qacc)


class PinocchioArm:
    """``mech`` in Pinocchio: its own articulated-body algorithm, joint frames on the axes."""

    def __init__(self, mech: Mechanism) -> None:
        self._pin = pin = oracle("pinocchio")
        self._model, parent, origin = pin.Model(), 0, np.zeros(3)
        for i in range(len(mech.mass)):
            joint = pin.JointModelRevoluteUnaligned(*(float(a) for a in mech.axis[i]))
            parent = self._model.addJoint(
                parent, joint, pin.SE3(np.eye(3), mech.point[i] - origin), f"angle {i}"
            )
            inertia = pin.Inertia(float(mech.mass[i]), mech.centre[i] - mech.point[i], mech.inertia[i])
            self._model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
            origin = mech.point[i]
        self._model.gravity = pin.Motion(mech.gravity, np.zeros(3))
        self._data = self._model.createData()

    def acceleration(self, q: Array, rate: Array, force: Array) -> Array:
        """Accelerations (n,) at ``q``, ``rate`` under generalised ``force``."""
        return np.array(self._pin.aba(self._model, self._data, q, rate, force))

    def energies(self, q: Array, rate: Array) -> tuple[float, float]:
        """Kinetic energy and gravity's potential (J)."""
        kinetic = self._pin.computeKineticEnergy(self._model, self._data, q, rate)
        return float(kinetic), float(self._pin.computePotentialEnergy(self._model, self._data, q))


N_CHAMBERS = 2 * N_ACTUATORS
CHAMBERS = slice(PRESSURE_A, PRESSURE_B + N_ACTUATORS)  # bore pressures, then rod pressures

GIVEN, RETURNED, THROTTLED, SEALS, HINGES, ADVECTED, MASSES = range(
    7
)  # integrals; from MASSES on, one a chamber
N_INTEGRALS = MASSES + N_CHAMBERS
LEAST, GREATEST, DEEPEST = range(3)  # pressures, and how far beyond a stroke's end relative to the stroke
GRID = np.geomspace(1e3, 1e8, 60_001)  # Pa
FIRST, PER_LOG = float(GRID[0]), (len(GRID) - 1) / math.log(float(GRID[-1] / GRID[0]))


class Balance(NamedTuple):
    """Energy (J) given by the supply, accounted for, and dissipated in valves, seals and hinges.

    ``mass_error``: worst relative error of a chamber's oil mass; ``least_pressure`` and ``greatest_pressure``
    (Pa) of the chambers, the least of the supply too; ``stop_met``: whether a piston went beyond its stroke.
    """

    given: float
    accounted: float
    dissipated: float
    mass_error: float
    least_pressure: float
    greatest_pressure: float
    stop_met: bool


class Compression(NamedTuple):
    """What oil holds: ``energy`` (J/kg of oil without pressure) over GRID, and its air's part in density."""

    energy: Array
    modulus: float
    air: float
    exponent: float


def compression(circuit: Array) -> Compression:
    """What the oil of ``circuit`` holds; of rigid chambers and at the reference temperature."""
    modulus, n = float(circuit[col.C_MODULUS]), float(circuit[col.C_EXPONENT])
    air = float(circuit[col.C_AIR]) * ATMOSPHERE ** (1.0 / n)
    softness = 1.0 / modulus + air * GRID ** (-1.0 / n) / (n * GRID)
    growth = GRID * softness / np.exp(GRID / modulus - air * GRID ** (-1.0 / n))
    steps = 0.5 * (growth[1:] + growth[:-1]) * np.diff(GRID)
    return Compression(np.concatenate(([0.0], np.cumsum(steps))), modulus, air, n)


@allocation_free
def density(pressure: float, oil: Compression) -> float:
    """Density of oil with entrained air over that of oil without pressure: exp ∫ dp/β."""
    return math.exp(pressure / oil.modulus - oil.air * pressure ** (-1.0 / oil.exponent))


@allocation_free
def stored(pressure: float, oil: Compression) -> float:
    """Energy of compression (J) of the oil that takes 1 m³ without pressure."""
    place = max(math.log(pressure / FIRST) * PER_LOG, 0.0)
    k = min(int(place), len(GRID) - 2)
    share = (pressure - GRID[k]) / (GRID[k + 1] - GRID[k])
    energy: float = oil.energy[k] + share * (oil.energy[k + 1] - oil.energy[k])
    return energy


@allocation_free
def _powers(state: Array, model: Model, work: Work, oil: Compression, out: Array) -> None:
    """Fill the rates (N_INTEGRALS,) of all integrals from the latest evaluation, at ``state``."""
    for k in range(N_INTEGRALS):
        out[k] = 0.0
    flows, p_s, back = work.flows, state[SUPPLY], model.circuit[col.C_RETURN]
    for i in range(N_ACTUATORS):
        p_a, p_b = state[PRESSURE_A + i], state[PRESSURE_B + i]
        in_a, in_b, drawn = flows[i, col.F_NET_A], flows[i, col.F_NET_B], flows[i, col.F_SUPPLY]
        extends = state[SPOOL + i] >= 0.0
        # all that did not come from the supply came from, or went to, the return line
        tank_a, tank_b = (in_a - drawn, in_b) if extends else (in_a, in_b - drawn)
        out[GIVEN] += p_s * drawn
        out[RETURNED] -= back * (tank_a + tank_b)
        out[THROTTLED] += drawn * (p_s - (p_a if extends else p_b)) + tank_a * (back - p_a)
        out[THROTTLED] += tank_b * (back - p_b)
        out[SEALS] += (flows[i, col.F_FRICTION] - flows[i, col.F_STOP]) * flows[i, col.F_VELOCITY]
        mass_a, mass_b = density(p_a, oil) * in_a, density(p_b, oil) * in_b
        out[ADVECTED] += mass_a * stored(p_a, oil) + mass_b * stored(p_b, oil)
        out[MASSES + i], out[MASSES + N_ACTUATORS + i] = mass_a, mass_b
    for j in range(work.turn.shape[0]):
        out[HINGES] += model.mechanism.damping[j] * work.turn[j] ** 2


@allocation_free
def _watch(state: Array, model: Model, work: Work, seen: Array) -> None:
    """Widen the extremes ``seen`` (3,) by ``state``."""
    for k in range(PRESSURE_A, PRESSURE_B + N_ACTUATORS):
        seen[LEAST], seen[GREATEST] = min(seen[LEAST], state[k]), max(seen[GREATEST], state[k])
    seen[LEAST] = min(seen[LEAST], state[SUPPLY])
    for i in range(N_ACTUATORS):
        y, stroke = work.flows[i, col.F_POSITION], model.actuators[i, col.A_STROKE]
        seen[DEEPEST] = max(seen[DEEPEST], max(-y, y - stroke) / stroke)


@allocation_free
def booked_steps(
    state: Array,
    drive: Array,
    target: Array,
    steps: int,
    h: float,
    model: Model,
    work: Work,
    oil: Compression,
    rates: Array,
    total: Array,
    seen: Array,
) -> None:
    """Advance ``state`` and ``drive`` as the plant does, with them ``total`` (N_INTEGRALS,) and ``seen``."""
    k, stage = work.slope, work.stage
    for _ in range(steps):
        for i in range(N_ACTUATORS):
            out, back = model.actuators[i, col.A_SLEW_OUT], model.actuators[i, col.A_SLEW_BACK]
            drive[i], work.command[i] = slew_limited(drive[i], target[i], out, back, h)
        for s in range(4):
            reach = h if s == 3 else 0.5 * h
            for j in range(state.shape[0]):
                stage[j] = state[j] if s == 0 else state[j] + reach * k[s - 1, j]
            right_hand_side(stage, work.command, model, work, k[s])
            _powers(stage, model, work, oil, rates[s])
        for j in range(state.shape[0]):
            state[j] += h / 6.0 * (k[0, j] + 2.0 * (k[1, j] + k[2, j]) + k[3, j])
        for j in range(N_INTEGRALS):
            total[j] += h / 6.0 * (rates[0, j] + 2.0 * (rates[1, j] + rates[2, j]) + rates[3, j])
        _watch(state, model, work, seen)


class Ledger:
    """Runs a stand under its ``command`` and keeps its books."""

    def __init__(self, stand: Stand) -> None:
        self._stand = stand
        self._oil = compression(stand.model.circuit)
        self._drive = np.zeros(N_ACTUATORS)
        self._rates = np.zeros((4, N_INTEGRALS))

    def run(self, seconds: float, step: float) -> Balance:
        """Advance the stand by ``seconds`` and balance the books of that time; NaN wherever a state is."""
        stand = self._stand
        total, seen = np.zeros(N_INTEGRALS), np.array([np.inf, 0.0, 0.0])
        energy, mass = self._stored_energy_and_mass()
        booked_steps(
            stand.state, self._drive, stand.command, round(seconds / step), step,
            stand.model, stand.work, self._oil, self._rates, total, seen,
        )  # fmt: skip
        energy_after, mass_after = self._stored_energy_and_mass()
        given, returned, throttled, seals, hinges, advected = (float(value) for value in total[:MASSES])
        dissipated = throttled + seals + hinges
        return Balance(
            given=given,
            accounted=returned + dissipated + energy_after - energy - advected,
            dissipated=dissipated,
            mass_error=float(np.abs((mass_after - mass - total[MASSES:]) / mass).max()),
            least_pressure=float(seen[LEAST]),
            greatest_pressure=float(seen[GREATEST]),
            stop_met=bool(seen[DEEPEST] > 0.0),
        )

    def _stored_energy_and_mass(self) -> tuple[float, Array]:
        """Energy in motion, height, bending and compression, and the oil mass (12,) of each chamber."""
        stand, oil = self._stand, self._oil
        stand.rates()
        mech, table, y = stand.model.mechanism, stand.model.actuators, stand.work.flows[:, col.F_POSITION]
        bores = table[:, col.A_DEAD_A] + table[:, col.A_AREA_A] * y
        rods = table[:, col.A_DEAD_B] + table[:, col.A_AREA_B] * (table[:, col.A_STROKE] - y)
        pressures = [float(p) for p in stand.state[CHAMBERS]]
        mass = np.concatenate((bores, rods)) * np.array([density(p, oil) for p in pressures])
        pressed = mass @ np.array([stored(p, oil) for p in pressures])
        q, rate = stand.angles, stand.state[stand.model.places.rate]
        mechanical = sum(PinocchioArm(mech).energies(q, rate)) + 0.5 * mech.stiffness @ (q * q)
        return float(mechanical + pressed), mass
