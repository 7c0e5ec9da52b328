"""Odometry over a recorded sequence: two directories of rectified pictures in, a TUM trajectory out."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from foundation.configuration import load
from protocol.errors import ConfigurationError, MeasurementFailed
from vision_pc.config.camera import CameraSettings, EyeSettings, PinholePair
from vision_pc.config.vision import OdometrySettings, RectifiedPairSettings
from vision_pc.core import se3
from vision_pc.core.odometry import StereoOdometry
from vision_pc.core.perception import intrinsics
from vision_pc.core.types import CameraCalibration, OdometryPose, StereoPair
from vision_pc.shell.cameras.directory import read_grey

_PICTURES = (".png", ".jpg", ".jpeg", ".pgm", ".bmp", ".tif", ".tiff")
_NS_FROM = 10**15  # a file name that is a number this great counts nanoseconds


class SequenceResult(NamedTuple):
    """What became of a sequence: its poses, and in how many pairs the odometry was lost, last for what."""

    poses: list[OdometryPose]
    frames: int
    lost: int
    last_loss: str | None
    keyframes: int


def read_pairs(left: Path, right: Path, rate_hz: float) -> Iterator[StereoPair]:
    """The pairs of two directories, matched by their order, which must be as long.

    Times come from ``times.txt`` beside or above ``left`` (seconds, one a line), from file names that are
    nanoseconds, or else from ``rate_hz``. Raises ConfigurationError.
    """
    names = [_pictures(directory) for directory in (left, right)]
    if len(names[0]) != len(names[1]):
        raise ConfigurationError(
            "configuration.bad_sequence", f"{left}: {len(names[0])} pictures, but {len(names[1])} in {right}"
        )
    times_ns = _times_ns(left, names[0], rate_hz)
    for index, (one, other) in enumerate(zip(*names, strict=True)):
        pair = StereoPair(read_grey(one), read_grey(other), times_ns[index], index)
        if pair.left.shape != pair.right.shape:
            raise ConfigurationError("configuration.bad_sequence", f"{one} and {other} differ in size")
        yield pair


def count_pairs(left: Path) -> int:
    """How many pictures ``left`` holds. Raises ConfigurationError where there are none."""
    return len(_pictures(left))


def read_calibration(path: Path, pair: StereoPair) -> CameraCalibration:
    """The calibration in ``path`` for pictures like ``pair``'s.

    YAML with fx_px, fy_px, cx_px, cy_px, baseline_m and, where the right eye's differs, right_cx_px; or a
    text file with KITTI's projection matrices ``P0:`` and ``P1:``. Raises ConfigurationError.
    """
    found = _kitti(path) if path.suffix == ".txt" else load(RectifiedPairSettings, path)
    height, width = pair.left.shape
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


def follow(
    left: Path,
    right: Path,
    calibration: Path,
    settings: OdometrySettings,
    rate_hz: float = 10.0,
    report: Callable[[int, OdometryPose | None], None] = lambda index, pose: None,
) -> SequenceResult:
    """The odometry of a whole sequence; ``report`` hears of every pair. Raises MeasurementFailed if all
    were lost.
    """
    poses: list[OdometryPose] = []
    odometry: StereoOdometry | None = None
    frames, last_loss = 0, None
    for pair in read_pairs(left, right, rate_hz):
        if odometry is None:
            odometry = StereoOdometry(read_calibration(calibration, pair), settings)
        pose = odometry.process(pair)
        frames += 1
        if pose is None:
            last_loss = odometry.last_loss
        else:
            poses.append(pose)
        report(pair.frame_id, pose)
    if odometry is None or not poses:
        raise MeasurementFailed(
            "measurement.odometry_lost", f"{left}: all {frames} pairs lost, last cause {last_loss}"
        )
    return SequenceResult(poses, frames, frames - len(poses), last_loss, odometry.keyframes)


def write_tum(path: Path, poses: list[OdometryPose]) -> None:
    """Write the trajectory to ``path``: seconds, x y z in metres, quaternion x y z w, one pose a line."""
    lines = []
    for pose in poses:
        (x, y, z), (qw, qx, qy, qz) = se3.to_pose(pose.X_C0C)
        numbers = " ".join(f"{value:.9f}" for value in (x, y, z, qx, qy, qz, qw))
        lines.append(f"{pose.capture_ns / 1e9:.9f} {numbers}\n")
    path.write_text("".join(lines), encoding="ascii")


def _pictures(directory: Path) -> list[Path]:
    if not directory.is_dir():
        raise ConfigurationError("configuration.bad_sequence", f"{directory}: no such directory")
    found = sorted(path for path in directory.iterdir() if path.suffix.lower() in _PICTURES)
    if not found:
        raise ConfigurationError(
            "configuration.bad_sequence", f"{directory}: 0 pictures, at least 1 is wanted"
        )
    return found


def _times_ns(directory: Path, names: list[Path], rate_hz: float) -> list[int]:
    for table in (directory / "times.txt", directory.parent / "times.txt"):
        if table.is_file():
            try:
                seconds = [float(line) for line in table.read_text(encoding="ascii").split()]
            except ValueError as error:
                raise ConfigurationError("configuration.bad_sequence", f"{table}: {error}") from error
            if len(seconds) < len(names):
                raise ConfigurationError(
                    "configuration.bad_sequence", f"{table}: {len(seconds)} times for {len(names)} pictures"
                )
            return [round(second * 1e9) for second in seconds[: len(names)]]
    if all(name.stem.isdigit() and int(name.stem) >= _NS_FROM for name in names):
        return [int(name.stem) for name in names]
    return [round(index * 1e9 / rate_hz) for index in range(len(names))]


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
