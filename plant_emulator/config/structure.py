"""Configuration of the arm's structure: pivots, masses, bending, payload."""

from typing import Annotated

from pydantic import Field, field_validator

from foundation.configuration import StrictModel

Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
Point = tuple[float, float]


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

    @field_validator("gyration_m")
    @classmethod
    def _is_a_body(cls, value: tuple[float, float, float]) -> tuple[float, float, float]:
        small, middle, great = sorted(value)
        if great * great > small * small + middle * middle:
            limit = (small * small + middle * middle) ** 0.5
            raise ValueError(f"the greatest must not exceed {limit:.4f}: no body has such moments of inertia")
        return value


class MassesConfig(StrictModel):
    """What each body is made of. Parts of a flexible link are shared between its two halves at the hinge."""

    pillar: tuple[PartConfig, ...]
    boom: Annotated[tuple[PartConfig, ...], Field(min_length=1)]
    arm: Annotated[tuple[PartConfig, ...], Field(min_length=1)]
    telescope: tuple[PartConfig, ...]
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
