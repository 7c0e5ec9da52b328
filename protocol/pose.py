"""The pose as it crosses process boundaries: position and unit quaternion, w first."""

import math
import sys
from typing import NamedTuple

_LEAST = sys.float_info.min


def is_usable(number: float) -> bool:
    """Whether ``number`` is finite and not subnormal.

    Nobody measures or asks for 1e-310 m: such a number is what misplaced bytes read as.
    """
    return math.isfinite(number) and (number == 0.0 or abs(number) >= _LEAST)


class Pose(NamedTuple):
    """Pose of one frame in another (``X_BT``: T in B).

    ``p_m`` is the position in metres, ``q_wxyz`` the orientation as a quaternion written w, x, y, z.
    """

    p_m: tuple[float, float, float]
    q_wxyz: tuple[float, float, float, float]

    def is_finite(self) -> bool:
        """Whether all seven numbers are finite."""
        return all(map(math.isfinite, (*self.p_m, *self.q_wxyz)))

    def is_usable(self) -> bool:
        """Whether all seven numbers are usable."""
        return all(map(is_usable, (*self.p_m, *self.q_wxyz)))

    def quaternion_norm(self) -> float:
        """The norm of ``q_wxyz``: 1 for a proper pose."""
        return math.sqrt(sum(c * c for c in self.q_wxyz))


IDENTITY = Pose((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
