"""Camera poses of somebody else's SLAM in place of our odometry, judged before they are used.

It says where the camera is in a world of its own; what is used is the motion since the first pair. A gap or
silence costs the pairs in it. A jump, another clock or another scale ends the watch by name: what came before
is not in the same world, or not in metres.
"""

from bisect import bisect_left
from itertools import pairwise
from typing import NamedTuple, Protocol

import numpy as np

from protocol.errors import MeasurementFailed
from vision_pc.config.vision import PoseFeedSettings
from vision_pc.core import se3
from vision_pc.core.se3 import Array
from vision_pc.core.types import OdometryPose, StereoPair

_GAP_MS = 250.0  # [D] between two poses that may be interpolated
_TURN_RAD_S = 1.5  # [D] between two poses: a jump is faster
_STRAIGHT_RAD = 0.06  # [D] turned less than this, camera and tool go the same way to a few per cent
_FAR_M = 0.15  # [D] of a way by which a scale is judged: encoders alone bend by centimetres in metres
_FOREIGN_CLOCK_S = 5.0  # [D] from a pose's time to its arrival; another clock is hours away


class TimedPose(NamedTuple):
    """The camera's pose (4, 4) in the feed's own world at ``time_ns`` on this machine's clock."""

    time_ns: int
    X_WC: Array
    arrived_ns: int


class PoseFeed(Protocol):
    """Where a foreign SLAM's poses come in."""

    def poses_to(self, time_ns: int) -> tuple[TimedPose, ...]:
        """What is known of times up to ``time_ns`` and just after, rising; waits a little where it is not
        there yet.
        """
        ...


class ForeignOdometry:
    """Implements ``vision_pc.core.perception.watch.Odometry`` over a feed; C0 is the camera of the first
    pair that has a pose.
    """

    def __init__(self, feed: PoseFeed, settings: PoseFeedSettings) -> None:
        self._feed, self._settings = feed, settings
        self._first: tuple[Array, Array | None] | None = None  # X_WC and X_BT of the first pair
        self._checked_ns = 0
        self.last_loss: str | None = None

    def process(
        self, pair: StereoPair, X_CM: Array | None = None, X_BT: Array | None = None
    ) -> OdometryPose | None:
        """The camera's pose at ``pair``, or None where the feed has none; then ``last_loss`` says why:
        ``feed_silent``, ``feed_gap``.

        Raises MeasurementFailed: ``measurement.odometry_jump``, ``measurement.odometry_clock``,
        ``measurement.odometry_scale``.
        """
        poses = self._feed.poses_to(pair.capture_ns)
        self._refuse_jumps(poses)
        found = self._at(poses, pair.capture_ns)
        if isinstance(found, str):
            self.last_loss = found
            return None
        if self._first is None:
            self._first = found, X_BT
        X_C0C = se3.inverse(self._first[0]) @ found
        self._refuse_scale(X_C0C, X_BT)
        self.last_loss = None
        settings = self._settings
        std = np.repeat([1e-3 * settings.std_mm, 1e-3 * settings.std_mrad], 3)
        return OdometryPose(pair.capture_ns, pair.frame_id, X_C0C, np.diag(std**2), 0, 0.0, 0.0)

    def _at(self, poses: tuple[TimedPose, ...], time_ns: int) -> Array | str:
        after = bisect_left(poses, time_ns, key=lambda pose: pose.time_ns)
        if after < len(poses) and poses[after].time_ns == time_ns:
            return poses[after].X_WC
        if after == len(poses):
            return "feed_silent"
        gap_ns = poses[after].time_ns - poses[after - 1].time_ns if after else np.inf
        if gap_ns > 1e6 * _GAP_MS:
            return "feed_gap"
        fraction = (time_ns - poses[after - 1].time_ns) / gap_ns
        return se3.interpolate(poses[after - 1].X_WC, poses[after].X_WC, float(fraction))

    def _refuse_jumps(self, poses: tuple[TimedPose, ...]) -> None:
        """Of the poses since the last call; before the first pair only the newest counts, and no jump."""
        settings = self._settings
        for before, after in pairwise(poses if self._first is not None else poses[-2:]):
            if after.time_ns <= self._checked_ns:
                continue
            late_s = 1e-9 * (after.arrived_ns - after.time_ns)
            if not -0.05 <= late_s <= _FOREIGN_CLOCK_S:
                why = f"a pose came {late_s:.3f} s after its time: its times are not those of the pictures"
                raise _refusal("clock", why)
            seconds = max(1e-9 * (after.time_ns - before.time_ns), 1e-3)
            moved = se3.local(before.X_WC, after.X_WC)
            speed, turn = (float(np.linalg.norm(part)) / seconds for part in (moved[:3], moved[3:]))
            if self._first is not None and (speed > settings.speed_m_s or turn > _TURN_RAD_S):
                why = f"{speed:.2f} m/s, {turn:.2f} rad/s between two poses"
                most = f"{settings.speed_m_s:g} and {_TURN_RAD_S:g} at most"
                raise _refusal("jump", f"{why}, {most}: it was lost, or began another map")
        self._checked_ns = max(self._checked_ns, poses[-1].time_ns) if poses else self._checked_ns

    def _refuse_scale(self, X_C0C: Array, X_BT: Array | None) -> None:
        if self._first is None or self._first[1] is None or X_BT is None:
            return
        by_arm = se3.local(self._first[1], X_BT)
        way_m = float(np.linalg.norm(by_arm[:3]))
        if way_m < _FAR_M or np.linalg.norm(by_arm[3:]) > _STRAIGHT_RAD:
            return
        scale, most = float(np.linalg.norm(X_C0C[:3, 3])) / way_m, self._settings.scale_error
        if abs(scale - 1.0) > most:
            why = f"{scale:.2f} times the arm's {1e3 * way_m:.0f} mm, {1 - most:g} to {1 + most:g} may be"
            raise _refusal("scale", f"{why}: it is not in metres, or not of this camera")


def _refusal(what: str, why: str) -> MeasurementFailed:
    return MeasurementFailed(f"measurement.odometry_{what}", f"odometry's feed: {why}")
