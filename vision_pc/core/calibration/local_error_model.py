"""Local error model: from what the camera measures to what the arm must be commanded, near the present pose.

Three legs along the tool's own axes, ending where the look will be, show how the rigid arm model turns,
stretches and bends space nearby, and how much backlash of the slew shifts it. A rotation alone, as in
trajectory matching, cannot know that. The model is linear in its unknowns: a rotation, a scale, the slew's
backlash, and a small strain for all the rest, each with a prior.
Source: docs/calibration.md, "Corrected positioning".
"""

from typing import NamedTuple

import numpy as np

from nominal_arm.dimensions import BoomDimensions
from protocol.errors import MeasurementFailed
from vision_pc.config.programs import LocalErrorModelSettings
from vision_pc.core.calibration.boom_levers import boom_levers, slew_angles, slew_lever
from vision_pc.core.calibration.local_calibration import settled_pose
from vision_pc.core.calibration.object_motion import refuse_moving_object
from vision_pc.core.calibration.take_up import backlash_sides, move_with_take_up
from vision_pc.core.perception.watch import AT_REST
from vision_pc.core.ports import Arm, Eyes, Report
from vision_pc.core.se3 import Array, hat, inverse, nearest_rotation, transform
from vision_pc.core.types import WatchSample

_OFFSET_STD_M = 1.0  # of the offset: free
_ROUNDS = 5  # of reweighting
_SCALE_STD = 0.003  # [S] odometry's
_REVERSAL_RAD = 1e-4  # [M] two counts of the encoder; the side at rest was so right in 13 of 13 runs
_FEWEST_SAMPLES = 20  # [D]
_RESIDUAL_M = 0.02  # [D] a larger misfit is refused
_TAKEN_UP = np.array([-1.0])  # the side of the backlash after a positive turn of the slew

# Columns of Φ, entries of θ.
_ROTATION = slice(0, 3)
_SCALE = 3
_STRAIN = slice(4, 13)
_OFFSET = slice(13, 16)
_BACKLASH = _OFFSET.stop
_COLUMNS = _BACKLASH + 1


class LocalTrack(NamedTuple):
    """Camera and tool poses along a path: ``X_KC`` and ``X_BT``, each (N, 4, 4), in time order.

    K is the camera frame where the path ended, which is where the arm stands now. ``speed`` (N,) m/s of the
    tool: a moving boom sways, which its encoders do not measure.
    ``joint_residuals`` (P, 3) rad: servo residual of slew, lift and tilt at the end of each path so far,
    positive beyond the reference. ``residuals`` (D, 3) m in B: how far from their goal motions ended, by
    odometry. ``residual_motion`` m: how far the tool went to and fro by its encoders where it should have
    rested. ``object_stands``: the object was seen to stand still along the path.
    """

    X_KC: Array
    X_BT: Array
    speed: Array
    joint_residuals: Array
    residuals: Array
    residual_motion: float = 0.0
    object_stands: bool = False

    @property
    def X_BT_now(self) -> Array:
        """The tool's pose at the path's end."""
        X: Array = self.X_BT[-1]
        return X


class LocalErrorModel(NamedTuple):
    """The fitted model R d = x + Φ(x) θ about the present pose ``X_BT``, for an arm of ``dimensions``.

    ``R`` (3, 3) rotates the axes of K into B; ``theta`` (n,), ``covariance`` (n, n). ``residual_m``: rms of
    the fit. Holds for steps that end as the track did, after a positive turn of the slew (backlash taken up).
    """

    R: Array
    X_BT: Array
    theta: Array
    covariance: Array
    residual_m: float
    dimensions: BoomDimensions

    @property
    def slew_play(self) -> float:
        """Half of the slew's play (rad), as the legs have shown it."""
        return abs(float(self.theta[_BACKLASH]))


async def record_local_track(
    arm: Arm, eyes: Eyes, report: Report, settings: LocalErrorModelSettings, dimensions: BoomDimensions
) -> LocalTrack:
    """Drive three legs along n, s and a from behind the present pose back to it; return their track.

    Raises MeasurementFailed for lost odometry, too few samples, and an object that moves meanwhile; errors of
    arm and eyes pass through.
    """
    X_BT = (await arm.view()).X_BT
    report(0.05, f"three legs of {settings.leg_m:g} m")
    waypoints = three_legs(X_BT, settings.leg_m)
    track = await watched_path(arm, eyes, waypoints, dimensions, settings, markers=True)
    refuse_poor_track(track)
    report(1.0, f"{len(track.X_BT)} samples")
    return track


def three_legs(X_BT: Array, leg_m: float) -> list[Array]:
    """Four waypoints: back along all axes at once, then n, s, a to ``X_BT``."""
    n, s, a = (leg_m * X_BT[:3, axis] for axis in range(3))
    p = X_BT[:3, 3]
    return [transform(X_BT[:3, :3], corner) for corner in (p - n - s - a, p - s - a, p - a, p)]


async def watched_path(
    arm: Arm,
    eyes: Eyes,
    waypoints: list[Array],
    dimensions: BoomDimensions,
    settings: LocalErrorModelSettings,
    markers: bool = False,
) -> LocalTrack:
    """Drive a path through ``waypoints``; return its track, in the camera frame of its end.

    ``markers``: seen on the way, they tell whether the object moves (MeasurementFailed ``target.moves``).
    """
    async with eyes.watch(markers=markers, odometry=True) as watch:
        end = await move_with_take_up(arm, waypoints, dimensions, settings)
    stands = markers and refuse_moving_object(watch.samples, 4.0 * settings.leg_m, settings)
    unrest = boom_levers(end.view.X_BT, dimensions) @ end.view.unrest[:3]
    return track_of(watch.samples)._replace(
        joint_residuals=end.residual[None],
        residual_motion=float(np.linalg.norm(unrest)),
        object_stands=stands,
    )


def track_of(samples: tuple[WatchSample, ...]) -> LocalTrack:
    """The track of a watch; it ends with the mean of the pictures at rest.

    Raises MeasurementFailed when odometry was lost at its end or over a fifth.
    """
    held = [s for s in samples if s.X_C0C is not None]
    if len(held) < 0.8 * len(samples) or len(held) < AT_REST or samples[-1].X_C0C is None:
        raise MeasurementFailed(
            "measurement.odometry_lost",
            f"local error model: odometry held in {len(held)} of {len(samples)} pictures",
        )
    X_C0C = np.array([s.X_C0C for s in held])
    X_BT = np.array([s.X_BT for s in held])
    X_KC0 = inverse(settled_pose(X_C0C[-AT_REST:]))
    X_KC = X_KC0 @ X_C0C
    X_KC[-1] = np.eye(4)
    time_s = 1e-9 * np.array([float(s.time_ns) for s in held])
    return LocalTrack(X_KC, X_BT, _speeds(X_BT[:, :3, 3], time_s), np.zeros((1, 3)), np.zeros((0, 3)))


def extended(track: LocalTrack, further: LocalTrack) -> LocalTrack:
    """``track`` followed by ``further``, which began where it ended; all in the new end's camera frame."""
    X_KnewK = further.X_KC[0]
    return LocalTrack(
        np.concatenate([X_KnewK @ track.X_KC, further.X_KC]),
        np.concatenate([track.X_BT, further.X_BT]),
        np.concatenate([track.speed, further.speed]),
        np.concatenate([track.joint_residuals, further.joint_residuals]),
        np.concatenate([track.residuals, further.residuals]),
        further.residual_motion,
    )


def refuse_poor_track(track: LocalTrack) -> None:
    """Raises MeasurementFailed (``measurement.too_few_samples``, ``.ill_conditioned``)."""
    if len(track.X_BT) < _FEWEST_SAMPLES:
        raise MeasurementFailed(
            "measurement.too_few_samples",
            f"local error model: {len(track.X_BT)} samples, at least {_FEWEST_SAMPLES} are wanted",
        )
    spread = np.linalg.svd(track.X_BT[:, :3, 3] - track.X_BT[:, :3, 3].mean(axis=0), compute_uv=False)
    if spread[2] < 0.1 * spread[0]:
        raise MeasurementFailed(
            "measurement.ill_conditioned",
            f"local error model: the path is flat, spread ratio {spread[2] / spread[0]:.3f}, wanted is 0.1",
        )


def fit_error_model(
    track: LocalTrack, p_CM: Array, dimensions: BoomDimensions, settings: LocalErrorModelSettings
) -> LocalErrorModel:
    """The model about the track's end, from the tool marker's position ``p_CM`` (3,) in the camera.

    Raises MeasurementFailed (``measurement.match_poor``) when the misfit exceeds its limit.
    """
    m = track.X_KC[:, :3, 3] + track.X_KC[:, :3, :3] @ p_CM  # marker points: the lever arm is gone
    p = track.X_BT[:, :3, 3]
    R = _kabsch(m, p)
    h = backlash_sides(slew_angles(track.X_BT, dimensions.wrist_to_tool), _REVERSAL_RAD)
    columns = _columns(track.X_BT, h, track.X_BT_now)
    Phi = columns.reshape(-1, columns.shape[2])
    target = ((m - m[-1]) @ R.T - (p - p[-1])).ravel()
    std = np.repeat(np.hypot(settings.noise_std_m, settings.sway_s * track.speed), 3)
    precision = np.diag(_prior(settings) ** -2.0)
    weights = np.ones(len(p))
    for _ in range(_ROUNDS):  # reweighted: a glitch of odometry must not bend the map
        weighted = Phi * (np.repeat(weights, 3) / std**2)[:, None]
        covariance = np.asarray(np.linalg.inv(weighted.T @ Phi + precision), dtype=np.float64)
        theta = covariance @ (weighted.T @ target)
        misfit = (target - Phi @ theta).reshape(-1, 3)
        weights = 1.0 / np.maximum(1.0, np.linalg.norm(misfit / std.reshape(-1, 3), axis=1) / 4.0)
    residual = float(np.sqrt((weights * (misfit**2).sum(axis=1)).mean()))
    if residual > _RESIDUAL_M:
        raise MeasurementFailed(
            "measurement.match_poor",
            f"local error model: misfit {residual:.4f} m, limit {_RESIDUAL_M:g} m",
        )
    return LocalErrorModel(R, track.X_BT_now, theta, covariance, residual, dimensions)


def solve_step(fitted: LocalErrorModel, d: Array) -> tuple[Array, Array]:
    """(x (3,): the nominal step in B that moves the marker by ``d`` (3,) in K, its covariance (3×3) in B)."""
    target = fitted.R @ d
    here = fitted.X_BT
    x, columns = target, np.zeros((3, len(fitted.theta)))
    for _ in range(20):
        goal = transform(here[:3, :3], here[:3, 3] + x)
        columns = _columns(goal[None], _TAKEN_UP, here)[0]
        columns[:, _OFFSET] = 0.0  # the offset is the error of the track's end alone
        x = target - columns @ fitted.theta
    return x, columns @ fitted.covariance @ columns.T


def _columns(X_BT: Array, play: Array, X_BT_now: Array) -> Array:
    """Φ (n, 3, K) at the poses (n, 4, 4); ``play`` (n,): the side of the backlash there, −1…1.

    At the present pose all columns are zero but the offset's.
    """
    n = len(X_BT)
    x = X_BT[:, :3, 3] - X_BT_now[:3, 3]
    Phi = np.zeros((n, 3, _COLUMNS))
    Phi[:, :, _ROTATION] = -np.array([hat(step) for step in x])
    Phi[:, :, _SCALE] = x
    Phi[:, :, _STRAIN] = np.einsum("ij,nk->nijk", np.eye(3), x).reshape(n, 3, 9)
    Phi[:, :, _OFFSET] = np.eye(3)
    levers = np.array([slew_lever(X) for X in X_BT])
    Phi[:, :, _BACKLASH] = levers * (play - _TAKEN_UP)[:, None]
    return Phi


def _prior(settings: LocalErrorModelSettings) -> Array:
    """Prior standard deviations (K,) of θ."""
    std = np.empty(_COLUMNS)
    std[_ROTATION], std[_SCALE], std[_STRAIN] = settings.rotation_std, _SCALE_STD, settings.strain_std
    std[_OFFSET], std[_BACKLASH] = _OFFSET_STD_M, settings.play_std
    return std


def _speeds(p: Array, time_s: Array) -> Array:
    """Speed (n,) m/s of points (n, 3): the larger of before and after."""
    between = np.linalg.norm(np.diff(p, axis=0), axis=1) / np.maximum(np.diff(time_s), 1e-6)
    speeds: Array = np.maximum(np.append(between, 0.0), np.insert(between, 0, 0.0))
    return speeds


def camera_in_tool(track: LocalTrack, p_CM: Array) -> Array:
    """R_TC (3×3): camera axes in the tool's, from the track and the tool marker's ``p_CM`` (3,)."""
    m = track.X_KC[:, :3, 3] + track.X_KC[:, :3, :3] @ p_CM
    R: Array = track.X_BT_now[:3, :3].T @ _kabsch(m, track.X_BT[:, :3, 3])
    return R


def _kabsch(m: Array, p: Array) -> Array:
    """R (3×3) that turns the points ``m`` into ``p``, in association, far points reweighted."""
    weights = np.ones(len(m))
    R = np.eye(3)
    for _ in range(5):
        m0, p0 = weights @ m / weights.sum(), weights @ p / weights.sum()
        R = nearest_rotation((p - p0).T @ ((m - m0) * weights[:, None]))
        misfit = np.linalg.norm(p - p0 - (m - m0) @ R.T, axis=1)
        scale = 3.0 * 1.4826 * float(np.median(misfit)) + 1e-9
        weights = 1.0 / np.maximum(1.0, misfit / scale) ** 2
    return R
