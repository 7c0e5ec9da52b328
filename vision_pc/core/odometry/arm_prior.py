"""How far the camera may have gone, by the arm's own state: tool and camera are fixed to one body."""

from typing import NamedTuple

import numpy as np

from vision_pc.core import se3
from vision_pc.core.se3 import Array

_SIGMAS = 3.0
_PLACE_STD_M = 0.004  # [E] play of the slew at four metres, and booms that swing
_WAY_SHARE = 0.01  # [E] links as drawn; bending
_TURN_STD_RAD = 0.004  # [E]


class ArmPrior(NamedTuple):
    """How far the camera may be from the pairs that were located, as the arm tells of itself.

    ``since``: where the camera was in each, X_C0C, and how the arm's tool has gone since, X_TT (m and rad).
    """

    since: tuple[tuple[Array, Array], ...]
    lever_m: float

    def agrees(self, X_C0C: Array, tolerance: float = 1.0) -> bool:
        """Whether a camera at ``X_C0C`` has gone as the arm has; ``tolerance``: times what is usual."""
        return all(self._surprise(se3.inverse(X) @ X_C0C, X_TT) < tolerance for X, X_TT in self.since)

    def _surprise(self, seen: Array, X_TT: Array) -> float:
        """The worse of way and turn, relative to what they may differ by."""
        way, seen_way = (float(np.linalg.norm(X[:3, 3])) for X in (X_TT, seen))
        turn, seen_turn = (se3.angle_between(X[:3, :3], np.eye(3)) for X in (X_TT, seen))
        lever = 2.0 * np.sin(turn / 2.0) * self.lever_m
        place = _SIGMAS * float(np.hypot(_PLACE_STD_M, _WAY_SHARE * way)) + lever
        off = abs(seen_way - way) / place, abs(seen_turn - turn) / (_SIGMAS * _TURN_STD_RAD)
        return float(max(off))


class ArmHistory:
    """Where the arm's tool was in the pairs that were located: the first one and the last."""

    def __init__(self, lever_m: float) -> None:
        self._lever_m = lever_m
        self._first: tuple[Array, Array] | None = None
        self._last: tuple[Array, Array] | None = None

    def prior(self, X_BT: Array | None) -> ArmPrior | None:
        """What is told of a pair in which the tool is at ``X_BT``; None before one was located with a state,
        and where there is no state.
        """
        if X_BT is None or self._first is None or self._last is None:
            return None
        first, last = ((X, se3.inverse(before) @ X_BT) for X, before in (self._first, self._last))
        return ArmPrior((first, last), self._lever_m)

    def found(self, X_C0C: Array, X_BT: Array | None) -> None:
        """The camera was located at ``X_C0C`` while the tool was at ``X_BT``."""
        if X_BT is not None:
            self._last = (X_C0C, X_BT)
            self._first = self._first or self._last
