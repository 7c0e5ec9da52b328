"""Where camera and tool marker are during an exposure: constant body velocities about the capture instant."""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from plant_emulator.core.mechanics.geometry import rotation_from_vector, transform

Matrix = NDArray[np.float64]


class CameraView(NamedTuple):
    """Poses (4x4) in W of the left eye and of the tool marker."""

    X_WC: Matrix
    X_WM: Matrix


class CameraMotion(NamedTuple):
    """Velocities of both, (2, 6): velocity in W (m/s), then rotation vector in the body's axes (rad/s)."""

    rates: Matrix

    def at(self, view: CameraView, offset_s: float) -> CameraView:
        """The view ``offset_s`` after (or, negative, before) the instant of ``view``."""
        X_WC, X_WM = (_moved(X, rate * offset_s) for X, rate in zip(view, self.rates, strict=True))
        return CameraView(X_WC, X_WM)


STILL = CameraMotion(np.zeros((2, 6)))


class Capture(NamedTuple):
    """A capture instant, mid-exposure: its number and time, where eye and marker are and how they move.

    ``drift_px``: how far the right eye has turned since the first capture, as disparity and as rows.
    """

    frame_id: int
    capture_ns: int
    view: CameraView
    motion: CameraMotion = STILL
    drift_px: tuple[float, float] = (0.0, 0.0)

    def view_at(self, offset_s: float) -> CameraView:
        """The view ``offset_s`` after (or, negative, before) the instant."""
        return self.view if offset_s == 0.0 else self.motion.at(self.view, offset_s)


def motion_between(before: CameraView, now: CameraView, interval_s: float) -> CameraMotion:
    """The motion that carries ``before`` into ``now`` in ``interval_s``."""
    return CameraMotion(np.stack([_difference(a, b) / interval_s for a, b in zip(before, now, strict=True)]))


def _moved(X: Matrix, step: Matrix) -> Matrix:
    return transform(X[:3, :3] @ rotation_from_vector(step[3:]), X[:3, 3] + step[:3])


def _difference(a: Matrix, b: Matrix) -> Matrix:
    turn, _ = cv2.Rodrigues(a[:3, :3].T @ b[:3, :3])
    return np.concatenate([b[:3, 3] - a[:3, 3], turn[:, 0]])
