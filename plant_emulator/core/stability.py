"""How fast the plant's fastest mode is, hence how long a Runge-Kutta step may be."""

import math
from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from plant_emulator.config.actuators import RUNGE_KUTTA_REACH
from plant_emulator.core import layout as col
from plant_emulator.core.layout import (
    CHAMBER_TEMPERATURE,
    COORDINATES,
    JOINTS,
    LOAD_SENSE,
    N_ACTUATORS,
    PRESSURE_A,
    SUPPLY,
    TEMPERATURE,
)
from plant_emulator.core.mechanics import loose
from plant_emulator.core.mechanics.elastic import mobility
from plant_emulator.core.mechanics.geometry import ROTARY, actuator_position
from plant_emulator.core.model import Model
from plant_emulator.core.right_hand_side import new_work, right_hand_side
from protocol.errors import ConfigurationError

Array = NDArray[np.float64]


def linearised(model: Model, state: Array, command: Array) -> Array:
    """The Jacobian (states, states) of the right-hand side at ``state``, by central differences."""
    n = state.shape[0]
    work, steps = new_work(model), np.full(n, 1e-6)
    steps[PRESSURE_A : PRESSURE_A + 2 * N_ACTUATORS] = 100.0
    steps[[SUPPLY, LOAD_SENSE]] = 100.0
    steps[[TEMPERATURE, *range(CHAMBER_TEMPERATURE, CHAMBER_TEMPERATURE + N_ACTUATORS)]] = 1e-3
    jacobian, above, below = np.zeros((n, n)), np.zeros(n), np.zeros(n)
    for j in range(n):
        moved = state.copy()
        moved[j] = state[j] + steps[j]
        right_hand_side(moved, command, model, work, above)
        moved[j] = state[j] - steps[j]
        right_hand_side(moved, command, model, work, below)
        jacobian[:, j] = (above - below) / (2.0 * steps[j])
    return jacobian


def check_step(model: Model, state: Array, step: float, names: Sequence[str] = COORDINATES) -> None:
    """Raise ConfigurationError when ``step`` (s) is too long for the arm's own vibrations at ``state``.

    ``names`` (n,) are those of the chain's coordinates. An arm with more of them than the plain one is looked
    at over the strokes of lift and tilt: its fast motions lie between neighbours and change with the pose.
    """
    parts = _flank_rates(model, state)
    for i, name in enumerate(JOINTS):
        parts[f"the end stop of {name} acts"] = _stop_rate(model, state, i)
    whole = dict(_vibration(model, pose, names) for pose in _poses(model, state))
    for rates in (parts, whole):  # a part by itself says more than the motion it takes part in
        reason, rate = max(rates.items(), key=lambda item: item[1])
        limit = RUNGE_KUTTA_REACH / rate
        if step > limit:
            raise ConfigurationError(
                "configuration.unstable_step",
                f"step_ms = {step * 1e3:g}: must not exceed {limit * 1e3:.4f}, {reason} at {rate:.0f} rad/s",
            )


def _poses(model: Model, state: Array) -> Iterator[Array]:
    """``state``; with more than the plain coordinates also at the ends of lift's and tilt's strokes."""
    yield state
    if model.places.clock < 0:
        return
    (lift, tilt), rows = model.places.angle[model.places.joint[1:3]], model.actuators[1:3]
    ends = [_stroke_ends(row, float(state[joint])) for row, joint in zip(rows, (lift, tilt), strict=True)]
    for angles in product(*ends):
        pose = state.copy()
        pose[[lift, tilt]] = angles
        yield pose


def _stroke_ends(row: Array, angle: float) -> tuple[float, float]:
    """The joint's angles (rad) near either end of its stroke, on the side of the linkage where it is now."""
    link, found = row[col.A_KIND : col.A_LENGTH0 + 1], []
    grid = angle + np.linspace(-np.pi, np.pi, 721)
    inside = [0.0 <= actuator_position(float(a), *link) <= row[col.A_STROKE] for a in grid]
    for step in (-1, 1):
        k = 360
        while 0 <= k + step < 721 and inside[k + step]:
            k += step
        found.append(float(grid[k]))
    return found[0], found[1]


def _vibration(model: Model, state: Array, names: Sequence[str]) -> tuple[str, float]:
    """The fastest motion at ``state``: in words, and its rate (1/s)."""
    found, shapes = np.linalg.eig(linearised(model, state, np.zeros(N_ACTUATORS)))
    fastest = int(np.argmax(np.abs(found)))
    moving = names[int(np.argmax(np.abs(shapes[model.places.rate, fastest])))]
    return f"the arm vibrates (most in {moving})", float(np.abs(found[fastest]))


def _flank_rates(model: Model, state: Array) -> dict[str, float]:
    """How fast (1/s) the flanks of what is loose push, by what they belong to."""
    mesh, tilt, rates = model.loose.mesh, model.loose.tilt, {}
    if mesh[loose.M_AT] >= 0.0:
        at = [int(mesh[loose.M_AT])]
        rates["a flank of errors.loose_slew pushes (contact_nm_rad, contact_damping_nm_s_rad)"] = _rate_of(
            model, state, at, *mesh[[loose.M_STIFFNESS, loose.M_DAMPING]]
        )
    if tilt[loose.T_AT] >= 0.0:
        at = [int(tilt[loose.T_AT]), int(tilt[loose.T_AT]) + 1]
        rates["the ring of errors.bearing_tilt pushes (stiffness_nm_rad, damping_nm_s_rad)"] = _rate_of(
            model, state, at, *tilt[[loose.T_STIFFNESS, loose.T_DAMPING]]
        )
    return rates


def _rate_of(model: Model, state: Array, at: list[int], stiffness: float, damping: float) -> float:
    """How fast (1/s) a spring with a damper acts at coordinates ``at``, everything else free to give way."""
    gives = mobility(model.mechanism, state[model.places.angle], at, held=False)
    most = float(np.max(np.linalg.eigvalsh(0.5 * (gives + gives.T))))
    return max(math.sqrt(stiffness * most), damping * most)


def _stop_rate(model: Model, state: Array, i: int) -> float:
    """How fast (1/s) actuator ``i`` would rebound or brake at its end stop, its lever at the longest."""
    row = model.actuators[i]
    lever = 1.0 if row[col.A_KIND] == ROTARY else min(float(row[col.A_BASE]), float(row[col.A_LEVER]))
    at, square = [int(model.places.joint[i])], lever * lever
    return _rate_of(
        model, state, at, square * float(row[col.A_STOP_STIFFNESS]), square * float(row[col.A_STOP_DAMPING])
    )
