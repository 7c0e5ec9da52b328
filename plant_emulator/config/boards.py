"""Boards that hang before the wall: calibration marker, checkerboard, ChArUco board, control cabinet."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from foundation.configuration import StrictModel

Vector3 = tuple[float, float, float]
Grey = Annotated[float, Field(ge=0.0, le=255.0)]
Dictionary = Literal[
    "DICT_4X4_1000", "DICT_5X5_100", "DICT_5X5_1000", "DICT_6X6_1000", "DICT_7X7_1000", "DICT_ARUCO_ORIGINAL"
]
_CODES = {"DICT_5X5_100": 100, "DICT_ARUCO_ORIGINAL": 1024}


class BoardConfig(StrictModel):
    """Where a board truly hangs: its middle in O (x right, y up, z towards the arm), turned by a vector."""

    position_m: Vector3
    rotation_deg: Vector3 = (0.0, 0.0, 0.0)
    black_grey: Grey = 22.0
    white_grey: Grey = 208.0


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


class CabinetConfig(BoardConfig):
    """The front of a control cabinet: sheet metal with a knob, a switch and a key hole, seen from before.

    Targets are their middles in the front's axes, metres (x right, y up). ``seed`` makes the paint's grain.
    """

    kind: Literal["cabinet"]
    seed: int = Field(default=11, ge=0, lt=2**63)
    width_m: float = Field(default=0.384, gt=0.1, le=1.0)
    height_m: float = Field(default=0.288, gt=0.1, le=1.0)
    texel_mm: float = Field(default=0.5, ge=0.1, le=2.0)
    knob_m: tuple[float, float] = (-0.11, 0.055)
    switch_m: tuple[float, float] = (0.10, 0.06)
    key_hole_m: tuple[float, float] = (0.03, -0.075)

    @model_validator(mode="after")
    def _targets_on_the_front(self) -> "CabinetConfig":
        for name in ("knob_m", "switch_m", "key_hole_m"):
            x, y = getattr(self, name)
            if abs(x) > 0.5 * self.width_m - 0.03 or abs(y) > 0.5 * self.height_m - 0.03:
                raise ValueError(f"{name} {(x, y)}: must be 0.03 m inside the front's rim")
        return self


AnyBoardConfig = Annotated[
    CalibrationMarkerConfig | CheckerboardConfig | CharucoConfig | CabinetConfig, Field(discriminator="kind")
]
