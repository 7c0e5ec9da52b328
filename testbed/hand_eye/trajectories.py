"""Pose pairs from two recordings in time: hand and camera trajectories in TUM form.

A recording has hundreds of nearly equal poses, most of them taken in motion, where a few milliseconds between
the clocks are worth a tenth of a degree. So the slowest moments are taken first, and each must differ from
those already taken.
"""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from protocol.errors import RequestRefused
from testbed.hand_eye.importer import ImportOptions
from testbed.hand_eye.pose_text import (
    W_FIRST,
    W_LAST,
    PoseLine,
    heading,
    numbers,
    pose_lines,
    rotation_of_quaternion,
    unit_scale,
)
from testbed.reporting.console import out
from vision_pc.config.choices import Setup
from vision_pc.core import se3_stacks as stacks
from vision_pc.core.hand_eye.samples import PosePairs, check_pose, distinct, pose_pairs
from vision_pc.core.se3 import Array
from vision_pc.shell.cameras.capture_times import unix_seconds

_COPIES = 4  # [D] lines of one time, on average, that are believed
_SAME_S = 1e-5  # two stamps of one moment, whatever the clock counts from: a double's step is 2e-7 s in 2026
_EUROC = 17  # time, position, quaternion w first, velocity and the inertial unit's offsets
_KITTI = 12  # a pose's upper three rows, without a time
_RECORDING_HZ = 2.0  # a faster one is a recording in motion, a slower one a list of poses


class Trajectory(NamedTuple):
    """``time_s`` (n,) strictly increasing and ``X`` (n, 4, 4)."""

    time_s: Array
    X: Array


# At least so far apart are the moments that are chosen, and at most so many.
_SPACING_DEG, _SPACING_M, _MOST = 5.0, 0.05, 60
# Stretch of the hand's recording over which its pose is interpolated, s; [D] of the median time between new
# poses, and s: a hand that keeps one for longer rests.
_LONGEST_S, _HELD, _REST_S = 0.1, 1.5, 0.5


def load_tum(path: Path, normalise: bool = False, times_s: Array | None = None) -> Trajectory:
    """A trajectory file: lines ``t x y z qx qy qz qw`` (s or a Unix time of any unit, m) as ``pose_lines``
    has them; a heading gives the columns' order and unit, as do EuRoC's 17 columns of ground truth.

    Or KITTI's 12 columns, a line for each of ``times_s``. Lines are put in order of time, and of lines with
    the same time the first is kept. Raises RequestRefused naming the line.
    """
    times, poses = [], []
    columns, length = heading(path)
    lines = pose_lines(path)
    if lines and len(lines[0].words) == _KITTI:
        return _of_kitti(path, lines, times_s)
    for line in lines:
        euroc = len(line.words) == _EUROC
        values = numbers(line.words[:8] if euroc else line.words, 8, line.where)
        times.append(values[0])
        pose = values[1:][columns or (W_FIRST if euroc else W_LAST)]
        R = rotation_of_quaternion(pose[3:], line.where, normalise)
        poses.append(stacks.transform(R, unit_scale(length or "m") * pose[:3]))
    if len(times) < 3:
        raise RequestRefused(
            "refused.hand_eye.count", f"{path.name}: {len(times)} poses, at least 3 are needed"
        )
    found_s, unit = unix_seconds(np.array(times))
    if unit != "seconds":
        out.print(f"{path.name}: its times are taken for {unit}", highlight=False, soft_wrap=True)
    time_s, first = np.unique(found_s, return_index=True)
    if len(time_s) * _COPIES < len(times):
        why = f"{path.name}: {len(times)} lines have {len(time_s)} different times: have they lost digits?"
        raise RequestRefused("refused.hand_eye.clocks", why)
    return Trajectory(time_s, np.stack(poses)[first])


def _of_kitti(path: Path, lines: list[PoseLine], times_s: Array | None) -> Trajectory:
    """The poses of KITTI's odometry benchmark, one for each picture and without a time. Raises
    RequestRefused.
    """
    if times_s is None or len(times_s) != len(lines):
        many = "no pictures" if times_s is None else f"{len(times_s)} pairs"
        why = f"{path.name}: {len(lines)} poses of 12 columns, as KITTI's, beside {many}: as many"
        raise RequestRefused("refused.hand_eye.count", f"{why} are wanted, or TUM's t x y z qx qy qz qw")
    X = np.tile(np.eye(4), (len(lines), 1, 1))
    X[:, :3] = [numbers(line.words, _KITTI, line.where).reshape(3, 4) for line in lines]
    for line, pose in zip(lines, X, strict=True):
        check_pose(pose, line.where, math.inf)
    return Trajectory(times_s, X)


def pair(
    hand: Trajectory,
    camera: Trajectory,
    offset_s: float | None = 0.0,
    options: ImportOptions | None = None,
) -> tuple[PosePairs, float]:
    """Samples at the camera's times, the hand interpolated, and the clock offset that was used (s).

    ``offset_s`` is added to the camera's clock; None estimates it from the turning speeds.

    Raises RequestRefused: ``refused.hand_eye.count`` when the recordings do not overlap.
    """
    hand, options = _fresh(hand), options or ImportOptions()
    offset = estimated_offset(hand, camera) if offset_s is None else offset_s
    times = camera.time_s + offset
    after = np.clip(np.searchsorted(hand.time_s, times), 1, len(hand.time_s) - 1)
    width = hand.time_s[after] - hand.time_s[after - 1]
    exact = np.minimum(np.abs(times - hand.time_s[after]), np.abs(times - hand.time_s[after - 1])) < _SAME_S
    usable = (
        (times >= hand.time_s[0]) & (times <= hand.time_s[-1]) & ((width <= _LONGEST_S + _SAME_S) | exact)
    )
    usable[1:] &= np.any(camera.X[1:] != camera.X[:-1], axis=(1, 2))  # else an old pose with a new stamp
    if usable.sum() < 3:
        raise RequestRefused(
            "refused.hand_eye.count",
            f"only {int(usable.sum())} camera poses have a hand pose within {_LONGEST_S:g} s; it is new every"
            f" {float(np.median(np.diff(hand.time_s))):.2g} s; check the clocks or give an offset",
        )
    X_BT = interpolated(hand, times[usable])
    X_CP = stacks.inverse(camera.X[usable]) if options.camera_in_target else camera.X[usable]
    chosen = _choose_moments(times[usable], X_BT, X_CP)
    setup, times = options.setup or Setup.EYE_IN_HAND, camera.time_s[usable][chosen]
    return pose_pairs(X_BT[chosen], X_CP[chosen], setup, tuple(f"t={t:.3f}" for t in times)), offset


def _fresh(hand: Trajectory) -> Trajectory:
    """``hand`` without the poses of a robot that tells new ones more slowly than they were recorded: between
    them it was elsewhere. Where it rests, poses stay.
    """
    new = np.append(True, np.any(hand.X[1:] != hand.X[:-1], axis=(1, 2)))
    held_s = np.diff(hand.time_s[new], append=hand.time_s[-1])
    rests = held_s > min(_HELD * float(np.median(held_s)), _REST_S)
    return Trajectory(*(part[new | rests[np.cumsum(new) - 1]] for part in hand))


def interpolated(trajectory: Trajectory, times: Array) -> Array:
    """Poses (k, 4, 4) at ``times`` (k,) inside the trajectory, by straight lines and geodesics."""
    R = Slerp(trajectory.time_s, Rotation.from_matrix(trajectory.X[:, :3, :3]))(times).as_matrix()
    places = (np.interp(times, trajectory.time_s, trajectory.X[:, axis, 3]) for axis in range(3))
    return stacks.transform(R, np.column_stack(list(places)))


def _speeds(time_s: Array, X: Array, window_s: float = 0.15) -> tuple[Array, Array]:
    """Turning (rad/s) and moving (m/s) speed at each pose, over ``window_s`` to either side."""
    low = np.searchsorted(time_s, time_s - window_s)
    high = np.clip(np.searchsorted(time_s, time_s + window_s), 0, len(time_s) - 1)
    step = stacks.inverse(X[low]) @ X[high]
    duration = np.maximum(time_s[high] - time_s[low], 1e-6)
    return stacks.angle(step[:, :3, :3]) / duration, np.linalg.norm(step[:, :3, 3], axis=-1) / duration


def _choose_moments(times: Array, X_BT: Array, X_CP: Array) -> NDArray[np.intp]:
    """Indices of the moments to use, in order of time."""
    if 1.0 / float(np.median(np.diff(times))) < _RECORDING_HZ:
        return np.flatnonzero(distinct(X_BT, X_CP))
    spin_h, move_h = _speeds(times, X_BT)
    spin_c, move_c = _speeds(times, X_CP)
    restless = (spin_h + spin_c) / math.radians(_SPACING_DEG) + (move_h + move_c) / _SPACING_M
    taken: list[int] = []
    for k in np.argsort(restless, kind="stable"):
        others = X_BT[taken]
        turned = stacks.angle(np.swapaxes(others[:, :3, :3], -1, -2) @ X_BT[k, :3, :3])
        moved = np.linalg.norm(others[:, :3, 3] - X_BT[k, :3, 3], axis=-1)
        if ((turned > math.radians(_SPACING_DEG)) | (moved > _SPACING_M)).all():
            taken.append(int(k))
        if len(taken) == _MOST:
            break
    return np.array(sorted(taken))


def estimated_offset(hand: Trajectory, camera: Trajectory, longest_s: float = 2.0) -> float:
    """What to add to the camera's clock so that hand and camera turn together (s), whatever X is.

    The correlation of both turning speeds over offsets of 5 ms finds the neighbourhood. There the angles
    turned in 0.7 s, which must be equal, decide to a millisecond: their mean squared difference is a
    parabola in the offset.
    """
    spin_h = _speeds(hand.time_s, hand.X)[0]
    spin_c = _speeds(camera.time_s, camera.X)[0]
    offsets = np.arange(-longest_s, longest_s + 0.005, 0.005)
    scores = np.full(len(offsets), -1.0)
    for k, offset in enumerate(offsets):
        times = camera.time_s + offset
        inside = (times >= hand.time_s[0]) & (times <= hand.time_s[-1])
        if inside.sum() > 0.5 * len(times):
            here = np.interp(times[inside], hand.time_s, spin_h)
            if here.std() > 0.0 and spin_c[inside].std() > 0.0:
                scores[k] = np.corrcoef(here, spin_c[inside])[0, 1]
    best = int(np.argmax(scores))
    if scores[best] < 0.5:
        raise RequestRefused(
            "refused.hand_eye.clocks",
            f"hand and camera do not turn together (correlation {scores[best]:.2f})",
        )
    near = offsets[best] + np.linspace(-0.02, 0.02, 21)
    mismatch = np.array([_angle_mismatch(hand, camera, float(offset)) for offset in near])
    least = int(np.clip(np.argmin(mismatch), 3, len(near) - 4))
    fit = np.polyfit(near[least - 3 : least + 4], mismatch[least - 3 : least + 4], 2)
    return float(-0.5 * fit[1] / fit[0]) if fit[0] > 0.0 else float(near[least])


def _angle_mismatch(hand: Trajectory, camera: Trajectory, offset: float, lag_s: float = 0.7) -> float:
    """Mean squared difference (rad²) of the angles that hand and camera turned in ``lag_s``."""
    times = camera.time_s + offset
    inside = (times >= hand.time_s[0]) & (times <= hand.time_s[-1])
    lag = max(1, int(lag_s / float(np.median(np.diff(camera.time_s)))))
    turned = [
        stacks.angle(np.swapaxes(X[:-lag, :3, :3], -1, -2) @ X[lag:, :3, :3])
        for X in (interpolated(hand, times[inside]), camera.X[inside])
    ]
    return float(np.mean((turned[0] - turned[1]) ** 2))
