"""The plant's one right-hand side, and its fixed-step Runge-Kutta integration; compiled, on flat arrays, without allocation."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from plant_emulator.core.chambers import bulk_modulus, relief_flow
from plant_emulator.core.friction import bristle_rate, friction_force, steady_level
from plant_emulator.core.layout import (
    BRISTLE,
    N_ACTUATORS,
    N_COORDINATES,
    N_STATES,
    PRESSURE_A,
    PRESSURE_B,
    RATE,
    SPOOL,
    SPOOL_RATE,
    SUPPLY,
    TEMPERATURE,
    Q,
)
from plant_emulator.core.linkage import actuator_lever, actuator_position
from plant_emulator.core.model import Model
from plant_emulator.core.multibody import MultibodyWork, forward_dynamics, multibody_work
from plant_emulator.core.valves import opening, orifice_flow, slew_limited, spool_acceleration

Array = NDArray[np.float64]

DRIVEN_INDEX = np.array([0, 1, 4, 7, 8, 9])

# columns of Work.flows
FLOW_A, FLOW_B, FLOW_SUPPLY, FORCE, FRICTION, POSITION, VELOCITY, STOP = range(8)
N_FLOWS = 8


class Work(NamedTuple):
    """Scratch memory of one plant. After an evaluation ``flows`` (6, 8) holds, per actuator, net flow into chamber a and b
    (m³/s), flow taken from the supply, pressure force, friction force, position, velocity and end-stop force."""

    multibody: MultibodyWork
    force: Array  # (10,)
    acceleration: Array  # (10,)
    flows: Array  # (6, 8)
    slope: Array  # (4, N_STATES)
    stage: Array  # (N_STATES,)


def new_work() -> Work:
    """Fresh scratch memory."""
    return Work(
        multibody_work(N_COORDINATES), np.zeros(N_COORDINATES), np.zeros(N_COORDINATES),
        np.zeros((N_ACTUATORS, N_FLOWS)), np.zeros((4, N_STATES)), np.zeros(N_STATES),
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _actuator(i: int, state: Array, command: float, model: Model, work: Work, rate: Array) -> None:
    """Rates of spool, chambers and bristle of actuator ``i``, and its torque on the joint."""
    oil, line, link = model.hydraulics.oil, model.hydraulics.supply, model.hydraulics.linkage[i]
    body, valve, seal = model.hydraulics.cylinder[i], model.hydraulics.valve[i], model.hydraulics.friction[i]
    joint, out = DRIVEN_INDEX[i], work.flows[i]
    angle, turn = state[Q + joint], state[RATE + joint]
    y = actuator_position(angle, link[0], link[1], link[2], link[3], link[4])
    lever = actuator_lever(angle, link[0], link[1], link[2], link[3], link[4])
    v = lever * turn
    p_a, p_b, p_s, p_t, delta = state[PRESSURE_A + i], state[PRESSURE_B + i], state[SUPPLY], line[1], line[8]
    warmer = state[TEMPERATURE] - oil[3]
    thinner = math.exp(oil[4] * warmer)
    modulus = oil[0] * (1.0 - oil[5] * warmer)

    spool, spool_rate = state[SPOOL + i], state[SPOOL_RATE + i]
    rate[SPOOL + i] = spool_rate
    rate[SPOOL_RATE + i] = spool_acceleration(command, spool, spool_rate, valve[2], valve[3])

    gain = valve[0] * opening(spool, valve[1])
    if gain >= 0.0:
        in_a = orifice_flow(gain, p_s - p_a, delta)
        in_b = -orifice_flow(gain, p_b - p_t, delta)
        drawn = in_a
    else:
        in_a = orifice_flow(gain, p_a - p_t, delta)
        in_b = -orifice_flow(gain, p_s - p_b, delta)
        drawn = in_b
    leak = body[5] * thinner * (p_a - p_b)
    in_a -= leak + relief_flow(p_a, line[7], valve[5])
    in_b += leak - relief_flow(p_b, line[7], valve[5])
    if p_a < p_t:
        in_a += orifice_flow(valve[6], p_t - p_a, delta)
    if p_b < p_t:
        in_b += orifice_flow(valve[6], p_t - p_b, delta)
    volume_a = body[2] + body[0] * y
    volume_b = body[3] + body[1] * (body[4] - y)
    stiff_a = bulk_modulus(p_a, volume_a, modulus, body[8], oil[1], oil[2])
    stiff_b = bulk_modulus(p_b, volume_b, modulus, body[8], oil[1], oil[2])
    rate[PRESSURE_A + i] = stiff_a * (in_a - body[0] * v) / volume_a
    rate[PRESSURE_B + i] = stiff_b * (in_b + body[1] * v) / volume_b

    bristle = state[BRISTLE + i]
    z_rate = bristle_rate(v, bristle, steady_level(v, seal[0], seal[1], seal[2]), seal[3])
    rate[BRISTLE + i] = z_rate
    friction = friction_force(v, bristle, z_rate, seal[3], seal[4], seal[5] / thinner)
    stop = 0.0
    if y < 0.0:
        stop = max(-body[6] * y - body[7] * v, 0.0)
    elif y > body[4]:
        stop = -max(body[6] * (y - body[4]) + body[7] * v, 0.0)
    push = p_a * body[0] - p_b * body[1]
    work.force[joint] = (push - friction + stop) * lever
    out[FLOW_A], out[FLOW_B], out[FLOW_SUPPLY], out[FORCE] = in_a, in_b, drawn, push
    out[FRICTION], out[POSITION], out[VELOCITY], out[STOP] = friction, y, v, stop


@njit(cache=True, error_model="numpy")
def _supply(state: Array, model: Model, work: Work, rate: Array) -> None:
    """Rates of supply pressure and oil temperature."""
    oil, line = model.hydraulics.oil, model.hydraulics.supply
    p_s, drawn, delivered = state[SUPPLY], 0.0, 0.0
    for i in range(N_ACTUATORS):
        drawn += work.flows[i, FLOW_SUPPLY]
        delivered += work.flows[i, FORCE] * work.flows[i, VELOCITY]
    if line[6] > 0.0:
        pumped = min(max(line[3] * (line[0] - p_s), 0.0), line[2])
    else:
        pumped = -orifice_flow(line[5], p_s - line[1], line[8])
    net = pumped - drawn - relief_flow(p_s, line[7], line[3])
    modulus = oil[0] * (1.0 - oil[5] * (state[TEMPERATURE] - oil[3]))
    rate[SUPPLY] = bulk_modulus(p_s, line[4], modulus, 0.0, oil[1], oil[2]) * net / line[4]
    rate[TEMPERATURE] = 0.0
    if line[9] > 0.0:
        heat = p_s * max(pumped, 0.0) - delivered
        rate[TEMPERATURE] = heat / line[9] - oil[6] * (state[TEMPERATURE] - oil[7])


@njit(cache=True, error_model="numpy")
def right_hand_side(state: Array, command: Array, model: Model, work: Work, rate: Array) -> None:
    """Fill ``rate`` (N_STATES,) with d(state)/dt at ``state`` under spool ``command`` (6,)."""
    mech, turn = model.mechanism, state[RATE : RATE + N_COORDINATES]
    angle = state[Q : Q + N_COORDINATES]
    for i in range(N_COORDINATES):
        work.force[i] = -mech.stiffness[i] * angle[i] - mech.damping[i] * turn[i]
    for i in range(N_ACTUATORS):
        _actuator(i, state, command[i], model, work, rate)
    _supply(state, model, work, rate)
    forward_dynamics(angle, turn, work.force, mech, work.multibody, work.acceleration)
    for i in range(N_COORDINATES):
        rate[Q + i] = turn[i]
        rate[RATE + i] = work.acceleration[i]


@njit(cache=True, error_model="numpy")
def advance(
    state: Array, drive: Array, target: Array, play: Array, half_play: Array, steps: int, h: float, model: Model, work: Work
) -> None:
    """Advance ``state`` in place by ``steps`` Runge-Kutta steps of ``h`` (s) under constant valve ``target`` (6,).

    ``drive`` (6,) is the slew-limited command, ``play`` (6,) the angle of each encoder's shaft, which follows its joint
    with a play of ``half_play``; both are updated once a step.
    """
    k, stage = work.slope, work.stage
    for _ in range(steps):
        for i in range(N_ACTUATORS):
            drive[i] = slew_limited(drive[i], target[i], model.hydraulics.valve[i, 4] * h)
        right_hand_side(state, drive, model, work, k[0])
        for j in range(N_STATES):
            stage[j] = state[j] + 0.5 * h * k[0, j]
        right_hand_side(stage, drive, model, work, k[1])
        for j in range(N_STATES):
            stage[j] = state[j] + 0.5 * h * k[1, j]
        right_hand_side(stage, drive, model, work, k[2])
        for j in range(N_STATES):
            stage[j] = state[j] + h * k[2, j]
        right_hand_side(stage, drive, model, work, k[3])
        for j in range(N_STATES):
            state[j] += h / 6.0 * (k[0, j] + 2.0 * (k[1, j] + k[2, j]) + k[3, j])
        for i in range(N_ACTUATORS):
            angle = state[Q + DRIVEN_INDEX[i]]
            play[i] = min(max(play[i], angle - half_play[i]), angle + half_play[i])
