"""Recordings from the emulator: the plant alone under given valve words, no controller in between."""

import numpy as np

from foundation.configuration import configuration_hash
from plant_emulator.config.plant import PlantConfig
from plant_emulator.config.units import BAR
from plant_emulator.core.layout import N_ACTUATORS
from plant_emulator.core.plant import Plant
from plant_emulator.core.sensors import COUNTS_PER_RADIAN
from protocol.process_image import CONTROL_ENABLE, ValveImage
from testbed.identification.checks import Machine
from testbed.identification.excitation import Piece, seconds, words
from testbed.identification.recording import About, Array, MotionRecording, hex_hash

PERIOD_S = 0.01
FINE_STEP_MS = 0.2  # [D] other than the fit's, so that no error of integration is shared
PRESSURE_NOISE_BAR = 0.1  # [E] rms of a 250 bar transducer with 12 usable bits behind its filter


def record(
    config: PlantConfig, machine: Machine, pieces: list[Piece], held_out: list[Piece], seed: int
) -> MotionRecording:
    """What sensors tell while the plant ``config`` is driven through ``pieces``, then ``held_out``.

    The first of ``pieces`` is a rest. Encoders are as configured, pressures have white noise of
    ``PRESSURE_NOISE_BAR``; ``seed`` draws all of it.
    """
    valves = words([*pieces, *held_out], PERIOD_S)
    plant, noise = Plant(config, seed), np.random.default_rng([seed, 1])
    rows = []
    for k, row in enumerate(valves):
        image = plant.read()
        rows.append(
            [
                *image.encoder_counts,
                *np.ravel(image.pressures_bar),
                image.supply_bar,
                image.oil_temperature_degc,
            ]
        )
        a, b, c, d, e, f = row
        plant.write(ValveImage(k + 1, CONTROL_ENABLE, (a, b, c, d, e, f)))
        plant.advance(round(PERIOD_S * 1e9))
    told: Array = np.array(rows, dtype=np.float64)
    told[:, 6:19] += PRESSURE_NOISE_BAR * noise.standard_normal((len(told), 13))
    about = About(
        arm=machine.arm,
        arm_hash=machine.arm_hash,
        valve_set=machine.valve_set,
        plant_hash=hex_hash(configuration_hash(config)),
        rest_s=pieces[0].seconds,
        held_out_from_s=round(seconds(pieces), 6),
        note=f"emulated, seed {seed}",
    )
    return MotionRecording(
        about,
        np.arange(len(told), dtype=np.float64) * PERIOD_S,
        valves,
        told[:, :6] / COUNTS_PER_RADIAN,
        told[:, 6:18].reshape(-1, N_ACTUATORS, 2) * BAR,
        told[:, 18] * BAR,
        told[:, 19],
    )
