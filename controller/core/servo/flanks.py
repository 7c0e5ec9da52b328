"""On which flank of the play before its encoder a joint stands, and how far off it is left for that.

A joint drags its encoder along. One that came too far stands on the flank of its last turn; bringing it back
takes it through its whole play first, and the encoder shows nothing of that. So a joint is brought back only
when it is farther off than its play is wide, and by what any joint may be off.
"""

import math

import numpy as np

from controller.core.kinematics.rotations import Array
from controller.core.servo.parking_state import CAME, FURTHEST, WENT, ParkingLaw
from foundation.compiled import kernel

_FILTER_S = 0.05  # of the encoder: a third of its noise
_TURNED_RAD = 9.6e-5  # two digits: a joint that came back by less may not have


@kernel
def flanks_followed(state: Array, q_meas: Array, dt_s: float) -> None:
    """Follow the sense in which each encoder, at ``q_meas`` (6,), went last; in motion, too."""
    keep = math.exp(-dt_s / _FILTER_S)
    for i in range(6):
        if state[WENT, i] == 0.0 and state[FURTHEST, i] == 0.0:  # the first scan
            state[WENT, i] = state[FURTHEST, i] = q_meas[i]
        state[WENT, i] = keep * state[WENT, i] + (1.0 - keep) * q_meas[i]
        beyond = state[WENT, i] - state[FURTHEST, i]
        if state[CAME, i] * beyond > 0.0:
            state[FURTHEST, i] = state[WENT, i]
        elif abs(beyond) > _TURNED_RAD:
            turned_to(state, i, 1.0 if beyond > 0.0 else -1.0)


@kernel
def turned_to(state: Array, i: int, sense: float) -> None:
    """Joint ``i`` is on its way to the flank of a turn in ``sense``, ±1."""
    state[CAME, i], state[FURTHEST, i] = sense, state[WENT, i]


@kernel
def left_at(law: ParkingLaw, state: Array, i: int, off: float, least: float) -> float:
    """How far off (rad) joint ``i``, which is ``off`` (rad), may stay: by ``least``, and its play.

    A loaded one only where it was raised too far, and never so far that the arm would not be settled: it
    sinks by itself, and being raised brings it to the same flank each time.
    """
    if off * state[CAME, i] >= 0.0 or (law.loaded[i] > 0.0 and off > 0.0):
        return least
    most = least + law.play[i]
    return float(most if law.loaded[i] == 0.0 else min(most, max(least, law.leaves)))


@kernel
def came_too_far(law: ParkingLaw, state: Array, i: int, off: float) -> bool:
    """Whether joint ``i``, ``off`` (rad), passed its end by less than what it is left at for its play."""
    passed = law.loaded[i] == 0.0 and law.play[i] > 0.0 and off * state[CAME, i] < 0.0
    return bool(passed and abs(off) <= left_at(law, state, i, off, law.leaves))


def stays_within(law: ParkingLaw, state: Array, off: Array, least: float) -> bool:
    """Whether all joints, ``off`` (6,) rad, may stay: within ``least``, and the slew within its play."""
    passed = (off * state[CAME] < 0.0) & (law.loaded == 0.0)
    most = np.where(passed, least + law.play, least)
    return bool((np.abs(off) <= most).all())
