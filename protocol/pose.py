"""The pose as it crosses process boundaries: position and unit quaternion, w first."""

import math
from typing import NamedTuple


class Pose(NamedTuple):
    """Pose of one frame in another (``X_BT``: T in B).

    ``p_m`` is the position in metres, ``q_wxyz`` the orientation as a quaternion written w, x, y, z.
    """

    p_m: tuple[float, float, float]
    q_wxyz: tuple[float, float, float, float]

    def is_finite(self) -> bool:
        """Whether all seven numbers are finite."""
        return all(map(math.isfinite, (*self.p_m, *self.q_wxyz)))

    def quaternion_norm(self) -> float:
        """The norm of ``q_wxyz``: 1 for a proper pose."""
        return math.sqrt(sum(c * c for c in self.q_wxyz))


IDENTITY = Pose((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
