"""Play of a joint and the camera's delay, from odometry beside the joint's encoder; pure functions.

While the controller tries out a joint's valve, nothing but that joint moves. What odometry sees of the turn
then differs from the encoder's by the play, by the camera's delay and by how the boom swings:

    y(q) = c₀ + c₁ x + c₂ x² + c₃ x³ + c₁ (b s − τ v) + Σ dₖ qₖ + Σ eₖ tᵏ + swings,    x = q − q̄

with s = ±1 the sense of motion, v the encoder's speed, qₖ the encoders of the other joints, which creep
behind their closed valves, and a slow drift for what they creep within their own plays, where encoders show
nothing. Between s = −1 and s = +1 lie 2 b: b > 0 where the tool moves while the encoder stands (play on the
encoder's side), b < 0 where the encoder moves while the tool stands (loose steel behind it). Slow triangles
pass the same angles out and back at many speeds, which keeps b apart from τ. Swings: ``boom_swing``, or where
none is seen a lag with the acceleration; smoothed encoders and even stamps: ``joint_motion``.
"""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from protocol.errors import MeasurementFailed
from vision_pc.core.calibration.joint_motion import (
    JointMotion,
    JointSeen,
    Swing,
    Triangle,
    evenly,
    motion_at,
    rest_of,
    swing_columns,
    swings_in,
    triangles_in,
)
from vision_pc.core.se3 import Array

_LEAST_FREEDOM = 3.0  # degrees, as of which Student's spread is told
_OWN = 1e-8  # of 1 − an eigenvalue of H: a direction that one block alone tells leaves nothing


def block_spreads(columns: Array, target: Array, sums: Array, sizes: Sequence[int]) -> Array:
    """The standard deviations (p,) of ``sums`` (p, k) of the unknowns by which ``columns`` (m, k) make
    ``target`` (m,); ``sizes``: rows of each block, in order."""
    units = np.maximum(np.abs(columns).max(axis=0), 1e-12)
    basis, sizes_of, back = np.linalg.svd(columns / units, full_matrices=False)
    told = sizes_of > 1e-10 * sizes_of[0]
    basis, inverse = basis[:, told], (back[told].T / sizes_of[told]) @ basis[:, told].T
    left = target - basis @ (basis.T @ target)
    ends = np.cumsum([0, *sizes])
    weights = (sums / units) @ inverse
    blocks = [slice(first, end) for first, end in pairwise(ends)]
    spread = np.array([[w[b] @ _whitened(basis[b], left[b]) for b in blocks] for w in weights])
    freedom = np.array([_freedom(w, basis, blocks) for w in weights])
    return np.asarray(np.sqrt(np.sum(spread**2, axis=1) * freedom / (freedom - 2.0)))


def _whitened(basis: Array, values: Array) -> Array:
    """(I − B Bᵀ)^−½ ``values`` for the rows B of one block; what it alone tells is left out."""
    kept, rotation = np.linalg.eigh(np.eye(len(basis)) - basis @ basis.T)
    scale = np.where(kept > _OWN, np.maximum(kept, _OWN) ** -0.5, 0.0)
    return np.asarray(rotation @ (scale * (rotation.T @ values)))


def _freedom(weights: Array, basis: Array, blocks: Sequence[slice]) -> float:
    """Degrees of freedom of a spread if rows err alone: by its mean and its scatter (Satterthwaite)."""
    parts = np.zeros((len(blocks), len(weights)))
    for part, block in zip(parts, blocks, strict=True):
        part[block] = _whitened(basis[block], weights[block])
        part -= basis @ (basis.T @ part)
    shared = parts @ parts.T
    return max(float(np.trace(shared) ** 2 / np.sum(shared**2)), _LEAST_FREEDOM)


_LEAST_PAIRS = 2
_DRIFT = 3  # its order in time
# What all triangles share: the arc beyond its third order, swing, the map's points; and of the play.
_FLOOR_RAD, _FLOOR_SHARE = 1.5e-6, 0.002  # [M] one joint of each of 7600 to 7642 in lockstep
_DELAY_FLOOR_S = 1.5e-4  # [M] one joint of each of 7500 to 7528


class PlayFound(NamedTuple):
    """``half`` ± ``half_std`` (rad): half the play, positive on the encoder's side. ``delay`` ± ``delay_std``
    (s): how late captures are stamped. ``residual`` (rad): what the model leaves. ``triangles``: that
    odometry saw.
    """

    half: float
    half_std: float
    delay: float
    delay_std: float
    residual: float
    triangles: int


class _Fit(NamedTuple):
    """Half the play (rad), delay (s), the camera's ``turn`` over the joint's, what the fit leaves (rad)."""

    half: float
    delay: float
    turn: float
    residual: float


class _Sight(NamedTuple):
    """What is fitted: the camera's turn ``along`` (m, 3), as positions or rotation vectors, ``triangles``,
    and the ``swings`` that were found in them."""

    along: Array
    motion: JointMotion
    triangles: list[Triangle]
    swings: tuple[Swing, ...] = ()


def joint_play(seen: JointSeen) -> PlayFound:
    """The PlayFound of one joint, by what leaves the least: places or turns of the camera, stamps as told or
    evenly spaced.

    Raises MeasurementFailed (``measurement.play_unseen``) with fewer than two triangles out and back that
    odometry saw.
    """
    turned = Rotation.from_matrix(seen.X_C0C[:, :3, :3]).as_rotvec()
    ways = (seen.X_C0C[:, :3, 3], turned)
    spaced = evenly(seen.seen_t)
    best = _least([_swinging(_sight(seen, along, spaced)) for along in ways])
    told = _sight(seen, best.along, seen.seen_t)._replace(swings=best.swings)
    if _fit(told).residual < _fit(best).residual:
        best = _least([_swinging(_sight(seen, along, seen.seen_t)) for along in ways])
    return _play_of(best)


def mean_delay(found: Sequence[PlayFound]) -> tuple[float, float]:
    """The camera's delay and its standard deviation (s) by all joints; there must be one."""
    weights = np.array([1.0 / one.delay_std**2 for one in found])
    delays = np.array([one.delay for one in found])
    mean = float(weights @ delays / weights.sum())
    scatter = math.sqrt(float(weights @ (delays - mean) ** 2) / max(len(found) - 1, 1))
    return mean, max(scatter, 1.0) / math.sqrt(float(weights.sum()))


def _least(sights: Sequence[_Sight]) -> _Sight:
    return min(sights, key=lambda sight: _fit(sight).residual)


def _sight(seen: JointSeen, along: Array, times: Array) -> _Sight:
    motion = motion_at(seen, times)
    triangles = triangles_in(seen, motion)
    turns = min(sum(one.sense > 0.0 for one in triangles), sum(one.sense < 0.0 for one in triangles))
    if turns < _LEAST_PAIRS:
        raise MeasurementFailed(
            "measurement.play_unseen",
            f"{turns} triangles out and back that odometry saw: at least {_LEAST_PAIRS} are wanted",
        )
    return _Sight(along, motion, triangles)


def _swinging(sight: _Sight) -> _Sight:
    """``sight`` with its swings."""
    turned, fixed = _system(sight)
    return sight._replace(swings=swings_in(turned, fixed, sight.motion, sight.triangles))


def _play_of(sight: _Sight) -> PlayFound:
    """The spread is that of triangles: what a fit cannot tell of a swing is alike from frame to frame."""
    turned, columns = _columns(sight)
    whole = _least_squares(turned, columns)
    sums = np.zeros((2, columns.shape[1]))  # of small changes of the unknowns: half the play, the delay
    sums[0, 1], sums[0, 4] = -whole.half / whole.turn, 1.0 / whole.turn
    sums[1, 1], sums[1, 5] = -whole.delay / whole.turn, -1.0 / whole.turn
    sizes = [len(one.rows) for one in sight.triangles]
    half_std, delay_std = block_spreads(columns, turned, sums, sizes)
    return PlayFound(
        half=whole.half,
        half_std=math.hypot(half_std, _FLOOR_RAD, _FLOOR_SHARE * whole.half),
        delay=whole.delay,
        delay_std=math.hypot(delay_std, _DELAY_FLOOR_S),
        residual=whole.residual,
        triangles=len(sizes),
    )


def _fit(sight: _Sight) -> _Fit:
    return _least_squares(*_columns(sight))


def _least_squares(turned: Array, columns: Array) -> _Fit:
    units = np.maximum(np.abs(columns).max(axis=0), 1e-12)
    scaled, *_ = np.linalg.lstsq(columns / units, turned, rcond=None)
    found = scaled / units
    turn = float(found[1])
    return _Fit(float(found[4]) / turn, -float(found[5]) / turn, turn, rest_of(turned, columns))


def _columns(sight: _Sight) -> tuple[Array, Array]:
    """What odometry saw (m,), and all that may have made it (m, k)."""
    turned, fixed = _system(sight)
    swings = [swing_columns(swing, sight.motion, sight.triangles) for swing in sight.swings]
    return turned, np.hstack([fixed, *(swings or [_lagging(sight)])])


def _lagging(sight: _Sight) -> Array:
    """What a boom that swings too quickly to be seen lags behind its root by (m, 1), over its swing's square.

    A ramp's rows begin at some speed and end at less: unaccounted for, it would be a play of some µrad.
    """
    rows = np.concatenate([one.rows for one in sight.triangles])
    return np.asarray(sight.motion.a[rows][:, None])


def _system(sight: _Sight) -> tuple[Array, Array]:
    """What odometry saw, in radians of the joint (m,), and what but swings may have made it (m, k)."""
    motion = sight.motion
    rows = np.concatenate([one.rows for one in sight.triangles])
    senses = np.concatenate([np.full(len(one.rows), one.sense) for one in sight.triangles])
    x = motion.q[rows] - motion.q[rows].mean()
    slopes = np.polyfit(x, sight.along[rows], 1)[0]
    size = float(np.linalg.norm(slopes))
    if size == 0.0:
        raise MeasurementFailed("measurement.play_unseen", "odometry saw the camera stand still")
    turned = sight.along[rows] @ (slopes / size**2)
    since = (motion.t[rows] - motion.t[rows].mean()) / np.ptp(motion.t[rows])
    drift = [since**k for k in range(1, _DRIFT + 1)]
    fixed = [np.ones_like(x), x, x**2, x**3, senses, motion.v[rows], motion.others[rows], *drift]
    return turned, np.column_stack(fixed)
