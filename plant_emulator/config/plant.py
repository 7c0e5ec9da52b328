"""Configuration of the arm, its oil and its errors: every number of plant.yaml and its bounds."""

import math
from typing import Annotated

from pydantic import Field, ValidationInfo, field_validator

from foundation.configuration import StrictModel
from plant_emulator.config.actuators import ActuatorConfig, ActuatorsConfig
from plant_emulator.config.oil import OilConfig, ProtectionConfig, PumpConfig, ValvesConfig
from plant_emulator.config.structure import (
    FlexibilityConfig,
    GeometryConfig,
    MassesConfig,
    NotNegative,
    PayloadConfig,
)

Small = Annotated[float, Field(ge=-100.0, le=100.0)]
SixSmall = tuple[Small, Small, Small, Small, Small, Small]
SixNotNegative = tuple[NotNegative, NotNegative, NotNegative, NotNegative, NotNegative, NotNegative]

BAR = 1e5
LITRE = 1e-3
LITRE_PER_MINUTE = 1e-3 / 60.0
RUNGE_KUTTA_REACH = 2.78  # h |λ| beyond which classical RK4 diverges on a decaying mode


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


class PlantConfig(StrictModel):
    """The whole plant except what the camera sees; plant.yaml tells where each number comes from."""

    gravity_m_s2: Annotated[float, Field(ge=0.0, le=20.0)]
    start_pose_deg: tuple[float, float, float, float, float, float]
    watchdog_ms: Annotated[float, Field(gt=0.0, le=10_000.0)]
    geometry: GeometryConfig
    masses: MassesConfig
    payload: PayloadConfig
    flexibility: FlexibilityConfig
    actuators: ActuatorsConfig
    valves: ValvesConfig
    protection: ProtectionConfig
    oil: OilConfig
    pump: PumpConfig
    errors: ErrorsConfig
    step_ms: Annotated[float, Field(gt=0.0, le=2.0)]

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
        limit, reason = min(
            _slowest_steps(
                known["actuators"], known["valves"], known["protection"], known["oil"], known["pump"]
            )
        )
        if value > limit * 1e3:
            raise ValueError(f"must not exceed {limit * 1e3:.3f}: {reason} would make Runge-Kutta diverge")
        return value


def _slowest_steps(
    actuators: ActuatorsConfig,
    valves: ValvesConfig,
    guard: ProtectionConfig,
    oil: OilConfig,
    pump: PumpConfig,
) -> list[tuple[float, str]]:
    """The longest stable step (s) that each stiff part allows, with its reason.

    A chamber behind open regularised orifices decays at β K / (V √δ), a bristle at full speed at σ0 v / F_c.
    """
    soft, modulus = math.sqrt(valves.regularisation_bar * BAR), oil.bulk_modulus_mpa * 1e6
    limits: list[tuple[float, str]] = []
    for name, actuator in zip(ActuatorsConfig.model_fields, actuators.in_order(), strict=True):
        flow = actuator.rated_flow_l_min * LITRE_PER_MINUTE
        gain = flow / math.sqrt(valves.rated_drop_bar * BAR)
        check = flow / math.sqrt(guard.anticavitation_drop_bar * BAR) if guard.anticavitation else 0.0
        for key in ("dead_volume_a_l", "dead_volume_b_l"):
            volume = getattr(actuator, key) * LITRE
            rate = modulus * (gain + check) / (volume * soft)
            limits.append((RUNGE_KUTTA_REACH / rate, f"actuators.{name}.{key} = {getattr(actuator, key):g}"))
            rate = modulus * flow / (guard.relief_override_bar * BAR) / volume
            limits.append((RUNGE_KUTTA_REACH / rate, f"protection.relief_override_bar at actuators.{name}"))
        rate = _bristle_rate(actuator, gain, pump)
        limits.append((RUNGE_KUTTA_REACH / max(rate, 1e-9), f"the bristle stiffness of actuators.{name}"))
    most = pump.flow_limit_l_min * LITRE_PER_MINUTE
    rate = modulus * 2.0 * most / (pump.droop_bar * BAR) / (pump.line_volume_l * LITRE)
    limits.append((RUNGE_KUTTA_REACH / rate, f"pump.droop_bar = {pump.droop_bar:g}"))
    limits.append((RUNGE_KUTTA_REACH / (2.0 * math.pi * valves.bandwidth_hz), "valves.bandwidth_hz"))
    return limits


def _bristle_rate(actuator: ActuatorConfig, gain: float, pump: PumpConfig) -> float:
    """How fast (1/s) the friction bristles relax at the actuator's free speed."""
    area_a, area_b = actuator.areas()
    supply, back = pump.pressure_bar * BAR, pump.return_bar * BAR
    speed = gain * math.sqrt(max(area_a * supply - area_b * back, 0.0) / (area_a**3 + area_b**3))
    stiffness, coulomb = actuator.bristle()
    return stiffness * speed / coulomb if coulomb > 0.0 else 0.0
