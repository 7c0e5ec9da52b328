"""Configuration of the arm, its oil and its errors: every number of plant.yaml and its bounds."""

import math
from collections.abc import Iterator, Mapping
from operator import itemgetter
from typing import Annotated, Any

from pydantic import Field, ValidationInfo, field_validator, model_validator

from foundation.configuration import StrictModel, merged
from plant_emulator.config.actuators import (
    ANTICAVITATION_DROP_BAR,
    BAR,
    LITRE,
    LITRE_PER_MINUTE,
    RELIEF_OVERRIDE_BAR,
    RUNGE_KUTTA_REACH,
    ActuatorConfig,
    ActuatorsConfig,
    OilConfig,
    ProtectionConfig,
    PumpConfig,
)
from plant_emulator.config.structure import (
    BearingTiltConfig,
    EccentricityConfig,
    FinerBendingConfig,
    FlexibilityConfig,
    GeometryConfig,
    LooseSlewConfig,
    MassesConfig,
    NotNegative,
    PayloadConfig,
    PinComplianceConfig,
    RockingBaseConfig,
    TorsionConfig,
    VibrationConfig,
)
from plant_emulator.config.valves import JOINT_NAMES, JointName, ValvesConfig, without_overridden

Rates = Iterator[tuple[float, str]]
"""How fast (1/s) a part decays at most, and the part; Runge-Kutta bears RUNGE_KUTTA_REACH a step."""


def _rates(circuit: Mapping[str, Any]) -> Rates:
    """Open regularised orifices let a chamber decay at β K / (V √δ), bristles relax at σ0 v / F_c."""
    for name, actuator in zip(JOINT_NAMES, circuit["actuators"].in_order(), strict=True):
        yield from _of_actuator(circuit, name, actuator)
    pump: PumpConfig = circuit["pump"]
    modulus = circuit["oil"].bulk_modulus_mpa * 1e6
    most = pump.flow_limit_l_min * LITRE_PER_MINUTE
    rate = modulus * 2.0 * most / (pump.droop_bar * BAR) / (pump.line_volume_l * LITRE)
    yield rate, f"pump.droop_bar = {pump.droop_bar:g}"


def _of_actuator(circuit: Mapping[str, Any], name: JointName, actuator: ActuatorConfig) -> Rates:
    """Edges, check valves, relief, counterbalance, bristles and spool of one actuator."""
    valves: ValvesConfig = circuit["valves"]
    guard, oil, pump = circuit["protection"], circuit["oil"], circuit["pump"]
    soft, modulus = math.sqrt(valves.regularisation_bar * BAR), oil.bulk_modulus_mpa * 1e6
    flow = actuator.rated_flow_l_min * LITRE_PER_MINUTE
    valve = valves.of(name, actuator.rated_flow_l_min)
    edges = zip(valve.edge_flows_l_min(), valves.edge_drops_bar(), strict=True)
    gains = [flow * LITRE_PER_MINUTE / math.sqrt(drop * BAR) for flow, drop in edges]  # m³/s/√Pa, fully open
    check = flow / math.sqrt(ANTICAVITATION_DROP_BAR * BAR)
    for key, supply, back in (("dead_volume_a_l", 0, 3), ("dead_volume_b_l", 2, 1)):
        volume = getattr(actuator, key) * LITRE
        rate = modulus * (max(gains[supply], gains[back]) + check) / (volume * soft)
        yield rate, f"actuators.{name}.{key} = {getattr(actuator, key):g}"
        yield modulus * flow / (RELIEF_OVERRIDE_BAR * BAR) / volume, f"the relief valves of actuators.{name}"
    hold = valves.counterbalance
    if (name == "lift" and hold.lift) or (name == "tilt" and hold.tilt):
        slope = 2.0 * gains[3] * math.sqrt(guard.relief_bar * BAR) * hold.pilot_ratio / (hold.range_bar * BAR)
        rate = modulus * slope / (actuator.dead_volume_a_l * LITRE)
        yield rate, f"valves.counterbalance.range_bar = {hold.range_bar:g} at {name}"
        if hold.lag_ms > 0.0:
            yield 1e3 / hold.lag_ms, "valves.counterbalance.lag_ms"
    rate = _bristle_rate(actuator, max(gains[1], gains[3]) if valves.compensator_bar else max(gains), pump)
    yield rate, f"the bristle stiffness of actuators.{name}"
    yield 2.0 * math.pi * valve.bandwidth_hz, f"valves.bandwidth_hz = {valve.bandwidth_hz:g} of {name}"


def _bristle_rate(actuator: ActuatorConfig, gain: float, pump: PumpConfig) -> float:
    """How fast (1/s) the friction bristles relax at the actuator's free speed."""
    area_a, area_b = actuator.areas()
    supply, back = pump.pressure_bar * BAR, pump.return_bar * BAR
    speed = gain * math.sqrt(max(area_a * supply - area_b * back, 0.0) / (area_a**3 + area_b**3))
    stiffness, coulomb = actuator.bristle()
    return stiffness * speed / coulomb if coulomb > 0.0 else 0.0


Small = Annotated[float, Field(ge=-100.0, le=100.0)]
SixSmall = tuple[Small, Small, Small, Small, Small, Small]
SixNotNegative = tuple[NotNegative, NotNegative, NotNegative, NotNegative, NotNegative, NotNegative]


class JointErrorConfig(StrictModel):
    """A joint's true frame against the nominal one, at the home pose, in base axes."""

    offset_mm: tuple[Small, Small, Small] = (0.0, 0.0, 0.0)
    tilt_mrad: tuple[Small, Small, Small] = (0.0, 0.0, 0.0)


class GeometryErrorsConfig(StrictModel):
    enabled: bool
    slew: JointErrorConfig = JointErrorConfig()
    lift: JointErrorConfig = JointErrorConfig()
    tilt: JointErrorConfig = JointErrorConfig()
    wrist1: JointErrorConfig = JointErrorConfig()
    wrist2: JointErrorConfig = JointErrorConfig()
    wrist3: JointErrorConfig = JointErrorConfig()
    tool: JointErrorConfig = JointErrorConfig()


class EncoderOffsetsConfig(StrictModel):
    enabled: bool
    mrad: SixSmall


class BacklashConfig(StrictModel):
    """Half of the play between each joint and its encoder's shaft."""

    enabled: bool
    half_width_mrad: SixNotNegative


class EncoderNoiseConfig(StrictModel):
    enabled: bool
    rms_lsb: Annotated[float, Field(ge=0.0, le=100.0)]


class BaseTiltConfig(StrictModel):
    """The true base against the one that X_WB claims: small rotations about its x and y axes."""

    enabled: bool
    x_mrad: Small
    y_mrad: Small


class CoolingOilConfig(StrictModel):
    """Oil in the chambers that cools towards ``oil.ambient_degc``, and shrinks by what steel does not."""

    enabled: bool
    expansion_per_k: Annotated[float, Field(gt=0.0, le=2e-3)]
    time_constant_s: Annotated[float, Field(ge=60.0, le=1e6)]


class SwitchConfig(StrictModel):
    """Whether an error is there at all; its numbers stand with the part that has it."""

    enabled: bool


class ErrorsConfig(StrictModel):
    """What makes the nominal rigid-body positioning wrong, each entry with a switch of its own.

    Two more switches stand with their parts: ``flexibility.enabled`` and ``oil.thermal_drift``.
    """

    encoder_offsets: EncoderOffsetsConfig
    encoder_noise: EncoderNoiseConfig
    backlash: BacklashConfig
    geometry: GeometryErrorsConfig
    base_tilt: BaseTiltConfig
    friction: SwitchConfig
    leakage: SwitchConfig
    valve_deadband: SwitchConfig
    cooling_oil: CoolingOilConfig
    encoder_eccentricity: EccentricityConfig
    finer_bending: FinerBendingConfig
    torsion: TorsionConfig
    pin_compliance: PinComplianceConfig
    bearing_tilt: BearingTiltConfig
    loose_slew: LooseSlewConfig
    rocking_base: RockingBaseConfig
    vibration: VibrationConfig

    @field_validator("vibration")
    @classmethod
    def _has_something_to_shake(cls, value: VibrationConfig, info: ValidationInfo) -> VibrationConfig:
        base = info.data.get("rocking_base")
        if value.enabled and base is not None and not base.enabled:
            raise ValueError("enabled wants rocking_base.enabled: a rigid base cannot be shaken")
        return value


class PlantConfig(StrictModel):
    """The whole plant except what the camera sees; plant.yaml tells where each number comes from.

    ``valves`` are those that the machine has: the set that ``valve_set`` names out of ``valve_sets``, with
    what is written under ``valves`` laid over it.
    """

    gravity_m_s2: Annotated[float, Field(ge=0.0, le=20.0)]
    start_pose_deg: tuple[float, float, float, float, float, float]
    watchdog_ms: Annotated[float, Field(gt=0.0, le=10_000.0)]
    geometry: GeometryConfig
    masses: MassesConfig
    payload: PayloadConfig
    flexibility: FlexibilityConfig
    actuators: ActuatorsConfig
    valve_sets: dict[str, ValvesConfig]
    valve_set: str
    valves: ValvesConfig
    protection: ProtectionConfig
    oil: OilConfig
    pump: PumpConfig
    errors: ErrorsConfig
    step_ms: Annotated[float, Field(gt=0.0, le=2.0)]

    @model_validator(mode="before")
    @classmethod
    def _choose_valves(cls, data: Any) -> Any:
        if not isinstance(data, Mapping) or not isinstance(data.get("valve_sets"), Mapping):
            return data
        name, sets, own = data.get("valve_set"), data["valve_sets"], data.get("valves")
        if (
            not isinstance(name, str)
            or name not in sets
            or not isinstance(sets[name], Mapping)
            or not isinstance(own or {}, Mapping)
        ):
            return data
        return {**data, "valves": merged(without_overridden(sets[name], own or {}), own or {})}

    @field_validator("valve_set")
    @classmethod
    def _is_a_set(cls, value: str, info: ValidationInfo) -> str:
        sets = info.data.get("valve_sets")
        if sets is not None and value not in sets:
            raise ValueError(f"must be one of valve_sets: {', '.join(sets)}")
        return value

    @field_validator("valves")
    @classmethod
    def _acts_in_time(cls, value: ValvesConfig, info: ValidationInfo) -> ValvesConfig:
        watchdog = info.data.get("watchdog_ms", math.inf)
        for name in JOINT_NAMES:
            delay = value.of(name, 1.0).delay_ms
            if delay >= watchdog:
                raise ValueError(
                    f"delay_ms = {delay:g} of {name} must be below watchdog_ms = {watchdog:g}: old "
                    "commands would move the valve after the watchdog has tripped"
                )
        return value

    @field_validator("protection")
    @classmethod
    def _holds_beyond_the_return(cls, value: ProtectionConfig, info: ValidationInfo) -> ProtectionConfig:
        valves = info.data.get("valves")
        if (
            valves is not None
            and valves.counterbalance.setting_bar <= value.relief_bar
            and (valves.counterbalance.lift or valves.counterbalance.tilt)
        ):
            raise ValueError(
                f"relief_bar = {value.relief_bar:g} must be below valves.counterbalance.setting_bar = "
                f"{valves.counterbalance.setting_bar:g}: a load alone would open the holding valves"
            )
        return value

    @field_validator("pump")
    @classmethod
    def _feeds_the_compensators(cls, value: PumpConfig, info: ValidationInfo) -> PumpConfig:
        valves = info.data.get("valves")
        if valves is not None and valves.compensator_bar >= value.pressure_bar - value.return_bar:
            raise ValueError(
                f"pressure_bar = {value.pressure_bar:g} must exceed return_bar by more than "
                f"valves.compensator_bar = {valves.compensator_bar:g}: no flow would ever be metered"
            )
        return value

    @field_validator("pump")
    @classmethod
    def _below_the_relief(cls, value: PumpConfig, info: ValidationInfo) -> PumpConfig:
        guard = info.data.get("protection")
        if guard is not None and value.pressure_bar >= guard.relief_bar:
            raise ValueError(
                f"pressure_bar = {value.pressure_bar:g} must be below protection.relief_bar = "
                f"{guard.relief_bar:g}: the relief valves would never close"
            )
        return value

    @field_validator("step_ms")
    @classmethod
    def _integrates_stably(cls, value: float, info: ValidationInfo) -> float:
        known = info.data
        if not {"actuators", "valves", "protection", "oil", "pump"} <= known.keys():
            return value  # the fault that hides them is reported instead
        rate, reason = max(_rates(known), key=itemgetter(0))
        limit = 1e3 * RUNGE_KUTTA_REACH / rate
        if value > limit:
            raise ValueError(f"must not exceed {limit:.3f}: {reason} would make Runge-Kutta diverge")
        return value
