"""Whether the object stays where it is, while the arm learns the camera's axes."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from protocol.errors import MeasurementFailed
from vision_pc.config.programs import LocalErrorModelSettings
from vision_pc.core.se3 import Array
from vision_pc.core.types import WatchSample

_PICTURES = 8  # [D] at either end of the way, the arm at rest there
_SIGMAS = 4.0  # [D]
_LEAST_M = 1e-3  # [D] over a way of some 20 s: 0.05 mm/s, which ends inside the tolerance
_TO_SIGMA = 1.4826  # a normal's standard deviation over its median absolute deviation
_OF_MEDIAN = 1.2533  # [S] the standard deviation of a normal's median over that of its mean


class ObjectMotion(NamedTuple):
    """How far (3,), m, the object went in the axes of the first camera, its σ (3,), m, within ``time_s``."""

    shift: Array
    std: Array
    time_s: float

    @property
    def is_seen(self) -> bool:
        """Whether it is more than noise, and enough to matter."""
        far = float(np.linalg.norm(self.shift))
        return far > _LEAST_M and float(np.linalg.norm(self.shift / self.std)) > _SIGMAS


def object_motion(samples: Sequence[WatchSample], way_std_m: float) -> ObjectMotion | None:
    """The object against the world that odometry sees, from the first pictures to the last, the camera being
    back where it was; None where either saw too little. ``way_std_m``: how well odometry knows the way.
    """
    seen = [s for s in samples if s.X_C0C is not None and s.X_CO is not None]
    if len(seen) < 4 * _PICTURES:
        return None
    places = np.array([s.X_C0C[:3, :3] @ s.X_CO[:3, 3] + s.X_C0C[:3, 3] for s in seen])  # type: ignore[index]
    ends = places[:_PICTURES], places[-_PICTURES:]
    middles = [np.median(end, axis=0) for end in ends]
    off = np.concatenate([end - middle for end, middle in zip(ends, middles, strict=True)])
    spread = _OF_MEDIAN * _TO_SIGMA * np.median(np.abs(off), axis=0)
    variance = 2.0 * spread**2 / _PICTURES + way_std_m**2
    times_s = [1e-9 * s.time_ns for s in seen]
    time_s = float(np.mean(times_s[-_PICTURES:]) - np.mean(times_s[:_PICTURES]))
    return ObjectMotion(middles[1] - middles[0], np.sqrt(variance), time_s)


def refuse_moving_object(
    samples: Sequence[WatchSample], path_m: float, odometry: LocalErrorModelSettings
) -> bool:
    """Whether the object was seen to stand still; False where it was seen too seldom.

    Raises MeasurementFailed (``target.moves``) with the speed where the object moves while the camera goes
    along a path of ``path_m`` and back to where it was.
    """
    motion = object_motion(samples, 2.0 * odometry.odometry_std_m + odometry.odometry_scale_std * path_m)
    if motion is not None and motion.is_seen:
        far_mm = 1e3 * float(np.linalg.norm(motion.shift))
        raise MeasurementFailed(
            "target.moves",
            f"the object moves by {far_mm / motion.time_s:.2f} mm/s: {far_mm:.1f} mm in "
            f"{motion.time_s:.0f} s against what is around it, limit {1e3 * _LEAST_M:g} mm",
        )
    return motion is not None
