"""What faults in force do to oil, load and encoders: pure functions that the plant applies."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from plant_emulator.core import columns as col
from plant_emulator.core.faults.kinds import (
    EncoderBias,
    EncoderJump,
    EncoderStuck,
    Fault,
    PayloadChange,
    PayloadDrop,
    SupplyLost,
    ValveSlow,
    ValveStuck,
)
from plant_emulator.core.faults.schedule import Injection
from plant_emulator.core.layout import N_ACTUATORS, SPOOL_RATE
from plant_emulator.core.model import Model

Array = NDArray[np.float64]


def break_hydraulics(faults: Sequence[Fault], model: Model, healthy_omega: Array, state: Array) -> None:
    """Write into ``model`` and ``state`` what valves and pump are like under ``faults``.

    ``healthy_omega`` (6,): the spools' natural frequencies (rad/s). A stuck spool has none, and no rate.
    """
    omega = model.actuators[:, col.A_OMEGA]
    omega[:] = healthy_omega
    model.circuit[col.C_RUNNING] = 1.0
    for fault in faults:
        if isinstance(fault, ValveStuck):
            omega[fault.index] = 0.0
            state[SPOOL_RATE + fault.index] = 0.0
        elif isinstance(fault, ValveSlow):
            omega[fault.index] *= fault.bandwidth_share
        elif isinstance(fault, SupplyLost):
            model.circuit[col.C_RUNNING] = 0.0


def load_kg(faults: Sequence[Fault], healthy_kg: float) -> float:
    """The load at the tool (kg); of several faults that change it the latest counts."""
    load = healthy_kg
    for fault in faults:
        if isinstance(fault, PayloadDrop):
            load = 0.0
        elif isinstance(fault, PayloadChange):
            load = fault.mass_kg
    return load


def stuck_encoders(faults: Sequence[Fault]) -> set[int]:
    """The joints whose encoders repeat their count."""
    return {fault.index for fault in faults if isinstance(fault, EncoderStuck)}


def sensor_fault_reported(faults: Sequence[Fault]) -> bool:
    """Whether the plant itself knows that a sensor is broken."""
    return any(isinstance(fault, EncoderStuck) and fault.reported for fault in faults)


def encoder_shift(active: Sequence[Injection], now_ns: int) -> Array:
    """How far (6,), in radians, the encoders' readings are off at ``now_ns``."""
    shift = np.zeros(N_ACTUATORS)
    for _, fault, start_ns, _ in active:
        if isinstance(fault, EncoderJump):
            shift[fault.index] += 1e-3 * fault.angle_mrad
        elif isinstance(fault, EncoderBias):
            grown = min(1e-9 * (now_ns - start_ns) / fault.ramp_s, 1.0)
            shift[fault.index] += 1e-3 * fault.angle_mrad * grown
    return shift
