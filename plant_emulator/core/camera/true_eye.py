"""The geometry of one eye as it truly is: lens, pose, drift, and where a rolling shutter shows a point."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.compiled import kernel
from plant_emulator.config.camera import CameraConfig
from plant_emulator.core.camera.lens import Lens
from plant_emulator.core.mechanics.geometry import rotation_from_vector, transform

Matrix = NDArray[np.float64]

_ROW_SEARCHES = 4  # each is wrong by the share of a row that the shutter moves a point by: far below 1


class TrueEye(NamedTuple):
    """``X_CE``: the eye's pose (4x4) in the left one at the first capture. ``drifts``: the right one does."""

    lens: Lens
    X_CE: Matrix
    drifts: bool

    def pose(self, drift_px: tuple[float, float]) -> Matrix:
        """X_CE (4x4) after a drift that adds (disparity, rows) px at the principal point."""
        if not self.drifts or drift_px == (0.0, 0.0):
            return self.X_CE
        yaw, pitch = (math.atan(px / focal) for px, focal in zip(drift_px, self.lens.focal, strict=True))
        turn = rotation_from_vector(np.array([0.0, yaw, 0.0])) @ rotation_from_vector(
            np.array([pitch, 0.0, 0.0])
        )
        return np.asarray(self.X_CE @ transform(turn, np.zeros(3)), dtype=np.float64)

    def project(self, X_WC: Matrix, points: Matrix, drift_px: tuple[float, float] = (0.0, 0.0)) -> Matrix:
        """Exact image coordinates (n, 2) px of points (n, 3) in W; NaN behind the eye."""
        return self.seen_from(X_WC @ self.pose(drift_px), points)

    def seen_from(self, X_WE: Matrix, points: Matrix) -> Matrix:
        """The same where the eye's own pose in W is known."""
        return self.lens.project((points - X_WE[:3, 3]) @ X_WE[:3, :3])


def true_eyes(config: CameraConfig) -> tuple[TrueEye, TrueEye]:
    """The left and the right eye as they truly are."""
    rectification = config.rectification
    twist = rotation_from_vector(np.radians(np.array(rectification.right_eye_rotation_deg)))
    lens = Lens(
        config.lens_difference.added_to(config.lens), -rectification.disparity_px, rectification.vertical_px
    )
    right = TrueEye(lens, transform(twist, np.array([config.baseline_m, 0.0, 0.0])), drifts=True)
    return TrueEye(Lens(config.lens), np.eye(4), drifts=False), right


def as_read(project: Callable[[float], Matrix], config: CameraConfig) -> Matrix:
    """Image coordinates (n, 2) px of points that move while the rows are read.

    ``project`` gives them for an instant (s) after the capture; each point is seen when its own row is read.
    Between first, middle and last row its way is taken for a parabola.
    """
    line_s, last = config.shutter.line_s, config.height_px - 1
    middle = project(0.0)
    if line_s == 0.0:
        return middle
    early, late = project(-0.5 * line_s * last), project(0.5 * line_s * last)
    seen = middle.copy()
    _move_to_rows(seen, middle, late - early, late + early - 2.0 * middle, float(last))
    return seen


@kernel(nogil=True)
def _move_to_rows(seen: Matrix, middle: Matrix, way: Matrix, bow: Matrix, last: float) -> None:
    """Move ``seen`` (n, 2) from ``middle`` along its parabola to where it is when its own row is read."""
    for i in range(seen.shape[0]):
        for _ in range(_ROW_SEARCHES):
            share = 2.0 * seen[i, 1] / last - 1.0
            if share > 1.0:  # not min and max: what is behind the eye is NaN and stays it
                share = 1.0
            elif share < -1.0:
                share = -1.0
            for axis in range(2):
                seen[i, axis] = (
                    middle[i, axis] + 0.5 * share * way[i, axis] + 0.5 * (share * share) * bow[i, axis]
                )
