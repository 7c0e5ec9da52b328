"""The truth: what the plant alone knows about where things really are."""

import math
from collections.abc import Collection
from typing import NamedTuple

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


_IDENTITY = np.eye(4)  # to be copied: that is five times as fast as making one anew


class Mounts(NamedTuple):
    """True poses (4, 4) from the visible world: base in W, camera and marker on the tool, object in W."""

    X_WB: Array
    X_TC: Array
    X_TM: Array
    X_WO: Array


class PlantTruth(NamedTuple):
    """One instant of the plant. Poses are (4, 4), positions (3,), rotations (3, 3); SI units and radians.

    ``q`` (6,) true joint angles, where the encoders are, ``q_rate`` (6,), ``deflections`` (4,) of boom
    vertical, boom lateral, arm vertical, arm lateral: all hinges of each together. ``X_WB`` moves where the
    base rocks. ``pressures`` (6, 2) absolute, chamber a and b. ``valves`` (6,)
    commands in force, ``spools`` (6,). ``flows`` (6, 2) net into each chamber (m³/s). ``faults`` names what
    is broken at present.
    """

    time_ns: int
    q: Array
    q_rate: Array
    deflections: Array
    X_BT: Array
    X_WB: Array
    X_WT: Array
    X_WC: Array
    X_WM: Array
    X_WO: Array
    p_CM: Array
    p_CO: Array
    R_CM: Array
    R_CO: Array
    pressures: Array
    supply: float
    oil_temperature_degc: float
    payload_kg: float
    valves: Array
    spools: Array
    flows: Array
    faults: tuple[str, ...]


def tool_error(truth: PlantTruth, clearance_m: float) -> Array:
    """The true error (3,) in camera axes: p_CO − p_CM − [0, 0, b], what is left to drive. [M] eq. (20)."""
    return np.asarray(truth.p_CO - truth.p_CM - np.array([0.0, 0.0, clearance_m]))


def inverse(X: Array) -> Array:
    """The inverse (4, 4) of a rigid transform."""
    Y = _IDENTITY.copy()
    Y[:3, :3] = X[:3, :3].T
    Y[:3, 3] = -X[:3, :3].T @ X[:3, 3]
    return Y
