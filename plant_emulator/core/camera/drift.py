"""How a camera's rectification wanders with its temperature: a first-order walk, kept between knots."""

import math

import numpy as np

from plant_emulator.config.camera import DriftConfig

_STREAM = 0x6472696674
_KNOTS = 20  # in one time constant


class Drift:
    """The walk of one camera. Deterministic for a seed and the times asked for since the first one."""

    def __init__(self, config: DriftConfig, seed: int) -> None:
        self._spread = np.array([config.disparity_px, config.vertical_px])
        self._interval_s = config.time_constant_s / _KNOTS
        self._kept = math.exp(-1.0 / _KNOTS)
        self._rng = np.random.default_rng((seed, _STREAM))
        self._start_ns: int | None = None
        self._knots = [np.zeros(2)]

    def at(self, time_ns: int) -> tuple[float, float]:
        """(disparity, rows) px at ``time_ns``, both zero at the first time asked for and before it."""
        if not self._spread.any():
            return 0.0, 0.0
        if self._start_ns is None:
            self._start_ns = time_ns
        knots = max(1e-9 * (time_ns - self._start_ns), 0.0) / self._interval_s
        before = int(knots)
        while len(self._knots) < before + 2:
            step = math.sqrt(1.0 - self._kept**2) * self._rng.standard_normal(2)
            self._knots.append(self._kept * self._knots[-1] + step)
        share = knots - before
        drift = self._spread * ((1.0 - share) * self._knots[before] + share * self._knots[before + 1])
        return float(drift[0]), float(drift[1])
