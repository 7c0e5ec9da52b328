"""What the fieldbus sees of the arm: 17-bit encoders on play-afflicted shafts, and pressure transducers."""

import math

import numpy as np
from numpy.typing import NDArray

from plant_emulator.core.layout import N_ACTUATORS
from plant_emulator.plant_config import ErrorsConfig
from protocol.process_image import COUNTS_PER_TURN

Array = NDArray[np.float64]

COUNTS_PER_RADIAN = COUNTS_PER_TURN / (2.0 * math.pi)


class Encoders:
    """Six absolute encoders, each with its zero offset, play and noise, and its faults."""

    def __init__(self, errors: ErrorsConfig, rng: np.random.Generator) -> None:
        self._rng = rng
        self._noise = errors.encoder_noise.rms_lsb if errors.encoder_noise.enabled else 0.0
        off = errors.encoder_offsets
        self._offset = np.asarray(off.mrad) * 1e-3 if off.enabled else np.zeros(N_ACTUATORS)
        self.bias = np.zeros(N_ACTUATORS)
        self.held: dict[int, int] = {}
        self.last: tuple[int, ...] = (0,) * N_ACTUATORS

    def read(self, shaft: Array) -> tuple[int, ...]:
        """Six counts at encoder ``shaft`` angles (6,); every reading draws six numbers from the generator."""
        noise = self._noise * self._rng.standard_normal(N_ACTUATORS)
        exact = (shaft + self._offset + self.bias) * COUNTS_PER_RADIAN + noise
        counts = [int(value) for value in np.rint(exact)]
        for joint, value in self.held.items():
            counts[joint] = value
        self.last = tuple(counts)
        return self.last

    def hold(self, joint: int) -> None:
        """Freeze one encoder at its latest reading."""
        self.held[joint] = self.last[joint]
