"""Recordings of others, which are not part of the repository.

They are read from ``LONGREACH_DATA``, else from ``shared/data`` beside the project; where they are absent,
RequestRefused says so.
"""

import os
from pathlib import Path

import cv2
import numpy as np

from protocol.errors import RequestRefused
from testbed.hand_eye import trajectories
from testbed.hand_eye.importer import ImportOptions, load
from tests.support.paths import ROOT
from vision_pc.config.choices import Setup
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.samples import PosePairs
from vision_pc.core.perception.zhang_intrinsics import Checkerboard
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image

OPENCV_BOARD = Checkerboard(9, 6, 0.025)
OPENCV_FX_PX = 535.916  # left_intrinsics.yml, OpenCV's own result
# MoveIt's own test: camera in base, translation m and intrinsic Euler angles XYZ rad, each within 1 %
MOVEIT_TRANSLATION = np.array([0.659, -0.249, 0.830])
MOVEIT_EULER_XYZ = np.array([0.230, -2.540, 1.950])


def data_directory() -> Path:
    """Where the recordings are. Raises RequestRefused (``refused.data_absent``) when they are not there."""
    directory = Path(os.environ.get("LONGREACH_DATA", ROOT.resolve().parent / "shared" / "data"))
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


def checkerboard_pictures(eye: str = "left") -> list[tuple[str, Image]]:
    """OpenCV's 13 real pictures of a 9×6 board, by file name."""
    files = sorted((data_directory() / "opencv_stereo").glob(f"{eye}??.jpg"))
    if not files:
        raise RequestRefused("refused.data_absent", f"no {eye}??.jpg in {data_directory() / 'opencv_stereo'}")
    return [
        (file.stem, np.asarray(cv2.imread(str(file), cv2.IMREAD_GRAYSCALE), dtype=np.uint8)) for file in files
    ]
