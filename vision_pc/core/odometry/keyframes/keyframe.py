"""A remembered picture, and where it shows points of the map."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vision_pc.core import se3
from vision_pc.core.odometry.keyframes.templates import Templates
from vision_pc.core.odometry.tracking import Flags
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image

Indices = NDArray[np.int64]

_LARGEST_TURN = np.radians(25.0)  # beyond it a keyframe's patches no longer look alike
_LARGEST_ZOOM = 1.35


class Keyframe(NamedTuple):
    """A remembered left picture (also ``halved``), its pose, and the map points ``ids`` (n,) that it shows.

    ``pixels`` (n, 2) where it shows them, ``rays`` (n, 2) the same undistorted, ``surfaces`` (n, 3) from
    ``patches.planes``; ``right_rays`` (n, 2) in the right eye, where ``seen_right`` (n,);
    ``match_stds`` (2, n) px of where both eyes see them, as far as patches tell. Keyframes are numbered in
    the order in which they were made. ``templates`` are of all points that it was made with,
    ``rows`` (n,) which of those these are.
    """

    number: int
    X_C0C: Array
    left: Image
    halved: Image
    ids: Indices
    pixels: Array
    rays: Array
    surfaces: Array
    right_rays: Array
    seen_right: Flags
    match_stds: Array
    templates: Templates
    rows: Indices

    def only(self, chosen: Flags) -> "Keyframe":
        """The keyframe with the ``chosen`` (n,) of its points."""
        return self._replace(
            ids=self.ids[chosen],
            pixels=self.pixels[chosen],
            rays=self.rays[chosen],
            surfaces=self.surfaces[chosen],
            right_rays=self.right_rays[chosen],
            seen_right=self.seen_right[chosen],
            match_stds=self.match_stds[:, chosen],
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
