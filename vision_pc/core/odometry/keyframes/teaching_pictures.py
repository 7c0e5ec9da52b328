"""Which pictures teach a map: of those that are taken from one place, the first few."""

import numpy as np

from vision_pc.core import se3
from vision_pc.core.se3 import Array

_ELSEWHERE = 0.01  # of the way to what is seen, or rad: a base that rocks by a millimetre leaves no place


class TeachingPictures:
    """Counts the pictures of a place; ``a_place`` of them teach, 0: all do.

    Pictures from one place show the same disparities again. Their noise averages out in a few; what all
    points share does not, and as the camera warms it walks: learnt from on and on, it would stretch the map,
    and with it the way that the camera has come.
    """

    def __init__(self, a_place: int) -> None:
        self._a_place = a_place
        self._X_C0C = se3.identity()
        self._keyframes = self._taken = 0

    def teaches(self, X_CC0: Array, points: Array, keyframes: int) -> bool:
        """Whether one more picture at ``X_CC0``, of ``points`` (n, 3) in C0, is among the first there, or
        since the last of so many ``keyframes`` was made: its points have not been seen before.
        """
        if not self._a_place:
            return True
        X = X_CC0 @ self._X_C0C
        shift = np.linalg.norm(X[:3, 3]) / np.median(se3.apply(X_CC0, points)[:, 2])
        elsewhere = shift + se3.angle_between(X[:3, :3], np.eye(3)) > _ELSEWHERE
        if elsewhere or keyframes > self._keyframes:
            self._X_C0C, self._keyframes, self._taken = se3.inverse(X_CC0), keyframes, 0
        self._taken += 1
        return self._taken <= self._a_place
