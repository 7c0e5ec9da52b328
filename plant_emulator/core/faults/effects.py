"""What faults in force do to oil, load and encoders: pure functions that the plant applies."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from plant_emulator.core import layout as col
from plant_emulator.core.faults.kinds import (
    AnyFault,
    EncoderBias,
    EncoderJump,
    EncoderStuck,
    JointFault,
    ObjectMoves,
    OwnFault,
    PayloadChange,
    PayloadDrop,
    SupplyLost,
    ValveSlow,
    ValveStuck,
    ValvesWorn,
)
from plant_emulator.core.faults.schedule import Injection
from plant_emulator.core.layout import N_ACTUATORS, SPOOL_RATE
from plant_emulator.core.model import Model
from protocol.errors import RequestRefused

Array = NDArray[np.float64]
MOST_KG = 1000.0
_SIX = (N_ACTUATORS,)


def break_hydraulics(
    active: Sequence[Injection], now_ns: int, model: Model, healthy: Array, state: Array
) -> float:
    """How many times as wide as built the valves' hysteresis is at ``now_ns``; what else valves and pump are
    like is written into ``model`` and ``state``.

    ``healthy`` (6, A_COLUMNS): the actuators as built. A stuck spool has no natural frequency, and no rate.
    """
    omega, wider = model.actuators[:, col.A_OMEGA], 1.0
    model.actuators[:] = healthy
    model.circuit[col.C_RUNNING] = 1.0
    for injection in active:
        fault = injection.fault
        if isinstance(fault, ValveStuck):
            omega[fault.index] = 0.0
            state[SPOOL_RATE + fault.index] = 0.0
        elif isinstance(fault, ValveSlow):
            omega[fault.index] *= fault.bandwidth_share
        elif isinstance(fault, ValvesWorn):
            edges = len(col.EDGES)
            model.actuators[:, col.A_DEADBAND : col.A_DEADBAND + edges] *= fault.deadband_share
            model.actuators[:, col.A_GAIN + edges // 2 : col.A_GAIN + edges] *= fault.lowering_flow_share
            wider *= fault.hysteresis_share
        elif isinstance(fault, SupplyLost):
            model.circuit[col.C_RUNNING] = 0.0
        elif isinstance(fault, OwnFault):
            elapsed_s = injection.elapsed_s(now_ns)
            omega *= _taken(fault, "valve_speed", fault.valve_speed(elapsed_s), 0.0, 1.0)
            state[SPOOL_RATE : SPOOL_RATE + N_ACTUATORS][omega == 0.0] = 0.0
            if not fault.pump_runs(elapsed_s):
                model.circuit[col.C_RUNNING] = 0.0
    return wider


def joints_with(kind: type[JointFault], faults: Sequence[AnyFault]) -> list[int]:
    """The joints that have a fault of this kind."""
    return [fault.index for fault in faults if isinstance(fault, kind)]


def load_kg(active: Sequence[Injection], now_ns: int, healthy_kg: float) -> float:
    """The load at the tool (kg); of several faults that change it the latest counts."""
    load = healthy_kg
    for injection in active:
        fault = injection.fault
        if isinstance(fault, PayloadDrop):
            load = 0.0
        elif isinstance(fault, PayloadChange):
            load = fault.mass_kg
        elif isinstance(fault, OwnFault):
            load = _load_kg(fault, injection.elapsed_s(now_ns), load)
    return load


def object_shift_m(active: Sequence[Injection], now_ns: int) -> Array:
    """How far (3,), m, the object has slid along its own axes."""
    slid = np.zeros(3)
    for injection in active:
        fault = injection.fault
        if isinstance(fault, ObjectMoves):
            slid["xyz".index(fault.axis)] += 1e-3 * fault.speed_mm_s * injection.elapsed_s(now_ns)
    return slid


def sensor_fault_reported(faults: Sequence[AnyFault]) -> bool:
    """Whether the plant itself knows that a sensor is broken."""
    return any(isinstance(fault, EncoderStuck) and fault.reported for fault in faults)


def encoder_shift(active: Sequence[Injection], now_ns: int) -> Array:
    """How far (6,), in radians, the encoders' readings are off at ``now_ns``."""
    shift = np.zeros(N_ACTUATORS)
    for injection in active:
        fault = injection.fault
        if isinstance(fault, EncoderJump):
            shift[fault.index] += 1e-3 * fault.angle_mrad
        elif isinstance(fault, EncoderBias):
            grown = min(injection.elapsed_s(now_ns) / fault.ramp_s, 1.0)
            shift[fault.index] += 1e-3 * fault.angle_mrad * grown
        elif isinstance(fault, OwnFault):
            shift += _taken(
                fault, "encoder_shift", fault.encoder_shift(injection.elapsed_s(now_ns)), -1.0, 1.0
            )
    return shift


def try_out(fault: OwnFault) -> None:
    """Ask a foreign disturbance for all its effects once, before it is let loose on the plant.

    Raises RequestRefused (``refused.disturbance``).
    """
    try:
        _taken(fault, "encoder_shift", fault.encoder_shift(0.0), -1.0, 1.0)
        _taken(fault, "valve_speed", fault.valve_speed(0.0), 0.0, 1.0)
        _load_kg(fault, 0.0, 0.0)
        fault.pump_runs(0.0)
    except RequestRefused:
        raise
    except Exception as error:  # foreign code
        why = f"{fault.name}: {type(error).__name__}: {error}"
        raise RequestRefused("refused.disturbance", why) from error


def _taken(
    fault: OwnFault, what: str, values: Array | float, low: float, high: float, shape: tuple[int, ...] = _SIX
) -> Array:
    """``values`` of a foreign method; raises RequestRefused for what no plant takes."""
    found = np.asarray(values, dtype=np.float64)
    if found.shape != shape or not np.all((found >= low) & (found <= high)):
        wanted = f"wanted {'six numbers in ' if shape else ''}{low:g} to {high:g}"
        raise RequestRefused("refused.disturbance", f"{fault.name}: {what} gave {found.tolist()}: {wanted}")
    return found


def _load_kg(fault: OwnFault, elapsed_s: float, load_kg: float) -> float:
    return float(_taken(fault, "load_kg", fault.load_kg(elapsed_s, load_kg), 0.0, MOST_KG, ()))
