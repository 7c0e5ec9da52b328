"""How far a trajectory is from the truth: ATE, RPE, scale and drift, as the TUM and KITTI benchmarks define
them.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from protocol.errors import ConfigurationError
from vision_pc.core import se3
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.se3 import Array
from vision_pc.core.types import OdometryPose

_FEWEST = 3
_PIECES = 10  # drift is over pieces of 10 m, or of a tenth of a shorter way
_PIECE_M = 10.0
_LEAST_WAY_M = 0.05
_MISREAD = 5.0  # [D] times less error from pose to pose: no odometry does that, another reading does
_NEARER = 2.0  # [D] times, where turns fit so much better
_LEAST_TURN = 0.01  # rad a step: less is noise
_MOST_LATE = 10  # pairs by which the truth's clock may be off
_OFF_CLOCK = 2.0  # times less error of turns at another time: a camera's noise is the same at all times
_LEAST_DEG = 0.01  # of a turn: less is no camera's error


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

    def __str__(self) -> str:
        drift = "" if self.drift_percent is None else f", drift {self.drift_percent:.2f} %"
        return (
            f"{self.poses} poses over {self.length_m:.2f} m: ATE {self.ate_mm:.2f} mm,"
            f" RPE {self.rpe_mm:.2f} mm {self.rpe_deg:.4f} deg from pose to pose,"
            f" scale {self.scale:.4f}{drift}"
        )


def trajectory_errors(
    found: Sequence[OdometryPose], times_s: Array, true: Array, name: str
) -> TrajectoryErrors:
    """The errors of ``found`` against the ``true`` poses nearest in time, to half a picture's period.

    ``true`` are of the same left camera, in any world. Raises ConfigurationError where fewer than three fit,
    and for a truth that fits in another reading by far.
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
    estimates, truth = np.stack([found[k].X_C0C for k in chosen]), true[nearest[chosen]]
    errors = _errors(estimates, truth)
    readings = [(_errors(mine, otherwise), words) for words, mine, otherwise in _readings(estimates, truth)]
    fits, words = min(readings, key=lambda reading: float(reading[0].rpe_mm))
    turned = errors.rpe_deg > _MISREAD * fits.rpe_deg and errors.rpe_mm > _NEARER * fits.rpe_mm
    fitting = fits.rpe_mm < 500.0 * errors.length_m / (len(truth) - 1)  # half of a step
    if fitting and (turned or errors.rpe_mm > _MISREAD * fits.rpe_mm):
        comparison = f"RPE {errors.rpe_mm:.2f} mm as given, {fits.rpe_mm:.2f} mm if its {words}"
        raise ConfigurationError("configuration.bad_trajectory", f"{name}: {comparison}: write it so")
    if late := _late(estimates, truth):
        why = f"its turns fit where its times are {late * period:g} s less: it has another clock; shift them"
        raise ConfigurationError("configuration.bad_trajectory", f"{name}: {why}")
    return errors


def _late(found: Array, true: Array) -> int:
    """How many pairs too late the times of ``true`` are, by its turns; 0 where no others fit far better."""
    most = min(_MOST_LATE, len(true) // 4)
    mine, shifts = found[most : len(found) - most], range(-most, most + 1)
    off_deg = {k: _errors(mine, true[most + k : len(true) - most + k]).rpe_deg for k in shifts}
    best = min(shifts, key=lambda k: off_deg[k])
    return best if off_deg[0] > _OFF_CLOCK * max(off_deg[best], _LEAST_DEG) else 0


def _readings(found: Array, true: Array) -> Iterator[tuple[str, Array, Array]]:
    """What was found, and the truth as other programs write it: another order of the quaternion, poses
    inverted, lengths of another power of ten, other axes, a mirrored world.
    """
    R, p = true[:, :3, :3], true[:, :3, 3]
    q = stacks.quaternion_from_rotation(R)
    for words, step in (("quaternions are w first", -1), ("quaternions are w last", 1)):
        rolled = stacks.rotation_from_quaternion(np.roll(q, step, axis=-1))
        yield words, found, stacks.transform(rolled, p)
    yield "poses are of the world in the camera", found, stacks.inverse(true)
    yield "rotations are transposed", found, stacks.transform(np.swapaxes(R, -1, -2), p)
    moved, mine = np.diff(p, axis=0), stacks.inverse(found[:-1]) @ found[1:]
    longer = max(float(np.linalg.norm(moved)), 1e-9) / max(float(np.linalg.norm(mine[:, :3, 3])), 1e-9)
    power = round(math.log10(longer))
    words = f"lengths, or those of the baseline, are in another unit (times {10.0**-power:g})"
    yield words, stacks.transform(found[:, :3, :3], 10.0**power * found[:, :3, 3]), true
    for sign, words in ((1.0, ""), (-1.0, "axes are left-handed and its ")):
        mirror = np.diag([1.0, 1.0, sign, 1.0])
        X = mirror @ true @ mirror
        shown, axes = _axes(_turn_of(mine, stacks.inverse(X[:-1]) @ X[1:]))
        away = stacks.transform(X[:, :3, :3] @ axes.T, X[:, :3, 3])
        yield f"{words}rotations are of a camera with axes {shown}", found, away
    for mirrored in (False, True):
        turn = _nearest_turn(moved, np.einsum("kij,kj->ki", R[:-1], mine[:, :3, 3]), mirrored)
        shown, axes = _axes(turn.T)
        yield (
            f"positions are along {shown} of the axes of its rotations",
            found,
            stacks.transform(R, p @ axes),
        )


def _turn_of(mine: Array, other: Array) -> Array:
    """The rotation (3, 3) that takes the motions ``other`` (n, 4, 4) nearest to ``mine``."""
    turns = [Rotation.from_matrix(X[:, :3, :3]).as_rotvec() for X in (other, mine)]
    weight = np.linalg.norm(other[:, :3, 3]) / max(np.linalg.norm(turns[0]), _LEAST_TURN * len(mine) ** 0.5)
    steps = [np.concatenate([X[:, :3, 3], weight * of]) for X, of in zip((other, mine), turns, strict=True)]
    return _nearest_turn(steps[0], steps[1])


def _axes(turn: Array) -> tuple[str, Array]:
    """The signed axes that the columns of ``turn`` (3, 3) are next to, in words and as such a matrix."""
    at = np.abs(turn).argmax(axis=0)
    signs = np.sign(turn[at, range(3)])
    words = " ".join(f"{'-' if sign < 0.0 else ''}{'xyz'[k]}" for k, sign in zip(at, signs, strict=True))
    return words, np.eye(3)[:, at] * signs


def _nearest_turn(a: Array, b: Array, mirrored: bool = False) -> Array:
    """The rotation, or reflection, (3, 3) that takes ``a`` (n, 3) nearest to ``b`` (Umeyama 1991)."""
    U, _, Vt = np.linalg.svd(b.T @ a)
    hand = (np.sign(np.linalg.det(U @ Vt)) or 1.0) * (-1.0 if mirrored else 1.0)
    return np.asarray(U @ np.diag([1.0, 1.0, hand]) @ Vt)


def errors_of_maps(
    maps: Mapping[int, Sequence[OdometryPose]], times_s: Array, true: Array, name: str
) -> dict[int, TrajectoryErrors | None]:
    """``trajectory_errors`` of each map; None for one of which fewer than three poses fit.

    Raises ConfigurationError where that is so of every map.
    """
    found: dict[int, TrajectoryErrors | None] = dict.fromkeys(maps)
    refusals = []
    for number, poses in maps.items():
        try:
            found[number] = trajectory_errors(poses, times_s, true, name)
        except ConfigurationError as error:
            refusals.append(error)
    if len(refusals) == len(maps):
        raise refusals[0]
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
    ends = np.searchsorted(travelled, travelled + piece)
    shares = [
        np.linalg.norm(_relative(estimates, true, i, j)[:3]) / (travelled[j] - travelled[i])
        for i, j in enumerate(ends)
        if j < len(true)
    ]
    return 100.0 * float(np.mean(shares))


def _align(places: Array, truth: Array) -> tuple[Array, Array, float]:
    """R, t of the best rigid alignment of ``places`` (n, 3) to ``truth``, and the scale of the best
    similarity, places over wanted (Umeyama 1991).
    """
    a, b = places - places.mean(axis=0), truth - truth.mean(axis=0)
    R = _nearest_turn(a, b)
    stretch = float((b * (a @ R.T)).sum())
    scale = float((a**2).sum()) / stretch if stretch > 0.0 else float("nan")
    return R, truth.mean(axis=0) - R @ places.mean(axis=0), scale
