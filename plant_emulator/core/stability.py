"""How fast the plant's fastest mode is, hence how long a Runge-Kutta step may be."""

import math

import numpy as np
from numpy.typing import NDArray

from plant_emulator.config.units import RUNGE_KUTTA_REACH
from plant_emulator.core import columns as col
from plant_emulator.core.layout import (
    DRIVEN,
    JOINTS,
    N_ACTUATORS,
    N_COORDINATES,
    N_STATES,
    PRESSURE_A,
    SUPPLY,
    TEMPERATURE,
    Q,
)
from plant_emulator.core.mechanics.linkage import ROTARY
from plant_emulator.core.mechanics.multibody import forward_dynamics, multibody_work
from plant_emulator.core.model import Model
from plant_emulator.core.right_hand_side import new_work, right_hand_side
from protocol.errors import ConfigurationError

Array = NDArray[np.float64]


def linearised(model: Model, state: Array, command: Array) -> Array:
    """The Jacobian (N_STATES, N_STATES) of the right-hand side at ``state``, by central differences."""
    work, steps = new_work(), np.full(N_STATES, 1e-6)
    steps[PRESSURE_A : PRESSURE_A + 2 * N_ACTUATORS] = 100.0
    steps[SUPPLY] = 100.0
    steps[TEMPERATURE] = 1e-3
    jacobian, above, below = np.zeros((N_STATES, N_STATES)), np.zeros(N_STATES), np.zeros(N_STATES)
    for j in range(N_STATES):
        moved = state.copy()
        moved[j] = state[j] + steps[j]
        right_hand_side(moved, command, model, work, above)
        moved[j] = state[j] - steps[j]
        right_hand_side(moved, command, model, work, below)
        jacobian[:, j] = (above - below) / (2.0 * steps[j])
    return jacobian


def modes(model: Model, state: Array) -> NDArray[np.complex128]:
    """The eigenvalues (N_STATES,) of the plant at ``state`` with its valves closed (1/s, complex)."""
    return np.asarray(np.linalg.eigvals(linearised(model, state, np.zeros(N_ACTUATORS))))


def check_step(model: Model, state: Array, step: float) -> None:
    """Raise ConfigurationError when ``step`` (s) is too long for the arm's own vibrations at ``state``."""
    rates = {"the arm vibrates": float(np.max(np.abs(modes(model, state))))}
    for i, name in enumerate(JOINTS):
        rates[f"the end stop of {name} acts"] = _stop_rate(model, state, i)
    reason, fastest = max(rates.items(), key=lambda item: item[1])
    limit = RUNGE_KUTTA_REACH / fastest
    if step > limit:
        raise ConfigurationError(
            "configuration.unstable_step",
            f"step_ms = {step * 1e3:g}: must not exceed {limit * 1e3:.4f}, {reason} at {fastest:.0f} rad/s",
        )


def _stop_rate(model: Model, state: Array, i: int) -> float:
    """How fast (1/s) actuator ``i`` would rebound or brake at its end stop, its lever at the longest."""
    row, mech = model.actuators[i], model.mechanism._replace(gravity=np.zeros(3))
    lever = 1.0 if row[col.A_KIND] == ROTARY else min(float(row[col.A_BASE]), float(row[col.A_LEVER]))
    push, answer = np.zeros(N_COORDINATES), np.zeros(N_COORDINATES)
    push[DRIVEN[i]] = 1.0
    q = state[Q : Q + N_COORDINATES]
    forward_dynamics(q, np.zeros(N_COORDINATES), push, mech, multibody_work(N_COORDINATES), answer)
    mobility = lever * lever * float(answer[DRIVEN[i]])
    return max(
        math.sqrt(float(row[col.A_STOP_STIFFNESS]) * mobility), float(row[col.A_STOP_DAMPING]) * mobility
    )
