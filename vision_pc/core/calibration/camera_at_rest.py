"""Pictures of a camera at rest, at both ends of a watched drive: several, whose odometry agrees.

A boom that rocks takes the camera along by a millimetre, which no encoder sees. One picture of it would be
off in the whole drive that begins with it, and in all that follow; a mean over the rocking is not.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from protocol.errors import MeasurementFailed
from vision_pc.config.programs import AtRestSettings
from vision_pc.core.calibration.local_calibration import settled_pose
from vision_pc.core.ports import Watch
from vision_pc.core.se3 import Array, local, retract
from vision_pc.core.types import WatchSample

_LEVER_M = 1.0  # from the camera to what it looks at: there its turns count
_SILENT_S = 1.0  # without a picture: whoever ends the watch tells why


class AtRest(NamedTuple):
    """Which of the pictures that odometry holds were taken at rest, and how far (m) their halves disagree."""

    pictures: slice
    apart_m: float


def tracked(samples: Sequence[WatchSample]) -> Array:
    """The camera's poses (N, 4, 4) in C0 where odometry held."""
    return np.array([s.X_C0C for s in samples if s.X_C0C is not None]).reshape(-1, 4, 4)


async def at_rest(watch: Watch, settings: AtRestSettings, before: int = 0) -> AtRest:
    """The newest pictures once their odometry agrees, or after the patience; none of the first ``before``."""
    began_ns = watch.samples[before].time_ns if len(watch.samples) > before else None
    while True:
        samples = watch.samples
        newest = tracked(samples[before:])[-settings.pictures :]
        count = len(tracked(samples))
        found = AtRest(slice(count - len(newest), count), halves_apart_m(newest))
        enough = len(newest) >= settings.pictures
        if settings.pictures == 1 or (enough and found.apart_m < settings.agree_m):
            return found
        if began_ns is None and len(samples) > before:
            began_ns = samples[before].time_ns
        waited_s = 0.0 if began_ns is None else 1e-9 * (samples[-1].time_ns - began_ns)
        if waited_s > settings.patience_s or await watch.after(len(samples), _SILENT_S) is None:
            return found


def begun_at(X: Array, found: AtRest, agree_m: float) -> Array:
    """Where the camera (4, 4) was when its watch began, of which ``X`` (N, 4, 4) are the poses.

    The mean of the pictures ``found`` at rest. Where it has moved by more than ``agree_m`` until then, as
    while a boom sinks through the play before its encoder, the first pictures and their trend say it: the
    goal of the drive was set there. Raises MeasurementFailed (``measurement.odometry_lost``) for none.
    """
    if not len(X):
        raise MeasurementFailed(
            "measurement.odometry_lost", "odometry: no pose of the camera at rest, before anything moved"
        )
    resting = found.pictures
    first, settled = X[: resting.stop - resting.start], settled_pose(X[resting])
    if len(first) < 2 or _metres(local(settled_pose(first), settled)) <= agree_m:
        return X[0] if len(first) < 2 else settled
    half = len(first) // 2
    early, late = settled_pose(first[:half]), settled_pose(first[half:])
    return retract(early, -0.5 * (1.0 - 1.0 / half) * local(early, late))


def halves_apart_m(X: Array) -> float:
    """How far (m) the mean poses of both halves of ``X`` (N, 4, 4) are apart, seen a metre away."""
    if len(X) < 2:
        return 0.0
    half = len(X) // 2
    return _metres(local(settled_pose(X[:half]), settled_pose(X[half:])))


def _metres(moved: Array) -> float:
    """How far a motion (6,) takes what the camera looks at."""
    return float(np.hypot(np.linalg.norm(moved[:3]), _LEVER_M * np.linalg.norm(moved[3:])))
