"""One pair in work, and the pose that is found of it."""

from typing import NamedTuple

from vision_pc.core.odometry.keyframes.keyframe import Indices
from vision_pc.core.odometry.pose_spread import PoseSpread
from vision_pc.core.odometry.tracking import Flags
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image, StereoPair


class Frame(NamedTuple):
    """One pair in work, its left picture ``halved``, and where each eye may see the static world (height,
    width).
    """

    pair: StereoPair
    halved: Image
    left_static: Flags
    right_static: Flags


class PoseEstimate(NamedTuple):
    """A pair's pose against the map, with the map points (n,) that hold it, where the left eye sees them,
    and the right eye's rays (n, 2) to those that it sees (n,). ``by_arm``: the arm's state chose it.
    """

    X_C0C: Array
    spread: PoseSpread
    ids: Indices
    pixels: Array
    right_rays: Array
    seen_right: Flags
    residual_px: float
    by_arm: bool = False
