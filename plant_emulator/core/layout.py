"""The order of coordinates and states in the flat arrays that the compiled code works on.

Ten coordinates of the plain arm: six driven joints and four flexible hinges (vertical and lateral, on boom
and tilt link). The state vector is coordinates, their rates, then per actuator spool, spool rate, chamber
pressures and friction bristle, then supply pressure and oil temperature, then per actuator the opening of its
counterbalance valve, the pressure in the load-sensing line, and per actuator the temperature of its oil. What
else moves (a rocking base, a loose
slew, …) has its states behind these, so the plain arm's places never change: angles, rates, the bristle of
the slewing ring, the time. ``Places`` tells where in the state each coordinate of the chain stands.
"""

from collections.abc import Collection, Sequence
from typing import NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray


class Guest(Protocol):
    """A connection. ``served``: how often it was; ``heard_ns``: when last, or when it came."""

    address: str
    served: int
    heard_ns: int


GuestT = TypeVar("GuestT", bound=Guest)


def who_yields(
    guests: Collection[GuestT], address: str, kept: GuestT | None, most: int, most_of_one: int
) -> GuestT | None:
    """The guest whose place a newcomer from ``address`` takes; None while a place is free.

    There are ``most`` places, and ``most_of_one`` for one address, whose own guests then yield. First go
    those never served, then those not heard for longest; ``kept`` never does.
    """
    rivals = [guest for guest in guests if guest.address == address]
    if len(rivals) < most_of_one:
        if len(guests) < most:
            return None
        rivals = list(guests)
    return min(
        (guest for guest in rivals if guest is not kept),
        key=lambda guest: (guest.served > 0, guest.heard_ns),
        default=None,
    )


# linkage, as linkage.py takes it
A_KIND, A_BASE, A_LEVER, A_ANGLE0, A_LENGTH0 = range(5)
# chambers: areas (m², or m³/rad of a rotary actuator), dead volumes, stroke, leakage across the piston
A_AREA_A, A_AREA_B, A_DEAD_A, A_DEAD_B, A_STROKE, A_LEAKAGE = range(5, 11)
A_STOP_STIFFNESS, A_STOP_DAMPING, A_CUSHION = range(11, 14)
# spool: ω and ζ, slew limits out of the centre and back (1/s)
A_OMEGA, A_ZETA, A_SLEW_OUT, A_SLEW_BACK = range(14, 18)
# what guards a chamber: relief (m³/s/Pa), anti-cavitation (m³/s/√Pa), counterbalance gain (0 without one)
A_RELIEF, A_ANTICAVITATION, A_COUNTERBALANCE = range(18, 21)
# LuGre friction
A_COULOMB, A_STATIC, A_STRIBECK, A_BRISTLE, A_BRISTLE_DAMPING, A_VISCOUS = range(21, 27)
# four metering edges each, in the order of EDGES: orifice gain (m³/s/√Pa), overlap of the full stroke
EDGES = ("supply_a", "return_b", "supply_b", "return_a")
A_GAIN, A_DEADBAND = 27, 31
# flow curve: slope where an edge opens over the mean slope, extending and retracting
A_SLOPE = 35
# chambers to return past the spool (m³/s/Pa)
A_SPOOL_LEAKAGE = 37
A_COLUMNS = 38

# oil: modulus, air fraction, polytropic exponent
C_MODULUS, C_AIR, C_EXPONENT = range(3)
# temperature: reference, drifts (1/K), cooling rate (1/s), ambient, heat capacity (0: held)
C_REFERENCE, C_VISCOSITY_DRIFT, C_MODULUS_DRIFT, C_COOLING, C_AMBIENT, C_HEAT_CAPACITY = range(3, 9)
# supply: set and return pressure, pump's limit and gain, line volume, dump orifice, 1 while it runs
C_SET, C_RETURN, C_FLOW_LIMIT, C_PUMP_GAIN, C_LINE_VOLUME, C_DUMP, C_RUNNING = range(9, 16)
C_RELIEF, C_REGULARISATION = range(16, 18)
# counterbalance: setting, pilot ratio, pressure from cracking to full opening
C_HOLD, C_PILOT, C_HOLD_RANGE = range(18, 21)
# what the running pump loses as heat (W); what the pressure compensators keep across an edge (0 without)
C_IDLE_LOSS, C_COMPENSATOR = 21, 22
# counterbalance: lag of the opening behind its pilot (s, 0: none)
C_HOLD_LAG = 23
# load-sensing pump: pressure above the highest load (0: constant pressure), lag of the line (s)
C_LS_MARGIN, C_LS_LAG = 24, 25
# oil in the chambers: expansion net of steel (1/K, 0: its temperature is held), rate of cooling (1/s)
C_EXPANSION, C_CHAMBER_COOLING = 26, 27
C_COLUMNS = 28

# net flow into each chamber, flow drawn from the supply, pressure force, friction, position, velocity, stop
F_NET_A, F_NET_B, F_SUPPLY, F_PUSH, F_FRICTION, F_POSITION, F_VELOCITY, F_STOP = range(8)
# the pressure that the supply works against, 0 with the valve shut
F_LOAD = 8
F_COLUMNS = 9


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
CHAMBER_TEMPERATURE = LOAD_SENSE + 1
N_STATES = CHAMBER_TEMPERATURE + N_ACTUATORS


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
