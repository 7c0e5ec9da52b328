"""A remembered picture, and where it shows points of the map."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vision_pc.core.odometry.keyframes.templates import Templates
from vision_pc.core.odometry.tracking import Flags
from vision_pc.core.se3 import Array
from vision_pc.core.types import Image

Indices = NDArray[np.int64]


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
