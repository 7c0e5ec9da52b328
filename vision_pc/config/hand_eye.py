"""Settings of guided hand-eye sampling: section ``hand_eye`` of ``vision.yaml``."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from foundation.configuration import StrictModel

Degrees = Annotated[float, Field(gt=0.0, le=90.0)]
Metres = Annotated[float, Field(gt=0.0, le=5.0)]
Vector3 = tuple[float, float, float]
Small = Annotated[float, Field(ge=0.0, le=50.0)]
SixSmall = tuple[Small, Small, Small, Small, Small, Small]
JOINTS = 6


class ArmUncertainty(StrictModel):
    """How far the arm may be off its nominal model (standard deviations).

    ``zero_std_mrad`` of each encoder's zero. For each joint: ``play_mrad``, its backlash, anew in each pose,
    and ``bending_mrad_m``, its deflection for each metre of reach. ``link_*``, for each axis: the end of the
    link that each joint carries; the last one's is the hand.
    """

    zero_std_mrad: Small = 3.0
    play_mrad: SixSmall = (0.3, 0.05, 0.05, 0.1, 0.1, 0.1)
    bending_mrad_m: SixSmall = (0.0, 1.5, 6.0, 0.0, 0.0, 0.0)
    link_offset_std_mm: SixSmall = (1.5, 1.5, 1.5, 0.3, 0.3, 1.0)
    link_tilt_std_mrad: SixSmall = (0.7, 0.7, 0.7, 0.5, 0.5, 1.5)


class GuidedSettings(StrictModel):
    """What is looked at, how many samples, from where, and what is assumed while planning.

    ``mount_*`` is the camera in the hand as measured by tape: it only plans, it never enters the result.
    ``arm``: the uncertainties of each joint and link. ``principal_point_std_px``, ``focal_std`` (relative):
    what the camera's own calibration may be off by.
    ``distance_m``, ``obliquity_deg``, ``roll_deg`` bound the view of the marker, ``turn_deg`` and ``reach_m``
    the hand about its starting pose; ``margin_px`` keeps the marker off the picture's rim and off what the
    tool hides, ``clearance_m`` the tool off the marker's plane.
    """

    marker_id: int = Field(582, ge=0, le=1023, examples=[582])
    marker_size_m: float = Field(0.05, gt=0.005, le=2.0, examples=[0.05])
    dictionary: Literal[
        "DICT_4X4_1000", "DICT_5X5_1000", "DICT_6X6_1000", "DICT_7X7_1000", "DICT_ARUCO_ORIGINAL"
    ] = "DICT_5X5_1000"
    poses: int = Field(17, ge=5, le=100, examples=[17])
    frames: int = Field(5, ge=1, le=100)
    minimum_frames: int = Field(3, ge=1, le=100)
    mount_position_m: Vector3 = (-0.20, -0.05, -0.40)
    mount_rotation_deg: Vector3 = (0.0, 0.0, 0.0)
    arm: ArmUncertainty = ArmUncertainty()
    principal_point_std_px: float = Field(0.7, ge=0.0, le=50.0)
    focal_std: float = Field(0.001, ge=0.0, le=0.1)
    distance_m: tuple[Metres, Metres] = (0.55, 0.85)
    obliquity_deg: Degrees = 40.0
    roll_deg: float = Field(60.0, ge=0.0, le=180.0)
    turn_deg: float = Field(60.0, gt=0.0, le=180.0)
    reach_m: Metres = 0.6
    margin_px: float = Field(40.0, ge=0.0, le=500.0)
    clearance_m: float = Field(0.08, ge=0.0, le=1.0)
    candidates: int = Field(800, ge=20, le=20_000)

    @model_validator(mode="after")
    def _ranges_ascend(self) -> "GuidedSettings":
        if not self.distance_m[0] < self.distance_m[1]:
            raise ValueError(f"distance_m {self.distance_m}: the first must be below the second")
        if self.minimum_frames > self.frames:
            raise ValueError(f"minimum_frames {self.minimum_frames} must not exceed frames {self.frames}")
        return self
