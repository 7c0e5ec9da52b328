"""The plant's one right-hand side and its integration: compiled, on flat arrays, free of allocation."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.compiled import allocation_free
from plant_emulator.core import layout as col
from plant_emulator.core.hydraulics.oil_rates import JOINT, add_oil
from plant_emulator.core.hydraulics.valve_commands import ValveTargets, slew_limited, take
from plant_emulator.core.layout import N_ACTUATORS, Q, state_size
from plant_emulator.core.mechanics.loose import add_looseness
from plant_emulator.core.mechanics.multibody import MultibodyWork, forward_dynamics, multibody_work
from plant_emulator.core.model import Model

Array = NDArray[np.float64]


class Work(NamedTuple):
    """Scratch memory of one plant of n coordinates.

    The latest evaluation leaves behind ``angle`` and ``turn`` (n,) of the chain, base first, and in ``flows``
    (6, F_COLUMNS) what it found of the oil.
    """

    multibody: MultibodyWork
    angle: Array  # (n,)
    turn: Array  # (n,)
    force: Array  # (n,)
    acceleration: Array  # (n,)
    flows: Array  # (6, F_COLUMNS)
    command: Array  # (6,)
    slope: Array  # (4, states)
    stage: Array  # (states,)


class EncoderShafts(NamedTuple):
    """``angle`` (6,) of each encoder shaft, which its joint drags along with a play ``half_play`` (6,)."""

    angle: Array
    half_play: Array


def new_work(model: Model) -> Work:
    """Fresh scratch memory for a plant of this size."""
    n, size = len(model.places.angle), state_size(model.places)
    return Work(
        multibody=multibody_work(n),
        angle=np.zeros(n),
        turn=np.zeros(n),
        force=np.zeros(n),
        acceleration=np.zeros(n),
        flows=np.zeros((N_ACTUATORS, col.F_COLUMNS)),
        command=np.zeros(N_ACTUATORS),
        slope=np.zeros((4, size)),
        stage=np.zeros(size),
    )


@allocation_free
def hydraulic_rates(state: Array, command: Array, model: Model, work: Work, rate: Array) -> None:
    """Fill the generalised force (n,) of springs, looseness and oil in ``work.force``.

    Fills the oil's and the added states' own part of ``rate`` as well.
    """
    mech, where = model.mechanism, model.places
    for i in range(work.force.shape[0]):
        work.angle[i], work.turn[i] = state[where.angle[i]], state[where.rate[i]]
        work.force[i] = -mech.stiffness[i] * work.angle[i] - mech.damping[i] * work.turn[i]
    if where.clock >= 0:
        add_looseness(state, where, model.loose, work.angle, work.turn, work.force, rate)
    add_oil(state, command, model.actuators, model.circuit, where.joint, work.force, work.flows, rate)


@allocation_free
def right_hand_side(state: Array, command: Array, model: Model, work: Work, rate: Array) -> None:
    """Fill ``rate`` (states,) with d(state)/dt at ``state`` under spool ``command`` (6,)."""
    hydraulic_rates(state, command, model, work, rate)
    forward_dynamics(work.angle, work.turn, work.force, model.mechanism, work.multibody, work.acceleration)
    where = model.places
    for i in range(work.turn.shape[0]):
        rate[where.angle[i]] = work.turn[i]
        rate[where.rate[i]] = work.acceleration[i]


@allocation_free
def runge_kutta_step(state: Array, command: Array, h: float, model: Model, work: Work) -> None:
    """One classical fourth-order step of ``state`` in place."""
    k, stage = work.slope, work.stage
    right_hand_side(state, command, model, work, k[0])
    for stage_index in range(1, 4):
        reach = h if stage_index == 3 else 0.5 * h
        for j in range(state.shape[0]):
            stage[j] = state[j] + reach * k[stage_index - 1, j]
        right_hand_side(stage, command, model, work, k[stage_index])
    for j in range(state.shape[0]):
        state[j] += h / 6.0 * (k[0, j] + 2.0 * (k[1, j] + k[2, j]) + k[3, j])


@allocation_free
def advance(
    state: Array,
    drive: Array,
    target: Array,
    encoders: EncoderShafts,
    steps: int,
    h: float,
    model: Model,
    work: Work,
) -> None:
    """Advance ``state`` in place by ``steps`` steps of ``h`` (s) under constant valve ``target`` (6,).

    ``drive`` (6,), the slew-limited command, and the encoders' angles are updated in place once a step.
    """
    shaft, half_play = encoders
    for _ in range(steps):
        for i in range(N_ACTUATORS):
            out, back = model.actuators[i, col.A_SLEW_OUT], model.actuators[i, col.A_SLEW_BACK]
            drive[i], work.command[i] = slew_limited(drive[i], target[i], out, back, h)
        runge_kutta_step(state, work.command, h, model, work)
        for i in range(N_ACTUATORS):
            angle = state[Q + JOINT[i]]
            shaft[i] = min(max(shaft[i], angle - half_play[i]), angle + half_play[i])


@allocation_free
def advance_commanded(
    state: Array,
    valves: ValveTargets,
    leaving: Array,
    encoders: EncoderShafts,
    steps: int,
    h: float,
    model: Model,
    work: Work,
) -> None:
    """``advance`` by ``steps`` while commands arrive: rows of ``leaving`` (n, 3) are step, valve, command.

    A command acts from the start of its step on; rows are in order, their steps below ``steps``.
    """
    done = 0
    for k in range(leaving.shape[0]):
        step = int(leaving[k, 0])
        if step > done:
            advance(state, valves.drive, valves.spool, encoders, step - done, h, model, work)
            done = step
        take(valves, int(leaving[k, 1]), leaving[k, 2])
    advance(state, valves.drive, valves.spool, encoders, steps - done, h, model, work)
