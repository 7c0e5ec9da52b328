"""The methods on real recordings: MoveIt's samples, ETH's arm trajectories, OpenCV's checkerboards.

The data are not part of the repository: they are read from ``LONGREACH_DATA``, else from ``../shared/data``
beside the project, and whoever asks for them where they are absent is told so.
"""

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

import testbed
from protocol.errors import MeasurementFailed, RequestRefused
from testbed.experiments.hand_eye import intrinsics_experiment
from testbed.experiments.hand_eye.intrinsics_experiment import IntrinsicsRow
from testbed.hand_eye import trajectories
from testbed.hand_eye.importer import ImportOptions, load
from vision_pc.config.choices import Detector, Method, Setup
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.samples import PosePairs
from vision_pc.core.hand_eye.solvers import maximum_likelihood as ml
from vision_pc.core.hand_eye.solvers import methods
from vision_pc.core.perception import zhang_intrinsics as zhang
from vision_pc.core.perception.zhang_intrinsics import Checkerboard
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image

OPENCV_BOARD = Checkerboard(9, 6, 0.025)
OPENCV_FX_PX = 535.916  # left_intrinsics.yml, OpenCV's own result
# MoveIt's own test: camera in base, translation m and intrinsic Euler angles XYZ rad, each within 1 %
MOVEIT_TRANSLATION = np.array([0.659, -0.249, 0.830])
MOVEIT_EULER_XYZ = np.array([0.230, -2.540, 1.950])


class HoldOutRow(NamedTuple):
    """One method on one set: calibrated on one half, prediction error on the other, and exchanged.

    ``off_*`` compare X from all samples with the published reference, where there is one.
    """

    data: str
    method: str
    samples: int
    hold_out_deg: float
    hold_out_mm: float
    left_out: int
    off_deg: float | None = None
    off_mm: float | None = None
    error: str | None = None


def data_directory() -> Path:
    """Where the recordings are. Raises RequestRefused (``refused.data_absent``) when they are not there."""
    project = Path(testbed.__file__).resolve().parents[1]  # wherever this module lies in it
    default = project.parent / "shared" / "data"
    directory = Path(os.environ.get("LONGREACH_DATA", default))
    if not directory.is_dir():
        raise RequestRefused(
            "refused.data_absent", f"no recordings at {directory}; set LONGREACH_DATA to where they are"
        )
    return directory


def moveit() -> PosePairs:
    """MoveIt's 50 real samples, eye to hand."""
    return load(data_directory() / "moveit" / "pose_samples.json", ImportOptions(setup=Setup.EYE_TO_HAND))


def moveit_reference() -> Array:
    """The camera in the base (4, 4) that MoveIt's own test expects."""
    x, y, z = (stacks.exp_so3(angle * axis) for angle, axis in zip(MOVEIT_EULER_XYZ, np.eye(3), strict=True))
    return stacks.transform(x @ y @ z, MOVEIT_TRANSLATION)


def ethz() -> PosePairs:
    """ETH's simulated arm: hand and camera in the world, at its slowest distinct moments."""
    directory = data_directory() / "ethz_arm_sim"
    hand = trajectories.load_tum(directory / "robot_arm_sim_hand.csv")
    camera = trajectories.load_tum(directory / "robot_arm_sim_camera.csv")
    return trajectories.pair(hand, camera, options=ImportOptions(camera_in_target=True))[0]


def hold_out(
    data: str, pairs: PosePairs, reference: Array | None = None, only: Iterable[Method] | None = None
) -> tuple[HoldOutRow, ...]:
    """Root-mean-square errors of two-fold hold-out; halves are alternate samples in canonical order."""
    rows = []
    even = np.arange(len(pairs)) % 2 == 0
    for method in only if only is not None else Method:
        try:
            result = methods.solve(pairs, method)
            parts = [_prediction_errors(pairs, fold, method) for fold in (even, ~even)]
        except MeasurementFailed as error:
            rows.append(HoldOutRow(data, method.value, len(pairs), np.nan, np.nan, 0, error=str(error)))
            continue
        r = np.concatenate(parts)
        off = None if reference is None else stacks.inverse(reference) @ result.X
        rows.append(
            HoldOutRow(
                data,
                method.value,
                len(pairs),
                float(np.degrees(np.sqrt(np.mean(np.sum(r[:, 3:] ** 2, axis=1))))),
                float(1e3 * np.sqrt(np.mean(np.sum(r[:, :3] ** 2, axis=1)))),
                int((~result.inliers).sum()),
                None if off is None else float(np.degrees(stacks.angle(off[:3, :3]))),
                None if off is None else float(1e3 * np.linalg.norm(off[:3, 3])),
            )
        )
    return tuple(rows)


def _prediction_errors(pairs: PosePairs, fold: np.ndarray[Any, np.dtype[np.bool_]], method: Method) -> Array:
    found = methods.solve(pairs.subset(fold), method)
    other = pairs.subset(~fold)
    return ml.residuals(other.H, other.P, found.X, found.Z)


def checkerboard_pictures(eye: str = "left") -> list[tuple[str, Image]]:
    """OpenCV's 13 real pictures of a 9×6 board, by file name."""
    files = sorted((data_directory() / "opencv_stereo").glob(f"{eye}??.jpg"))
    if not files:
        raise RequestRefused("refused.data_absent", f"no {eye}??.jpg in {data_directory() / 'opencv_stereo'}")
    return [
        (file.stem, np.asarray(cv2.imread(str(file), cv2.IMREAD_GRAYSCALE), dtype=np.uint8)) for file in files
    ]


def checkerboards() -> tuple[IntrinsicsRow, ...]:
    """Intrinsics from those pictures with each corner detector."""
    pictures = checkerboard_pictures()
    height, width = pictures[0][1].shape
    rows = []
    for detector in Detector:
        views, missed = intrinsics_experiment.detect(pictures, OPENCV_BOARD, detector)
        found = zhang.calibrate(views, width, height)
        rows.append(intrinsics_experiment.row("OpenCV's left pictures", detector.value, found, missed))
    return tuple(rows)
