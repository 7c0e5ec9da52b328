"""The order of coordinates and states in the flat arrays that the compiled code works on.

Ten coordinates: six driven joints and four flexible hinges (vertical and lateral, on boom and tilt link).
The state vector is coordinates, their rates, then per actuator spool, spool rate, chamber pressures and
friction bristle, then supply pressure and oil temperature.
"""

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
N_STATES = TEMPERATURE + 1
