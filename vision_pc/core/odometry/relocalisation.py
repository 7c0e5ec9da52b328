"""Where a lost camera is, from a keyframe alone: descriptors matched without any idea of the pose."""

import cv2
import numpy as np
from scipy.spatial import cKDTree

from vision_pc.core import se3
from vision_pc.core.odometry.keyframes.keyframe import Keyframe
from vision_pc.core.odometry.limits import MINIMUM_INLIERS
from vision_pc.core.odometry.tracking import Flags
from vision_pc.core.perception import intrinsics
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration, Image

_DESCRIPTORS = 1000
_NEAR_A_POINT = 100.0  # px: farther from any map point the depth of a keyframe's pixel is a guess
_FEWEST = 12
_RANSAC_PX = 4.0


def relocalised(image: Image, static: Flags, keyframe: Keyframe, camera: CameraCalibration) -> Array | None:
    """X_C0C, to a few pixels, of the left ``image`` if it shows what ``keyframe`` shows; None if it does not.

    ``static`` (height, width): False where the picture shows what moves with the camera.
    """
    there, here = _describe_corners(image, static), _describe_corners(keyframe.left, static)
    if there is None or here is None:
        return None
    pairs = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(here[1], there[1])
    if len(pairs) < _FEWEST:
        return None
    pixels = here[0][[pair.queryIdx for pair in pairs]]
    seen = there[0][[pair.trainIdx for pair in pairs]]
    distance, nearest = cKDTree(keyframe.pixels).query(pixels)
    rays = np.column_stack([intrinsics.normalised(camera.left, pixels), np.ones(len(pixels))])
    inverse_depths = (rays * keyframe.surfaces[nearest]).sum(axis=1)
    usable = (distance < _NEAR_A_POINT) & (inverse_depths > 1e-3)
    if int(usable.sum()) < _FEWEST:
        return None
    points = se3.apply(keyframe.X_C0C, rays[usable] / inverse_depths[usable, None])
    found, rotation, position, inliers = cv2.solvePnPRansac(
        points,
        intrinsics.normalised(camera.left, seen[usable]),
        np.eye(3),
        None,
        iterationsCount=300,
        reprojectionError=_RANSAC_PX / float(camera.left.K[0, 0]),
        confidence=0.999,
        flags=cv2.SOLVEPNP_EPNP,
    )
    if not found or inliers is None or len(inliers) < max(_FEWEST, MINIMUM_INLIERS // 2):
        return None
    return se3.inverse(se3.transform(se3.exp_so3(rotation.ravel()), position.ravel()))


def _describe_corners(image: Image, static: Flags) -> tuple[Array, Image] | None:
    """Pixels (n, 2) and descriptors (n, 32) of an image's corners; None when it has none."""
    corners, descriptors = cv2.ORB.create(_DESCRIPTORS).detectAndCompute(image, static.astype(np.uint8) * 255)
    if descriptors is None or len(corners) < _FEWEST:
        return None
    return np.array([corner.pt for corner in corners], dtype=np.float64), np.asarray(
        descriptors, dtype=np.uint8
    )
