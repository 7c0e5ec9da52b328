"""Configuration of the arm's structure: pivots, masses, bending, payload, and what slips and rocks in it."""

from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field, ValidationInfo, field_validator

from foundation.configuration import StrictModel

Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
Point = tuple[float, float]


def _of_a_body(value: tuple[float, float, float]) -> tuple[float, float, float]:
    small, middle, great = sorted(value)
    if great * great > small * small + middle * middle:
        limit = (small * small + middle * middle) ** 0.5
        raise ValueError(f"the greatest must not exceed {limit:.4f}: no body has such moments of inertia")
    return value


Gyration = Annotated[tuple[Positive, Positive, Positive], AfterValidator(_of_a_body)]
"""Radii of gyration (m) about three axes, such as a body can have."""


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
    gyration_m: Gyration


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


Ratio = Annotated[float, Field(ge=0.0, le=0.2)]


def static_not_below(value: float, coulomb: float) -> float:
    """``value``. Raises ValueError below the Coulomb level."""
    if value < coulomb:
        raise ValueError(f"must not be below the Coulomb level {coulomb:g}: friction holds most at rest")
    return value


class EccentricityConfig(StrictModel):
    """Encoders off the centre of their shafts: each reading is off by mrad · sin(angle + phase)."""

    enabled: bool
    mrad: Annotated[tuple[NotNegative, ...], Field(min_length=6, max_length=6)]
    phase_deg: Annotated[tuple[float, ...], Field(min_length=6, max_length=6)]


def hinge_lengths(places: tuple[float, ...]) -> tuple[float, ...]:
    """What of a beam of length 1 each hinge at ``places`` (from its root) gives way for.

    Σ length u = 1/2 and Σ length u² = 1/3, u = 1 − place: slope and deflection under a tip force. Three have
    Σ length = 1 as well: the slope under a tip moment, and by the second sum its deflection. Two meet that
    where they stand as Gauss's points do.
    """
    u = 1.0 - np.array(places)
    powers, sums = (1, 2) if len(places) == 2 else (0, 1, 2), {0: 1.0, 1: 1.0 / 2.0, 2: 1.0 / 3.0}
    solved = np.linalg.solve(np.array([u**k for k in powers]), np.array([sums[k] for k in powers]))
    return tuple(float(length) for length in solved)


def _bends_everywhere(places: tuple[float, ...]) -> tuple[float, ...]:
    apart = np.diff((0.0, *places, 1.0))
    if float(apart.min()) < 0.02:
        raise ValueError("must rise from 0 to 1, 0.02 at least between one and the next")
    if min(hinge_lengths(places)) < 0.02:
        raise ValueError("no hinges there bend as a beam; of two, one must lie before a third of it")
    return places


Hinges = Annotated[tuple[float, ...], Field(min_length=2, max_length=3), AfterValidator(_bends_everywhere)]
"""Where a beam's hinges are, as shares of its length."""


class FinerBendingConfig(StrictModel):
    """Boom and arm of two or three hinges in each direction.

    What lies between a joint and its first hinge is light: the end stops of lift and tilt brake with
    ``stop_damping_share`` of their damping, so that a step of the plain arm's length bears them.
    """

    enabled: bool
    boom_at: Hinges
    arm_at: Hinges
    stop_damping_share: Annotated[float, Field(gt=0.0, le=1.0)]


class TorsionConfig(StrictModel):
    """Twist of boom and arm about the line between their pivots, G J / L each over the beam's length."""

    enabled: bool
    boom_gj_n_m2: Positive
    arm_gj_n_m2: Positive
    damping_ratio: Ratio


class PinComplianceConfig(StrictModel):
    """The pivot pins of lift and tilt give: their link yaws and rolls about the pivot, unseen by encoders."""

    enabled: bool
    lift_nm_rad: Positive
    tilt_nm_rad: Positive
    damping_ratio: Ratio


class BearingTiltConfig(StrictModel):
    """The slewing ring tilts by its axial play in any direction; beyond it, it is a stiff spring."""

    enabled: bool
    play_mm: Annotated[float, Field(ge=0.0, le=5.0)]
    diameter_m: Annotated[float, Field(ge=0.1, le=5.0)]
    height_m: Annotated[float, Field(ge=-5.0, le=5.0)]
    stiffness_nm_rad: Positive
    damping_nm_s_rad: NotNegative


class RotaryFrictionConfig(StrictModel):
    """LuGre friction about an axis."""

    coulomb_nm: NotNegative
    static_nm: NotNegative
    stribeck_rad_s: Positive
    bristle_nm_rad: NotNegative
    bristle_damping_nm_s_rad: NotNegative
    viscous_nm_s_rad: NotNegative

    @field_validator("static_nm")
    @classmethod
    def _order(cls, value: float, info: ValidationInfo) -> float:
        return static_not_below(value, info.data.get("coulomb_nm", 0.0))


class RingFrictionConfig(RotaryFrictionConfig):
    """LuGre friction between the turning upper structure and the base."""

    bristle_nm_rad: Positive


class LooseSlewConfig(StrictModel):
    """Play in the slew's mesh, as loose steel: what turns behind it has its own angle.

    ``backlash_mrad`` is the whole way to and fro. ``hose_nm`` is what hoses pull sideways, whatever the
    angle; ``hose_nm_rad`` what they pull back towards the middle.
    """

    enabled: bool
    backlash_mrad: Annotated[float, Field(gt=0.0, le=50.0)]
    contact_nm_rad: Positive
    contact_damping_nm_s_rad: NotNegative
    motor_side_kg_m2: Positive
    hose_nm: Annotated[float, Field(ge=-1e5, le=1e5)]
    hose_nm_rad: NotNegative
    friction: RingFrictionConfig


class RockingBaseConfig(StrictModel):
    """A carrier on outriggers that rolls, pitches and yaws about ``centre_m`` (in base axes) under the arm.

    ``frequency_hz`` of each (about x, y, z) holds at the start pose without payload, the others held.
    """

    enabled: bool
    mass_kg: Positive
    gyration_m: Gyration
    centre_m: tuple[float, float, float]
    frequency_hz: tuple[Positive, Positive, Positive]
    damping_ratio: Ratio


class ShakerConfig(StrictModel):
    """A machine on the carrier: moments about x, y, z that swing at one frequency; phases follow the seed."""

    frequency_hz: Annotated[float, Field(gt=0.0, le=400.0)]
    moment_nm: tuple[NotNegative, NotNegative, NotNegative]


class VibrationConfig(StrictModel):
    """Engine and pump shake the carrier; there is something to shake only where it can rock."""

    enabled: bool
    engine: ShakerConfig
    pump: ShakerConfig
