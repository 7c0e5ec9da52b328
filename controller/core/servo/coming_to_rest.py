"""When the arm has come to rest behind shut valves: from then on no joint is brought nearer to its reference.

An inch takes a joint through the play behind its encoder and swings the boom: the tool goes on by
millimetres for a tenth of a milliradian. So a joint that has been calm inside the tolerance stays where it
is, and the arm *rests* when all of them do. Only then does it count as settled.
"""

import numpy as np

from controller.core.kinematics.rotations import Array
from controller.core.servo.flanks import left_at, stays_within
from controller.core.servo.parking_state import (
    CALM,
    CALM_AT,
    CREPT,
    ERROR,
    FOLLOWING,
    KEPT,
    MARK,
    NUDGED,
    OPEN,
    PARKED,
    PHASE,
    PLACE,
    SHUT,
    ParkingLaw,
)
from foundation.compiled import kernel

JOINT_RESTS, ARM_RESTS = 1.0, 2.0  # values of PARKED
_PUSHED_RAD = 9.6e-5  # two digits: a resting joint that others have pushed so far is judged anew


@kernel
def calm_counted(law: ParkingLaw, state: Array, i: int, lever: float) -> None:
    """Count how long joint ``i`` has been calm; let it rest where it is, or judge it anew."""
    phase = state[PHASE, i]
    here = state[CREPT, i] if phase == KEPT else state[ERROR, i]
    state[CALM, i] += law.dt_s
    if phase == OPEN or abs(here - state[CALM_AT, i]) > law.calm_way / lever:
        state[CALM, i], state[CALM_AT, i] = 0.0, here
    if phase != SHUT or state[PARKED, i] == ARM_RESTS:
        return
    off, error = abs(state[ERROR, i] - state[PLACE, i]), state[ERROR, i]
    outside = abs(error) > left_at(law, state, i, error, law.leaves)
    if state[PARKED, i] == JOINT_RESTS and (outside or off > _PUSHED_RAD):
        state[PARKED, i], state[PLACE, i], state[CALM, i] = 0.0, 0.0, 0.0
    elif state[PARKED, i] == 0.0 and state[CALM, i] > law.calm and not outside:
        rests_here(state, i, JOINT_RESTS)


@kernel
def rests_here(state: Array, i: int, parked: float) -> None:
    """Joint ``i`` is where it shall stay."""
    state[PARKED, i] = parked
    state[PLACE, i] = state[MARK, i] = state[CREPT, i] = state[ERROR, i]


def restless(law: ParkingLaw, state: Array) -> Array:
    """Which joints (6,) do not rest yet."""
    shut = (state[PHASE] == SHUT) & (state[PARKED] > 0.0)
    leans = (state[PHASE] == KEPT) & (state[CALM] > law.calm) & (np.abs(state[ERROR]) < law.leaves)
    return np.asarray(~(shut | leans))


def may_stay(law: ParkingLaw, state: Array) -> bool:
    """Whether no joint is on its way, and all are near enough: an arm whose time is over may stay so."""
    moves = np.isin(state[PHASE], (FOLLOWING, OPEN, NUDGED))
    return bool(not moves.any() and stays_within(law, state, state[ERROR], law.leaves))


def rested_here(state: Array) -> Array:
    """``state`` with the arm at rest: joints behind shut valves stay where they are."""
    here = state.copy()
    for i in np.flatnonzero(state[PHASE] != KEPT).tolist():
        if state[PARKED, i] == 0.0:
            rests_here(here, i, ARM_RESTS)
        here[PARKED, i] = ARM_RESTS
    return here
