"""Configuration of the arm and its oil: every number of plant.yaml and its bounds."""

import math
from typing import Annotated

from pydantic import Field, ValidationInfo, field_validator, model_validator

from protocol.configuration import StrictModel

Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
Point = tuple[float, float]
Small = Annotated[float, Field(ge=-100.0, le=100.0)]
SixSmall = tuple[Small, Small, Small, Small, Small, Small]
SixNotNegative = tuple[NotNegative, NotNegative, NotNegative, NotNegative, NotNegative, NotNegative]

BAR = 1e5
LITRE = 1e-3
LITRE_PER_MINUTE = 1e-3 / 60.0


class GeometryConfig(StrictModel):
    """Pivots in the vertical plane of each link's own frame (x along the link, z up when it lies level)."""

    lift_pivot_m: Point
    tilt_pivot_m: Point
    boom_tip_m: Point
    telescope_m: Annotated[float, Field(ge=0.0, le=10.0)]
    tool_length_m: Annotated[float, Field(ge=0.0, le=3.0)]


class PartConfig(StrictModel):
    """A uniform bar between two points of its link's plane, or a lump where they coincide."""

    mass_kg: NotNegative
    from_m: Point
    to_m: Point
    width_m: Annotated[float, Field(ge=0.0, le=2.0)] = 0.0


class WristBodyConfig(StrictModel):
    """A compact wrist body: its centre ahead of the wrist centre, its radii of gyration."""

    mass_kg: Positive
    forward_m: Annotated[float, Field(ge=-2.0, le=2.0)]
    gyration_m: tuple[Positive, Positive, Positive]


class MassesConfig(StrictModel):
    """What each body is made of. Parts of a flexible link are shared between its two halves at the hinge."""

    pillar: tuple[PartConfig, ...]
    boom: Annotated[tuple[PartConfig, ...], Field(min_length=1)]
    arm: Annotated[tuple[PartConfig, ...], Field(min_length=1)]
    wrist1: WristBodyConfig
    wrist2: WristBodyConfig
    tool: WristBodyConfig


class BeamConfig(StrictModel):
    """Bending of one link, lumped into two hinges at a third of its length, K = 4 EI / (3 L)."""

    length_m: Positive
    vertical_ei_n_m2: Positive
    lateral_ei_n_m2: Positive
    damping_ratio: Annotated[float, Field(ge=0.0, le=0.2)]


class FlexibilityConfig(StrictModel):
    enabled: bool
    boom: BeamConfig
    arm: BeamConfig


class PayloadConfig(StrictModel):
    """A load at the tool, as a homogeneous sphere; its centre in T axes. It can be changed at run time."""

    mass_kg: Annotated[float, Field(ge=0.0, le=1000.0)]
    centre_m: tuple[float, float, float]
    radius_m: Annotated[float, Field(ge=0.0, le=1.0)]


def _static_not_below(value: float, coulomb: float) -> float:
    if value < coulomb:
        raise ValueError(f"must not be below the Coulomb level {coulomb:g}: a seal holds most at rest")
    return value


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
        return _static_not_below(value, info.data.get("coulomb_n", 0.0))


class RotaryFrictionConfig(StrictModel):
    """LuGre seal friction of a rotary actuator."""

    coulomb_nm: NotNegative
    static_nm: NotNegative
    stribeck_rad_s: Positive
    bristle_nm_rad: NotNegative
    bristle_damping_nm_s_rad: NotNegative
    viscous_nm_s_rad: NotNegative

    @field_validator("static_nm")
    @classmethod
    def _order(cls, value: float, info: ValidationInfo) -> float:
        return _static_not_below(value, info.data.get("coulomb_nm", 0.0))


class CylinderStopConfig(StrictModel):
    """Cushion at both ends of a cylinder's stroke."""

    stiffness_n_m: Positive
    damping_n_s_m: NotNegative


class RotaryStopConfig(StrictModel):
    """Cushion at both ends of a rotary actuator's range."""

    stiffness_nm_rad: Positive
    damping_nm_s_rad: NotNegative


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


class RotaryConfig(StrictModel):
    """A vane or rack actuator on the joint's own axis."""

    displacement_m3_rad: Positive
    from_deg: Annotated[float, Field(ge=-360.0, le=0.0)]
    to_deg: Annotated[float, Field(ge=0.0, le=360.0)]
    friction: RotaryFrictionConfig
    end_stop: RotaryStopConfig

    @field_validator("to_deg")
    @classmethod
    def _has_range(cls, value: float, info: ValidationInfo) -> float:
        if value <= info.data.get("from_deg", -1.0):
            raise ValueError("must be above from_deg: the actuator would have no range")
        return value


class ActuatorConfig(StrictModel):
    """One hydraulic actuator with its valve's size; exactly one of ``cylinder`` and ``rotary``."""

    cylinder: CylinderConfig | None = None
    rotary: RotaryConfig | None = None
    dead_volume_a_l: Annotated[float, Field(ge=0.02, le=100.0)]
    dead_volume_b_l: Annotated[float, Field(ge=0.02, le=100.0)]
    leakage_m3_s_pa: Annotated[float, Field(ge=0.0, le=1e-10)]
    rated_flow_l_min: Annotated[float, Field(gt=0.0, le=1000.0)]

    @model_validator(mode="after")
    def _one_kind(self) -> "ActuatorConfig":
        if (self.cylinder is None) == (self.rotary is None):
            raise ValueError("exactly one of cylinder and rotary is wanted")
        return self


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


class ValvesConfig(StrictModel):
    """What all six servo valves share; their sizes stand with the actuators."""

    rated_drop_bar: Positive
    bandwidth_hz: Annotated[float, Field(gt=0.0, le=300.0)]
    damping_ratio: Annotated[float, Field(gt=0.0, le=3.0)]
    slew_limit_per_s: Positive
    delay_ms: Annotated[float, Field(ge=0.0, le=100.0)]
    deadband: Annotated[float, Field(ge=0.0, le=0.5)]
    regularisation_bar: Annotated[float, Field(ge=0.1, le=20.0)]


class CounterbalanceConfig(StrictModel):
    """Load-holding valves at chamber a: they open with p_a + pilot_ratio p_b above the setting."""

    lift: bool
    tilt: bool
    setting_bar: Positive
    pilot_ratio: Annotated[float, Field(ge=1.0, le=20.0)]
    range_bar: Positive


class ProtectionConfig(StrictModel):
    """Relief and anti-cavitation at every chamber, passing the valve's rated flow at the difference."""

    relief_bar: Positive
    relief_override_bar: Positive
    anticavitation: bool
    anticavitation_drop_bar: Positive
    counterbalance: CounterbalanceConfig


class OilConfig(StrictModel):
    bulk_modulus_mpa: Annotated[float, Field(ge=50.0, le=3000.0)]
    wall_compliance_m3_pa: Annotated[float, Field(ge=0.0, le=1e-10)]
    air_fraction: Annotated[float, Field(ge=0.0, le=0.1)]
    polytropic_exponent: Annotated[float, Field(ge=1.0, le=1.7)]
    thermal_drift: bool
    temperature_degc: Annotated[float, Field(ge=-30.0, le=110.0)]
    ambient_degc: Annotated[float, Field(ge=-50.0, le=60.0)]
    heat_capacity_kj_k: Positive
    cooling_w_k: NotNegative
    reference_degc: Annotated[float, Field(ge=-30.0, le=110.0)]
    viscosity_per_k: Annotated[float, Field(ge=0.0, le=0.1)]
    modulus_per_k: Annotated[float, Field(ge=0.0, le=0.01)]


class PumpConfig(StrictModel):
    """Pressure-compensated pump: Q = sat(K (p_set − p_s), 0, Q_max), K = Q_max over the droop."""

    pressure_bar: Annotated[float, Field(gt=20.0, le=500.0)]
    return_bar: Annotated[float, Field(ge=1.0, le=50.0)]
    flow_limit_l_min: Annotated[float, Field(gt=0.0, le=2000.0)]
    droop_bar: Positive
    line_volume_l: Annotated[float, Field(ge=0.3, le=100.0)]
    dump_flow_l_min: Positive

    @field_validator("return_bar")
    @classmethod
    def _below_supply(cls, value: float, info: ValidationInfo) -> float:
        if value >= info.data.get("pressure_bar", math.inf):
            raise ValueError("must be below pressure_bar: nothing would move")
        return value


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


class ErrorsConfig(StrictModel):
    """What makes the nominal rigid-body positioning wrong, each entry with a switch of its own."""

    encoder_offsets: EncoderOffsetsConfig
    encoder_noise: EncoderNoiseConfig
    backlash: BacklashConfig
    geometry: GeometryErrorsConfig
    base_tilt: BaseTiltConfig


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
