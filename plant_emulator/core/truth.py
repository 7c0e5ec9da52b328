"""The truth: what the plant alone knows about where things really are."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

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
