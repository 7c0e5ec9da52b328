"""A model under test, with its state and command, advanced by the plant's own step."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foundation.configuration import load, merged
from plant_emulator.config.plant import PlantConfig
from plant_emulator.config.valves import JOINT_NAMES
from plant_emulator.core import layout as col
from plant_emulator.core.equilibrium import gravity_torque, rest_state
from plant_emulator.core.layout import (
    DRIVEN,
    N_ACTUATORS,
    N_COORDINATES,
    PRESSURE_A,
    PRESSURE_B,
    SUPPLY,
    TEMPERATURE,
    Q,
    state_size,
)
from plant_emulator.core.mechanics.bodies import Lump, sphere, together
from plant_emulator.core.mechanics.geometry import ROTARY, actuator_lever
from plant_emulator.core.mechanics.multibody import forward_kinematics
from plant_emulator.core.model import build_model, put_payload
from plant_emulator.core.right_hand_side import new_work, right_hand_side, runge_kutta_step
from tests.support.paths import CONFIGS

Array = NDArray[np.float64]

_NAMED = ("encoder_offsets", "encoder_noise", "backlash", "geometry", "base_tilt")
NO_ERRORS: dict[str, Any] = {
    "errors": {name: {"enabled": False} for name in _NAMED},
    "oil": {"thermal_drift": False},
    "valve_sets": {"servo": {"joints": dict.fromkeys(JOINT_NAMES)}},  # six valves alike
}
CHECK_POSE = np.radians([0.0, 45.0, -90.0, 0.0, 0.0, 0.0])  # the pose of the published model's checks
START = np.radians([0.0, 50.0, -75.0, 0.0, -25.0, 0.0])
CHECK_TELESCOPE = {"geometry": {"telescope_m": 0.5}}
LIFT, TILT, ARM_END = 1, 4, 6  # in the chain; the last is the body beyond the arm's hinges
LIFT_VALVE, TILT_VALVE = 1, 2  # in the table of actuators


def default_config(*changes: Mapping[str, Any]) -> PlantConfig:
    """plant.yaml without its named errors, with ``changes`` laid over it in turn."""
    over = NO_ERRORS
    for change in changes:
        over = merged(over, dict(change))
    return load(PlantConfig, CONFIGS / "plant.yaml", over)


def switched_on(*names: str, **changes: Mapping[str, Any]) -> dict[str, Any]:
    """The errors of these ``names`` on, with ``changes`` of their numbers."""
    return {"errors": {name: {"enabled": True, **changes.get(name, {})} for name in {*names, *changes}}}


class Stand:
    """A model, its state, its command; every part of it may be changed."""

    def __init__(self, config: PlantConfig, pose: Array = CHECK_POSE) -> None:
        self.config = config
        self.model, self.chain, self.tool = build_model(config)
        self.work = new_work(self.model)
        self.state = np.zeros(state_size(self.model.places))
        self.command = np.zeros(N_ACTUATORS)
        self.state[[Q + joint for joint in DRIVEN]] = pose
        self.state[PRESSURE_A : PRESSURE_B + N_ACTUATORS] = self.model.circuit[col.C_SET] / 2.0
        self.state[SUPPLY] = self.model.circuit[col.C_SET]
        self.state[TEMPERATURE] = config.oil.temperature_degc

    @property
    def angles(self) -> Array:
        """The chain's angles (n,), base first; a copy."""
        return self.state[self.model.places.angle]

    def at(self, name: str) -> int:
        """Where in the chain the coordinate of this name is."""
        return self.chain.names.index(name)

    def clamp_all_but(self, *coordinates: int) -> None:
        """Lock every coordinate except the ones named."""
        self.model.mechanism.free[:] = 0.0
        self.model.mechanism.free[list(coordinates)] = 1.0

    def hang(self, body: int, lumps: list[Lump]) -> None:
        """Make ``body`` consist of ``lumps``, given at the home pose in base axes."""
        mech = self.model.mechanism
        mech.mass[body], mech.centre[body], mech.inertia[body] = together(lumps)

    def body(self, index: int) -> Lump:
        """Present mass properties of a body."""
        mech = self.model.mechanism
        return Lump(float(mech.mass[index]), mech.centre[index].copy(), mech.inertia[index].copy())

    def unload(self, *bodies: int) -> None:
        """Take away all mass of ``bodies``."""
        for i in bodies:
            self.hang(i, [])

    def smooth(self, *actuators: int) -> None:
        """Take away friction and leakage of ``actuators``."""
        columns = [col.A_COULOMB, col.A_STATIC, col.A_BRISTLE_DAMPING, col.A_VISCOUS, col.A_LEAKAGE]
        for i in actuators:
            self.model.actuators[i, columns] = 0.0

    def place(self, body: int, point_home: Array) -> Array:
        """Where the point of ``body`` that is at ``point_home`` (3,) in the home pose is now."""
        work = self.work.multibody
        forward_kinematics(self.angles, self.model.mechanism, work)
        return np.asarray(work.rotation[body + 1] @ point_home + work.origin[body + 1])

    def rates(self) -> Array:
        """d(state)/dt now; ``work.flows`` is filled as well."""
        rate = np.zeros_like(self.state)
        right_hand_side(self.state, self.command, self.model, self.work, rate)
        return rate

    def run(self, seconds: float, step: float, watch: Callable[["Stand"], Any] = lambda stand: None) -> Array:
        """Advance by ``seconds`` in steps of ``step``; what ``watch`` saw before each step and at the end."""
        seen: list[Any] = []
        for _ in range(round(seconds / step)):
            seen.append(watch(self))
            runge_kutta_step(self.state, self.command, step, self.model, self.work)
        return np.array([*seen, watch(self)])

    def run_with_integrals(
        self, seconds: float, step: float, integrand: Callable[["Stand", Array], Array], size: int
    ) -> Array:
        """Advance as ``run`` does; integrals (size,) of ``integrand(stand, state)`` by the same stages."""
        total, slope, grown = np.zeros(size), np.zeros((4, len(self.state))), np.zeros((4, size))
        weights = np.array([1.0, 2.0, 2.0, 1.0]) * step / 6.0
        for _ in range(round(seconds / step)):
            start = self.state.copy()
            for k, reach in enumerate((0.0, 0.5, 0.5, 1.0)):
                stage = start if k == 0 else start + reach * step * slope[k - 1]
                right_hand_side(stage, self.command, self.model, self.work, slope[k])
                grown[k] = integrand(self, stage)
            self.state[:] = start + weights @ slope
            total += weights @ grown
        return total


def loaded_lift(end_mass: float = 570.0) -> Stand:
    """The published load case: 45°, −90°, telescope 0.5 m, no wrist, ``end_mass`` (kg) at its end.

    As published, the mass lies on the line through the tilt pivot: the tip's offset of 0.15264 m is left out.
    """
    stand = Stand(default_config(CHECK_TELESCOPE))
    stand.unload(7, 8, 9)
    geometry = stand.config.geometry
    end = stand.chain.point[TILT] + np.array([geometry.boom_tip_m[0] + geometry.telescope_m, 0.0, 0.0])
    stand.hang(ARM_END, [stand.body(ARM_END), sphere(end_mass, end, 0.0)])
    return stand


def shut_lift(end_mass: float = 570.0, rod_side: float = 42e5) -> Stand:
    """That case on the oil of the shut lift alone, at rest: the bore carries the load above ``rod_side``."""
    stand = loaded_lift(end_mass)
    stand.clamp_all_but(LIFT)
    stand.smooth(LIFT_VALVE)
    row = stand.model.actuators[LIFT_VALVE]
    lever = actuator_lever(stand.state[Q + LIFT], *row[: col.A_LENGTH0 + 1])
    force = -gravity_torque(stand.model.mechanism, stand.state[Q : Q + N_COORDINATES])[LIFT] / lever
    stand.state[PRESSURE_B + LIFT_VALVE] = rod_side
    stand.state[PRESSURE_A + LIFT_VALVE] = (force + rod_side * row[col.A_AREA_B]) / row[col.A_AREA_A]
    return stand


def bare_cylinder() -> Stand:
    """One free cylinder, actuator 0, with the lift's oil and 500 kg: the slew joint, its angle in metres.

    No friction, no overlap; supply of endless volume; orifices all but unregularised; stroke 10 m.
    """
    stand = Stand(default_config(), np.zeros(6))
    stand.clamp_all_but(0)
    stand.unload(*range(len(stand.angles)))
    stand.hang(0, [Lump(1.0, np.zeros(3), np.eye(3) * 500.0)])
    table = stand.model.actuators
    table[0] = table[LIFT_VALVE]
    table[0, col.A_KIND], table[0, col.A_ANGLE0], table[0, col.A_STROKE] = ROTARY, -0.3, 10.0
    table[0, col.A_DEADBAND : col.A_DEADBAND + len(col.EDGES)] = 0.0
    stand.smooth(0)
    stand.model.circuit[[col.C_LINE_VOLUME, col.C_REGULARISATION]] = 1e9, 200.0
    stand.model.circuit[col.C_AIR] = 0.0
    return stand


def resting_arm(pose_deg: list[float], payload: float, *changes: Mapping[str, Any]) -> Stand:
    """The whole flexible arm at rest, carrying ``payload`` (kg)."""
    config = default_config({"start_pose_deg": pose_deg}, *changes)
    stand = Stand(config, np.radians(pose_deg))
    put_payload(stand.model, stand.tool, payload, config, stand.chain)
    stand.state[:] = rest_state(stand.model, stand.angles, config.oil.temperature_degc)
    return stand


def period(step: float, values: Array) -> float:
    """Mean period (s) of an oscillation sampled every ``step``, from its upward crossings of its mean."""
    x = values - values.mean()
    up = np.nonzero((x[:-1] < 0.0) & (x[1:] >= 0.0))[0]
    crossings = step * (up - x[up] / (x[up + 1] - x[up]))
    return float((crossings[-1] - crossings[0]) / (len(crossings) - 1))


def decrement(values: Array) -> float:
    """Logarithmic decrement of a decaying oscillation, over its first nine tops."""
    tops = np.nonzero((values[1:-1] > values[:-2]) & (values[1:-1] >= values[2:]))[0] + 1
    left, top, right = (values[tops[[0, 8]] + k] for k in (-1, 0, 1))
    first, last = top - (right - left) ** 2 / (8.0 * (left - 2.0 * top + right))
    return float(np.log(first / last)) / 8.0
