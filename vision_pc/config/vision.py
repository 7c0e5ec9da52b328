"""Configuration of the vision PC: cameras, markers, looks, odometry and the addresses it talks to."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from foundation.configuration import Host, HostName, StrictModel, configuration_hash
from foundation.rest.tokens import TokenSources
from foundation.secret_source import SecretSource
from nominal_arm.description import NominalArm
from protocol.reference_messages import ANY_ARM
from vision_pc.config.camera import CameraSettings, Port
from vision_pc.config.hand_eye import GuidedSettings
from vision_pc.config.programs import ProgramSettings, TargetSettings


def _ordered(sides: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    x_min, y_min, x_max, y_max = sides
    if not (x_min < x_max and y_min < y_max):
        raise ValueError(
            f"{list(sides)} must be x_min, y_min, x_max, y_max with each minimum below its maximum"
        )
    return sides


Rectangle = Annotated[tuple[float, float, float, float], AfterValidator(_ordered)]


class ToolMarkerSettings(StrictModel):
    """The marker on the tool, and what moves with the camera around it.

    ``carried_m``: rectangles in the marker's plane, each x_min, y_min, x_max, y_max (x right, y up), that
    odometry must not take for the world.
    """

    id: int = Field(ge=0, le=999)
    size_m: float = Field(gt=0.005, le=2.0)
    carried_m: tuple[Rectangle, ...] = ()


class ObjectMarkerSettings(StrictModel):
    """One marker of the object of interest: its centre in O; its axes are parallel to O's."""

    id: int = Field(ge=0, le=999)
    size_m: float = Field(gt=0.005, le=2.0)
    x_m: float = Field(ge=-5.0, le=5.0)
    y_m: float = Field(ge=-5.0, le=5.0)


class CalibrationDoubts(StrictModel):
    """Whether the camera's errors are found along the legs; ``baseline``: its error, relative, 1 σ."""

    enabled: bool
    baseline: float = Field(gt=0.0, le=0.1)


class MarkerSettings(StrictModel):
    """Detection, refinement and what is taken for granted about noise and printing.

    The right eye's offset: ``offset_std_px`` before markers were seen, never known better than
    ``offset_floor_px``.
    ``finds_edge_shift``: a camera whose grey levels do not go with the light shows black smaller than it is;
    by how much is found of each marker's own cells.
    """

    dictionary: Literal[
        "DICT_4X4_50", "DICT_4X4_100", "DICT_4X4_250", "DICT_4X4_1000",
        "DICT_5X5_50", "DICT_5X5_100", "DICT_5X5_250", "DICT_5X5_1000",
        "DICT_6X6_50", "DICT_6X6_100", "DICT_6X6_250", "DICT_6X6_1000",
        "DICT_7X7_50", "DICT_7X7_100", "DICT_7X7_250", "DICT_7X7_1000", "DICT_ARUCO_ORIGINAL",
        "DICT_APRILTAG_16h5", "DICT_APRILTAG_25h9", "DICT_APRILTAG_36h10", "DICT_APRILTAG_36h11",
    ]  # fmt: skip
    tool: ToolMarkerSettings
    object: tuple[ObjectMarkerSettings, ...] = Field(min_length=1)
    region_margin_px: int = Field(ge=10, le=500)
    finds_edge_shift: bool
    corner_std_px: float = Field(gt=0.0, le=2.0)
    residual_limit_px: float = Field(gt=0.0, le=10.0)
    print_size_std: float = Field(gt=0.0, le=0.05)
    offset_std_px: float = Field(gt=0.0, le=5.0)
    offset_floor_px: float = Field(gt=0.0, le=1.0)
    focal_std: float = Field(ge=0.0, le=0.05)
    radial_std: float = Field(ge=0.0, le=0.5)
    placement_std_m: float = Field(ge=0.0, le=0.05)
    calibration: CalibrationDoubts

    @model_validator(mode="after")
    def _ids_differ(self) -> "MarkerSettings":
        ids = [self.tool.id, *(marker.id for marker in self.object)]
        if len(set(ids)) != len(ids):
            raise ValueError(f"marker ids must differ, got {ids}")
        return self

    @property
    def sizes(self) -> dict[int, float]:
        """Side of every known marker, by id, in metres."""
        return {self.tool.id: self.tool.size_m} | {marker.id: marker.size_m for marker in self.object}


class LookSettings(StrictModel):
    """How many pairs a look takes, and of how many tool and object must each be seen.

    A look that finds the right eye off its calibration by more than ``offset_limit_px`` is refused.
    ``std_factor``: how much wider than its pictures say a look is known.
    """

    frames: int = Field(ge=1, le=1000)
    minimum_frames: int = Field(ge=1, le=1000)
    huber_sigmas: float = Field(ge=0.5, le=10.0)
    offset_limit_px: float = Field(gt=0.0, le=100.0)
    std_factor: float = Field(ge=1.0, le=5.0)

    @model_validator(mode="after")
    def _minimum_fits(self) -> "LookSettings":
        if self.minimum_frames > self.frames:
            raise ValueError(f"minimum_frames {self.minimum_frames} must not exceed frames {self.frames}")
        return self


class OdometrySettings(StrictModel):
    """Stereo odometry against a persistent keyframe map.

    What is known of the camera: depths are weighed as if disparities were never better than
    ``depth_floor_px``; ``disparity_std_px``: of an offset that all disparities share, 0: it is known.
    ``lever_m``: from the arm's tool to the camera.
    """

    features: int = Field(ge=30, le=5000)
    least_disparity_px: float = Field(gt=0.0, le=20.0)
    depth_floor_px: float = Field(gt=0.0, le=2.0)
    disparity_std_px: float = Field(ge=0.0, le=5.0)
    keyframe_overlap: float = Field(gt=0.05, le=0.99)
    keyframes: int = Field(ge=2, le=1000)
    lever_m: float = Field(ge=0.0, le=20.0)


class PoseFeedSettings(StrictModel):
    """Camera poses of somebody else's SLAM, by UDP, in place of our odometry where ``source`` is ``udp``.

    ``wait_ms``: for the pose of a pair that is there already. Between two poses the camera is no faster than
    ``speed_m_s``; the way is the arm's to ``scale_error``. ``std_mm`` and ``std_mrad``: how well a pose is
    believed.
    """

    source: Literal["own", "udp"] = "own"
    host: Host = "127.0.0.1"
    port: int = Field(47200, ge=0, le=65_535)
    wait_ms: float = Field(300.0, ge=0.0, le=5_000.0)
    speed_m_s: float = Field(2.0, gt=0.0, le=50.0)
    scale_error: float = Field(0.08, gt=0.0, le=1.0)
    std_mm: float = Field(2.0, gt=0.0, le=1_000.0)
    std_mrad: float = Field(2.0, gt=0.0, le=1_000.0)


class RecordedCameraSettings(StrictModel):
    """What of a camera that nobody here knows is other than in ``odometry``: how well its pairs fit."""

    depth_floor_px: float = Field(gt=0.0, le=2.0)
    disparity_std_px: float = Field(ge=0.0, le=5.0)


class RectifiedPairSettings(StrictModel):
    """Intrinsics of a recorded sequence of rectified pictures, one file beside it.

    ``width_px`` and ``height_px``: of the pictures that they are for; without them the principal point must
    lie near the middle.
    """

    fx_px: float = Field(ge=50.0, le=10_000.0)
    fy_px: float = Field(ge=50.0, le=10_000.0)
    cx_px: float = Field(ge=0.0, le=8192.0)
    cy_px: float = Field(ge=0.0, le=8192.0)
    right_cx_px: float | None = Field(None, ge=0.0, le=8192.0)
    baseline_m: float = Field(gt=0.005, le=2.0)
    width_px: int | None = Field(None, ge=32, le=16_384)
    height_px: int | None = Field(None, ge=32, le=16_384)


class LinkSettings(StrictModel):
    """Where the controller listens, and where the key shared with it is (none: not authenticated).

    The controller must drive the arm of arm.yaml, by the hash of that file's content, or refuses the session.
    ``any_arm``: it may drive any; then nothing tells a wrong arm.yaml before the arm moves.
    """

    host: Host = "127.0.0.1"
    port: Port = 47000
    state_period_ms: int = Field(20, ge=1, le=1000)
    link_key: SecretSource = SecretSource()
    any_arm: bool = False

    def expected_arm(self, arm: NominalArm) -> int:
        """The ``arm_hash`` to send in HELLO when ``arm`` is what arm.yaml says."""
        return ANY_ARM if self.any_arm else configuration_hash(arm)


class MotionSettings(StrictModel):
    """When a motion counts as finished: settled by the controller's judgement, then ``rest_s`` more.

    An arm that the joint servo leaves hanging beside its reference counts too, once ``settle_timeout_s``
    have passed and no encoder moves by more than ``still_mrad``: where it stands is measured, not presumed.
    """

    settle_timeout_s: float = Field(5.0, gt=0.0, le=120.0)
    still_mrad: float = Field(2.0, gt=0.0, le=50.0)
    rest_s: float = Field(0.5, ge=0.0, le=30.0)


class ApiSettings(StrictModel):
    """Where the REST API listens, and by what names, beside loopback and ``host``, it may be called.

    ``emulator_face``: address of the plant emulator's HTTP face, such as ``http://127.0.0.1:8010``, that the
    console may ask; this service never does. ``tokens``: who may look, who may operate; compulsory where
    ``host`` is not loopback.
    """

    host: Host = "127.0.0.1"
    port: Port = 8000
    allowed_hosts: tuple[HostName, ...] = ()
    emulator_face: str = Field("", pattern=r"^(https?://[A-Za-z0-9.\[\]:-]+)?$")
    tokens: TokenSources = TokenSources()


class RecordingSettings(StrictModel):
    """What ``vision.mcap`` of --record-dir holds of pictures.

    ``none``: their checksums alone, by which pictures rendered again from the plant's recording are proved
    the same; ``jpeg``: also the left eye's, once a second at most, for people; ``raw``: every pixel of both
    eyes.
    """

    images: Literal["none", "jpeg", "raw"] = "none"


class VisionConfig(StrictModel):
    """Everything in ``vision.yaml``; the arm's dimensions come from ``arm.yaml``."""

    camera: CameraSettings
    markers: MarkerSettings
    look: LookSettings
    odometry: OdometrySettings
    recorded_odometry: RecordedCameraSettings
    odometry_feed: PoseFeedSettings = PoseFeedSettings()
    link: LinkSettings = LinkSettings()
    motion: MotionSettings = MotionSettings()
    programs: ProgramSettings
    hand_eye: GuidedSettings = GuidedSettings()
    sessions_dir: Path = Path("runs/hand-eye")
    targets: TargetSettings = TargetSettings()
    api: ApiSettings = ApiSettings()
    recording: RecordingSettings = RecordingSettings()

    @property
    def odometry_of_recordings(self) -> OdometrySettings:
        """``odometry`` for a recording: with what is known of its camera."""
        return self.odometry.model_copy(update=self.recorded_odometry.model_dump())
