"""The compiled plant itself, run along a recording's valve words from the state that the sensors tell.

What sensors tell is put into the plant at the start, and again at every restart of a window: angles and
rates of the driven joints, chamber and supply pressures. What no sensor tells (bent hinges, bristles, spools)
begins at rest and is carried on from window to window.
"""

from typing import NamedTuple

import numpy as np
from scipy.signal import savgol_filter

from plant_emulator.config.plant import PlantConfig
from plant_emulator.config.units import BAR
from plant_emulator.core import columns as col
from plant_emulator.core.layout import (
    BRISTLE,
    DRIVEN,
    N_ACTUATORS,
    PRESSURE_A,
    PRESSURE_B,
    RATE,
    SUPPLY,
    Q,
)
from plant_emulator.core.plant import Plant
from plant_emulator.core.right_hand_side import EncoderShafts
from protocol.process_image import CONTROL_ENABLE, ValveImage
from testbed.identification.drive import drive_of
from testbed.identification.recording import Array, MotionRecording

N_SIGNALS = 3 * N_ACTUATORS + 1
"""Of a prediction: six angles (rad), chambers a and b of each joint (Pa), supply (Pa)."""
_SMOOTHING = 7  # samples of a local cubic


class Start(NamedTuple):
    """The state of rest that a recording begins with, averaged: ``angles`` (6,) rad as the encoders tell,
    ``pressures`` (6, 2) and ``supply`` Pa; and where the encoders' shafts stand in their play (6,) rad."""

    angles: Array
    pressures: Array
    supply: float
    oil_degc: float
    in_play: Array


class Smoothed(NamedTuple):
    """What a recording tells at each of its n samples, noise filtered: for restarts and derivatives."""

    angles: Array  # (n, 6) rad
    rates: Array  # (n, 6) rad/s
    pressures: Array  # (n, 6, 2) Pa
    pressure_rates: Array  # (n, 6, 2) Pa/s
    supply: Array  # (n,) Pa


def start_of(recording: MotionRecording) -> Start:
    """The averages over the rest that ``recording`` begins with."""
    rest = recording.part(0.0, recording.time_s[0] + recording.about.rest_s)
    return Start(
        rest.angles.mean(axis=0),
        rest.pressures.mean(axis=0),
        float(rest.supply.mean()),
        float(rest.oil_degc.mean()),
        np.zeros(N_ACTUATORS),
    )


def smoothed(recording: MotionRecording) -> Smoothed:
    """Local cubics through the samples (Savitzky and Golay 1964), and their derivatives."""

    def through(values: Array, derivative: int = 0) -> Array:
        return np.asarray(
            savgol_filter(values, _SMOOTHING, 3, deriv=derivative, delta=recording.period_s, axis=0)
        )

    return Smoothed(
        through(recording.angles),
        through(recording.angles, 1),
        through(recording.pressures),
        through(recording.pressures, 1),
        through(recording.supply),
    )


def measured(recording: MotionRecording) -> Array:
    """The signals (n, N_SIGNALS) that a prediction is compared with."""
    n = len(recording.time_s)
    flat = recording.pressures.reshape(n, 2 * N_ACTUATORS)
    return np.column_stack([recording.angles, flat, recording.supply])


def predicted(
    config: PlantConfig,
    recording: MotionRecording,
    start: Start,
    told: Smoothed | None = None,
    window_s: float = 0.0,
) -> Array:
    """The signals (n, N_SIGNALS) of the plant ``config`` under the recording's valve words, without noise.

    From ``start`` on in one run; with ``told``, a new window begins at the measured state every ``window_s``.
    Raises ConfigurationError where the plant cannot stand at the start.
    """
    offsets = np.asarray(config.errors.encoder_offsets.mrad) * 1e-3
    times_ns = np.rint((recording.time_s - recording.time_s[0]) * 1e9).astype(np.int64)
    drive = drive_of(config)
    targets = drive.targets(recording.valves)
    plant, shafts = _plant_at(drive.rest, start, offsets)
    signals, n = np.zeros((len(times_ns), N_SIGNALS)), len(times_ns)
    every = max(round(window_s / recording.period_s), 1) if told is not None else n
    step_ns, before = round(config.step_ms * 1e6), np.zeros(N_ACTUATORS)
    for k in range(n):
        if told is not None and k > 0 and k % every == 0:
            _restart(plant.state, shafts, told, k, offsets)
        _read(plant.state, shafts, offsets, signals[k])
        if k + 1 < n:
            words, left_ns = targets[k], int(times_ns[k + 1] - times_ns[k])
            first = drive.after_a_part(before, words)
            if np.any(first != words):
                _write(plant, 2 * k + 1, first)
                plant.advance(step_ns)
                left_ns -= step_ns
            _write(plant, 2 * k + 2, words)
            plant.advance(left_ns)
            before = words
    return signals


def _write(plant: Plant, cycle: int, words: Array) -> None:
    a, b, c, d, e, f = words
    plant.write(ValveImage(cycle, CONTROL_ENABLE, (a, b, c, d, e, f)))


def _plant_at(config: PlantConfig, start: Start, offsets: Array) -> tuple[Plant, EncoderShafts]:
    """A plant at rest as ``start`` tells; friction carries what pressures and load leave over."""
    at = start.angles - offsets
    pose = np.degrees(at - start.in_play).tolist()
    oil = config.oil.model_copy(update={"temperature_degc": start.oil_degc})
    pump = config.pump.model_copy(update={"pressure_bar": start.supply / BAR})
    plant = Plant(config.model_copy(update={"start_pose_deg": tuple(pose), "oil": oil, "pump": pump}), seed=0)
    state, table = plant.state, plant.model.actuators
    load = _push(plant)  # what the arm needs at rest
    state[PRESSURE_A : PRESSURE_B + N_ACTUATORS] = start.pressures.T.ravel()
    push = _push(plant)
    stiff = table[:, col.A_BRISTLE]
    held = np.clip(push - load, -table[:, col.A_STATIC], table[:, col.A_STATIC])
    state[BRISTLE : BRISTLE + N_ACTUATORS] = np.divide(
        held, stiff, out=np.zeros(N_ACTUATORS), where=stiff > 0.0
    )
    plant.shafts.angle[:] = at
    return plant, plant.shafts


def _read(state: Array, shafts: EncoderShafts, offsets: Array, signal: Array) -> None:
    signal[:N_ACTUATORS] = shafts.angle + offsets
    chambers = state[PRESSURE_A : PRESSURE_B + N_ACTUATORS].reshape(2, N_ACTUATORS)
    signal[N_ACTUATORS : 3 * N_ACTUATORS] = chambers.T.ravel()
    signal[-1] = state[SUPPLY]


def _restart(state: Array, shafts: EncoderShafts, told: Smoothed, k: int, offsets: Array) -> None:
    """Put what the sensors tell at sample ``k`` into the plant; play and bristles stay as they are."""
    driven = [Q + joint for joint in DRIVEN]
    shift = told.angles[k] - offsets - shafts.angle
    shafts.angle[:] += shift
    state[driven] += shift
    state[[RATE + joint for joint in DRIVEN]] = told.rates[k]
    state[PRESSURE_A : PRESSURE_B + N_ACTUATORS] = told.pressures[k].T.ravel()
    state[SUPPLY] = told.supply[k]


def standing_push(config: PlantConfig, pose: Array) -> Array:
    """What the arm asks of its actuators (6,) at rest at ``pose`` (6,) rad: p_a A_a − p_b A_b, N or N m.

    Raises ConfigurationError where the arm cannot stand there.
    """
    plant = Plant(config.model_copy(update={"start_pose_deg": tuple(np.degrees(pose).tolist())}), seed=0)
    return _push(plant)


def _push(plant: Plant) -> Array:
    chambers = plant.state[PRESSURE_A : PRESSURE_B + N_ACTUATORS].reshape(2, N_ACTUATORS)
    table = plant.model.actuators
    return np.asarray(chambers[0] * table[:, col.A_AREA_A] - chambers[1] * table[:, col.A_AREA_B])
