"""How often markers are looked for in pictures that only a console's watchers see."""

import numpy as np
from numpy.typing import NDArray

_MOVING_S = 0.5
_AT_REST_S = 2.5  # somebody may still walk into the picture
_MOVED_RAD = 2e-3  # a joint: more than valves leak in a second


class MeasuringPace:
    """Twice a second while the arm moves, seldom at rest, where nothing changes that joints tell of."""

    def __init__(self) -> None:
        self._last_s = -np.inf
        self._joints_rad: NDArray[np.float64] | None = None

    def due(self, now_s: float, joints_rad: NDArray[np.float64] | None) -> bool:
        """Whether to measure now; if so, that counts as done. ``joints_rad`` (n,) is None while unknown."""
        rests = (
            joints_rad is not None
            and self._joints_rad is not None
            and bool(np.all(np.abs(joints_rad - self._joints_rad) < _MOVED_RAD))
        )
        if now_s - self._last_s < (_AT_REST_S if rests else _MOVING_S):
            return False
        self._last_s, self._joints_rad = now_s, joints_rad
        return True
