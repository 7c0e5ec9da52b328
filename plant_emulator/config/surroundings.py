"""Configuration of the wall and of what stands or passes before it."""

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator

from foundation.configuration import StrictModel

Vector3 = tuple[float, float, float]
Dictionary = Literal[
    "DICT_4X4_1000", "DICT_5X5_100", "DICT_5X5_1000", "DICT_6X6_1000", "DICT_7X7_1000", "DICT_ARUCO_ORIGINAL"
]
_CODES = {"DICT_5X5_100": 100, "DICT_ARUCO_ORIGINAL": 1024}


class BoardConfig(StrictModel):
    """Where a board truly hangs: its middle in O (x right, y up, z towards the arm), turned by a vector."""

    position_m: Vector3
    rotation_deg: Vector3 = (0.0, 0.0, 0.0)


class CalibrationMarkerConfig(BoardConfig):
    """One ArUco marker, as hand-eye calibration looks at: number 582 of 50 mm in Hua et al. 2024."""

    kind: Literal["marker"] = "marker"
    marker_id: int = Field(default=582, ge=0, lt=1024)
    dictionary: Dictionary = "DICT_5X5_1000"
    side_m: float = Field(default=0.05, gt=0.005, le=1.0)
    quiet_zone_m: float = Field(default=0.012, ge=0.0, le=0.5)
    print_scale_error: float = Field(default=0.0, ge=-0.05, le=0.05)

    @model_validator(mode="after")
    def _holds_the_number(self) -> "CalibrationMarkerConfig":
        count = _CODES.get(self.dictionary, 1000)
        if self.marker_id >= count:
            raise ValueError(f"marker_id {self.marker_id}: {self.dictionary} holds numbers below {count}")
        return self


class CheckerboardConfig(BoardConfig):
    """A checkerboard of ``columns`` × ``rows`` inner corners with a white rim of one square."""

    kind: Literal["checkerboard"]
    columns: int = Field(default=8, ge=2, le=40)
    rows: int = Field(default=6, ge=2, le=40)
    square_m: float = Field(default=0.024, gt=0.002, le=0.5)


class CharucoConfig(BoardConfig):
    """A ChArUco board of ``columns`` × ``rows`` squares, as OpenCV lays it out."""

    kind: Literal["charuco"]
    columns: int = Field(default=9, ge=2, le=40)
    rows: int = Field(default=7, ge=2, le=40)
    square_m: float = Field(default=0.024, gt=0.002, le=0.5)
    marker_m: float = Field(default=0.018, gt=0.001, le=0.5)
    dictionary: Dictionary = "DICT_5X5_100"

    @model_validator(mode="after")
    def _markers_fit(self) -> "CharucoConfig":
        if not self.marker_m < self.square_m:
            raise ValueError(f"marker_m {self.marker_m} must be below square_m {self.square_m}")
        return self


AnyBoardConfig = Annotated[
    CalibrationMarkerConfig | CheckerboardConfig | CharucoConfig, Field(discriminator="kind")
]


Length = Annotated[float, Field(gt=0.01, le=10.0)]


class DrillHoleConfig(StrictModel):
    """A drill hole in the wall, centre in O axes (x right, y up), with a brighter rim.

    A tube straight into the wall, in which what is seen moves with the eye; its rim has broken out by up to
    ``broken`` of its radius in places that ``seed`` chooses.
    """

    centre_m: tuple[float, float]
    diameter_mm: float = Field(gt=1.0, le=500.0)
    grey: int = Field(default=18, ge=0, le=255)
    rim_grey: int = Field(default=165, ge=0, le=255)
    depth_m: float = Field(default=0.5, gt=0.0, le=20.0)
    broken: float = Field(default=0.0, ge=0.0, le=0.5)
    seed: int = Field(default=1, ge=0, lt=2**31)


class BarePatchConfig(StrictModel):
    """A round patch of the wall with little to see: smooth plaster, shotcrete. Centre in O axes.

    ``contrast`` is the share of the wall's contrast that it has left.
    """

    centre_m: tuple[float, float]
    radius_m: float = Field(gt=0.01, le=2.0)
    contrast: float = Field(default=0.1, ge=0.0, le=1.0)


class BlockConfig(StrictModel):
    """A depth step: a block that stands ``depth_m`` out of the wall, its face as rough as the wall.

    Middle of its face in O axes (x right, y up). It hides what is behind it, markers too.
    """

    centre_m: tuple[float, float]
    size_m: tuple[Length, Length]
    depth_m: float = Field(gt=0.005, le=1.0)
    texture_seed: int = Field(default=1, ge=0, lt=2**63)


class WallConfig(StrictModel):
    """The textured wall: the plane z_O = 0 of the object of interest, endless because its texture repeats.

    ``undulation_mm`` is how far it rises and falls about that plane, over waves of ``undulation_length_m``;
    the markers' plates stay flat.
    """

    texture_seed: int = Field(ge=0, lt=2**63)
    texel_mm: float = Field(ge=0.5, le=4.0)
    mean_grey: float = Field(ge=10.0, le=230.0)
    contrast_grey: float = Field(ge=0.0, le=60.0)
    lighting_gradient_per_m: tuple[float, float] = (0.0, 0.0)
    undulation_mm: float = Field(default=0.0, ge=0.0, le=50.0)
    undulation_length_m: float = Field(default=1.0, ge=0.2, le=10.0)
    drill_holes: tuple[DrillHoleConfig, ...] = Field(default=(), max_length=100)
    bare_patches: tuple[BarePatchConfig, ...] = Field(default=(), max_length=100)
    blocks: tuple[BlockConfig, ...] = Field(default=(), max_length=32)

    @model_validator(mode="after")
    def _gradient_keeps_light_positive(self) -> "WallConfig":
        if math.hypot(*self.lighting_gradient_per_m) > 0.4:
            raise ValueError(
                "lighting_gradient_per_m: more than 0.4 per metre darkens the wall to black within reach"
            )
        return self


class PasserConfig(StrictModel):
    """Something textured that crosses: a board of ``size_m``, upright and parallel to the wall.

    Its middle is at ``start_m`` (in O) at time 0 and moves with ``velocity_m_s``; after ``period_s`` it
    begins again. It is nearer than the wall and farther than the tool.
    """

    size_m: tuple[Length, Length] = (0.5, 1.8)
    start_m: tuple[float, float, float]
    velocity_m_s: tuple[float, float, float]
    period_s: float = Field(default=10.0, gt=0.1, le=3600.0)
    texture_seed: int = Field(default=1, ge=0, lt=2**63)
    mean_grey: float = Field(default=90.0, ge=10.0, le=230.0)
    contrast_grey: float = Field(default=30.0, ge=0.0, le=60.0)

    @model_validator(mode="after")
    def _stays_before_the_wall(self) -> "PasserConfig":
        end = self.start_m[2] + self.velocity_m_s[2] * self.period_s
        if not min(self.start_m[2], end) > 0.0:
            low = min(self.start_m[2], end)
            raise ValueError(f"start_m, velocity_m_s: z goes down to {low:g}, into the wall")
        return self

    def place_m(self, time_s: float) -> tuple[float, float, float]:
        """Its middle in O."""
        since = time_s % self.period_s
        x, y, z = (
            start + speed * since for start, speed in zip(self.start_m, self.velocity_m_s, strict=True)
        )
        return x, y, z
