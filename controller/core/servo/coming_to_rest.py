"""When the arm has come to rest, and is parked: from then on no joint is brought nearer to its reference.

An inch takes a joint through the play behind its encoder and swings the boom: the tool goes on by
millimetres for a tenth of a milliradian. So a joint that has been calm inside the tolerance stays where it
is, and the arm *rests* when all of them do. Only then does it count as settled.
"""

import math

import numpy as np

from controller.core.kinematics.rotations import Array
from controller.core.servo.flanks import left_at, stays_within
from controller.core.servo.keeping import calm_gain
from controller.core.servo.parking_state import (
    BAND,
    BIAS,
    CALM,
    CALM_AT,
    CREPT,
    DRIFT,
    ERROR,
    FELT,
    FOLLOWING,
    HELD,
    KEPT,
    LOAD,
    MARK,
    NUDGED,
    OPEN,
    PARKED,
    PHASE,
    PLACE,
    QUIET,
    QUIET_AT,
    RESTED,
    SENSE,
    SHUT,
    STEADY,
    STEADY_AT,
    ParkingLaw,
)
from foundation.compiled import kernel

JOINT_RESTS, ARM_RESTS = 1.0, 2.0  # values of PARKED
_PUSHED_RAD = 9.6e-5  # two digits: a resting joint that others have pushed so far is judged anew
_CREEP_FILTER_S = 3.0  # of the slow creep of a parked joint: good for a microradian
ARRIVED_RAD = 9.6e-5  # two digits: until the arm is parked, no joint is brought nearer
_NEARLY = 1.5  # of that: a kept joint stays there
_QUIET_S = 10.0  # the arm is parked when no joint moved for so long,
_LEANS_S = 35.0  # nor a kept one, which by then leans on one flank of the play before its encoder,
_LONGEST_S = 300.0  # or when its joints have been away from the joint law for so long
_QUIET_BAR = 0.05  # with a slew of 4 cm³/degree 0.01 mrad of its friction
_STEADY_RAD_S = 1e-5  # and whose leak does not change by more: oil that drains away took a lift 1.5 mm along


@kernel
def listened(law: ParkingLaw, state: Array, i: int, lever: float, error: float, load: float) -> None:
    """Count how long joint ``i`` has moved the tool by no more than the quiet, and been off the joint law.

    One without load relaxes within the play before its encoder; the oil, ``load`` (bar), tells how long.
    """
    keep = math.exp(-law.dt_s / _CREEP_FILTER_S)
    state[CREPT, i] = keep * state[CREPT, i] + (1.0 - keep) * error
    state[LOAD, i] = keep * state[LOAD, i] + (1.0 - keep) * load
    state[HELD, i] += law.dt_s
    state[QUIET, i] += law.dt_s
    relaxes = law.loaded[i] == 0.0 and abs(state[LOAD, i] - state[RESTED, i]) > _QUIET_BAR
    if relaxes or abs(state[CREPT, i] - state[QUIET_AT, i]) > law.quiet / lever:
        state[QUIET, i], state[QUIET_AT, i], state[RESTED, i] = 0.0, state[CREPT, i], state[LOAD, i]
    state[STEADY, i] += law.dt_s
    if law.felt[i] > 0.0 and abs(state[BIAS, i] - state[STEADY_AT, i]) > _STEADY_RAD_S:
        state[STEADY, i], state[STEADY_AT, i] = 0.0, state[BIAS, i]


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


@kernel
def at_rest(state: Array) -> bool:
    """Whether no joint moves the tool any more, each shut near its place or kept; or it never will."""
    rests = too_long = True
    for i in range(6):
        phase, quiet = state[PHASE, i], state[QUIET, i]
        near = abs(state[ERROR, i] - state[PLACE, i]) < 1.5 * state[BAND, i]
        stands = phase == SHUT and near and quiet > _QUIET_S
        leans = phase == KEPT and min(quiet, state[STEADY, i]) > _LEANS_S
        rests = rests and (stands or leans)
        too_long = too_long and phase != FOLLOWING and state[HELD, i] > _LONGEST_S
    return bool(rests or too_long)


def parked_here(law: ParkingLaw, state: Array) -> Array:
    """``state`` with the arm parked: from now on its joints are kept where they rest.

    A kept joint that is near its goal, too: it would take minutes to creep there, and the tool with it.
    Its valve stays as it is: what held it there, against its error and what its load had told, is bias now.
    """
    here = state.copy()
    near = (state[PHASE] == KEPT) & (np.abs(state[ERROR]) < ARRIVED_RAD * _NEARLY)
    here[PARKED], here[PLACE] = ARM_RESTS, np.where((state[PHASE] == SHUT) | near, state[ERROR], 0.0)
    left = here[PLACE] - state[PLACE] + law.felt * (state[FELT] - state[LOAD])
    here[BIAS] += np.where(near, calm_gain(law) * state[SENSE] * left, 0.0)
    here[FELT] = np.where(near, state[LOAD], state[FELT])
    here[MARK] = here[CREPT] = here[PLACE]
    here[DRIFT] = np.where(state[PHASE] == SHUT, 0.0, state[DRIFT])
    return here
