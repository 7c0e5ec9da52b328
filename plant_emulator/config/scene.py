"""Configuration of the visible world, all of it truth: wall, object, tool marker, camera mount and camera."""

from typing import Annotated

from pydantic import Field, model_validator

from foundation.configuration import StrictModel
from plant_emulator.config.camera import CameraConfig, LightingConfig
from plant_emulator.config.surroundings import (
    AnyBoardConfig,
    PasserConfig,
    WallConfig,
)

Vector3 = tuple[float, float, float]
SmallAngle = Annotated[float, Field(ge=-90.0, le=90.0)]
Angles = tuple[SmallAngle, SmallAngle, SmallAngle]
Misplaced = Annotated[float, Field(ge=-0.05, le=0.05)]


class PoseConfig(StrictModel):
    """A rigid pose: position, and the rotation vector (axis times angle) from the parent's axes."""

    position_m: Vector3 = (0.0, 0.0, 0.0)
    rotation_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)


class MarkerConfig(StrictModel):
    """One ArUco marker (DICT_5X5_1000) on a white plate that leaves a quiet zone all round.

    ``print_scale_error`` makes the printed side ``side_m * (1 + print_scale_error)`` while vision believes
    ``side_m``. A bent plate is a cylinder: its surface stands c d² before the plane of its middle, where d is
    the way across, along ``bend_direction_deg`` (from x towards y), and c such that ``bend_m`` is reached at
    half the side; negative: the middle stands out.
    """

    marker_id: int = Field(ge=0, lt=1000)
    side_m: float = Field(gt=0.005, le=1.0)
    quiet_zone_m: float = Field(ge=0.0, le=0.5)
    print_scale_error: float = Field(default=0.0, ge=-0.05, le=0.05)
    bend_m: float = Field(default=0.0, ge=-0.005, le=0.005)
    bend_direction_deg: float = Field(default=0.0, ge=-90.0, le=90.0)


class WallMarkerConfig(MarkerConfig):
    """A marker pasted on the wall, centre in O axes (x right, y up), turned by ``roll_deg`` about z_O.

    ``misplaced_m`` (in O) and ``misplaced_deg`` (a rotation vector in the plate's own axes) are how far from
    there it truly hangs, as nobody knows.
    """

    centre_m: tuple[float, float]
    roll_deg: SmallAngle = 0.0
    misplaced_m: tuple[Misplaced, Misplaced, Misplaced] = (0.0, 0.0, 0.0)
    misplaced_deg: Angles = (0.0, 0.0, 0.0)


class ToolMarkerConfig(MarkerConfig):
    """The tool marker: nominal X_TM has R = diag(1, -1, -1); ``offset_m`` and ``misalignment_deg`` are what
    is wrong with it.

    ``misalignment_deg`` is a rotation vector in M's own axes.
    """

    offset_m: Vector3 = (0.0, 0.0, 0.0)
    misalignment_deg: Angles = (0.0, 0.0, 0.0)


class ObjectConfig(StrictModel):
    """Pose of the object of interest in W, and the markers that define it.

    With all angles zero O faces the arm: x_O = -y_W (right as seen from the arm), y_O = z_W (up),
    z_O = -x_W (out of the wall).
    ``tilt_deg`` is a rotation vector in O's own axes.
    """

    position_m: Vector3
    tilt_deg: Angles = (0.0, 0.0, 0.0)
    markers: tuple[WallMarkerConfig, ...] = Field(max_length=16)

    @model_validator(mode="after")
    def _ids_differ(self) -> "ObjectConfig":
        ids = [marker.marker_id for marker in self.markers]
        if len(set(ids)) != len(ids):
            raise ValueError(f"markers: marker_id must differ, got {ids}")
        return self


class SceneConfig(StrictModel):
    """``scene.yaml``: everything that the camera can see, and the camera."""

    seed: int = Field(ge=0, lt=2**63)
    base: PoseConfig = PoseConfig()
    wall: WallConfig
    object_of_interest: ObjectConfig
    tool_marker: ToolMarkerConfig
    boards: tuple[AnyBoardConfig, ...] = Field(default=(), max_length=16)
    passers: tuple[PasserConfig, ...] = Field(default=(), max_length=8)
    lighting: LightingConfig = LightingConfig()
    mount: PoseConfig
    camera: CameraConfig
