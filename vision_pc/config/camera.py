"""Configuration of vision's stereo camera: where its pictures come from, and what is believed of it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Discriminator, Field, Tag, ValidationInfo, model_validator

from foundation.configuration import Host, StrictModel, beside
from protocol.errors import ConfigurationError
from vision_pc.config.stereo_camera import StereoCalibration

Port = Annotated[int, Field(ge=1, le=65535)]


class EyeSettings(StrictModel):
    """Pinhole of one eye, pixel centres at integers; distortion k1 k2 p1 p2 k3, zeros for rectified
    pictures.
    """

    fx_px: float = Field(ge=50.0, le=10_000.0)
    fy_px: float = Field(ge=50.0, le=10_000.0)
    cx_px: float = Field(ge=0.0, le=8192.0)
    cy_px: float = Field(ge=0.0, le=8192.0)
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)


class PinholePair(StrictModel):
    """What is believed of pictures that are used as they come: they are rectified, or nearly."""

    left: EyeSettings
    right: EyeSettings
    baseline_m: float = Field(gt=0.005, le=2.0)
    right_rotation_vector_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)


class StreamSettings(StrictModel):
    """Raw TCP stream of stereo frames."""

    host: Host = "127.0.0.1"
    port: Port = 47100
    reconnect_ms: float = Field(500.0, ge=10.0, le=60_000.0)


class UvcSettings(StrictModel):
    """A side-by-side UVC camera, such as a ZED2. ``exposure_us`` and ``gain``: none leaves them to the
    camera.

    Exposure is set as V4L2 has it, in steps of 100 µs; the gain has the driver's own unit.
    """

    device: int | str = 0
    frame_rate_hz: float = Field(60.0, ge=1.0, le=240.0)
    latency_ms: float = Field(30.0, ge=0.0, le=500.0)
    exposure_us: float | None = Field(None, ge=100.0, le=1_000_000.0)
    gain: float | None = Field(None, ge=0.0, le=10_000.0)


class GenicamSettings(StrictModel):
    """Two industrial cameras, one an eye, by address or by Aravis' name. Each picture is a region of the
    size of ``width_px`` and ``height_px``.

    ``trigger``: ``free`` (each at its own pace), ``software`` (both asked at ``frame_rate_hz``), or the
    input that a common line leads to, such as ``Line1``. ``apart_ms``: between two pictures of a pair.
    ``clock`` of their stamps: each its ``own``, ``common`` to both (PTP, which is enabled where it is
    offered), or this ``host``'s system time (PTP to which this machine is synchronised). ``latency_ms``: of
    the first two, from the stamp to the first packet at the least.
    """

    left: str = "192.168.1.10"
    right: str = "192.168.1.11"
    trigger: str = Field("Line1", min_length=1, max_length=64)
    frame_rate_hz: float = Field(10.0, ge=0.1, le=240.0)
    apart_ms: float = Field(1.0, ge=0.01, le=100.0)
    clock: Literal["own", "common", "host"] = "own"
    latency_ms: float = Field(0.0, ge=0.0, le=500.0)
    pixel_format: str = Field("Mono8", min_length=1, max_length=32)
    offset_x_px: int = Field(0, ge=0, le=16_384)
    offset_y_px: int = Field(0, ge=0, le=16_384)
    exposure_us: float | None = Field(None, ge=1.0, le=1_000_000.0)
    gain: float | None = Field(None, ge=0.0, le=10_000.0)

    @model_validator(mode="after")
    def _refuse_one_camera(self) -> Self:
        if self.left == self.right:
            raise ValueError(f"left and right are both {self.left}: each eye is a camera of its own")
        return self


def _load_named_file(value: Any, info: ValidationInfo) -> Any:
    """A mapping as it stands, or what is in the file that is named."""
    if not isinstance(value, str | Path):
        return value
    from vision_pc.config.camera_files.reading import (
        read_calibration,  # numpy, which most commands do without
    )

    path = beside(value, info)
    size = (info.data.get("width_px", 0), info.data.get("height_px", 0))
    found = read_calibration(path, size)
    if (found.width_px, found.height_px) != size:
        raise ConfigurationError(
            "configuration.calibration_size",
            f"{path}: is for pictures of {found.width_px}x{found.height_px} px, camera.width_px and "
            f"height_px are {size[0]}x{size[1]}; calibrate at this size, or set the size of the file",
        )
    return found


def _kind(value: Any) -> str:
    raw = "format" in value if isinstance(value, Mapping) else isinstance(value, StereoCalibration)
    return "raw" if raw else "rectified"


Calibration = Annotated[
    Annotated[PinholePair, Tag("rectified")] | Annotated[StereoCalibration, Tag("raw")], Discriminator(_kind)
]


class CameraSettings(StrictModel):
    """The stereo camera: where its pictures come from and its calibration.

    ``calibration`` is a ``PinholePair`` for pictures that are used as they come, or the path of a camera's
    calibration file (ours, ZED, Kalibr, OpenCV): every pair is then rectified by it, and vision has the
    rectified pictures' intrinsics.
    """

    source: Literal["stream", "uvc", "genicam"] = "stream"
    stale_ms: float = Field(ge=10.0, le=60_000.0)
    frozen_frames: int = Field(ge=0, le=1000)
    stream: StreamSettings = StreamSettings()
    uvc: UvcSettings = UvcSettings()
    genicam: GenicamSettings = GenicamSettings()
    width_px: int = Field(ge=64, le=8192)
    height_px: int = Field(ge=64, le=8192)
    calibration: Annotated[Calibration, BeforeValidator(_load_named_file)]
