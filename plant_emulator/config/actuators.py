"""Configuration of the hydraulic actuators: linkage, areas, dead volumes, friction and end stops."""

import math
from typing import Annotated

from pydantic import Field, ValidationInfo, field_validator, model_validator

from foundation.configuration import StrictModel
from plant_emulator.config.structure import NotNegative, Positive, RotaryFrictionConfig, static_not_below

BAR = 1e5  # Pa
LITRE = 1e-3  # m³
LITRE_PER_MINUTE = 1e-3 / 60.0  # m³/s
RUNGE_KUTTA_REACH = 2.78  # h |λ| beyond which classical RK4 diverges on a decaying mode

RELIEF_OVERRIDE_BAR = 10.0  # [E] a relief valve passes the rated flow at this much above its setting
# An anti-cavitation valve passes the rated flow at this much below the return pressure.
ANTICAVITATION_DROP_BAR = 5.0  # [E]

HOTTEST_DEGC = 110.0
MOST_SOFTENING = 0.8  # of the bulk modulus, up to the hottest oil


class ProtectionConfig(StrictModel):
    """Relief and anti-cavitation at every chamber, passing the valve's rated flow at the difference."""

    relief_bar: Positive


class OilConfig(StrictModel):
    bulk_modulus_mpa: Annotated[float, Field(ge=50.0, le=3000.0)]
    air_fraction: Annotated[float, Field(ge=0.0, le=0.1)]
    thermal_drift: bool
    temperature_degc: Annotated[float, Field(ge=-30.0, le=HOTTEST_DEGC)]
    ambient_degc: Annotated[float, Field(ge=-50.0, le=60.0)]
    heat_capacity_kj_k: Positive
    cooling_w_k: NotNegative
    reference_degc: Annotated[float, Field(ge=-30.0, le=HOTTEST_DEGC)]
    viscosity_per_k: Annotated[float, Field(ge=0.0, le=0.1)]
    modulus_per_k: Annotated[float, Field(ge=0.0, le=0.01)]

    @field_validator("modulus_per_k")
    @classmethod
    def _stays_stiff(cls, value: float, info: ValidationInfo) -> float:
        warmth = HOTTEST_DEGC - info.data.get("reference_degc", HOTTEST_DEGC)
        if value * warmth > MOST_SOFTENING:
            raise ValueError(
                f"must not exceed {MOST_SOFTENING / warmth:.5f}: at {HOTTEST_DEGC:g} °C oil would turn soft"
            )
        return value


class LoadSensingConfig(StrictModel):
    """The pump keeps ``margin_bar`` above the highest load that an open valve reports, which it learns late.

    With all valves shut it idles at the margin above the return pressure.
    """

    enabled: bool
    margin_bar: Annotated[float, Field(ge=5.0, le=100.0)]
    lag_ms: Annotated[float, Field(ge=1.0, le=1000.0)]


class PumpConfig(StrictModel):
    """Pressure-compensated pump: Q = sat(K (p_set − p_s), 0, Q_max), K = Q_max over the droop.

    p_set is ``pressure_bar``, or below it what the loads ask for (``load_sensing``).
    """

    pressure_bar: Annotated[float, Field(gt=20.0, le=500.0)]
    return_bar: Annotated[float, Field(ge=1.0, le=50.0)]
    flow_limit_l_min: Annotated[float, Field(gt=0.0, le=2000.0)]
    droop_bar: Positive
    line_volume_l: Annotated[float, Field(ge=0.3, le=100.0)]
    dump_flow_l_min: Positive
    idle_loss_kw: NotNegative
    load_sensing: LoadSensingConfig

    @field_validator("return_bar")
    @classmethod
    def _below_supply(cls, value: float, info: ValidationInfo) -> float:
        if value >= info.data.get("pressure_bar", math.inf):
            raise ValueError("must be below pressure_bar: nothing would move")
        return value


def _cushion_fits(cushion: float, stroke: float, key: str) -> None:
    if 2.0 * cushion > stroke:
        raise ValueError(
            f"{key} = {cushion:g} must not exceed {stroke / 2.0:g}, half the stroke: cushions would meet"
        )


class CylinderFrictionConfig(StrictModel):
    """LuGre seal friction of a cylinder."""

    coulomb_n: NotNegative
    static_n: NotNegative
    stribeck_m_s: Positive
    bristle_n_m: NotNegative
    bristle_damping_n_s_m: NotNegative
    viscous_n_s_m: NotNegative

    @field_validator("static_n")
    @classmethod
    def _order(cls, value: float, info: ValidationInfo) -> float:
        return static_not_below(value, info.data.get("coulomb_n", 0.0))


class CylinderStopConfig(StrictModel):
    """A cushion over the last ``cushion_m`` at both ends of a cylinder's stroke, then a stiff stop."""

    stiffness_n_m: Positive
    damping_n_s_m: NotNegative
    cushion_m: Positive


class RotaryStopConfig(StrictModel):
    """A cushion over the last ``cushion_deg`` at both ends of a rotary range, then a stiff stop."""

    stiffness_nm_rad: Positive
    damping_nm_s_rad: NotNegative
    cushion_deg: Positive


class CylinderConfig(StrictModel):
    """A cylinder across a triangle: x = √(L² + l² + 2 L l cos(θ − θ0)) − x0."""

    bore_mm: Positive
    rod_mm: Positive
    base_m: Positive
    lever_m: Positive
    angle_rad: float
    length_m: Positive
    stroke_m: Positive
    friction: CylinderFrictionConfig
    end_stop: CylinderStopConfig

    @field_validator("rod_mm")
    @classmethod
    def _rod_fits(cls, value: float, info: ValidationInfo) -> float:
        bore = info.data.get("bore_mm", math.inf)
        if value >= bore:
            raise ValueError(f"must be below bore_mm = {bore:g}: the rod side would have no area")
        return value

    @field_validator("length_m")
    @classmethod
    def _closes(cls, value: float, info: ValidationInfo) -> float:
        known = info.data
        if "base_m" in known and "lever_m" in known and value <= abs(known["base_m"] - known["lever_m"]):
            least = abs(known["base_m"] - known["lever_m"])
            raise ValueError(f"must be above {least:.5f} = |base_m - lever_m|: the linkage would not close")
        return value

    @field_validator("stroke_m")
    @classmethod
    def _stays_below_singularity(cls, value: float, info: ValidationInfo) -> float:
        known = info.data
        if not {"base_m", "lever_m", "length_m"} <= known.keys():
            return value
        stretched = known["base_m"] + known["lever_m"] - known["length_m"]
        if value >= stretched:
            raise ValueError(f"must stay below {stretched:.5f}: there the linkage's lever vanishes")
        return value

    @field_validator("end_stop")
    @classmethod
    def _cushions_apart(cls, value: CylinderStopConfig, info: ValidationInfo) -> CylinderStopConfig:
        _cushion_fits(value.cushion_m, info.data.get("stroke_m", math.inf), "cushion_m")
        return value


class RotaryConfig(StrictModel):
    """A vane or rack actuator on the joint's own axis."""

    displacement_m3_rad: Positive
    from_deg: Annotated[float, Field(ge=-360.0, le=0.0)]
    to_deg: Annotated[float, Field(gt=0.0, le=360.0)]
    friction: RotaryFrictionConfig
    end_stop: RotaryStopConfig

    @field_validator("end_stop")
    @classmethod
    def _cushions_apart(cls, value: RotaryStopConfig, info: ValidationInfo) -> RotaryStopConfig:
        if {"from_deg", "to_deg"} <= info.data.keys():
            _cushion_fits(value.cushion_deg, info.data["to_deg"] - info.data["from_deg"], "cushion_deg")
        return value


DeadVolume = Annotated[float, Field(ge=0.02, le=100.0)]
"""Litres: a chamber without oil has no pressure."""


class ActuatorConfig(StrictModel):
    """One hydraulic actuator with its valve's size; exactly one of ``cylinder`` and ``rotary``."""

    cylinder: CylinderConfig | None = None
    rotary: RotaryConfig | None = None
    dead_volume_a_l: DeadVolume
    dead_volume_b_l: DeadVolume
    leakage_m3_s_pa: Annotated[float, Field(ge=0.0, le=1e-10)]
    rated_flow_l_min: Annotated[float, Field(gt=0.0, le=1000.0)]

    @model_validator(mode="after")
    def _one_kind(self) -> "ActuatorConfig":
        if (self.cylinder is None) == (self.rotary is None):
            raise ValueError("exactly one of cylinder and rotary is wanted")
        return self

    def areas(self) -> tuple[float, float]:
        """Working areas of chamber a and b: m², or m³/rad of a rotary actuator."""
        if self.cylinder is not None:
            bore, rod = (
                math.pi / 4.0 * (d * 1e-3) ** 2 for d in (self.cylinder.bore_mm, self.cylinder.rod_mm)
            )
            return bore, bore - rod
        assert self.rotary is not None  # by the validator above
        return self.rotary.displacement_m3_rad, self.rotary.displacement_m3_rad

    def bristle(self) -> tuple[float, float]:
        """Bristle stiffness and Coulomb level: N/m and N, or N m/rad and N m."""
        if self.cylinder is not None:
            return self.cylinder.friction.bristle_n_m, self.cylinder.friction.coulomb_n
        assert self.rotary is not None  # by the validator above
        return self.rotary.friction.bristle_nm_rad, self.rotary.friction.coulomb_nm


class ActuatorsConfig(StrictModel):
    slew: ActuatorConfig
    lift: ActuatorConfig
    tilt: ActuatorConfig
    wrist1: ActuatorConfig
    wrist2: ActuatorConfig
    wrist3: ActuatorConfig

    def in_order(self) -> tuple[ActuatorConfig, ...]:
        """The six actuators, slew first."""
        return (self.slew, self.lift, self.tilt, self.wrist1, self.wrist2, self.wrist3)
