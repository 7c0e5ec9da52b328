"""Test stands for the plant's own compiled code, and a case with a known answer as data."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.configuration import load
from plant_emulator.config.plant import PlantConfig
from plant_emulator.config.valves import JOINT_NAMES
from plant_emulator.core import layout as col
from plant_emulator.core.layout import (
    DRIVEN,
    N_ACTUATORS,
    PRESSURE_A,
    PRESSURE_B,
    RATE,
    SUPPLY,
    TEMPERATURE,
    Q,
    state_size,
)
from plant_emulator.core.mechanics.bodies import Lump, sphere, together
from plant_emulator.core.mechanics.geometry import ROTARY, Chain
from plant_emulator.core.mechanics.multibody import forward_kinematics
from plant_emulator.core.model import Model, build_model
from plant_emulator.core.right_hand_side import new_work, right_hand_side, runge_kutta_step

Array = NDArray[np.float64]

NO_ERRORS: dict[str, Any] = {
    "errors": {
        "encoder_offsets": {"enabled": False},
        "encoder_noise": {"enabled": False},
        "backlash": {"enabled": False},
        "geometry": {"enabled": False},
        "base_tilt": {"enabled": False},
    },
    "oil": {"thermal_drift": False},
    "valve_sets": {"servo": {"joints": dict.fromkeys(JOINT_NAMES)}},  # six valves alike
}
CHECK_POSE = np.radians([0.0, 45.0, -90.0, 0.0, 0.0, 0.0])  # the pose of the published model's checks
CHECK_TELESCOPE = {"geometry": {"telescope_m": 0.5}}
LIFT = 1
TILT = 4
ARM_END = 6  # the body beyond the arm's hinges
STAND = 0  # the actuator that stands in for a bare cylinder
END_MASS = 570.0  # kg of the published load cases


def default_config(config_dir: Path, *changes: Mapping[str, Any]) -> PlantConfig:
    """plant.yaml without its named errors, with ``changes`` laid over it in turn."""
    overrides: dict[str, Any] = {}
    for change in (NO_ERRORS, *changes):
        for key, value in change.items():
            known = overrides.get(key)
            both = isinstance(known, dict) and isinstance(value, Mapping)
            overrides[key] = {**known, **value} if both and isinstance(known, dict) else value
    return load(PlantConfig, config_dir / "plant.yaml", overrides)


class Stand:
    """A model under test with its state and command, advanced by the plant's own step."""

    def __init__(self, config: PlantConfig, pose: Array = CHECK_POSE) -> None:
        self.config = config
        self.model: Model
        self.chain: Chain
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
        """The chain's angles (n,) now, base first; a copy."""
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
        whole = together(lumps)
        mech = self.model.mechanism
        mech.mass[body], mech.centre[body], mech.inertia[body] = whole

    def body(self, index: int) -> Lump:
        """The body's present mass properties."""
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

    def run(self, seconds: float, step: float, watch: Callable[["Stand"], Any] | None = None) -> list[Any]:
        """Advance by ``seconds`` in steps of ``step``; what ``watch`` saw before each step and at the end."""
        seen: list[Any] = []
        for _ in range(round(seconds / step)):
            if watch is not None:
                seen.append(watch(self))
            runge_kutta_step(self.state, self.command, step, self.model, self.work)
        if watch is not None:
            seen.append(watch(self))
        return seen

    def run_with_integrals(
        self, seconds: float, step: float, integrand: Callable[["Stand", Array], Array], size: int
    ) -> tuple[Array, Array]:
        """Advance as ``run`` does; integrals (size,) of ``integrand`` by the same stages, and states seen.

        ``integrand`` gets the stand, its ``work.flows`` fresh, and the stage's state.
        """
        total, seen = np.zeros(size), [self.state.copy()]
        slope, stage = np.zeros((4, len(self.state))), self.state.copy()
        for _ in range(round(seconds / step)):
            start, grown = self.state.copy(), np.zeros((4, size))
            for k, reach in enumerate((0.0, 0.5, 0.5, 1.0)):
                stage = start if k == 0 else start + reach * step * slope[k - 1]
                right_hand_side(stage, self.command, self.model, self.work, slope[k])
                grown[k] = integrand(self, stage)
            weights = np.array([1.0, 2.0, 2.0, 1.0]) * step / 6.0
            self.state[:] = start + weights @ slope
            total += weights @ grown
            seen.append(self.state.copy())
        return total, np.array(seen)


def loaded_lift(config_dir: Path, end_mass: float = END_MASS) -> Stand:
    """The published load case: 45°, −90°, telescope 0.5 m, no wrist, ``end_mass`` at the telescope's end.

    The published expectations follow with the mass on the line through the tilt pivot: the tip's offset of
    0.15264 m is left out.
    """
    stand = Stand(default_config(config_dir, CHECK_TELESCOPE))
    stand.unload(7, 8, 9)
    geometry = stand.config.geometry
    end = stand.chain.point[TILT] + np.array([geometry.boom_tip_m[0] + geometry.telescope_m, 0.0, 0.0])
    stand.hang(ARM_END, [stand.body(ARM_END), sphere(end_mass, end, 0.0)])
    return stand


def bare_cylinder(config_dir: Path, mass: float = 500.0) -> Stand:
    """One free cylinder with the lift's oil: the frictionless slew joint, its angle read as metres.

    Supply of endless volume, so that its pressure stands; orifices all but unregularised; stroke 10 m.
    """
    stand = Stand(default_config(config_dir), np.zeros(6))
    stand.clamp_all_but(0)
    stand.unload(*range(len(stand.angles)))
    stand.hang(0, [Lump(1.0, np.zeros(3), np.eye(3) * mass)])
    table = stand.model.actuators
    table[STAND] = table[1]
    table[STAND, col.A_KIND], table[STAND, col.A_ANGLE0], table[STAND, col.A_STROKE] = ROTARY, -0.3, 10.0
    table[STAND, col.A_DEADBAND : col.A_DEADBAND + len(col.EDGES)] = 0.0
    stand.smooth(STAND)
    stand.model.circuit[[col.C_LINE_VOLUME, col.C_REGULARISATION]] = 1e9, 200.0
    stand.model.circuit[col.C_AIR] = 0.0
    return stand


def rate_of(stand: Stand) -> float:
    """The bare cylinder's velocity (m/s)."""
    return float(stand.state[RATE])


Relation = Literal["near", "at_most", "at_least"]


class ValidationCase(NamedTuple):
    """A case with a known answer. ``tolerance`` is absolute, in ``unit``; it widens a bound as well.

    ``source`` says where the expected value comes from.
    """

    family: int
    name: str
    unit: str
    expected: float
    obtained: float
    tolerance: float
    source: str
    relation: Relation = "near"

    @property
    def passed(self) -> bool:
        """Whether the obtained value is where it should be; NaN never is."""
        if self.relation == "at_most":
            return self.obtained <= self.expected + self.tolerance
        if self.relation == "at_least":
            return self.obtained >= self.expected - self.tolerance
        return abs(self.obtained - self.expected) <= self.tolerance
