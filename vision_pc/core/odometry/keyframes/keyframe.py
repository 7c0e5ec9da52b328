"""A remembered picture, and where it shows points of the map."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vision_pc.core import se3
from vision_pc.core.odometry.contradiction import Depths
from vision_pc.core.odometry.keyframes.templates import Templates
from vision_pc.core.odometry.tracking import Flags
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image

A_PLACE = 16  # [M] a camera that warms walked by 0.25 px while the arm came to rest: 2.3 mm of a metre
_ELSEWHERE = 0.01  # of the way to what is seen, or rad: a base that rocks by a millimetre leaves no place


class TeachingPictures:
    """Counts the pictures of a place: the first few teach.

    Pictures from one place show the same disparities again. Their noise averages out in a few; what all
    points share does not, and as the camera warms it walks: learnt from on and on, it would stretch the map,
    and with it the way that the camera has come.
    """

    def __init__(self) -> None:
        self._X_C0C = se3.identity()
        self._keyframes = self._taken = 0

    def teaches(self, X_CC0: Array, points: Array, keyframes: int) -> bool:
        """Whether one more picture at ``X_CC0``, of ``points`` (n, 3) in C0, is among the first there, or
        since the last of so many ``keyframes`` was made: its points have not been seen before.
        """
        X = X_CC0 @ self._X_C0C
        shift = np.linalg.norm(X[:3, 3]) / np.median(se3.apply(X_CC0, points)[:, 2])
        elsewhere = shift + se3.angle_between(X[:3, :3], np.eye(3)) > _ELSEWHERE
        if elsewhere or keyframes > self._keyframes:
            self._X_C0C, self._keyframes, self._taken = se3.inverse(X_CC0), keyframes, 0
        self._taken += 1
        return self._taken <= A_PLACE


Indices = NDArray[np.int64]

_LARGEST_TURN = np.radians(25.0)  # beyond it a keyframe's patches no longer look alike
_LARGEST_ZOOM = 1.35


class Keyframe(NamedTuple):
    """A remembered left picture (also ``halved``), its pose, and the map points ``ids`` (n,) that it shows.

    ``pixels`` (n, 2) where it shows them, ``rays`` (n, 2) the same undistorted, ``surfaces`` (n, 3) from
    ``patches.planes``. Keyframes are numbered in the order in which they were made. ``templates`` are of all
    points that it was made with, ``rows`` (n,) which of those these are. ``depths``: of its small picture.
    """

    number: int
    X_C0C: Array
    left: Image
    halved: Image
    ids: Indices
    pixels: Array
    rays: Array
    surfaces: Array
    templates: Templates
    rows: Indices
    depths: Depths | None = None

    def only(self, chosen: Flags) -> "Keyframe":
        """The keyframe with the ``chosen`` (n,) of its points."""
        return self._replace(
            ids=self.ids[chosen],
            pixels=self.pixels[chosen],
            rays=self.rays[chosen],
            surfaces=self.surfaces[chosen],
            rows=self.rows[chosen],
        )

    def view_distance(self, points: Array, X_C0C: Array) -> float:
        """Shift of the picture from the keyframe to a camera at ``X_C0C`` as a share of its width, with turn
        and zoom added. ``points`` (n, 3) in C0: those that it shows.
        """
        depth = float(np.median(se3.apply(se3.inverse(self.X_C0C), points)[:, 2]))
        X = se3.inverse(self.X_C0C) @ X_C0C
        shift = np.linalg.norm(X[:2, 3] / depth + X[:2, 2])
        zoom = abs(np.log(max(1.0 - X[2, 3] / depth, 0.05))) / np.log(_LARGEST_ZOOM)
        turn = se3.angle_between(X[:3, :3], np.eye(3)) / _LARGEST_TURN
        return float(shift + zoom + turn)
