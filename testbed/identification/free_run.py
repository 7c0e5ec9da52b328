"""The compiled plant itself, run along a recording's valve words from the state that the sensors tell.

What sensors tell is put into the plant at the start, and again at every restart of a window: angles and
rates of the driven joints, chamber and supply pressures. What no sensor tells (bent hinges, bristles, spools)
begins at rest and is carried on from window to window.
"""

from typing import NamedTuple

import numpy as np
from scipy.signal import savgol_filter

from plant_emulator.config.actuators import BAR
from plant_emulator.config.plant import PlantConfig
from plant_emulator.core import layout as col
from plant_emulator.core.equilibrium import bent_pose, standing_torque
from plant_emulator.core.layout import (
    BRISTLE,
    N_ACTUATORS,
    PRESSURE_A,
    PRESSURE_B,
)
from plant_emulator.core.mechanics.elastic import start_angles
from plant_emulator.core.mechanics.geometry import actuator_lever
from plant_emulator.core.model import build_model, put_payload
from plant_emulator.core.plant import Plant
from plant_emulator.core.right_hand_side import new_work
from testbed.identification.compiled_run import N_SIGNALS, Restarts, drive_of, run
from testbed.identification.recording import Array, MotionRecording

_SMOOTHING = 7  # samples of a local cubic


class Start(NamedTuple):
    """The state that a recording begins with: ``angles`` (6,) rad as the encoders tell, ``pressures`` (6, 2)
    and ``supply`` Pa; where the encoders' shafts stand in their play (6,) rad; by how much of one sample's
    noise an angle and a pressure of it are uncertain."""

    angles: Array
    pressures: Array
    supply: float
    oil_degc: float
    in_play: Array
    of_noise: float = 0.0


class Smoothed(NamedTuple):
    """What a recording tells at each of its n samples, noise filtered: for restarts and derivatives."""

    angles: Array  # (n, 6) rad
    rates: Array  # (n, 6) rad/s
    pressures: Array  # (n, 6, 2) Pa
    pressure_rates: Array  # (n, 6, 2) Pa/s
    supply: Array  # (n,) Pa


def start_of(recording: MotionRecording) -> Start:
    """Where the straight lines through the rest that ``recording`` begins with have their first sample.

    Lines, as shut valves do not keep a leaking joint from creeping; the supply is held by its pump.
    """
    rest = recording.part(0.0, recording.time_s[0] + recording.about.rest_s)
    n = len(rest.time_s)
    lines = np.column_stack([np.ones(n), rest.time_s - rest.time_s[0]])
    first = np.linalg.pinv(lines)[0]  # (n,) what each sample counts
    return Start(
        first @ rest.angles,
        np.tensordot(first, rest.pressures, axes=1),
        float(rest.supply.mean()),
        float(rest.oil_degc.mean()),
        np.zeros(N_ACTUATORS),
        float(np.linalg.norm(first)),
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
    smoothed: Smoothed | None = None,
    window_s: float = 0.0,
) -> Array:
    """The signals (n, N_SIGNALS) of the plant ``config`` under the recording's valve words, without noise.

    From ``start`` on in one run; with ``smoothed``, a new window begins at the measured state every
    ``window_s``.
    Raises ConfigurationError where the plant cannot stand at the start.
    """
    offsets = np.asarray(config.errors.encoder_offsets.mrad) * 1e-3
    drive = drive_of(config)
    plant, n = _plant_at(config, start, offsets), len(recording.time_s)
    if smoothed is None:
        none = np.empty((0, N_ACTUATORS))
        restarts = Restarts(0, offsets, none, none, np.empty((0, N_ACTUATORS, 2)), np.empty(0))
    else:
        every = max(round(window_s / recording.period_s), 1)
        restarts = Restarts(
            every, offsets, smoothed.angles, smoothed.rates, smoothed.pressures, smoothed.supply
        )
    words, signals = drive.along(recording), np.zeros((n, N_SIGNALS))
    h = 1e-3 * config.step_ms
    run(plant.state, plant.shafts, words, restarts, h, plant.model, new_work(plant.model), signals)
    return signals


def _plant_at(config: PlantConfig, start: Start, offsets: Array) -> Plant:
    """A plant at rest as ``start`` tells; friction carries what pressures and load leave over."""
    at = start.angles - offsets
    pose = np.degrees(at - start.in_play).tolist()
    oil = config.oil.model_copy(update={"temperature_degc": start.oil_degc})
    pump = config.pump
    if not pump.load_sensing.enabled:
        pump = pump.model_copy(update={"pressure_bar": start.supply / BAR})
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
    return plant


def standing_push(config: PlantConfig, poses: Array) -> Array:
    """What the arm asks of its actuators (m, 6) at rest at ``poses`` (m, 6) rad: p_a A_a − p_b A_b, N or N m.

    Raises ConfigurationError where its hinges do not come to rest.
    """
    model, chain, tool = build_model(config)
    put_payload(model, tool, config.payload.mass_kg, config, chain)
    joints, q = model.places.joint, start_angles(config, chain.names)
    found = np.empty(poses.shape)
    for pose, push in zip(poses, found, strict=True):
        q[joints] = pose
        q = bent_pose(model, q, 1e-9)  # from where it was bent before: poses follow each other closely
        for i, row in enumerate(model.actuators):
            push[i] = 1.0 / actuator_lever(pose[i], *row[col.A_KIND : col.A_LENGTH0 + 1])
        push *= -standing_torque(model, q)[joints]
    return found


def _push(plant: Plant) -> Array:
    chambers = plant.state[PRESSURE_A : PRESSURE_B + N_ACTUATORS].reshape(2, N_ACTUATORS)
    table = plant.model.actuators
    return np.asarray(chambers[0] * table[:, col.A_AREA_A] - chambers[1] * table[:, col.A_AREA_B])
