"""What is no linear spring in the structure: play in the slew's mesh, a ring that tilts, machines that shake.

A flank pushes like a spring with a damper that sets in over the first tenth of the play's half, so that the
torque of a meeting has no jump, and it never pulls. Between the flanks nothing acts but the friction of the
ring, which lies between the upper structure and the base and so loads the slew as well as its play. Its
bristles are damped below the Stribeck speed alone: their damper would outdo the friction of a light ring.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.compiled import allocation_free
from plant_emulator.config.plant import PlantConfig
from plant_emulator.config.structure import ShakerConfig
from plant_emulator.core.layout import Places


@allocation_free
def steady_level(velocity: float, coulomb: float, static: float, stribeck: float) -> float:
    """g(v) = F_c + (F_s − F_c) exp(−(v/v_s)²): the bristles' force in steady sliding."""
    ratio = velocity / stribeck
    return coulomb + (static - coulomb) * math.exp(-ratio * ratio)


@allocation_free
def bristle_rate(velocity: float, bristle: float, level: float, stiffness: float) -> float:
    """ż = v − σ0 |v| z / g(v), with g(v) given as ``level``; zero friction keeps the bristles at rest."""
    if level <= 0.0:
        return 0.0
    return velocity - stiffness * abs(velocity) * bristle / level


@allocation_free
def friction_force(
    velocity: float, bristle: float, rate: float, stiffness: float, micro_damping: float, viscous: float
) -> float:
    """F = σ0 z + σ1 ż + σ2 v (N, or N m for a rotary actuator)."""
    return stiffness * bristle + micro_damping * rate + viscous * velocity


Array = NDArray[np.float64]

# mesh of the slew: coordinate (−1: none), half of its play, flanks, what hoses pull and pull back
M_AT, M_HALF, M_STIFFNESS, M_DAMPING, M_HOSE, M_HOSE_SPRING = range(6)
# friction of the slewing ring, LuGre
M_COULOMB, M_STATIC, M_STRIBECK, M_BRISTLE, M_BRISTLE_DAMPING, M_VISCOUS = range(6, 12)
M_COLUMNS = 12
# tilt of the ring: its roll's coordinate (−1: none; pitch follows), half of its play, stiffness, damping
T_AT, T_HALF, T_STIFFNESS, T_DAMPING = range(4)
T_COLUMNS = 4
# a shaker: angular frequency (rad/s), phase (rad), moments about x, y, z (N m)
S_FREQUENCY, S_PHASE, S_MOMENT = range(3)
S_COLUMNS = 5

ONSET = 0.1  # of the play's half, over which a flank's damper sets in
RELAXING = 2000.0  # 1/s; a bristle that has turned about in half a millisecond has turned about


class Looseness(NamedTuple):
    """``mesh`` (M_COLUMNS,), ``tilt`` (T_COLUMNS,), ``shakers`` (k, S_COLUMNS) of the first coordinates.

    ``shared`` (k, 3): torque on the coordinate of column 0 against the rate of that of column 1, N m s/rad.
    """

    mesh: Array
    tilt: Array
    shakers: Array
    shared: Array


def build_looseness(
    config: PlantConfig, names: tuple[str, ...], shared: list[tuple[int, int, float]]
) -> Looseness:
    """The tables of ``config`` for a chain of these coordinates; phases are zero until ``set_phases``."""
    errors = config.errors
    slew, ring, shake = errors.loose_slew, errors.bearing_tilt, errors.vibration
    mesh, tilt = np.zeros(M_COLUMNS), np.zeros(T_COLUMNS)
    mesh[M_AT], tilt[T_AT] = -1.0, -1.0
    if slew.enabled:
        f = slew.friction
        mesh[: M_HOSE_SPRING + 1] = (
            names.index("slew_play"), 0.5e-3 * slew.backlash_mrad, slew.contact_nm_rad,
            slew.contact_damping_nm_s_rad, slew.hose_nm, slew.hose_nm_rad,
        )  # fmt: skip
        mesh[M_COULOMB : M_STRIBECK + 1] = f.coulomb_nm, f.static_nm, f.stribeck_rad_s
        mesh[M_BRISTLE:] = f.bristle_nm_rad, f.bristle_damping_nm_s_rad, f.viscous_nm_s_rad
        if not errors.friction.enabled:
            mesh[[M_COULOMB, M_STATIC, M_BRISTLE_DAMPING, M_VISCOUS]] = 0.0
    if ring.enabled:
        half = 0.5e-3 * ring.play_mm / ring.diameter_m
        tilt[:] = names.index("ring_roll"), half, ring.stiffness_nm_rad, ring.damping_nm_s_rad
    sources = (shake.engine, shake.pump) if shake.enabled else ()
    shakers = np.array([_shaker(source) for source in sources]).reshape(-1, S_COLUMNS)
    return Looseness(mesh, tilt, shakers, np.array(shared, dtype=float).reshape(-1, 3))


def _shaker(source: ShakerConfig) -> list[float]:
    return [2.0 * math.pi * source.frequency_hz, 0.0, *source.moment_nm]


def set_phases(loose: Looseness, seed: int) -> None:
    """Draw the shakers' phases from ``seed``, apart from every other draw."""
    loose.shakers[:, S_PHASE] = np.random.default_rng([seed, 13]).uniform(
        0.0, 2.0 * math.pi, len(loose.shakers)
    )


@allocation_free
def flank(depth: float, speed: float, half: float, stiffness: float, damping: float) -> float:
    """Push (≥ 0) of a flank that is pressed in by ``depth`` at ``speed``; nothing where it is not touched."""
    if depth <= 0.0:
        return 0.0
    onset = ONSET * half
    engaged = 1.0 if depth >= onset else depth / onset
    return max(stiffness * depth + damping * engaged * speed, 0.0)


@allocation_free
def _slowed(velocity: float, level: float, stiffness: float) -> float:
    """What a bristle's rate is slowed by, so that it relaxes at RELAXING at most; its steady state stays."""
    relaxing = stiffness * abs(velocity)
    return 1.0 if level <= 0.0 else 1.0 / math.sqrt(1.0 + (relaxing / (RELAXING * level)) ** 2)


@allocation_free
def _mesh(
    state: Array, where: Places, mesh: Array, angle: Array, turn: Array, force: Array, rate: Array
) -> None:
    """Forces on the slew and its play, and the rate of the ring's bristle."""
    at, slew = int(mesh[M_AT]), where.joint[0]
    play, speed = angle[at], turn[at]
    side = 1.0 if play >= 0.0 else -1.0
    depth = side * play - mesh[M_HALF]
    force[at] -= side * flank(depth, side * speed, mesh[M_HALF], mesh[M_STIFFNESS], mesh[M_DAMPING])
    turning = turn[slew] + speed
    bristle = state[where.ring_bristle]
    level = steady_level(turning, mesh[M_COULOMB], mesh[M_STATIC], mesh[M_STRIBECK])
    z_rate = _slowed(turning, level, mesh[M_BRISTLE]) * bristle_rate(turning, bristle, level, mesh[M_BRISTLE])
    rate[where.ring_bristle] = z_rate
    ratio = turning / mesh[M_STRIBECK]
    micro = mesh[M_BRISTLE_DAMPING] * math.exp(-ratio * ratio)
    drag = friction_force(turning, bristle, z_rate, mesh[M_BRISTLE], micro, mesh[M_VISCOUS])
    pull = mesh[M_HOSE] - mesh[M_HOSE_SPRING] * (angle[slew] + play) - drag
    force[at] += pull
    force[slew] += pull


@allocation_free
def _tilt(tilt: Array, angle: Array, turn: Array, force: Array) -> None:
    """Forces on roll and pitch of the ring: free within its play, whatever the direction, stiff beyond it."""
    at = int(tilt[T_AT])
    roll, pitch = angle[at], angle[at + 1]
    lean = math.sqrt(roll * roll + pitch * pitch)
    depth = lean - tilt[T_HALF]
    if depth <= 0.0:
        return
    x, y = roll / lean, pitch / lean
    outward = x * turn[at] + y * turn[at + 1]
    push = flank(depth, outward, tilt[T_HALF], tilt[T_STIFFNESS], tilt[T_DAMPING])
    onset = ONSET * tilt[T_HALF]
    along = tilt[T_DAMPING] * (1.0 if depth >= onset else depth / onset)
    force[at] -= push * x + along * (turn[at] - outward * x)
    force[at + 1] -= push * y + along * (turn[at + 1] - outward * y)


@allocation_free
def add_looseness(
    state: Array, where: Places, loose: Looseness, angle: Array, turn: Array, force: Array, rate: Array
) -> None:
    """Add to ``force`` (n,) what is loose and shaken does at ``angle`` and ``turn`` (n,) of the chain.

    Fills the added states' own part of ``rate``. For a chain that has such states at all.
    """
    rate[where.clock] = 1.0
    rate[where.ring_bristle] = 0.0
    if loose.mesh[M_AT] >= 0.0:
        _mesh(state, where, loose.mesh, angle, turn, force, rate)
    if loose.tilt[T_AT] >= 0.0:
        _tilt(loose.tilt, angle, turn, force)
    for k in range(loose.shared.shape[0]):
        force[int(loose.shared[k, 0])] -= loose.shared[k, 2] * turn[int(loose.shared[k, 1])]
    for k in range(loose.shakers.shape[0]):
        swing = math.sin(loose.shakers[k, S_FREQUENCY] * state[where.clock] + loose.shakers[k, S_PHASE])
        for axis in range(3):
            force[axis] += loose.shakers[k, S_MOMENT + axis] * swing
