"""The state of rest from which a plant starts: hinges bent, oil carrying the load, nothing moving."""

import math

import numpy as np
from numpy.typing import NDArray

from plant_emulator.config.units import BAR
from plant_emulator.core import columns as col
from plant_emulator.core.layout import (
    DRIVEN,
    FLEXIBLE,
    JOINTS,
    N_ACTUATORS,
    N_COORDINATES,
    N_STATES,
    PRESSURE_A,
    PRESSURE_B,
    SUPPLY,
    TEMPERATURE,
    Q,
)
from plant_emulator.core.mechanics.linkage import actuator_lever, actuator_position
from plant_emulator.core.mechanics.multibody import Mechanism, forward_kinematics, multibody_work
from plant_emulator.core.model import Model
from protocol.errors import ConfigurationError

Array = NDArray[np.float64]


def gravity_torque(mechanism: Mechanism, q: Array) -> Array:
    """Generalised gravity force (10,) at pose ``q``: Σ axis · (r × m g) over the bodies behind."""
    work = multibody_work(N_COORDINATES)
    forward_kinematics(q, mechanism, work)
    rotation, origin = work.rotation, work.origin
    centre = np.einsum("irc,ic->ir", rotation[1:], mechanism.centre) + origin[1:]
    axis = np.einsum("irc,ic->ir", rotation[:-1], mechanism.axis)
    point = np.einsum("irc,ic->ir", rotation[:-1], mechanism.point) + origin[:-1]
    torque = np.zeros(N_COORDINATES)
    for i in range(N_COORDINATES):
        arm = centre[i:] - point[i]
        torque[i] = axis[i] @ np.cross(arm, mechanism.mass[i:, None] * mechanism.gravity).sum(axis=0)
    return torque


def bent_pose(mechanism: Mechanism, q: Array) -> Array:
    """``q`` (10,) with its flexible hinges where stiffness balances gravity."""
    q = q.copy()
    flexible = [i for i in FLEXIBLE if mechanism.free[i] > 0.0]
    for _ in range(200):
        bent = gravity_torque(mechanism, q)[flexible] / mechanism.stiffness[flexible]
        change = float(np.max(np.abs(bent - q[flexible]), initial=0.0))
        q[flexible] = bent
        if change < 1e-15:
            return q
    if change < 1e-12:
        return q
    raise ConfigurationError(
        "configuration.no_equilibrium",
        f"flexibility: the arm does not come to rest, its hinges still move by {change:g} rad",
    )


def _check_stroke(row: Array, angle: float, joint: str) -> None:
    """Raise ConfigurationError when the joint's actuator would stand outside its stroke."""
    position, stroke = (
        float(actuator_position(angle, *row[col.A_KIND : col.A_LENGTH0 + 1])),
        float(row[col.A_STROKE]),
    )
    if not 0.0 <= position <= stroke:
        raise ConfigurationError(
            "configuration.outside_stroke",
            f"start_pose_deg: {joint} at {math.degrees(angle):g} puts its actuator at {position:.4f}, "
            f"outside its stroke of 0 to {stroke:.4f}",
        )


def rest_state(model: Model, q: Array, temperature: float) -> Array:
    """The full state (N_STATES,) at rest at pose ``q`` (10,), spools centred and friction unloaded.

    Raises ConfigurationError when a load is beyond what the supply can carry.
    """
    state = np.zeros(N_STATES)
    bent = bent_pose(model.mechanism, q)
    state[Q : Q + N_COORDINATES] = bent
    torque = -gravity_torque(model.mechanism, bent)[list(DRIVEN)]
    low, high = float(model.circuit[col.C_RETURN]), float(model.circuit[col.C_SET])
    for i in range(N_ACTUATORS):
        row = model.actuators[i]
        _check_stroke(row, float(bent[DRIVEN[i]]), JOINTS[i])
        lever = actuator_lever(bent[DRIVEN[i]], *row[col.A_KIND : col.A_LENGTH0 + 1])
        force = torque[i] / lever
        area_a, area_b = row[col.A_AREA_A], row[col.A_AREA_B]
        if row[col.A_SPOOL_LEAKAGE] > 0.0:  # a closed centre, past which both chambers drain to the return
            p_a = max(low, (force + low * area_b) / area_a)
        else:  # a matched valve at its centre shares the supply between both chambers
            p_a = (force + (low + high) * area_b) / (area_a + area_b)
            p_a = min(max(p_a, low, (force + low * area_b) / area_a), high)
        p_b = (p_a * area_a - force) / area_b
        if not low * 0.999 <= p_b <= high * 1.001:
            raise ConfigurationError(
                "configuration.overload",
                f"start_pose_deg: {JOINTS[i]} needs {force:.0f} N (N m), beyond {high / BAR:g} bar",
            )
        state[PRESSURE_A + i], state[PRESSURE_B + i] = p_a, p_b
    state[SUPPLY] = high
    state[TEMPERATURE] = temperature
    return state
