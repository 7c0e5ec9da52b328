"""How long a Runge-Kutta step each stiff part of the hydraulics allows, from configuration alone."""

import math
from collections.abc import Iterator
from typing import NamedTuple

from plant_emulator.config.actuators import ActuatorConfig, ActuatorsConfig
from plant_emulator.config.oil import OilConfig, ProtectionConfig, PumpConfig
from plant_emulator.config.units import BAR, LITRE, LITRE_PER_MINUTE, RUNGE_KUTTA_REACH
from plant_emulator.config.valves import JOINT_NAMES, JointName, ValvesConfig


class StiffParts(NamedTuple):
    """What the limits follow from."""

    actuators: ActuatorsConfig
    valves: ValvesConfig
    protection: ProtectionConfig
    oil: OilConfig
    pump: PumpConfig


class StepLimit(NamedTuple):
    """The longest stable step (s) that a part allows, and the part."""

    step_s: float
    reason: str


def shortest(circuit: StiffParts) -> StepLimit:
    """The limit of the part that allows the shortest step."""
    return min(_limits(circuit))


def _limits(circuit: StiffParts) -> Iterator[StepLimit]:
    """Open regularised orifices let a chamber decay at β K / (V √δ), bristles relax at σ0 v / F_c."""
    for name, actuator in zip(JOINT_NAMES, circuit.actuators.in_order(), strict=True):
        yield from _of_actuator(circuit, name, actuator)
    pump, modulus = circuit.pump, circuit.oil.bulk_modulus_mpa * 1e6
    most = pump.flow_limit_l_min * LITRE_PER_MINUTE
    rate = modulus * 2.0 * most / (pump.droop_bar * BAR) / (pump.line_volume_l * LITRE)
    yield StepLimit(RUNGE_KUTTA_REACH / rate, f"pump.droop_bar = {pump.droop_bar:g}")


def _of_actuator(circuit: StiffParts, name: JointName, actuator: ActuatorConfig) -> Iterator[StepLimit]:
    """Edges, check valves, relief, counterbalance, bristles and spool of one actuator."""
    _, valves, guard, oil, pump = circuit
    soft, modulus = math.sqrt(valves.regularisation_bar * BAR), oil.bulk_modulus_mpa * 1e6
    flow = actuator.rated_flow_l_min * LITRE_PER_MINUTE
    gains = _edge_gains(valves, name, actuator)
    check = flow / math.sqrt(guard.anticavitation_drop_bar * BAR) if guard.anticavitation else 0.0
    for key, supply, back in (("dead_volume_a_l", 0, 3), ("dead_volume_b_l", 2, 1)):
        volume = getattr(actuator, key) * LITRE
        rate = modulus * (max(gains[supply], gains[back]) + check) / (volume * soft)
        yield StepLimit(RUNGE_KUTTA_REACH / rate, f"actuators.{name}.{key} = {getattr(actuator, key):g}")
        rate = modulus * flow / (guard.relief_override_bar * BAR) / volume
        yield StepLimit(RUNGE_KUTTA_REACH / rate, f"protection.relief_override_bar at actuators.{name}")
    hold = valves.counterbalance
    if (name == "lift" and hold.lift) or (name == "tilt" and hold.tilt):
        slope = 2.0 * gains[3] * math.sqrt(guard.relief_bar * BAR) * hold.pilot_ratio / (hold.range_bar * BAR)
        rate = modulus * slope / (actuator.dead_volume_a_l * LITRE)
        yield StepLimit(
            RUNGE_KUTTA_REACH / rate, f"valves.counterbalance.range_bar = {hold.range_bar:g} at {name}"
        )
        if hold.lag_ms > 0.0:
            yield StepLimit(RUNGE_KUTTA_REACH * hold.lag_ms * 1e-3, "valves.counterbalance.lag_ms")
    rate = _bristle_rate(actuator, max(gains[1], gains[3]) if valves.compensator_bar else max(gains), pump)
    yield StepLimit(RUNGE_KUTTA_REACH / max(rate, 1e-9), f"the bristle stiffness of actuators.{name}")
    bandwidth = valves.of(name, 1.0).bandwidth_hz
    yield StepLimit(
        RUNGE_KUTTA_REACH / (2.0 * math.pi * bandwidth), f"valves.bandwidth_hz = {bandwidth:g} of {name}"
    )


def _edge_gains(valves: ValvesConfig, name: JointName, actuator: ActuatorConfig) -> list[float]:
    """K (m³/s/√Pa) of the four edges, fully open."""
    flows = valves.of(name, actuator.rated_flow_l_min).edge_flows_l_min()
    return [
        flow * LITRE_PER_MINUTE / math.sqrt(drop * BAR)
        for flow, drop in zip(flows, valves.edge_drops_bar(), strict=True)
    ]


def _bristle_rate(actuator: ActuatorConfig, gain: float, pump: PumpConfig) -> float:
    """How fast (1/s) the friction bristles relax at the actuator's free speed."""
    area_a, area_b = actuator.areas()
    supply, back = pump.pressure_bar * BAR, pump.return_bar * BAR
    speed = gain * math.sqrt(max(area_a * supply - area_b * back, 0.0) / (area_a**3 + area_b**3))
    stiffness, coulomb = actuator.bristle()
    return stiffness * speed / coulomb if coulomb > 0.0 else 0.0
