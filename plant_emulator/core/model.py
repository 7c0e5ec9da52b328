"""The plant's parameters as flat arrays in SI units, the only thing that the compiled code reads."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plant_emulator.core.bodies import Lump, build_bodies, payload, together
from plant_emulator.core.geometry import Chain, base_tilt, build_chain
from plant_emulator.core.layout import DRIVEN, FLEXIBLE, N_COORDINATES
from plant_emulator.core.linkage import CYLINDER, ROTARY
from plant_emulator.core.multibody import Mechanism, forward_dynamics, multibody_work
from plant_emulator.plant_config import BAR, LITRE, LITRE_PER_MINUTE, ActuatorConfig, PlantConfig

Array = NDArray[np.float64]


class Hydraulics(NamedTuple):
    """Per actuator, one row each: ``linkage`` (6, 5) as linkage.py takes it, ``cylinder`` (6, 9) area a, area b, dead
    volume a, dead volume b, stroke, leakage, stop stiffness, stop damping, wall compliance; ``valve`` (6, 7) orifice gain, deadband,
    ω, ζ, slew limit, relief gain, anti-cavitation gain; ``friction`` (6, 6) Coulomb, static, Stribeck, stiffness, micro-damping,
    viscous. ``oil`` (8): modulus, air, exponent, reference temperature, 1/K viscosity, 1/K modulus, cooling/heat capacity,
    ambient; then ``supply`` (10): set pressure, return, flow limit, gain, volume, dump gain, running, relief setting,
    regularisation, heat capacity (0 when the temperature is held)."""

    linkage: Array
    cylinder: Array
    valve: Array
    friction: Array
    oil: Array
    supply: Array


class Model(NamedTuple):
    """Everything that the right-hand side needs besides state and command."""

    mechanism: Mechanism
    hydraulics: Hydraulics


def orifice_gain(flow: float, drop: float) -> float:
    """K_v (m³/s/√Pa) of an edge that passes ``flow`` (m³/s) at ``drop`` (Pa), well above the regularisation."""
    return flow / math.sqrt(drop)


def _actuator_rows(actuator: ActuatorConfig, wall: float) -> tuple[list[float], list[float], list[float]]:
    """Rows of ``linkage``, ``cylinder`` and ``friction``."""
    volumes = [actuator.dead_volume_a_l * LITRE, actuator.dead_volume_b_l * LITRE]
    if actuator.cylinder is not None:
        c = actuator.cylinder
        bore, rod = math.pi / 4.0 * (c.bore_mm * 1e-3) ** 2, math.pi / 4.0 * (c.rod_mm * 1e-3) ** 2
        f = c.friction
        return (
            [CYLINDER, c.base_m, c.lever_m, c.angle_rad, c.length_m],
            [bore, bore - rod, *volumes, c.stroke_m, actuator.leakage_m3_s_pa,
             c.end_stop.stiffness_n_m, c.end_stop.damping_n_s_m, wall],
            [f.coulomb_n, f.static_n, f.stribeck_m_s, f.bristle_n_m, f.bristle_damping_n_s_m, f.viscous_n_s_m],
        )  # fmt: skip
    r = actuator.rotary
    assert r is not None  # the configuration allows exactly one of the two
    g, first, last = r.friction, math.radians(r.from_deg), math.radians(r.to_deg)
    return (
        [ROTARY, 0.0, 0.0, first, 0.0],
        [r.displacement_m3_rad, r.displacement_m3_rad, *volumes, last - first, actuator.leakage_m3_s_pa,
         r.end_stop.stiffness_nm_rad, r.end_stop.damping_nm_s_rad, wall],
        [g.coulomb_nm, g.static_nm, g.stribeck_rad_s, g.bristle_nm_rad, g.bristle_damping_nm_s_rad, g.viscous_nm_s_rad],
    )  # fmt: skip


def build_hydraulics(config: PlantConfig) -> Hydraulics:
    """Valves, chambers, friction, oil and pump of ``config`` in SI units."""
    actuators, valves, guard = config.actuators.in_order(), config.valves, config.protection
    linkage, cylinder, valve, friction = [], [], [], []
    for actuator in actuators:
        rows = _actuator_rows(actuator, config.oil.wall_compliance_m3_pa)
        linkage.append(rows[0])
        cylinder.append(rows[1])
        friction.append(rows[2])
        flow = actuator.rated_flow_l_min * LITRE_PER_MINUTE
        valve.append([
            orifice_gain(flow, valves.rated_drop_bar * BAR), valves.deadband, 2.0 * math.pi * valves.bandwidth_hz,
            valves.damping_ratio, valves.slew_limit_per_s, flow / (guard.relief_override_bar * BAR),
            orifice_gain(flow, guard.anticavitation_drop_bar * BAR) if guard.anticavitation else 0.0,
        ])  # fmt: skip
    oil, pump = config.oil, config.pump
    most = pump.flow_limit_l_min * LITRE_PER_MINUTE
    capacity = oil.heat_capacity_kj_k * 1e3
    return Hydraulics(
        np.array(linkage), np.array(cylinder), np.array(valve), np.array(friction),
        np.array([oil.bulk_modulus_mpa * 1e6, oil.air_fraction, oil.polytropic_exponent, oil.reference_degc,
                  oil.viscosity_per_k, oil.modulus_per_k, oil.cooling_w_k / capacity, oil.ambient_degc]),
        np.array([pump.pressure_bar * BAR, pump.return_bar * BAR, most, most / (pump.droop_bar * BAR),
                  pump.line_volume_l * LITRE, orifice_gain(pump.dump_flow_l_min * LITRE_PER_MINUTE, 100.0 * BAR), 1.0,
                  guard.relief_bar * BAR, valves.regularisation_bar * BAR, capacity if oil.thermal_drift else 0.0]),
    )  # fmt: skip


def build_mechanism(config: PlantConfig, chain: Chain, bodies: list[Lump]) -> Mechanism:
    """The true chain of ``config`` with the given ``bodies``; hinge damping from the outboard inertia at the start pose."""
    n = N_COORDINATES
    stiffness, free = np.zeros(n), np.ones(n)
    flex = config.flexibility
    for i, ei, beam in (
        (2, flex.boom.vertical_ei_n_m2, flex.boom), (3, flex.boom.lateral_ei_n_m2, flex.boom),
        (5, flex.arm.vertical_ei_n_m2, flex.arm), (6, flex.arm.lateral_ei_n_m2, flex.arm),
    ):  # fmt: skip
        stiffness[i] = 4.0 * ei / (3.0 * beam.length_m)
        free[i] = 1.0 if flex.enabled else 0.0
    gravity = base_tilt(config)[:3, :3].T @ np.array([0.0, 0.0, -config.gravity_m_s2])
    mechanism = Mechanism(
        chain.axis, chain.point, np.array([b.mass for b in bodies]), np.array([b.centre for b in bodies]),
        np.array([b.inertia for b in bodies]), free, stiffness, np.zeros(n), gravity,
    )  # fmt: skip
    for i, beam in zip(FLEXIBLE, (flex.boom, flex.boom, flex.arm, flex.arm), strict=True):
        inertia = hinge_inertia(mechanism, start_coordinates(config), i)
        mechanism.damping[i] = 2.0 * beam.damping_ratio * math.sqrt(stiffness[i] * inertia)
    return mechanism


def hinge_inertia(mechanism: Mechanism, q: Array, coordinate: int) -> float:
    """The inertia (kg m²) of everything behind ``coordinate`` about its axis at pose ``q``, all other coordinates locked."""
    alone = mechanism._replace(
        free=np.array([1.0 if i == coordinate else 0.0 for i in range(N_COORDINATES)]), gravity=np.zeros(3)
    )
    push, acceleration = np.zeros(N_COORDINATES), np.zeros(N_COORDINATES)
    push[coordinate] = 1.0
    forward_dynamics(q, np.zeros(N_COORDINATES), push, alone, multibody_work(N_COORDINATES), acceleration)
    return 1.0 / float(acceleration[coordinate])


def start_coordinates(config: PlantConfig) -> Array:
    """The ten coordinates (10,) of the start pose, hinges straight."""
    q = np.zeros(N_COORDINATES)
    q[list(DRIVEN)] = np.radians(config.start_pose_deg)
    return q


def build_model(config: PlantConfig) -> tuple[Model, Chain, Lump]:
    """The model without payload, its chain, and the bare tool body that a payload is added to."""
    chain = build_chain(config)
    bodies = build_bodies(config, chain)
    return Model(build_mechanism(config, chain, bodies), build_hydraulics(config)), chain, bodies[-1]


def put_payload(model: Model, tool: Lump, mass: float, config: PlantConfig, chain: Chain) -> None:
    """Write ``tool`` plus a payload of ``mass`` (kg) into the model's last body, in place."""
    loaded = together([tool, payload(mass, config, chain)])
    model.mechanism.mass[-1] = loaded.mass
    model.mechanism.centre[-1] = loaded.centre
    model.mechanism.inertia[-1] = loaded.inertia

