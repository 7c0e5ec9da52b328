"""What the motion so far foresees of the next picture, and how far that may be wrong."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vision_pc.core import se3
from vision_pc.core.perception import intrinsics
from vision_pc.core.se3 import Array
from vision_pc.core.types import CameraCalibration

_SIGMAS = 3.0
_PLACE_STD_M = 0.004  # [E] play of the slew at four metres, and booms that swing
_WAY_SHARE = 0.01  # [E] links as drawn; bending
_TURN_STD_RAD = 0.004  # [E]


class Since(NamedTuple):
    """A pair that was located at ``X_C0C``, and how the arm's tool has gone since: ``X_TT``, m and rad."""

    X_C0C: Array
    X_TT: Array


class ArmPrior:
    """How far the camera may be from the pairs that were located, as the arm tells of itself."""

    def __init__(self, since: list[Since], lever_m: float) -> None:
        self._since = since
        self._lever_m = lever_m

    def agrees(self, X_C0C: Array, tolerance: float = 1.0) -> bool:
        """Whether a camera at ``X_C0C`` has gone as the arm has; ``tolerance``: times what is usual."""
        return all(self._surprise(one, X_C0C) < tolerance for one in self._since)

    def _surprise(self, since: Since, X_C0C: Array) -> float:
        """The worse of way and turn, relative to what they may differ by."""
        seen = se3.inverse(since.X_C0C) @ X_C0C
        way, seen_way = (float(np.linalg.norm(X[:3, 3])) for X in (since.X_TT, seen))
        turn, seen_turn = (se3.angle_between(X[:3, :3], np.eye(3)) for X in (since.X_TT, seen))
        lever = 2.0 * np.sin(turn / 2.0) * self._lever_m
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
        known = (self._first, self._last)
        return ArmPrior([Since(X, se3.inverse(before) @ X_BT) for X, before in known], self._lever_m)

    def found(self, X_C0C: Array, X_BT: Array | None) -> None:
        """The camera was located at ``X_C0C`` while the tool was at ``X_BT``."""
        if X_BT is not None:
            self._last = (X_C0C, X_BT)
            self._first = self._first or self._last


_REMEMBERED = 6  # pictures
_FEWEST = 3
_TIMES = 3.0  # the largest surprise of late
_FLOOR_PX = 3.0  # [D] a thing that walks through moves by 5 to 20 px a picture


UNDECIDED = "two_motions: the arm's state still fits both"


class MotionPrior(NamedTuple):
    """The camera foreseen, and within how many pixels (median over the points) its picture must be."""

    X_C0C: Array
    tolerance_px: float

    def agrees(self, X_CC0: Array, points: Array, camera: CameraCalibration) -> bool:
        """Whether a camera at ``X_CC0`` sees ``points`` (n, 3) about where they were foreseen."""
        return shift_px(se3.inverse(self.X_C0C), X_CC0, points, camera) < self.tolerance_px


class Foreseen(NamedTuple):
    """What is known of the next picture beforehand: from the motion so far, and from the arm's own
    state, which is believed first.
    """

    motion: MotionPrior | None = None
    arm: ArmPrior | None = None

    @property
    def known(self) -> bool:
        """Whether anything is."""
        return self.motion is not None or self.arm is not None

    def agrees(self, X_CC0: Array, points: Array, camera: CameraCalibration) -> bool:
        """Whether ``X_CC0``, which sees ``points`` (n, 3), was foreseen; False where nothing was."""
        if self.arm is not None:
            return self.arm.agrees(se3.inverse(X_CC0))
        return self.motion is not None and self.motion.agrees(X_CC0, points, camera)

    def chosen(self, places: Sequence[Array], points: Array, camera: CameraCalibration) -> int | str:
        """Which of two ``places`` (X_CC0) of the camera was foreseen, or the loss's cause where that does not
        tell.
        """
        if self.arm is not None:
            fits = [self.arm.agrees(se3.inverse(X_CC0)) for X_CC0 in places]
            if fits.count(True) == 1:
                return fits.index(True)
            if not any(fits):
                return "two_motions"
        if self.motion is not None:
            fits = [self.motion.agrees(X_CC0, points, camera) for X_CC0 in places]
            if fits.count(True) == 1:
                return fits.index(True)
        return "two_motions" if self.arm is None else UNDECIDED


class MotionHistory:
    """Learns from picture to picture how well constant motion foresees.

    Through pictures lost the motion goes on, and the tolerance grows with the square of their number, as a
    bounded acceleration lets the place go astray.
    """

    def __init__(self) -> None:
        self._surprises: list[float] = []
        self._X_C0C: Array | None = None
        self._motion: Array | None = None
        self._lost = 0

    @property
    def prior(self) -> MotionPrior | None:
        """What is foreseen of the next picture; None before enough was seen."""
        if len(self._surprises) < _FEWEST or self._motion is None:
            return None
        tolerance = _FLOOR_PX + _TIMES * max(self._surprises)
        return MotionPrior(self._foreseen(), tolerance * (1 + self._lost) ** 2)

    def found(self, X_C0C: Array, camera: CameraCalibration, points: Array, pixels: Array) -> None:
        """The camera was at ``X_C0C`` and its left eye saw ``points`` (n, 3) at ``pixels`` (n, 2)."""
        if self._X_C0C is not None and not self._lost:
            if self._motion is not None:
                foreseen = se3.inverse(self._foreseen())
                surprise = _median_px(intrinsics.project(camera.left, se3.apply(foreseen, points)), pixels)
                self._surprises = [*self._surprises, surprise][-_REMEMBERED:]
            self._motion = se3.inverse(self._X_C0C) @ X_C0C
        self._X_C0C, self._lost = X_C0C, 0

    def lost(self) -> None:
        """Nothing was found in a picture."""
        self._lost += 1

    def _foreseen(self) -> Array:
        assert self._X_C0C is not None
        assert self._motion is not None
        X = self._X_C0C
        for _ in range(1 + self._lost):
            X = X @ self._motion
        return X


def shift_px(X_CC0: Array, other_CC0: Array, points: Array, camera: CameraCalibration) -> float:
    """Median distance (px) between the left eye's views of ``points`` (n, 3) from two places."""
    one, other = (intrinsics.project(camera.left, se3.apply(X, points)) for X in (X_CC0, other_CC0))
    return _median_px(one, other)


def _median_px(one: Array, other: Array) -> float:
    """Median distance of pixels (n, 2); infinite where none can be told."""
    apart = np.linalg.norm(one - other, axis=1)
    seen = np.isfinite(apart)
    return float(np.median(apart[seen])) if seen.any() else np.inf


class History:
    """What the pairs so far foresee of the next one, by the camera's motion and by the arm's own state."""

    def __init__(self, lever_m: float) -> None:
        self._motion = MotionHistory()
        self._arm = ArmHistory(lever_m)

    def foreseen(self, X_BT: Array | None) -> Foreseen:
        """What is foreseen of a pair in which the arm's tool is at ``X_BT``."""
        return Foreseen(self._motion.prior, self._arm.prior(X_BT))

    def found(
        self, X_C0C: Array, X_BT: Array | None, camera: CameraCalibration, points: Array, pixels: Array
    ) -> None:
        """The camera was at ``X_C0C`` and its left eye saw ``points`` (n, 3) at ``pixels`` (n, 2), while the
        tool was at ``X_BT``.
        """
        self._motion.found(X_C0C, camera, points, pixels)
        self._arm.found(X_C0C, X_BT)

    def lost(self) -> None:
        """Nothing was found in a picture."""
        self._motion.lost()
