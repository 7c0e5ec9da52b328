"""How far a trajectory is from the truth: ATE, RPE, scale and drift, as the TUM and KITTI benchmarks define
them.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from foundation.foreign_text import read_text
from protocol.errors import ConfigurationError
from testbed.reporting.console import out
from vision_pc.core import se3
from vision_pc.core.se3 import Array
from vision_pc.core.types import OdometryPose
from vision_pc.shell.cameras.capture_times import unix_seconds

_FEWEST = 3
_PIECES = 10  # drift is over pieces of 10 m, or of a tenth of a shorter way
_PIECE_M = 10.0
_LEAST_WAY_M = 0.05


class TrajectoryErrors(NamedTuple):
    """ATE: rms distance after the best rigid alignment. RPE: rms error of the motion from pose to pose.
    ``scale``: estimated over true, of the best similarity. Drift: mean error of pieces over their length.
    """

    poses: int
    length_m: float
    ate_mm: float
    rpe_mm: float
    rpe_deg: float
    scale: float
    drift_percent: float | None


def read_tum(path: Path) -> tuple[Array, Array]:
    """Times (n,) s, rising, and poses (n, 4, 4) of a TUM file, Unix times of any unit. Raises
    ConfigurationError.
    """
    try:
        rows = np.loadtxt(read_text(path).splitlines(), ndmin=2)
    except OSError as error:
        raise ConfigurationError("configuration.unreadable", f"{path}: {error.strerror}") from error
    except ValueError as error:
        raise ConfigurationError("configuration.bad_trajectory", f"{path}: {error}") from error
    if rows.shape[1] != 8 or not np.isfinite(rows).all() or (np.linalg.norm(rows[:, 4:], axis=1) < 0.5).any():
        raise ConfigurationError(
            "configuration.bad_trajectory",
            f"{path}: lines of t x y z qx qy qz qw are wanted, {rows.shape[1]} columns were found",
        )
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3, 3] = rows[:, 1:4]
    poses[:, :3, :3] = Rotation.from_quat(rows[:, 4:]).as_matrix()
    times_s, unit = unix_seconds(rows[:, 0])
    if unit != "seconds":
        out.print(f"{path}: its times are taken for {unit}", highlight=False, soft_wrap=True)
    return times_s, poses


def trajectory_errors(
    found: Sequence[OdometryPose], times_s: Array, true: Array, name: str
) -> TrajectoryErrors:
    """The errors of ``found`` against the ``true`` poses nearest in time, to half a picture's period.

    ``true`` are of the same left camera, in any world. Raises ConfigurationError where fewer than three fit.
    """
    mine_s = np.array([pose.capture_ns / 1e9 for pose in found])
    nearest = np.abs(mine_s[:, None] - times_s[None]).argmin(axis=1)
    apart = np.abs(mine_s - times_s[nearest])
    period = float(np.median(np.diff(mine_s))) if len(found) > 1 else 0.0
    chosen = [k for k, gap in enumerate(apart) if gap <= 0.5 * period]
    if len(chosen) < _FEWEST:
        raise ConfigurationError(
            "configuration.bad_trajectory",
            f"{name}: {len(chosen)} poses within half a period of a pair ({_FEWEST} are wanted): the clocks"
            " do not overlap",
        )
    estimates = np.stack([found[k].X_C0C for k in chosen])
    return _errors(estimates, true[nearest[chosen]])


def errors_of_maps(
    maps: Mapping[int, Sequence[OdometryPose]], times_s: Array, true: Array, name: str
) -> dict[int, TrajectoryErrors | None]:
    """``trajectory_errors`` of each map; None for one of which fewer than three poses fit.

    Raises ConfigurationError where that is so of every map.
    """
    found: dict[int, TrajectoryErrors | None] = {}
    why: ConfigurationError | None = None
    for number, poses in maps.items():
        try:
            found[number] = trajectory_errors(poses, times_s, true, name)
        except ConfigurationError as error:
            found[number], why = None, why or error
    if why is not None and not any(found.values()):
        raise why
    return found


def _errors(estimates: Array, true: Array) -> TrajectoryErrors:
    places, truth = estimates[:, :3, 3], true[:, :3, 3]
    R, t, scale = _align(places, truth)
    ate = np.linalg.norm(places @ R.T + t - truth, axis=1)
    steps = [_relative(estimates, true, i, i + 1) for i in range(len(true) - 1)]
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(truth, axis=0), axis=1))])
    return TrajectoryErrors(
        len(true),
        float(travelled[-1]),
        1e3 * float(np.sqrt(np.mean(ate**2))),
        1e3 * float(np.sqrt(np.mean([np.sum(step[:3] ** 2) for step in steps]))),
        float(np.degrees(np.sqrt(np.mean([np.sum(step[3:] ** 2) for step in steps])))),
        scale,
        _drift(estimates, true, travelled),
    )


def _relative(estimates: Array, true: Array, i: int, j: int) -> Array:
    """The error (6,) of the motion from pose i to pose j."""
    found = se3.inverse(estimates[i]) @ estimates[j]
    return se3.local(se3.inverse(true[i]) @ true[j], found)


def _drift(estimates: Array, true: Array, travelled: Array) -> float | None:
    """Percent of the way; None for a camera that hardly moved."""
    if travelled[-1] < _LEAST_WAY_M:
        return None
    piece = min(_PIECE_M, float(travelled[-1]) / _PIECES)
    shares = []
    for i in range(len(true)):
        j = int(np.searchsorted(travelled, travelled[i] + piece))
        if j < len(true):
            shares.append(
                np.linalg.norm(_relative(estimates, true, i, j)[:3]) / (travelled[j] - travelled[i])
            )
    return 100.0 * float(np.mean(shares))


def _align(places: Array, truth: Array) -> tuple[Array, Array, float]:
    """R, t of the best rigid alignment of ``places`` (n, 3) to ``truth``, and the scale of the best
    similarity, places over wanted (Umeyama 1991).
    """
    a, b = places - places.mean(axis=0), truth - truth.mean(axis=0)
    U, singular, Vt = np.linalg.svd(b.T @ a)
    sign = np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt)) or 1.0])
    R = U @ sign @ Vt
    stretch = float((singular * np.diag(sign)).sum())
    scale = float((a**2).sum()) / stretch if stretch > 0.0 else float("nan")
    return R, truth.mean(axis=0) - R @ places.mean(axis=0), scale
