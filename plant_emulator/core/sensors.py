"""What the fieldbus sees of the arm: 17-bit encoders on play-afflicted shafts, and pressure transducers."""

import math
from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from plant_emulator.config.plant import ErrorsConfig
from plant_emulator.core.layout import N_ACTUATORS
from protocol.process_image import COUNTS_PER_TURN

Array = NDArray[np.float64]

COUNTS_PER_RADIAN = COUNTS_PER_TURN / (2.0 * math.pi)


class Encoders:
    """Six absolute encoders, each with its zero offset, eccentricity and noise; ``hold`` freezes a count."""

    def __init__(self, errors: ErrorsConfig, rng: np.random.Generator) -> None:
        self._rng = rng
        self._noise = errors.encoder_noise.rms_lsb if errors.encoder_noise.enabled else 0.0
        off = errors.encoder_offsets
        self._offset = np.asarray(off.mrad) * 1e-3 if off.enabled else np.zeros(N_ACTUATORS)
        wobble = errors.encoder_eccentricity
        self._wobble = np.asarray(wobble.mrad) * 1e-3 if wobble.enabled else np.zeros(N_ACTUATORS)
        self._phase = np.radians(wobble.phase_deg)
        self._held: dict[int, int] = {}
        self._last: tuple[int, ...] | None = None

    def read(self, shaft: Array, shift: Array) -> tuple[int, ...]:
        """Six counts at encoder ``shaft`` angles (6,) that are ``shift`` (6,) off.

        Every reading draws six numbers from the generator, whatever is held.
        """
        noise = self._noise * self._rng.standard_normal(N_ACTUATORS)
        counts = self._counts(shaft + shift, noise)
        for joint, value in self._held.items():
            counts[joint] = value
        self._last = tuple(counts)
        return self._last

    def hold(self, joints: Collection[int], shaft: Array) -> None:
        """Freeze exactly these, each at its latest reading, or at ``shaft`` (6,) before the first one."""
        latest = self._last or self._counts(shaft, np.zeros(N_ACTUATORS))
        self._held = {joint: self._held.get(joint, latest[joint]) for joint in joints}

    def _counts(self, angle: Array, noise: Array) -> list[int]:
        off = self._offset + self._wobble * np.sin(angle + self._phase)
        counts: list[float] = np.rint((angle + off) * COUNTS_PER_RADIAN + noise).tolist()
        return [int(count) for count in counts]
