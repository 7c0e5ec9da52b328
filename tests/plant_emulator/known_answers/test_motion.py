"""Accelerations by two other engines; vibration, friction, clearance, encoders, convergence."""

import math

import numpy as np
import pytest

from plant_emulator.core import layout as col
from plant_emulator.core.layout import N_COORDINATES, RATE, Q
from plant_emulator.core.mechanics import loose
from plant_emulator.core.mechanics.elastic import outboard_inertia
from plant_emulator.core.mechanics.loose import bristle_rate, friction_force, steady_level
from plant_emulator.core.mechanics.multibody import forward_dynamics, multibody_work
from plant_emulator.core.plant import Plant
from protocol.process_image import CONTROL_ENABLE, COUNTS_PER_TURN, ValveImage
from tests.plant_emulator.known_answers.stand import (
    LIFT,
    LIFT_VALVE,
    START,
    Array,
    Stand,
    decrement,
    default_config,
    period,
    resting_arm,
    shut_lift,
    switched_on,
)
from tests.plant_emulator.mechanics.structure_world import ENTRIES
from tests.plant_emulator.oracles import MujocoArm, PinocchioArm

FLOATING = {"gravity_m_s2": 0.0}
LSB = 2.0 * math.pi / COUNTS_PER_TURN
MOVING = [name for name in ENTRIES if name not in ("encoder_eccentricity", "vibration")]


@pytest.mark.parametrize("engine", [MujocoArm, PinocchioArm])
def test_the_whole_chain_accelerates_as_other_engines_say(engine: type[MujocoArm | PinocchioArm]) -> None:
    stand = Stand(default_config(switched_on(*MOVING)), START)
    mech, n, rng = stand.model.mechanism, len(stand.chain.names), np.random.default_rng(24)
    own, work, other = np.zeros(n), multibody_work(n), engine(mech)
    for _ in range(100):
        q = rng.uniform(-0.02, 0.02, n)
        q[stand.model.places.joint] = np.array([0.0, 0.8, -1.4, 0.0, 0.0, 0.0]) + rng.uniform(-1.0, 1.0, 6)
        rate, force = rng.normal(0.0, 0.5, n), rng.normal(0.0, 30.0, n)
        forward_dynamics(q, rate, force, mech, work, own)
        assert other.acceleration(q, rate, force) == pytest.approx(own, rel=1e-9, abs=1e-9)


def test_energy_stays_in_10_s_of_free_fall() -> None:
    """The flexible arm without oil and damping; of the largest kinetic energy, by Pinocchio."""
    stand = Stand(default_config())
    mech, oracle = stand.model.mechanism, PinocchioArm(stand.model.mechanism)
    mech.damping[:] = 0.0
    stand.smooth(*range(6))
    stand.model.actuators[:, [col.A_AREA_A, col.A_AREA_B, col.A_STOP_STIFFNESS, col.A_STOP_DAMPING]] = 0.0

    def energy(s: Stand) -> tuple[float, float]:
        q = s.angles
        kinetic, gravity = oracle.energies(q, s.state[RATE : RATE + N_COORDINATES])
        return kinetic, kinetic + gravity + 0.5 * float(mech.stiffness @ (q * q))

    kinetic, whole = stand.run(10.0, 2e-4, energy).T
    assert np.abs(whole - whole[0]).max() < 1e-6 * kinetic.max()


@pytest.mark.parametrize(("kg", "rod_side", "hz"), [(570.0, 42e5, 1.8356), (0.0, 21e5, 7.57)])
def test_the_locked_lift_swings_on_its_oil(kg: float, rod_side: float, hz: float) -> None:
    stand = shut_lift(kg, rod_side)
    stand.state[Q + LIFT] += 1e-4
    seen = stand.run(20.0 if kg else 5.0, 5e-4, lambda s: s.state[Q + LIFT])
    assert 1.0 / period(5e-4, seen) == pytest.approx(hz, rel=1e-3 if kg else 0.01)


def assert_rings_down(stand: Stand, at: int, hz: float, zeta: float) -> None:
    """Let go from 1 mrad, coordinate ``at`` alone: frequency √(K/J)/2π √(1 − ζ²), decrement 2πζ/√(1 − ζ²)."""
    stand.clamp_all_but(at)
    stand.state[stand.model.places.angle[at]] = 1e-3
    seen = stand.run(12.0 / hz, 2e-4, lambda s: s.angles[at])
    assert 1.0 / period(2e-4, seen) == pytest.approx(hz * math.sqrt(1.0 - zeta**2), rel=2e-3)
    assert decrement(seen) == pytest.approx(2.0 * math.pi * zeta / math.sqrt(1.0 - zeta**2), rel=0.01)


@pytest.mark.parametrize(("beam", "hinge"), [("boom", 2), ("boom", 3), ("arm", 5), ("arm", 6)])
def test_a_beam_rings_down(beam: str, hinge: int) -> None:
    stand = Stand(default_config(FLOATING), START)
    inertia = outboard_inertia(stand.model.mechanism, stand.angles, hinge)
    hz = math.sqrt(float(stand.model.mechanism.stiffness[hinge]) / inertia) / (2.0 * math.pi)
    assert_rings_down(stand, hinge, hz, getattr(stand.config.flexibility, beam).damping_ratio)


@pytest.mark.parametrize(("name", "k"), [("base_roll", 0), ("base_pitch", 1), ("base_yaw", 2)])
def test_a_rocking_base_rings_down(name: str, k: int) -> None:
    stand = Stand(default_config(FLOATING, switched_on("rocking_base")), START)
    base = stand.config.errors.rocking_base
    assert_rings_down(stand, stand.at(name), base.frequency_hz[k], base.damping_ratio)


class Seal:
    """The lift's seal, dragged by the plant's own equations; bristles by the midpoint rule."""

    def __init__(self) -> None:
        row = Stand(default_config()).model.actuators[LIFT_VALVE]
        self.coulomb, self.static, self.stribeck, self.stiffness, self.damping, self.viscous = (
            float(value) for value in row[col.A_COULOMB : col.A_VISCOUS + 1]
        )
        self.bristle = 0.0

    def drag(self, velocity: float, h: float) -> float:
        """Friction force after ``h`` seconds at ``velocity``."""
        level = steady_level(velocity, self.coulomb, self.static, self.stribeck)
        middle = self.bristle + 0.5 * h * bristle_rate(velocity, self.bristle, level, self.stiffness)
        self.bristle += h * bristle_rate(velocity, middle, level, self.stiffness)
        rate = bristle_rate(velocity, self.bristle, level, self.stiffness)
        return float(friction_force(velocity, self.bristle, rate, self.stiffness, self.damping, self.viscous))


@pytest.mark.parametrize("velocity", [-0.3, -0.05, -0.01, -0.002, 0.0005, 0.005, 0.02, 0.1, 0.5])
def test_steady_friction_is_stribecks_curve(velocity: float) -> None:
    """F_c + (F_s − F_c) exp(−(v/v_s)²) + σ2 v."""
    seal, h = Seal(), min(1e-3, 2e-5 / abs(velocity))
    forces = [seal.drag(velocity, h) for _ in range(int(6e-3 / abs(velocity) / h))]
    curve = seal.coulomb + (seal.static - seal.coulomb) * math.exp(-((velocity / seal.stribeck) ** 2))
    assert forces[-1] == pytest.approx(math.copysign(curve, velocity) + seal.viscous * velocity, rel=1e-3)


def test_500_kg_break_away_at_the_static_force_and_give_as_bristles_before() -> None:
    seal, h, velocity, first, most = Seal(), 2e-5, 0.0, 4.5e3, 0.0
    seal.bristle = first / seal.stiffness
    for step in range(round(7.0 / h)):
        velocity += h * (first + 100.0 * step * h - seal.drag(velocity, h)) / 500.0
        most = max(most, seal.stiffness * seal.bristle)
        if velocity > 2.0 * seal.stribeck:
            break
    assert velocity > seal.stribeck
    assert most == pytest.approx(5000.0, abs=50.0)
    slow = Seal()
    forces = [slow.drag(1e-5, 1e-3) for _ in range(1000)]
    assert (forces[-1] - forces[0]) / (999 * 1e-3 * 1e-5) == pytest.approx(8e6, rel=0.01)


def turntable(pull: float, **friction: float) -> Stand:
    """The arm as one rigid body on the loose slew of 1.6 mrad, without gravity, the motor side held."""
    entry = {"backlash_mrad": 1.6, "hose_nm": pull, "hose_nm_rad": 0.0, "friction": friction}
    stand = Stand(default_config(FLOATING, switched_on(loose_slew=entry)), START)
    stand.clamp_all_but(stand.at("slew_play"))
    return stand


@pytest.mark.parametrize("pull", [60.0, -60.0])
def test_a_side_load_chooses_the_side_of_the_clearance(pull: float) -> None:
    """b + τ / K; friction holds up to 20 N m of it."""
    stand = turntable(pull, coulomb_nm=20.0, static_nm=25.0)
    at, stiffness = stand.at("slew_play"), float(stand.model.loose.mesh[loose.M_STIFFNESS])
    stand.run(3.0, 5e-4)
    assert stand.angles[at] == pytest.approx(math.copysign(0.8e-3, pull) + pull / stiffness, abs=1.2e-5)


@pytest.mark.parametrize("zeta", [0.0, 0.05])
def test_a_flank_returns_what_damping_leaves_of_the_speed(zeta: float) -> None:
    """exp(−πζ/√(1 − ζ²)): a flank never pulls."""
    none = {"coulomb_nm": 0.0, "static_nm": 0.0, "bristle_damping_nm_s_rad": 0.0, "viscous_nm_s_rad": 0.0}
    stand = turntable(0.0, **none)
    mesh, play = stand.model.loose.mesh, stand.at("slew_play")
    inertia = outboard_inertia(stand.model.mechanism, stand.angles, play)
    mesh[loose.M_DAMPING] = 2.0 * zeta * math.sqrt(mesh[loose.M_STIFFNESS] * inertia)
    at = stand.model.places.rate[play]
    stand.state[at] = 0.02
    back = -stand.run(0.2, 1e-4, lambda s: s.state[at]).min() / 0.02
    assert back == pytest.approx(math.exp(-math.pi * zeta / math.sqrt(1.0 - zeta**2)), abs=0.03)


def sweep(plant: Plant) -> Array:
    """True slew angle (rad) and encoder count, sampled while the joint goes to and fro."""
    rows = []
    for k in range(600):
        opening = 0.2 * math.sin(2.0 * math.pi * k / 300.0)
        plant.write(ValveImage(k + 1, CONTROL_ENABLE, (opening, 0.0, 0.0, 0.0, 0.0, 0.0)))
        plant.advance(5_000_000)
        rows.append((plant.truth().q[0], plant.read().encoder_counts[0]))
    return np.array(rows)


def test_encoders_round_to_17_bit_and_backlash_makes_a_loop() -> None:
    q, counts = sweep(Plant(default_config(), seed=1)).T
    assert np.abs(counts * LSB - q).max() <= 0.5 * LSB + 1e-12
    loose_shaft = switched_on(backlash={"half_width_mrad": [0.3, 0, 0, 0, 0, 0]})
    q, counts = sweep(Plant(default_config(loose_shaft), seed=1)).T
    assert np.ptp(counts * LSB - q) == pytest.approx(2 * 0.3e-3, abs=1.05 * LSB)


def test_an_eccentric_encoder_is_off_once_a_turn() -> None:
    plant = Plant(default_config(switched_on("encoder_eccentricity")), seed=1)
    entry, turn = plant.config.errors.encoder_eccentricity, np.radians(np.arange(0.0, 360.0, 2.0))
    read = np.array([plant._encoders.read(np.full(6, angle), np.zeros(6)) for angle in turn])
    first = 2.0 / len(turn) * (np.exp(-1j * turn) @ (read * LSB - turn[:, None])) * 1j
    assert 1e3 * np.abs(first) == pytest.approx(np.array(entry.mrad), abs=0.01)
    turned = np.angle(first * np.exp(-1j * np.radians(entry.phase_deg)), deg=True)
    assert turned == pytest.approx(0.0, abs=2.0)


def test_the_integration_is_of_fourth_order() -> None:
    ends = {}
    for step in (1e-3, 5e-4, 2.5e-4, 3.125e-5):
        stand = resting_arm([0.0, 30.0, -80.0, 0.0, -20.0, 0.0], 30.0)
        stand.command[:] = 0.25, 0.3, 0.25, 0.2, 0.2, 0.2
        stand.run(0.3, 3.125e-5)  # past break-away, where friction is not smooth
        stand.run(0.4, step)
        ends[step] = stand.angles
    errors = [float(np.linalg.norm(ends[step] - ends[3.125e-5])) for step in (1e-3, 5e-4, 2.5e-4)]
    assert errors[0] / errors[1] == pytest.approx(16.0, abs=1.0)
    assert errors[1] / errors[2] == pytest.approx(16.0, abs=1.0)
