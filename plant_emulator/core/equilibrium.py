"""The state of rest from which a plant starts: hinges bent, oil carrying the load, nothing moving."""

import math

import numpy as np
from numpy.typing import NDArray

from plant_emulator.config.actuators import BAR
from plant_emulator.core import layout as col
from plant_emulator.core.layout import (
    CHAMBER_TEMPERATURE,
    JOINTS,
    LOAD_SENSE,
    N_ACTUATORS,
    PRESSURE_A,
    PRESSURE_B,
    SUPPLY,
    TEMPERATURE,
    state_size,
)
from plant_emulator.core.mechanics import loose
from plant_emulator.core.mechanics.geometry import actuator_lever, actuator_position
from plant_emulator.core.mechanics.multibody import Mechanism, forward_kinematics, multibody_work
from plant_emulator.core.model import Model
from protocol.errors import ConfigurationError

Array = NDArray[np.float64]

_TO_AND_FRO = 100  # rounds; a mesh that still goes from flank to flank finds rest on none


def gravity_torque(mechanism: Mechanism, q: Array) -> Array:
    """Generalised gravity force (n,) at pose ``q`` (n,): Σ axis · (r × m g) over the bodies behind."""
    n = q.shape[0]
    work = multibody_work(n)
    forward_kinematics(q, mechanism, work)
    rotation, origin = work.rotation, work.origin
    centre = np.einsum("irc,ic->ir", rotation[1:], mechanism.centre) + origin[1:]
    axis = np.einsum("irc,ic->ir", rotation[:-1], mechanism.axis)
    point = np.einsum("irc,ic->ir", rotation[:-1], mechanism.point) + origin[:-1]
    torque = np.zeros(n)
    for i in range(n):
        arm = centre[i:] - point[i]
        torque[i] = axis[i] @ np.cross(arm, mechanism.mass[i:, None] * mechanism.gravity).sum(axis=0)
    return torque


def standing_torque(model: Model, q: Array) -> Array:
    """Generalised force (n,) at rest at pose ``q`` (n,) of what springs and oil must hold: gravity, hoses."""
    torque, slew = gravity_torque(model.mechanism, q), int(model.places.joint[0])
    at = int(model.loose.mesh[loose.M_AT])
    if at >= 0:
        mesh = model.loose.mesh
        torque[[slew, at]] += mesh[loose.M_HOSE] - mesh[loose.M_HOSE_SPRING] * (q[slew] + q[at])
    return torque


def _on_a_flank(torque: Array, half: float, stiffness: float) -> Array:
    """Where play of ``half`` in every direction, with a spring behind it, goes under ``torque`` (k,)."""
    size = float(np.linalg.norm(torque))
    return torque * (1.0 / stiffness + (half / size if size > 0.0 else 0.0))


def _relaxed(model: Model, q: Array, flexible: list[int], held: float | None = None) -> Array:
    """``q`` (n,) with everything elastic or loose where the torques at ``q`` put it; the slew's mesh at
    ``held`` (rad) in its play.
    """
    found, torque = q.copy(), standing_torque(model, q)
    found[flexible] = torque[flexible] / model.mechanism.stiffness[flexible]
    mesh, tilt = model.loose.mesh, model.loose.tilt
    at = int(mesh[loose.M_AT])
    if at >= 0 and held is not None:
        found[at] = held
    elif at >= 0:
        found[[at]] = _on_a_flank(torque[[at]], mesh[loose.M_HALF], mesh[loose.M_STIFFNESS])
    at = int(tilt[loose.T_AT])
    if at >= 0:
        both = [at, at + 1]
        found[both] = _on_a_flank(torque[both], tilt[loose.T_HALF], tilt[loose.T_STIFFNESS])
    return found


def bent_pose(model: Model, q: Array, still: float = 1e-15) -> Array:
    """``q`` (n,) with its springs where stiffness balances gravity, and what is loose on its lower flank.

    A mesh that is pushed off either flank rests between them, held by the ring's friction. To ``still`` (rad)
    at most. Raises ConfigurationError for an arm that comes to no rest.
    """
    mechanism = model.mechanism
    flexible = [i for i in range(len(q)) if mechanism.stiffness[i] > 0.0 and mechanism.free[i] > 0.0]
    held: float | None = None
    for turn in range(200):
        bent = _relaxed(model, q, flexible, held)
        change = float(np.max(np.abs(bent - q), initial=0.0))
        if turn == _TO_AND_FRO:
            held = _between_flanks(model, q, bent)
        q = bent
        if change < still:
            return q
    if change < 1e-12:
        return q
    raise ConfigurationError(
        "configuration.no_equilibrium",
        f"flexibility: the arm does not come to rest, its hinges still move by {change:g} rad",
    )


def _between_flanks(model: Model, q: Array, other: Array) -> float | None:
    """Where in its play the slew's mesh has no torque, rad, if ``q`` and ``other`` have it on two flanks."""
    at = int(model.loose.mesh[loose.M_AT])
    if at < 0 or not q[at] * other[at] < 0.0:
        return None
    here, there = (float(standing_torque(model, pose)[at]) for pose in (q, other))
    return float(q[at] + (other[at] - q[at]) * here / (here - there))


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
    """The full state at rest at pose ``q`` (n,) of the chain, spools centred and friction unloaded.

    Raises ConfigurationError when a load is beyond what the supply can carry.
    """
    where = model.places
    state = np.zeros(state_size(where))
    bent = bent_pose(model, q)
    state[where.angle] = bent
    torque = -standing_torque(model, bent)[where.joint]
    low, high = float(model.circuit[col.C_RETURN]), float(model.circuit[col.C_SET])
    for i in range(N_ACTUATORS):
        row = model.actuators[i]
        _check_stroke(row, float(bent[where.joint[i]]), JOINTS[i])
        lever = actuator_lever(bent[where.joint[i]], *row[col.A_KIND : col.A_LENGTH0 + 1])
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
    sensing = float(model.circuit[col.C_LS_MARGIN])
    state[LOAD_SENSE] = low
    state[SUPPLY] = min(high, low + sensing) if sensing > 0.0 else high
    state[TEMPERATURE] = temperature
    state[CHAMBER_TEMPERATURE : CHAMBER_TEMPERATURE + N_ACTUATORS] = temperature
    return state
