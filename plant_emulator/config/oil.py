"""Configuration of what the actuators share: protection, oil and pump."""

import math
from typing import Annotated

from pydantic import Field, ValidationInfo, field_validator

from foundation.configuration import StrictModel
from plant_emulator.config.structure import NotNegative, Positive

HOTTEST_DEGC = 110.0
MOST_SOFTENING = 0.8  # of the bulk modulus, up to the hottest oil


class ProtectionConfig(StrictModel):
    """Relief and anti-cavitation at every chamber, passing the valve's rated flow at the difference."""

    relief_bar: Positive
    relief_override_bar: Positive
    anticavitation: bool
    anticavitation_drop_bar: Positive


class OilConfig(StrictModel):
    bulk_modulus_mpa: Annotated[float, Field(ge=50.0, le=3000.0)]
    wall_compliance_m3_pa: Annotated[float, Field(ge=0.0, le=1e-10)]
    air_fraction: Annotated[float, Field(ge=0.0, le=0.1)]
    polytropic_exponent: Annotated[float, Field(ge=1.0, le=1.7)]
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
