"""The order of coordinates and states in the flat arrays that the compiled code works on.

Ten coordinates of the plain arm: six driven joints and four flexible hinges (vertical and lateral, on boom
and tilt link). The state vector is coordinates, their rates, then per actuator spool, spool rate, chamber
pressures and friction bristle, then supply pressure and oil temperature, then per actuator the opening of its
counterbalance valve, and the pressure in the load-sensing line. What else moves (a rocking base, a loose
slew, …) has its states behind these, so the plain arm's places never change: angles, rates, the bristle of
the slewing ring, the time. ``Places`` tells where in the state each coordinate of the chain stands.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

JOINTS = ("slew", "lift", "tilt", "wrist1", "wrist2", "wrist3")
COORDINATES = (
    "slew",
    "lift",
    "boom_vertical",
    "boom_lateral",
    "tilt",
    "arm_vertical",
    "arm_lateral",
    "wrist1",
    "wrist2",
    "wrist3",
)
HINGES = ("boom_vertical", "boom_lateral", "arm_vertical", "arm_lateral")

DRIVEN = (0, 1, 4, 7, 8, 9)  # coordinate of each joint
FLEXIBLE = (2, 3, 5, 6)  # coordinate of each hinge

N_COORDINATES = 10
N_ACTUATORS = 6

Q = 0
RATE = Q + N_COORDINATES
SPOOL = RATE + N_COORDINATES
SPOOL_RATE = SPOOL + N_ACTUATORS
PRESSURE_A = SPOOL_RATE + N_ACTUATORS
PRESSURE_B = PRESSURE_A + N_ACTUATORS
BRISTLE = PRESSURE_B + N_ACTUATORS
SUPPLY = BRISTLE + N_ACTUATORS
TEMPERATURE = SUPPLY + 1
HOLDING = TEMPERATURE + 1
LOAD_SENSE = HOLDING + N_ACTUATORS
N_STATES = LOAD_SENSE + 1


class Places(NamedTuple):
    """Where the state holds each coordinate of a chain of ``n``: ``angle`` and ``rate`` (n,) of the state.

    ``joint`` (6,) is each joint's coordinate in the chain. ``ring_bristle`` and ``clock``: where the slewing
    ring's bristle and the time (s) stand, −1 in a plain arm, which has neither.
    """

    angle: NDArray[np.int64]
    rate: NDArray[np.int64]
    joint: NDArray[np.int64]
    ring_bristle: int
    clock: int


def places(names: Sequence[str]) -> Places:
    """The places of a chain whose coordinates have these ``names``, base first."""
    added = [name for name in names if name not in COORDINATES]
    angle, rate = [], []
    for name in names:
        plain = name in COORDINATES
        k = COORDINATES.index(name) if plain else added.index(name)
        angle.append(Q + k if plain else N_STATES + k)
        rate.append(RATE + k if plain else N_STATES + len(added) + k)
    last = N_STATES + 2 * len(added)
    return Places(
        angle=np.array(angle),
        rate=np.array(rate),
        joint=np.array([names.index(name) for name in JOINTS]),
        ring_bristle=last if added else -1,
        clock=last + 1 if added else -1,
    )


def state_size(where: Places) -> int:
    """How many states an arm with these places has."""
    return max(N_STATES, where.clock + 1)
