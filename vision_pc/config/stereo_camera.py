"""A stereo camera as it comes: both lenses, and where the right eye is. This model is also our own file of
one.

Pixel centres lie at integers, as in OpenCV. C is the left eye: x right, y down, z forward.
"""

import math
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from foundation.configuration import StrictModel
from vision_pc.config.choices import LensModel

FORMAT = "longreach-camera/1"
_LEAST_BASELINE_M, _LARGEST_BASELINE_M = 0.005, 2.0
_LARGEST_TURN_DEG = 45.0

Vector3 = tuple[float, float, float]
FOCAL_PX = (50.0, 20_000.0)  # [D] from a fisheye in a small picture to a telephoto lens in a large one
Focal = Annotated[float, Field(ge=FOCAL_PX[0], le=FOCAL_PX[1])]
Place = Annotated[float, Field(ge=-8192.0, le=16_384.0)]


COEFFICIENTS = {
    LensModel.BROWN_CONRADY: ("k1", "k2", "p1", "p2", "k3"),
    LensModel.RATIONAL: ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    LensModel.FISHEYE: ("k1", "k2", "k3", "k4"),
}


class RawEye(StrictModel):
    """One eye's lens as it is: focal lengths, principal point and ``distortion`` by ``lens``."""

    lens: LensModel
    fx_px: Focal
    fy_px: Focal
    cx_px: Place
    cy_px: Place
    distortion: tuple[float, ...]

    @model_validator(mode="after")
    def _coefficients_are_counted(self) -> Self:
        wanted = COEFFICIENTS[self.lens]
        if len(self.distortion) != len(wanted):
            raise ValueError(
                f"distortion: {len(self.distortion)} numbers, {self.lens} has {len(wanted)}: "
                f"{' '.join(wanted)}"
            )
        return self


class StereoCalibration(StrictModel):
    """Both eyes of a raw stereo camera.

    ``right_position_m`` (x, y, z) and ``right_rotation_vector_deg`` are the right eye in C: a point p_R in
    its axes is at R p_R + position. ``source`` says where the numbers come from.
    """

    format: Literal["longreach-camera/1"]
    source: str = Field("", max_length=500)
    width_px: int = Field(ge=64, le=8192)
    height_px: int = Field(ge=64, le=8192)
    left: RawEye
    right: RawEye
    right_position_m: Vector3
    right_rotation_vector_deg: Vector3 = (0.0, 0.0, 0.0)
    rms_px: float | None = Field(None, ge=0.0)

    @model_validator(mode="after")
    def _eyes_belong_together(self) -> Self:
        x, y, z = self.right_position_m
        baseline = math.hypot(x, y, z)
        if not _LEAST_BASELINE_M <= baseline <= _LARGEST_BASELINE_M:
            raise ValueError(
                f"right_position_m: the eyes are {baseline:g} m apart, {_LEAST_BASELINE_M:g} to "
                f"{_LARGEST_BASELINE_M:g} are believed; likely millimetres taken for metres or the reverse"
            )
        turn = math.hypot(*self.right_rotation_vector_deg)
        if turn > _LARGEST_TURN_DEG:
            raise ValueError(
                f"right_rotation_vector_deg: the right eye is turned by {turn:.1f} degrees, at most "
                f"{_LARGEST_TURN_DEG:g} are believed; likely radians taken for degrees, or another "
                "camera's axes"
            )
        if abs(y) > math.hypot(x, z):
            raise ValueError(
                f"right_position_m: one eye stands {abs(y):g} m above the other: a vertical pair; eyes side "
                "by side are wanted"
            )
        if x <= math.hypot(y, z):
            raise ValueError(
                f"right_position_m: the second eye is not to the right of the first (x {x:g} m); likely the "
                "eyes are exchanged, or the inverse transform is given"
            )
        if (self.left.lens is LensModel.FISHEYE) != (self.right.lens is LensModel.FISHEYE):
            raise ValueError("right.lens: one eye is a fisheye and the other is not")
        return self

    @model_validator(mode="after")
    def _principal_points_are_near(self) -> Self:
        for name, eye in (("left", self.left), ("right", self.right)):
            if not (0.0 < eye.cx_px < self.width_px and 0.0 < eye.cy_px < self.height_px):
                raise ValueError(
                    f"{name}.cx_px, cy_px: ({eye.cx_px:g}, {eye.cy_px:g}) lies outside a picture of "
                    f"{self.width_px}x{self.height_px} px; likely numbers for another picture size"
                )
        return self
