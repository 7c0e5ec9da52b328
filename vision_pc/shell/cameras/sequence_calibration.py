"""The calibration of a recorded sequence: of rectified pairs, or of a camera as it comes."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from foundation.configuration import load, read_yaml, validated
from protocol.errors import ConfigurationError
from vision_pc.config.camera import CameraSettings, EyeSettings, PinholePair
from vision_pc.config.camera_files import reading
from vision_pc.config.camera_files.parts import OFF_CENTRE, Entries
from vision_pc.config.vision import RectifiedPairSettings
from vision_pc.core.perception import intrinsics
from vision_pc.core.perception.rectification import Rectifier, rectified_camera
from vision_pc.core.types import CameraCalibration, StereoPair

_KITTI_FOLDER = re.compile(r"/image_0?([0-3])(?:/data)?$")
_LEAST_BASELINE_M = 0.005


class RecordedCamera(NamedTuple):
    """What is known of the rectified pairs, and how a pair of the recording becomes one of them; ``notes``:
    what was chosen in the file.
    """

    camera: CameraCalibration
    rectified: Callable[[StereoPair], StereoPair]
    notes: tuple[str, ...] = ()


def kitti_eyes(left: Path, right: Path) -> tuple[int, int]:
    """The numbers of KITTI's cameras by which two directories are called (image_2, or image_02/data); 0 and
    1, the grey ones, where they are not.
    """
    names = [_KITTI_FOLDER.search(directory.resolve().as_posix()) for directory in (left, right)]
    if names[0] is None or names[1] is None:
        return (0, 1)
    return (int(names[0][1]), int(names[1][1]))


def recorded_camera(path: Path, pair: StereoPair, eyes: tuple[int, int] = (0, 1)) -> RecordedCamera:
    """The camera whose calibration is in ``path``, for pictures like ``pair``'s; ``eyes`` as ``kitti_eyes``.

    Of rectified pairs: YAML with fx_px, fy_px, cx_px, cy_px, baseline_m and, where the right eye's differs,
    right_cx_px; or a text file with KITTI's projection matrices. Or any of a raw stereo camera: ours, a
    ZED's, Kalibr's, OpenCV's. Raises ConfigurationError.
    """
    if path.suffix == ".txt" or _is_of_rectified(path):
        pinholes = _kitti(path, eyes) if path.suffix == ".txt" else load(RectifiedPairSettings, path)
        notes = (f"baseline {pinholes.baseline_m:.4f} m, from {path.name}",)
        if path.suffix == ".txt":
            of = f"P{eyes[0]} and P{eyes[1]} are taken (P2 and P3 for directories image_2 and image_3)"
            notes = (f"{path.name}: {of}, baseline {pinholes.baseline_m:.4f} m",)
        return RecordedCamera(_rectified_pair(path, pinholes, pair), lambda taken: taken, notes)
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


def _rectified_pair(path: Path, found: RectifiedPairSettings, pair: StereoPair) -> CameraCalibration:
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
            if abs(value - centre) > OFF_CENTRE * size:
                raise ConfigurationError(
                    "configuration.wrong_size",
                    f"{path}: {name} {value:g} is {abs(value - centre):.0f} px from the middle of pictures of"
                    f" {width} x {height} ({OFF_CENTRE * size:.0f} px at most): it is for another size, or"
                    " lacks width_px and height_px",
                )


def _kitti(path: Path, eyes: tuple[int, int]) -> RectifiedPairSettings:
    """From the projection matrices of two ``eyes``: P1 = K [I | (−fx·b, 0, 0)], the first one's alike."""
    names = [f"P{eye}" for eye in eyes]
    rows: dict[str, list[str]] = {}
    file = Entries(path, rows)
    for line in reading.text_of(path).splitlines():
        name, colon, words = line.partition(":")
        if colon and name.strip() in rows:
            raise file.refused(name.strip(), words.strip(), "is written twice")
        rows[name.strip()] = words.split()
    expected = f"rows {names[0]}: and {names[1]}: are wanted"
    found = [file.entry(expected, name, name.replace("P", "P_rect_0")) for name in names]  # KITTI's raw data
    left, right = (file.camera_matrix(*named, 4) for named in zip(names, found, strict=True))
    fx, shift = float(left[0, 0]), float(right[0, 3] - left[0, 3])
    if fx <= 0.0 or shift >= 0.0:
        exchanged = "-fx·b is wanted, below the left eye's; are the eyes exchanged?"
        raise file.refused(f"{names[1]}[3]", float(right[0, 3]), exchanged)
    if -shift / fx <= _LEAST_BASELINE_M:
        wanted = f"gives {-shift / fx:.4f} m; -fx·b is wanted there ({fx * shift:.0f} for {-shift:g} m)"
        raise file.refused(f"{names[1]}[3]", float(right[0, 3]), wanted)
    file.alike(names[1], right, left)
    values = {
        "fx_px": fx, "fy_px": left[1, 1], "cx_px": left[0, 2], "cy_px": left[1, 2],
        "right_cx_px": right[0, 2], "baseline_m": -shift / fx,
    }  # fmt: skip
    return validated(RectifiedPairSettings, {name: float(value) for name, value in values.items()}, str(path))
