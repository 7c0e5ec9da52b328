"""The calibration of a recorded sequence: of rectified pairs, or of a camera as it comes."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from foundation.configuration import load, read_yaml
from protocol.errors import ConfigurationError
from vision_pc.config.camera import CameraSettings, EyeSettings, PinholePair
from vision_pc.config.camera_files import reading
from vision_pc.config.vision import RectifiedPairSettings
from vision_pc.core.perception import intrinsics
from vision_pc.core.perception.rectification import Rectifier, rectified_camera
from vision_pc.core.types import CameraCalibration, StereoPair

_OFF_CENTRE = 0.15  # of width or height: rectification moves principal points by a tenth at most


class RecordedCamera(NamedTuple):
    """What is known of the rectified pairs, and how a pair of the recording becomes one of them."""

    camera: CameraCalibration
    rectified: Callable[[StereoPair], StereoPair]


def recorded_camera(path: Path, pair: StereoPair) -> RecordedCamera:
    """The camera whose calibration is in ``path``, for pictures like ``pair``'s.

    A file of rectified pairs (as ``read_calibration`` says), or any of a raw stereo camera: ours, a ZED's,
    Kalibr's, OpenCV's. Raises ConfigurationError.
    """
    if path.suffix == ".txt" or _is_of_rectified(path):
        return RecordedCamera(read_calibration(path, pair), lambda taken: taken)
    height, width = pair.left.shape
    found = reading.read_calibration(path, (width, height))
    if (found.width_px, found.height_px) != (width, height):
        raise ConfigurationError(
            "configuration.wrong_size",
            f"{path}: for pictures of {found.width_px} x {found.height_px}, but {width} x {height} came",
        )
    return RecordedCamera(rectified_camera(found), Rectifier(found))


def _is_of_rectified(path: Path) -> bool:
    """Whether a YAML file has a rectified pinhole's keys at its top, or nothing that a raw camera's has."""
    if path.suffix.lower() not in (".yaml", ".yml"):
        return False
    try:
        keys = set(read_yaml(path))
    except ConfigurationError:
        return False  # OpenCV's is no YAML, and whoever reads a spoiled one says what is wrong
    return "format" not in keys and bool(keys & set(RectifiedPairSettings.model_fields))


def read_calibration(path: Path, pair: StereoPair) -> CameraCalibration:
    """The calibration in ``path`` for pictures like ``pair``'s.

    YAML with fx_px, fy_px, cx_px, cy_px, baseline_m and, where the right eye's differs, right_cx_px; or a
    text file with KITTI's projection matrices ``P0:`` and ``P1:``. Raises ConfigurationError.
    """
    found = _kitti(path) if path.suffix == ".txt" else load(RectifiedPairSettings, path)
    height, width = pair.left.shape
    _check_size(path, found, width, height)
    left = EyeSettings(fx_px=found.fx_px, fy_px=found.fy_px, cx_px=found.cx_px, cy_px=found.cy_px)
    right_cx = found.cx_px if found.right_cx_px is None else found.right_cx_px
    return intrinsics.calibration(
        CameraSettings(
            stale_ms=1000.0,
            frozen_frames=0,
            width_px=width,
            height_px=height,
            calibration=PinholePair(
                left=left, right=left.model_copy(update={"cx_px": right_cx}), baseline_m=found.baseline_m
            ),
        )
    )


def _check_size(path: Path, found: RectifiedPairSettings, width: int, height: int) -> None:
    """Raises ConfigurationError where the calibration is not for pictures of this size."""
    wanted = (found.width_px or width, found.height_px or height)
    if wanted != (width, height):
        raise ConfigurationError(
            "configuration.wrong_size",
            f"{path}: for pictures of {wanted[0]} x {wanted[1]}, but {width} x {height} came",
        )
    if found.width_px is None:
        middle = ((width - 1) / 2.0, (height - 1) / 2.0)
        for name, value, centre, size in zip(
            ("cx_px", "cy_px"), (found.cx_px, found.cy_px), middle, (width, height), strict=True
        ):
            if abs(value - centre) > _OFF_CENTRE * size:
                raise ConfigurationError(
                    "configuration.wrong_size",
                    f"{path}: {name} {value:g} is {abs(value - centre):.0f} px from the middle of pictures of"
                    f" {width} x {height} ({_OFF_CENTRE * size:.0f} px at most): it is for another size, or"
                    " lacks width_px and height_px",
                )


def _kitti(path: Path) -> RectifiedPairSettings:
    """From the first two projection matrices: P1 = K [I | (−fx·b, 0, 0)]."""
    try:
        rows = dict(
            line.split(":", 1) for line in path.read_text(encoding="ascii").splitlines() if ":" in line
        )
        P0, P1 = (np.array(rows[name].split(), dtype=np.float64).reshape(3, 4) for name in ("P0", "P1"))
    except OSError as error:
        raise ConfigurationError("configuration.unreadable", f"{path}: {error.strerror}") from error
    except (KeyError, ValueError) as error:
        raise ConfigurationError(
            "configuration.bad_sequence", f"{path}: rows P0: and P1: are wanted ({error})"
        ) from error
    return RectifiedPairSettings(
        fx_px=float(P0[0, 0]),
        fy_px=float(P0[1, 1]),
        cx_px=float(P0[0, 2]),
        cy_px=float(P0[1, 2]),
        right_cx_px=float(P1[0, 2]),
        baseline_m=float(P0[0, 3] - P1[0, 3]) / float(P0[0, 0]),
    )
