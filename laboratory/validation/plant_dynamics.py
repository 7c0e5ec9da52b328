"""Families 4, 5, 10, 13, 14: accelerations, energy, vibration on oil and on beams; friction."""

import math
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from foundation.configuration import load
from laboratory.validation.ledger import MujocoArm, PinocchioArm
from laboratory.validation.plant_rig import LIFT, Stand, ValidationCase, default_config, loaded_lift
from laboratory.validation.plant_statics import settle_lift
from plant_emulator.config.plant import PlantConfig
from plant_emulator.core import layout as col
from plant_emulator.core.layout import N_COORDINATES, RATE, Q
from plant_emulator.core.mechanics.elastic import outboard_inertia
from plant_emulator.core.mechanics.loose import bristle_rate, friction_force, steady_level
from plant_emulator.core.mechanics.multibody import forward_dynamics, multibody_work
from plant_emulator.core.model import put_payload

Array = NDArray[np.float64]


def accelerations(config_dir: Path) -> list[ValidationCase]:
    """Family 4: 200 random states of the arm with all its geometric errors and a payload, both oracles."""
    config = load(PlantConfig, config_dir / "plant.yaml")
    stand = Stand(config)
    put_payload(stand.model, stand.tool, 60.0, config, stand.chain)
    mech = stand.model.mechanism
    oracles: dict[str, MujocoArm | PinocchioArm] = {
        "MuJoCo": MujocoArm(mech),
        "Pinocchio": PinocchioArm(mech),
    }
    worst = dict.fromkeys(oracles, 0.0)
    rng, own, work = np.random.default_rng(4), np.zeros(N_COORDINATES), multibody_work(N_COORDINATES)
    reach = np.array([2.0, 1.0, 0.02, 0.02, 1.0, 0.02, 0.02, 1.5, 1.5, 1.5])
    middle = np.array([0.0, 0.8, 0.0, 0.0, -1.4, 0.0, 0.0, 0.0, 0.0, 0.0])
    torques = np.array([300.0, 1e3, 100.0, 100.0, 300.0, 30.0, 30.0, 10.0, 10.0, 10.0])
    for _ in range(200):
        q = middle + reach * rng.uniform(-1.0, 1.0, N_COORDINATES)
        rate = rng.normal(0.0, 0.5, N_COORDINATES)
        force = rng.normal(0.0, 1.0, N_COORDINATES) * torques
        forward_dynamics(q, rate, force, mech, work, own)
        for name, arm in oracles.items():
            worst[name] = max(worst[name], float(np.abs(arm.acceleration(q, rate, force) - own).max()))
    return [
        ValidationCase(
            4, f"accelerations against {name}", "rad/s²", 0.0, difference, 1e-10, f"{name}, 200 random states"
        )
        for name, difference in worst.items()
    ]


def energy_drift(config_dir: Path) -> list[ValidationCase]:
    """Family 5: a free fall of the flexible arm for 10 s without oil or damping, energies by Pinocchio."""
    stand = Stand(default_config(config_dir))
    mech = stand.model.mechanism
    mech.damping[:] = 0.0
    stand.smooth(*range(6))
    stand.model.actuators[:, [col.A_AREA_A, col.A_AREA_B, col.A_STOP_STIFFNESS, col.A_STOP_DAMPING]] = 0.0
    oracle = PinocchioArm(mech)

    def energy(s: Stand) -> tuple[float, float]:
        q, rate = s.state[Q : Q + N_COORDINATES], s.state[RATE : RATE + N_COORDINATES]
        kinetic, gravity = oracle.energies(q, rate)
        return kinetic, kinetic + gravity + 0.5 * float(mech.stiffness @ (q * q))

    seen = np.array(stand.run(10.0, 2e-4, energy))
    drift = float(np.abs(seen[:, 1] - seen[0, 1]).max() / seen[:, 0].max())
    source = "conservation; of the largest kinetic energy, by Pinocchio"
    return [ValidationCase(5, "energy drift in 10 s of free fall", "", 0.0, drift, 1e-6, source)]


def period(step: float, values: Array) -> float:
    """The mean period (s) of an oscillation sampled every ``step``, from its upward crossings of its mean."""
    x = values - values.mean()
    up = np.nonzero((x[:-1] < 0.0) & (x[1:] >= 0.0))[0]
    crossings = step * (up - x[up] / (x[up + 1] - x[up]))
    return float((crossings[-1] - crossings[0]) / (len(crossings) - 1))


def _swing(stand: Stand, seconds: float) -> float:
    """The frequency (Hz) at which the lift vibrates on its oil after a nudge of 0.1 mrad."""
    step = 5e-4
    stand.state[Q + LIFT] += 1e-4
    seen = np.array(stand.run(seconds, step, lambda s: float(s.state[Q + LIFT])))
    return 1.0 / period(step, seen)


def locked_lift(config_dir: Path) -> list[ValidationCase]:
    """Family 10: the oil spring of the shut lift, and how the arm swings on it with and without 570 kg."""
    stand = loaded_lift(config_dir)
    stand.clamp_all_but(LIFT)
    stand.smooth(1)
    settle_lift(stand)
    stand.state[RATE + LIFT] = 1e-6
    rate = stand.rates()
    row, velocity = stand.model.actuators[1], float(stand.work.flows[1, col.F_VELOCITY])
    spring = -(row[col.A_AREA_A] * rate[33] - row[col.A_AREA_B] * rate[39]) / velocity / 1e6
    stand.state[RATE + LIFT] = 0.0
    loaded = _swing(stand, 20.0)
    bare = loaded_lift(config_dir, 0.0)
    bare.clamp_all_but(LIFT)
    bare.smooth(1)
    settle_lift(bare, rod_side=21e5)
    return [
        ValidationCase(
            10, "oil spring of the shut lift", "MN/m", 6.74, float(spring), 0.02, "β (A_a²/V_a + A_b²/V_b)"
        ),
        ValidationCase(
            10, "locked lift with 570 kg", "Hz", 1.8356, loaded, 0.0018, "oil spring, gravity, geometry"
        ),
        ValidationCase(
            10,
            "locked lift, bare",
            "Hz",
            7.57,
            _swing(bare, 5.0),
            0.08,
            "rod side at 21 bar, softened by air; links' inertia estimated",
        ),
    ]


def ring_down(config_dir: Path) -> list[ValidationCase]:
    """Family 13: each hinge alone, let go from 1 mrad: frequency and decay."""
    cases = []
    for name, hinge in (("boom vertical", 2), ("boom lateral", 3), ("arm vertical", 5), ("arm lateral", 6)):
        stand = Stand(default_config(config_dir, {"gravity_m_s2": 0.0}), np.radians([0, 50, -75, 0, -25, 0]))
        stand.clamp_all_but(hinge)
        mech = stand.model.mechanism
        inertia = outboard_inertia(mech, stand.state[Q : Q + N_COORDINATES], hinge)
        beam = stand.config.flexibility.boom if hinge < 4 else stand.config.flexibility.arm
        zeta = beam.damping_ratio
        frequency = math.sqrt(float(mech.stiffness[hinge]) / inertia) / (2.0 * math.pi)
        stand.state[Q + hinge] = 1e-3
        step = 2e-4
        seen = np.array(stand.run(12.0 / frequency, step, partial(_angle, hinge)))
        decay = decrement(seen)
        expected = 2.0 * math.pi * zeta / math.sqrt(1.0 - zeta * zeta)
        damped = frequency * math.sqrt(1.0 - zeta * zeta)
        obtained = 1.0 / period(step, seen)
        cases.append(
            ValidationCase(13, f"{name} ring-down", "Hz", damped, obtained, 0.002 * damped, "√(K/J) / 2π")
        )
        cases.append(
            ValidationCase(13, f"{name} log decrement", "", expected, decay, 0.01 * expected, "2πζ/√(1 − ζ²)")
        )
    return cases


def decrement(values: Array) -> float:
    """The logarithmic decrement of a decaying oscillation, over its first nine tops."""
    tops = np.nonzero((values[1:-1] > values[:-2]) & (values[1:-1] >= values[2:]))[0] + 1
    heights = [_vertex(values[k - 1 : k + 2]) for k in tops[:9]]
    return math.log(heights[0] / heights[8]) / 8.0


def _angle(coordinate: int, stand: Stand) -> float:
    return float(stand.state[Q + coordinate])


def _vertex(three: Array) -> float:
    """The height of the parabola through three equidistant samples."""
    left, top, right = (float(v) for v in three)
    return top - (right - left) ** 2 / (8.0 * (left - 2.0 * top + right))


class Seal:
    """The lift's seal, dragged by the plant's own equations."""

    def __init__(self, row: Array) -> None:
        self.coulomb, self.static, self.stribeck, self.stiffness, self.damping, self.viscous = (
            float(value) for value in row[col.A_COULOMB : col.A_VISCOUS + 1]
        )
        self.bristle = 0.0

    def drag(self, velocity: float, h: float) -> float:
        """The friction force after ``h`` seconds at ``velocity``; bristles by the midpoint rule."""
        level = steady_level(velocity, self.coulomb, self.static, self.stribeck)
        middle = self.bristle + 0.5 * h * bristle_rate(velocity, self.bristle, level, self.stiffness)
        self.bristle += h * bristle_rate(velocity, middle, level, self.stiffness)
        rate = bristle_rate(velocity, self.bristle, level, self.stiffness)
        return float(friction_force(velocity, self.bristle, rate, self.stiffness, self.damping, self.viscous))


def friction(config_dir: Path) -> list[ValidationCase]:
    """Family 14: the steady curve, the largest force before sliding, the slope of the first micrometres."""
    row = Stand(default_config(config_dir)).model.actuators[1]
    worst = 0.0
    for velocity in (-0.3, -0.05, -0.01, -0.002, 0.0005, 0.005, 0.02, 0.1, 0.5):
        seal, h = Seal(row), min(1e-3, 2e-5 / abs(velocity))
        for _ in range(int(6e-3 / abs(velocity) / h)):
            force = seal.drag(velocity, h)
        curve = np.sign(velocity) * (
            seal.coulomb + (seal.static - seal.coulomb) * np.exp(-((velocity / seal.stribeck) ** 2))
        )
        worst = max(worst, abs(force / (curve + seal.viscous * velocity) - 1.0))
    return [
        ValidationCase(
            14,
            "steady curve, nine velocities",
            "",
            0.0,
            float(worst),
            1e-3,
            "F_c + (F_s − F_c) e^−(v/v_s)² + σ2 v",
        ),
        ValidationCase(14, "break-away force", "kN", 5.0, _break_away(row) / 1e3, 0.05, "F_s"),
        ValidationCase(14, "pre-sliding slope", "N/µm", 8.0, _first_slope(row), 0.08, "σ0"),
    ]


def _break_away(row: Array) -> float:
    """The largest bristle force (N) before 500 kg slide off, pulled by a force that rises by 100 N/s."""
    seal, mass, h, velocity, first = Seal(row), 500.0, 2e-5, 0.0, 4.5e3
    seal.bristle, most = first / seal.stiffness, 0.0
    for step in range(round(7.0 / h)):
        velocity += h * (first + 100.0 * step * h - seal.drag(velocity, h)) / mass
        most = max(most, seal.stiffness * seal.bristle)
        if velocity > 2.0 * seal.stribeck:
            return most
    return float("nan")


def _first_slope(row: Array) -> float:
    """Force over displacement (N/µm) of the first 10 µm, pulled slowly."""
    seal, h, velocity = Seal(row), 1e-3, 1e-5
    forces = [seal.drag(velocity, h) for _ in range(1000)]
    return (forces[-1] - forces[0]) / (999 * h * velocity * 1e6)
