"""The oil's half of the right-hand side: valves, chambers, friction, end stops, pump and temperature."""

import math

import numpy as np
from numpy.typing import NDArray

from foundation.compiled import allocation_free
from plant_emulator.core import layout as col
from plant_emulator.core.hydraulics.valve_commands import (
    compensated_drop,
    held_gain,
    opening,
    orifice_flow,
    spool_acceleration,
)
from plant_emulator.core.layout import (
    BRISTLE,
    CHAMBER_TEMPERATURE,
    DRIVEN,
    HOLDING,
    LOAD_SENSE,
    N_ACTUATORS,
    PRESSURE_A,
    PRESSURE_B,
    RATE,
    SPOOL,
    SPOOL_RATE,
    SUPPLY,
    TEMPERATURE,
    Q,
)
from plant_emulator.core.mechanics.geometry import actuator_reach
from plant_emulator.core.mechanics.loose import bristle_rate, friction_force, steady_level

ATMOSPHERE = 101_325.0  # Pa
FLOOR = 1_000.0  # Pa: below it the air term is held constant, so that the modulus stays above zero


@allocation_free
def bulk_modulus(pressure: float, oil: float, air: float, exponent: float) -> float:
    """Effective bulk modulus (Pa) of a chamber: 1/β = 1/β_oil + α (p0/p)^(1/n)/(n p).

    ``oil``: of oil, barrel and hose; ``air``: entrained volume fraction at atmospheric pressure. Each term is
    a relative volume per pascal, hence mass is conserved whatever the pressure does.
    """
    p = max(pressure, FLOOR)
    softness = 1.0 / oil
    if air > 0.0:
        softness += air * (ATMOSPHERE / p) ** (1.0 / exponent) / (exponent * p)
    return 1.0 / softness


@allocation_free
def relief_flow(pressure: float, setting: float, gain: float) -> float:
    """Flow (m³/s) that a relief valve lets out: ``gain`` (m³/s/Pa) times the excess over ``setting``."""
    return gain * max(pressure - setting, 0.0)


Array = NDArray[np.float64]
Indices = NDArray[np.int64]

JOINT = np.array(DRIVEN)  # compiled code indexes an array, not a tuple, with a variable


@allocation_free
def _held_open(p_a: float, p_b: float, c: Array) -> float:
    """How far (0…1) pressures at the load and in the pilot line open a counterbalance valve at rest."""
    wish: float = (p_a + c[col.C_PILOT] * p_b - c[col.C_HOLD]) / c[col.C_HOLD_RANGE]
    return min(max(wish, 0.0), 1.0)


@allocation_free
def _metered(i: int, state: Array, a: Array, c: Array, flows: Array) -> tuple[float, float]:
    """Flows (m³/s) through the open edges of valve ``i`` into chamber a and b; ``flows`` tells the draw."""
    p_a, p_b, p_s, p_t = state[PRESSURE_A + i], state[PRESSURE_B + i], state[SUPPLY], c[col.C_RETURN]
    soft, set_pressure, travel = c[col.C_REGULARISATION], c[col.C_COMPENSATOR], abs(state[SPOOL + i])
    extends = state[SPOOL + i] >= 0.0
    way = 0 if extends else 1
    slope, edge = a[i, col.A_SLOPE + way], 2 * way
    gain_in = a[i, col.A_GAIN + edge] * opening(travel, a[i, col.A_DEADBAND + edge], slope)
    gain_out = a[i, col.A_GAIN + edge + 1] * opening(travel, a[i, col.A_DEADBAND + edge + 1], slope)
    gain_a, gain_b = (gain_in, gain_out) if extends else (gain_out, gain_in)
    drop_a, drop_b = (p_s - p_a, p_t - p_b) if extends else (p_t - p_a, p_s - p_b)
    if set_pressure > 0.0:
        if extends:
            drop_a = compensated_drop(drop_a, set_pressure)
        else:
            drop_b = compensated_drop(drop_b, set_pressure)
    if drop_a < 0.0 and a[i, col.A_COUNTERBALANCE] > 0.0:
        opened = state[HOLDING + i] if c[col.C_HOLD_LAG] > 0.0 else _held_open(p_a, p_b, c)
        gain_a = held_gain(gain_a, a[i, col.A_COUNTERBALANCE] * opened)
    in_a, in_b = orifice_flow(gain_a, drop_a, soft), orifice_flow(gain_b, drop_b, soft)
    flows[i, col.F_SUPPLY] = in_a if extends else in_b
    flows[i, col.F_LOAD] = (p_a if extends else p_b) if gain_in > 0.0 else 0.0
    return in_a, in_b


@allocation_free
def _chamber_flows(i: int, state: Array, viscosity_ratio: float, a: Array, c: Array, flows: Array) -> None:
    """Fill net chamber flows and supply flow of actuator ``i``: valve, leakage, relief, anti-cavitation."""
    p_a, p_b, p_t = state[PRESSURE_A + i], state[PRESSURE_B + i], c[col.C_RETURN]
    soft, limit = c[col.C_REGULARISATION], c[col.C_RELIEF]
    in_a, in_b = _metered(i, state, a, c, flows)
    leak = a[i, col.A_LEAKAGE] * viscosity_ratio * (p_a - p_b)
    in_a -= leak + relief_flow(p_a, limit, a[i, col.A_RELIEF])
    in_b += leak - relief_flow(p_b, limit, a[i, col.A_RELIEF])
    if a[i, col.A_SPOOL_LEAKAGE] > 0.0:
        past = a[i, col.A_SPOOL_LEAKAGE] * viscosity_ratio
        in_b -= past * (p_b - p_t)
        if a[i, col.A_COUNTERBALANCE] == 0.0 or p_a < p_t:  # its seat keeps the load's oil from the spool
            in_a -= past * (p_a - p_t)
    if p_a < p_t:
        in_a += orifice_flow(a[i, col.A_ANTICAVITATION], p_t - p_a, soft)
    if p_b < p_t:
        in_b += orifice_flow(a[i, col.A_ANTICAVITATION], p_t - p_b, soft)
    flows[i, col.F_NET_A], flows[i, col.F_NET_B] = in_a, in_b


@allocation_free
def _end_stop(i: int, y: float, v: float, a: Array) -> float:
    """Force at either end of the stroke: a cushion brakes what enters it, behind it stands a stiff stop."""
    side = 1.0 if 2.0 * y < a[i, col.A_STROKE] else -1.0
    left = y if side > 0.0 else a[i, col.A_STROKE] - y  # of the stroke, ahead of the moving piston
    entered = min(max(1.0 - left / a[i, col.A_CUSHION], 0.0), 1.0)
    brake = a[i, col.A_STOP_DAMPING] * entered * max(-side * v, 0.0)
    push: float = side * (brake + a[i, col.A_STOP_STIFFNESS] * max(-left, 0.0))
    return push


@allocation_free
def _pressure_rates(i: int, state: Array, a: Array, c: Array, flows: Array, rate: Array) -> None:
    """Rates of pressures, oil temperature and holding valve of actuator ``i``, its flows being known."""
    y, v = flows[i, col.F_POSITION], flows[i, col.F_VELOCITY]
    area_a, area_b = a[i, col.A_AREA_A], a[i, col.A_AREA_B]
    volume_a = a[i, col.A_DEAD_A] + area_a * y
    volume_b = a[i, col.A_DEAD_B] + area_b * (a[i, col.A_STROKE] - y)
    warmer = state[TEMPERATURE] - c[col.C_REFERENCE]
    oil = c[col.C_MODULUS] * (1.0 - c[col.C_MODULUS_DRIFT] * warmer)
    air, exponent = c[col.C_AIR], c[col.C_EXPONENT]
    stiff_a = bulk_modulus(state[PRESSURE_A + i], oil, air, exponent)
    stiff_b = bulk_modulus(state[PRESSURE_B + i], oil, air, exponent)
    rate[PRESSURE_A + i] = stiff_a * (flows[i, col.F_NET_A] - area_a * v) / volume_a
    rate[PRESSURE_B + i] = stiff_b * (flows[i, col.F_NET_B] + area_b * v) / volume_b
    if c[col.C_EXPANSION] > 0.0:  # oil that cools shrinks as if it flowed out; what the supply gives is warm
        at = CHAMBER_TEMPERATURE + i
        fresh = max(flows[i, col.F_SUPPLY], 0.0) / (volume_a + volume_b)
        rate[at] = fresh * (state[TEMPERATURE] - state[at])
        rate[at] -= c[col.C_CHAMBER_COOLING] * (state[at] - c[col.C_AMBIENT])
        rate[PRESSURE_A + i] += stiff_a * c[col.C_EXPANSION] * rate[at]
        rate[PRESSURE_B + i] += stiff_b * c[col.C_EXPANSION] * rate[at]
    rate[HOLDING + i] = 0.0
    if a[i, col.A_COUNTERBALANCE] > 0.0 and c[col.C_HOLD_LAG] > 0.0:
        wish = _held_open(state[PRESSURE_A + i], state[PRESSURE_B + i], c)
        rate[HOLDING + i] = (wish - state[HOLDING + i]) / c[col.C_HOLD_LAG]


@allocation_free
def _actuator(
    i: int,
    state: Array,
    command: float,
    viscosity_ratio: float,
    a: Array,
    c: Array,
    flows: Array,
    rate: Array,
) -> float:
    """Rates of spool, chambers and bristle of actuator ``i``; returns its torque on the joint.

    ``a`` is the actuator table, ``c`` the circuit, ``flows`` the flow table, ``viscosity_ratio`` the
    reference viscosity over the present one.
    """
    joint = JOINT[i]
    y, ratio = actuator_reach(
        state[Q + joint],
        a[i, col.A_KIND],
        a[i, col.A_BASE],
        a[i, col.A_LEVER],
        a[i, col.A_ANGLE0],
        a[i, col.A_LENGTH0],
    )
    v = ratio * state[RATE + joint]
    spool, spool_rate = state[SPOOL + i], state[SPOOL_RATE + i]
    rate[SPOOL + i] = spool_rate
    rate[SPOOL_RATE + i] = spool_acceleration(command, spool, spool_rate, a[i, col.A_OMEGA], a[i, col.A_ZETA])

    _chamber_flows(i, state, viscosity_ratio, a, c, flows)
    flows[i, col.F_POSITION], flows[i, col.F_VELOCITY] = y, v
    _pressure_rates(i, state, a, c, flows, rate)

    bristle = state[BRISTLE + i]
    level = steady_level(v, a[i, col.A_COULOMB], a[i, col.A_STATIC], a[i, col.A_STRIBECK])
    z_rate = bristle_rate(v, bristle, level, a[i, col.A_BRISTLE])
    rate[BRISTLE + i] = z_rate
    viscous = a[i, col.A_VISCOUS] / viscosity_ratio
    friction = friction_force(v, bristle, z_rate, a[i, col.A_BRISTLE], a[i, col.A_BRISTLE_DAMPING], viscous)
    stop = _end_stop(i, y, v, a)
    push = state[PRESSURE_A + i] * a[i, col.A_AREA_A] - state[PRESSURE_B + i] * a[i, col.A_AREA_B]
    flows[i, col.F_PUSH], flows[i, col.F_FRICTION], flows[i, col.F_STOP] = push, friction, stop
    torque: float = (push - friction + stop) * ratio
    return torque


@allocation_free
def pump_flow(supply: float, load: float, circuit: Array) -> float:
    """What the pump delivers (m³/s) at ``supply`` pressure; once lost, what its dump orifice takes.

    A load-sensing one keeps its margin above the reported ``load`` (Pa), at most its set pressure.
    """
    if circuit[col.C_RUNNING] > 0.0:
        set_pressure: float = circuit[col.C_SET]
        if circuit[col.C_LS_MARGIN] > 0.0:
            set_pressure = min(set_pressure, load + circuit[col.C_LS_MARGIN])
        wish: float = circuit[col.C_PUMP_GAIN] * (set_pressure - supply)
        delivered: float = min(max(wish, 0.0), circuit[col.C_FLOW_LIMIT])
        return delivered
    return -orifice_flow(circuit[col.C_DUMP], supply - circuit[col.C_RETURN], circuit[col.C_REGULARISATION])


@allocation_free
def _supply(state: Array, c: Array, flows: Array, rate: Array) -> None:
    """Rates of supply pressure and oil temperature."""
    supply = state[SUPPLY]
    drawn = delivered = load = 0.0
    for i in range(N_ACTUATORS):
        drawn += flows[i, col.F_SUPPLY]
        load = max(load, flows[i, col.F_LOAD])
        delivered += flows[i, col.F_PUSH] * flows[i, col.F_VELOCITY]
    pumped = pump_flow(supply, state[LOAD_SENSE], c)
    rate[LOAD_SENSE] = 0.0
    if c[col.C_LS_MARGIN] > 0.0:
        rate[LOAD_SENSE] = (max(load, c[col.C_RETURN]) - state[LOAD_SENSE]) / c[col.C_LS_LAG]
    net = pumped - drawn - relief_flow(supply, c[col.C_RELIEF], c[col.C_PUMP_GAIN])
    oil = c[col.C_MODULUS] * (1.0 - c[col.C_MODULUS_DRIFT] * (state[TEMPERATURE] - c[col.C_REFERENCE]))
    volume = c[col.C_LINE_VOLUME]
    stiff = bulk_modulus(supply, oil, c[col.C_AIR], c[col.C_EXPONENT])
    rate[SUPPLY] = stiff * net / volume
    rate[TEMPERATURE] = 0.0
    if c[col.C_HEAT_CAPACITY] > 0.0:
        heat = supply * max(pumped, 0.0) - delivered + c[col.C_RUNNING] * c[col.C_IDLE_LOSS]
        cooling = c[col.C_COOLING] * (state[TEMPERATURE] - c[col.C_AMBIENT])
        rate[TEMPERATURE] = heat / c[col.C_HEAT_CAPACITY] - cooling


@allocation_free
def add_oil(
    state: Array, command: Array, a: Array, c: Array, at: Indices, force: Array, flows: Array, rate: Array
) -> None:
    """Fill the oil's part of ``rate``, and ``flows``; add the actuators' torques to ``force`` (n,).

    ``a`` is the actuator table, ``c`` the circuit, ``at`` (6,) where in ``force`` each joint is.
    """
    viscosity_ratio = math.exp(c[col.C_VISCOSITY_DRIFT] * (state[TEMPERATURE] - c[col.C_REFERENCE]))
    for i in range(N_ACTUATORS):
        force[at[i]] += _actuator(i, state, command[i], viscosity_ratio, a, c, flows, rate)
    _supply(state, c, flows, rate)
