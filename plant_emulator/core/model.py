"""The plant's parameters as flat arrays in SI units, the only thing that the compiled code reads."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.configuration import StrictModel
from plant_emulator.config.actuators import (
    ANTICAVITATION_DROP_BAR,
    BAR,
    LITRE,
    LITRE_PER_MINUTE,
    RELIEF_OVERRIDE_BAR,
    ActuatorConfig,
)
from plant_emulator.config.plant import PlantConfig
from plant_emulator.config.valves import JOINT_NAMES, Valve, ValvesConfig
from plant_emulator.core import layout as col
from plant_emulator.core.layout import N_ACTUATORS, Places, places
from plant_emulator.core.mechanics.bodies import Lump, build_bodies, payload, together
from plant_emulator.core.mechanics.elastic import build_mechanism
from plant_emulator.core.mechanics.geometry import CYLINDER, ROTARY, Chain, build_chain
from plant_emulator.core.mechanics.loose import Looseness, build_looseness
from plant_emulator.core.mechanics.multibody import Mechanism

Array = NDArray[np.float64]

_POLYTROPIC_EXPONENT = 1.2  # [E] of entrained air
RETURN_A = col.EDGES.index("return_a")


class Model(NamedTuple):
    """Everything that the right-hand side needs besides state and command; see columns.py for the tables."""

    mechanism: Mechanism
    actuators: Array  # (6, A_COLUMNS)
    circuit: Array  # (C_COLUMNS,)
    places: Places
    loose: Looseness


def orifice_gain(flow: float, drop: float) -> float:
    """K_v (m³/s/√Pa) of an edge that passes ``flow`` (m³/s) at ``drop`` (Pa), far from zero."""
    return flow / math.sqrt(drop)


def _describe_actuator(actuator: ActuatorConfig, row: Array) -> None:
    """Fill linkage, areas, stops and friction of one row of the actuator table."""
    row[[col.A_AREA_A, col.A_AREA_B]] = actuator.areas()
    if actuator.cylinder is not None:
        c = actuator.cylinder
        friction: StrictModel = c.friction
        row[col.A_KIND : col.A_LENGTH0 + 1] = CYLINDER, c.base_m, c.lever_m, c.angle_rad, c.length_m
        row[col.A_STROKE], row[col.A_CUSHION] = c.stroke_m, c.end_stop.cushion_m
        row[[col.A_STOP_STIFFNESS, col.A_STOP_DAMPING]] = c.end_stop.stiffness_n_m, c.end_stop.damping_n_s_m
    else:
        assert actuator.rotary is not None  # by its validator
        r, stop, friction = actuator.rotary, actuator.rotary.end_stop, actuator.rotary.friction
        first, last = math.radians(r.from_deg), math.radians(r.to_deg)
        row[col.A_KIND : col.A_LENGTH0 + 1] = ROTARY, 0.0, 0.0, first, 0.0
        row[col.A_STROKE], row[col.A_CUSHION] = last - first, math.radians(stop.cushion_deg)
        row[[col.A_STOP_STIFFNESS, col.A_STOP_DAMPING]] = stop.stiffness_nm_rad, stop.damping_nm_s_rad
    row[col.A_COULOMB : col.A_VISCOUS + 1] = [number for _, number in friction]  # in the models' order


def _describe_valve(valves: ValvesConfig, valve: Valve, row: Array) -> None:
    """Fill spool, edges and flow curve of one row of the actuator table."""
    row[col.A_OMEGA], row[col.A_ZETA] = 2.0 * math.pi * valve.bandwidth_hz, valve.damping_ratio
    row[[col.A_SLEW_OUT, col.A_SLEW_BACK]] = valve.slew_out_per_s, valve.slew_back_per_s
    edges = zip(valve.edge_flows_l_min(), valves.edge_drops_bar(), valve.deadband, strict=True)
    for k, (flow, drop, overlap) in enumerate(edges):
        row[col.A_GAIN + k] = orifice_gain(flow * LITRE_PER_MINUTE, drop * BAR)
        row[col.A_DEADBAND + k] = overlap
    row[[col.A_SLOPE, col.A_SLOPE + 1]] = valve.slope_extend, valve.slope_retract
    row[col.A_SPOOL_LEAKAGE] = valve.spool_leakage_m3_s_pa


def build_actuators(config: PlantConfig) -> Array:
    """The actuator table (6, A_COLUMNS) of ``config``."""
    table = np.zeros((N_ACTUATORS, col.A_COLUMNS))
    valves, errors = config.valves, config.errors
    for name, row, actuator in zip(JOINT_NAMES, table, config.actuators.in_order(), strict=True):
        _describe_actuator(actuator, row)
        flow = actuator.rated_flow_l_min * LITRE_PER_MINUTE
        row[col.A_DEAD_A], row[col.A_DEAD_B] = (
            actuator.dead_volume_a_l * LITRE,
            actuator.dead_volume_b_l * LITRE,
        )
        valve = valves.of(name, actuator.rated_flow_l_min)
        stated = valve.actuator_leakage_m3_s_pa
        row[col.A_LEAKAGE] = actuator.leakage_m3_s_pa if math.isnan(stated) else stated
        _describe_valve(valves, valve, row)
        if not errors.leakage.enabled:
            row[[col.A_LEAKAGE, col.A_SPOOL_LEAKAGE]] = 0.0
        if not errors.friction.enabled:
            row[[col.A_COULOMB, col.A_STATIC, col.A_BRISTLE_DAMPING, col.A_VISCOUS]] = 0.0
        if not errors.valve_deadband.enabled:
            row[col.A_DEADBAND : col.A_DEADBAND + len(col.EDGES)] = 0.0
        row[col.A_RELIEF] = flow / (RELIEF_OVERRIDE_BAR * BAR)
        row[col.A_ANTICAVITATION] = orifice_gain(flow, ANTICAVITATION_DROP_BAR * BAR)
    if errors.finer_bending.enabled:
        table[1:3, col.A_STOP_DAMPING] *= errors.finer_bending.stop_damping_share
    hold = valves.counterbalance
    for i, fitted in ((1, hold.lift), (2, hold.tilt)):
        table[i, col.A_COUNTERBALANCE] = 2.0 * table[i, col.A_GAIN + RETURN_A] if fitted else 0.0
    return table


def build_circuit(config: PlantConfig) -> Array:
    """The circuit vector (C_COLUMNS,) of ``config``: oil, supply and return."""
    oil, pump, guard = config.oil, config.pump, config.protection
    most, capacity = pump.flow_limit_l_min * LITRE_PER_MINUTE, oil.heat_capacity_kj_k * 1e3
    c = np.zeros(col.C_COLUMNS)
    c[col.C_MODULUS] = oil.bulk_modulus_mpa * 1e6
    c[col.C_AIR], c[col.C_EXPONENT] = oil.air_fraction, _POLYTROPIC_EXPONENT
    c[col.C_REFERENCE], c[col.C_AMBIENT] = oil.reference_degc, oil.ambient_degc
    c[col.C_VISCOSITY_DRIFT], c[col.C_MODULUS_DRIFT] = oil.viscosity_per_k, oil.modulus_per_k
    c[col.C_COOLING] = oil.cooling_w_k / capacity
    c[col.C_HEAT_CAPACITY] = capacity if oil.thermal_drift else 0.0
    c[col.C_SET], c[col.C_RETURN] = pump.pressure_bar * BAR, pump.return_bar * BAR
    c[col.C_FLOW_LIMIT], c[col.C_PUMP_GAIN] = most, most / (pump.droop_bar * BAR)
    c[col.C_IDLE_LOSS] = pump.idle_loss_kw * 1e3
    c[col.C_LINE_VOLUME], c[col.C_RUNNING] = pump.line_volume_l * LITRE, 1.0
    c[col.C_DUMP] = orifice_gain(pump.dump_flow_l_min * LITRE_PER_MINUTE, 100.0 * BAR)
    c[col.C_RELIEF], c[col.C_REGULARISATION] = guard.relief_bar * BAR, config.valves.regularisation_bar * BAR
    hold = config.valves.counterbalance
    c[col.C_COMPENSATOR] = config.valves.compensator_bar * BAR
    c[col.C_HOLD], c[col.C_PILOT], c[col.C_HOLD_RANGE] = (
        hold.setting_bar * BAR,
        hold.pilot_ratio,
        hold.range_bar * BAR,
    )
    c[col.C_HOLD_LAG] = hold.lag_ms * 1e-3
    sensing = pump.load_sensing
    if sensing.enabled:
        c[col.C_LS_MARGIN], c[col.C_LS_LAG] = sensing.margin_bar * BAR, sensing.lag_ms * 1e-3
    cools = config.errors.cooling_oil
    if cools.enabled:
        c[col.C_EXPANSION], c[col.C_CHAMBER_COOLING] = cools.expansion_per_k, 1.0 / cools.time_constant_s
    return c


def build_model(config: PlantConfig) -> tuple[Model, Chain, Lump]:
    """The model without payload, its chain, and the bare tool body that a payload is added to."""
    chain = build_chain(config)
    bodies = build_bodies(config, chain)
    mechanism, shared = build_mechanism(config, chain, bodies)
    model = Model(
        mechanism=mechanism,
        actuators=build_actuators(config),
        circuit=build_circuit(config),
        places=places(chain.names),
        loose=build_looseness(config, chain.names, shared),
    )
    return model, chain, bodies[-1]


def put_payload(model: Model, tool: Lump, mass: float, config: PlantConfig, chain: Chain) -> None:
    """Write ``tool`` plus a payload of ``mass`` (kg) into the model's last body, in place."""
    loaded = together([tool, payload(mass, config, chain)])
    model.mechanism.mass[-1] = loaded.mass
    model.mechanism.centre[-1] = loaded.centre
    model.mechanism.inertia[-1] = loaded.inertia
