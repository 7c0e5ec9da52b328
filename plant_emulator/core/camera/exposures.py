"""What a camera that loses, repeats or cannot see frames makes of each capture."""

import math
from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from plant_emulator.config.camera import CameraConfig, DriftConfig
from plant_emulator.core.faults.kinds import (
    AnyFault,
    BaseFault,
    CameraBlind,
    CameraFrozen,
    FramesDropped,
    MarkerCovered,
)
from plant_emulator.core.mechanics.geometry import rotation_from_vector, transform

Matrix = NDArray[np.float64]


class CameraView(NamedTuple):
    """Poses (4x4) in W of the left eye, the tool marker, and the object with all that hangs about it; None:
    where the scene has it.
    """

    X_WC: Matrix
    X_WM: Matrix
    X_WO: Matrix | None = None


class CameraMotion(NamedTuple):
    """Velocities of both, (2, 6): velocity in W (m/s), then rotation vector in the body's axes (rad/s)."""

    rates: Matrix

    def at(self, view: CameraView, offset_s: float) -> CameraView:
        """The view ``offset_s`` after (or, negative, before) the instant of ``view``."""
        moving = zip((view.X_WC, view.X_WM), self.rates, strict=True)
        X_WC, X_WM = (_pose_after(X, rate * offset_s) for X, rate in moving)
        return CameraView(X_WC, X_WM, view.X_WO)


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
    pairs = ((before.X_WC, now.X_WC), (before.X_WM, now.X_WM))
    return CameraMotion(np.stack([_difference(a, b) / interval_s for a, b in pairs]))


def _pose_after(X: Matrix, step: Matrix) -> Matrix:
    return transform(X[:3, :3] @ rotation_from_vector(step[3:]), X[:3, 3] + step[:3])


def _difference(a: Matrix, b: Matrix) -> Matrix:
    turn, _ = cv2.Rodrigues(a[:3, :3].T @ b[:3, :3])
    return np.concatenate([b[:3, 3] - a[:3, 3], turn[:, 0]])


_STREAM = 0x6472696674
_KNOTS = 20  # in one time constant


class Drift:
    """The walk of one camera. Deterministic for a seed and the times asked for since the first one."""

    def __init__(self, config: DriftConfig, seed: int) -> None:
        self._spread = np.array([config.disparity_px, config.vertical_px])
        self._interval_s = config.time_constant_s / _KNOTS
        self._kept = math.exp(-1.0 / _KNOTS)
        self._rng = np.random.default_rng((seed, _STREAM))
        self._start_ns: int | None = None
        self._knots = [np.zeros(2)]

    def at(self, time_ns: int) -> tuple[float, float]:
        """(disparity, rows) px at ``time_ns``, both zero at the first time asked for and before it."""
        if not self._spread.any():
            return 0.0, 0.0
        if self._start_ns is None:
            self._start_ns = time_ns
        knots = max(1e-9 * (time_ns - self._start_ns), 0.0) / self._interval_s
        before = int(knots)
        while len(self._knots) < before + 2:
            step = math.sqrt(1.0 - self._kept**2) * self._rng.standard_normal(2)
            self._knots.append(self._kept * self._knots[-1] + step)
        share = knots - before
        drift = self._spread * ((1.0 - share) * self._knots[before] + share * self._knots[before + 1])
        return float(drift[0]), float(drift[1])


_DROP_STREAM, _STAMP_STREAM = 0x64726F70, 0x7374616D70
_WORST_JITTER = 3.0  # standard deviations
FaultT = TypeVar("FaultT", bound=BaseFault)


class Shot(NamedTuple):
    """A frame as the camera sends it: its stamps, and what it shows.

    ``frame_id`` and ``capture_ns`` are the stamps, wrong by what the configuration says. ``shown`` is the
    capture whose picture it is, its time the true one; the same for every frame of a frozen camera, with what
    was ``blind`` and covered then. ``delivered``: false when lost.
    """

    frame_id: int
    capture_ns: int
    shown: Capture
    blind: CameraBlind | None
    covers: tuple[MarkerCovered, ...]
    delivered: bool


class Exposures:
    """Turns captures into shots, in their order; deterministic for a seed.

    Give it every capture instant, also those that nobody looks at: a frozen camera goes on showing the last
    one before it froze.
    """

    def __init__(self, config: CameraConfig, seed: int) -> None:
        self._config = config
        self._seed = seed
        self._last: Shot | None = None
        self._drift = Drift(config.drift, seed)

    def shot(self, capture: Capture, faults: Sequence[AnyFault]) -> Shot:
        """The frame that the camera sends at ``capture`` under the plant's ``faults`` in force."""
        dropping = _latest(faults, FramesDropped)
        delivered = dropping is None or not self._is_lost(capture.frame_id, dropping.share)
        capture = capture._replace(drift_px=self._drift.at(capture.capture_ns))
        stamp_ns = self._stamp(capture)
        frozen = _latest(faults, CameraFrozen)
        if frozen is None or self._last is None:
            covers = tuple(fault for fault in faults if isinstance(fault, MarkerCovered))
            blind = _latest(faults, CameraBlind)
            self._last = Shot(capture.frame_id, stamp_ns, capture, blind, covers, delivered)
        elif frozen.stamps == "hold":
            self._last = self._last._replace(delivered=delivered)
        else:
            self._last = self._last._replace(
                frame_id=capture.frame_id, capture_ns=stamp_ns, delivered=delivered
            )
        return self._last

    def _stamp(self, capture: Capture) -> int:
        """The capture time that is told, never below the clock's zero."""
        stamps = self._config.stamps
        error_ms = stamps.delay_ms
        if stamps.jitter_ms > 0.0:
            draw = np.random.default_rng((self._seed, _STAMP_STREAM, capture.frame_id)).standard_normal()
            error_ms += stamps.jitter_ms * min(max(draw, -_WORST_JITTER), _WORST_JITTER)
        return max(capture.capture_ns + round(1e6 * error_ms), 0)

    def _is_lost(self, frame_id: int, share: float) -> bool:
        """Whether this frame is among the ``share`` that never arrives."""
        return bool(np.random.default_rng((self._seed, _DROP_STREAM, frame_id)).random() < share)


def _latest(faults: Sequence[AnyFault], kind: type[FaultT]) -> FaultT | None:
    return next((fault for fault in reversed(faults) if isinstance(fault, kind)), None)
