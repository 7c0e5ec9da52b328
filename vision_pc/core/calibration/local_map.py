"""Best mode, part one: a local affine map from what the camera measures to what the arm must be told.

Three legs along the tool's own axes, ending where the look will be, show how the arm's rigid model
stretches and shears space nearby (bending, encoder offsets) and how much the slew's play shifts it. A
rotation alone, as in trajectory matching, cannot know either. Source: the local-calibration study,
"formulas (affine map with play)".
"""

import math
from typing import NamedTuple

import numpy as np

from protocol.errors import MeasurementFailed
from vision_pc.core.calibration.local_calibration import AT_REST, rotation_information, settled_pose
from vision_pc.core.calibration.settings import LocalMapSettings
from vision_pc.core.ports import Arm, Eyes, Report
from vision_pc.core.se3 import Array, inverse, nearest_rotation, transform
from vision_pc.core.types import WatchSample

_OFFSET_STD_M = 1.0  # of the map's constant: free


class LocalTrack(NamedTuple):
    """Camera and tool poses along a path: ``X_KC`` and ``X_BT``, each (N, 4, 4), in time order.

    K is the camera frame where the path ended, which is where the arm stands now.
    """

    X_KC: Array
    X_BT: Array

    @property
    def X_BT_now(self) -> Array:
        """The tool's pose at the path's end."""
        X: Array = self.X_BT[-1]
        return X


class LocalMap(NamedTuple):
    """y = (I + E) x + v (h − h_n) + c about the present pose n; y: marker steps, x: nominal TCP steps.

    ``R`` (3×3) turns the axes of K into B; ``coefficients`` (5, 3) are the rows of [Eᵀ; vᵀ; cᵀ],
    ``covariance`` (5×5) that of each column; ``residual_m`` the rms misfit, ``condition`` that of the
    track's spread.
    """

    R: Array
    coefficients: Array
    covariance: Array
    residual_m: float
    condition: float
    play_now: float


async def record_local_track(arm: Arm, eyes: Eyes, report: Report, settings: LocalMapSettings) -> LocalTrack:
    """The track of three legs along n, s and a, behind the present pose and back to it.

    Raises MeasurementFailed for lost odometry or too few samples; errors of arm and eyes pass through.
    """
    X_BT = (await arm.view()).X_BT
    report(0.05, f"three legs of {settings.leg_m:g} m")
    track = await watched_path(arm, eyes, three_legs(X_BT, settings.leg_m), settings)
    refuse_poor_track(track, settings)
    report(1.0, f"{len(track.X_BT)} samples")
    return track


def three_legs(X_BT: Array, leg_m: float) -> list[Array]:
    """Four waypoints: back along all axes at once, which reverses the slew, then n, s, a to ``X_BT``."""
    n, s, a = (leg_m * X_BT[:3, axis] for axis in range(3))
    p = X_BT[:3, 3]
    return [transform(X_BT[:3, :3], corner) for corner in (p - n - s - a, p - s - a, p - a, p)]


async def watched_path(
    arm: Arm, eyes: Eyes, waypoints: list[Array], settings: LocalMapSettings
) -> LocalTrack:
    """The track of one path through ``waypoints``, in the camera frame of its end."""
    async with eyes.watch(markers=False, odometry=True) as watch:
        await arm.follow(waypoints, segment_s=settings.segment_s, dwell_s=settings.dwell_s)
    return track_of(watch.samples)


def track_of(samples: tuple[WatchSample, ...]) -> LocalTrack:
    """The track of a watch. Raises MeasurementFailed when odometry was lost at its end or over a fifth."""
    held = [s for s in samples if s.X_C0C is not None]
    if len(held) < 0.8 * len(samples) or len(held) < AT_REST or samples[-1].X_C0C is None:
        raise MeasurementFailed(
            "measurement.odometry_lost", f"local map: odometry held in {len(held)} of {len(samples)} pictures"
        )
    X_C0C = np.array([s.X_C0C for s in held])
    X_BT = np.array([s.X_BT for s in held])
    X_KC0 = inverse(settled_pose(X_C0C[-AT_REST:]))
    X_KC = X_KC0 @ X_C0C
    X_KC[-1] = np.eye(4)
    return LocalTrack(X_KC, X_BT)


def extended(track: LocalTrack, further: LocalTrack) -> LocalTrack:
    """``track`` followed by ``further``, which began where it ended; all in the new end's camera frame."""
    X_KnewK = further.X_KC[0]
    return LocalTrack(
        np.concatenate([X_KnewK @ track.X_KC, further.X_KC]), np.concatenate([track.X_BT, further.X_BT])
    )


def refuse_poor_track(track: LocalTrack, settings: LocalMapSettings) -> None:
    """Raises MeasurementFailed (``measurement.too_few_samples``, ``.ill_conditioned``)."""
    if len(track.X_BT) < settings.minimum_samples:
        raise MeasurementFailed(
            "measurement.too_few_samples",
            f"local map: {len(track.X_BT)} samples, at least {settings.minimum_samples} are wanted",
        )
    spread = np.linalg.svd(track.X_BT[:, :3, 3] - track.X_BT[:, :3, 3].mean(axis=0), compute_uv=False)
    if spread[2] < 0.1 * spread[0]:
        raise MeasurementFailed(
            "measurement.ill_conditioned",
            f"local map: the path is flat, spread ratio {spread[2] / spread[0]:.3f}, at least 0.1 is wanted",
        )


def fit_map(track: LocalTrack, p_CM: Array, settings: LocalMapSettings) -> LocalMap:
    """The map about the track's end, from the tool marker's position ``p_CM`` (3,) in the camera.

    Raises MeasurementFailed (``measurement.match_poor``) when the misfit exceeds its limit.
    """
    m = track.X_KC[:, :3, 3] + track.X_KC[:, :3, :3] @ p_CM  # 1: marker points, the lever arm is gone
    p = track.X_BT[:, :3, 3]
    R = _kabsch(m, p)  # 2
    h = play_states(slew_angles(track.X_BT, settings.wrist_to_tool_m), settings.play_rad)  # 3
    x, y = p - p[-1], (m - m[-1]) @ R.T  # 4
    rows = np.column_stack([x, h - h[-1], np.ones(len(x))])
    prior = np.array([settings.strain_std] * 3 + [settings.play_std_m, _OFFSET_STD_M])
    weights = np.ones(len(x))
    coefficients: Array = np.zeros((5, 3))
    covariance: Array = np.zeros((5, 5))
    misfit = np.zeros(len(x))
    for _ in range(5):  # reweighted: a glitch of odometry must not bend the map
        weighted = rows * weights[:, None]
        covariance = np.linalg.inv(weighted.T @ rows / settings.noise_std_m**2 + np.diag(prior**-2.0))
        coefficients = covariance @ (weighted.T @ (y - x)) / settings.noise_std_m**2
        misfit = np.linalg.norm(y - x - rows @ coefficients, axis=1)
        weights = 1.0 / np.maximum(1.0, misfit / (3.0 * settings.noise_std_m))
    residual = float(np.sqrt((weights * misfit**2).mean()))
    if residual > settings.residual_limit_m:
        raise MeasurementFailed(
            "measurement.match_poor",
            f"local map: misfit {residual:.4f} m, limit {settings.residual_limit_m:g} m",
        )
    information = np.linalg.eigvalsh(rotation_information(p, np.ones(len(p))))
    return LocalMap(
        R, coefficients, covariance, residual, float(information[-1] / information[0]), float(h[-1])
    )


def solve_step(fitted: LocalMap, d: Array, X_BT: Array, settings: LocalMapSettings) -> tuple[Array, float]:
    """(x (3,): the nominal step in B that moves the marker by ``d`` (3,) in K, its std (m) per axis)."""
    E, v = fitted.coefficients[:3].T, fitted.coefficients[3]
    wanted = fitted.R @ d
    slew_now = float(slew_angles(X_BT[None], settings.wrist_to_tool_m)[0])
    x, play = wanted, fitted.play_now
    for _ in range(20):  # 5
        goal = transform(X_BT[:3, :3], X_BT[:3, 3] + x)
        slew = float(slew_angles(goal[None], settings.wrist_to_tool_m)[0])
        play = _play_after(fitted.play_now, slew - slew_now, settings.play_rad)
        x = wanted - E @ x - v * (play - fitted.play_now)
    row = np.array([*x, play - fitted.play_now, 0.0])
    return x, math.sqrt(float(row @ fitted.covariance @ row))


def camera_in_tool(track: LocalTrack, p_CM: Array) -> Array:
    """R_TC (3×3): camera axes in the tool's, from the track and the tool marker's ``p_CM`` (3,)."""
    m = track.X_KC[:, :3, 3] + track.X_KC[:, :3, :3] @ p_CM
    R: Array = track.X_BT_now[:3, :3].T @ _kabsch(m, track.X_BT[:, :3, 3])
    return R


def slew_angles(X_BT: Array, wrist_to_tool_m: float) -> Array:
    """Slew angles (N,) rad of poses (N, 4, 4): the wrist's centre lies on the slew plane."""
    wrist = X_BT[:, :3, 3] - wrist_to_tool_m * X_BT[:, :3, 2]
    return np.asarray(np.unwrap(np.arctan2(wrist[:, 1], wrist[:, 0])))


def play_states(slew: Array, half_play: float) -> Array:
    """h (N,) in −1…1: on which flank of the play the slew's load side lies."""
    states = np.zeros(len(slew))
    for i in range(1, len(slew)):
        states[i] = _play_after(float(states[i - 1]), float(slew[i] - slew[i - 1]), half_play)
    return states


def _play_after(state: float, turn: float, half_play: float) -> float:
    return min(max(state - turn / half_play, -1.0), 1.0)


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
