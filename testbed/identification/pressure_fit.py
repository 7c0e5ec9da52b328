"""Second stage: the equation error of the chambers, linear in 1/β, rated flows and leakage.

V_a (1/β + air) dp_a/dt + A_a v = k Q(x, Δp) − C (p_a − p_b), and likewise for chamber b, where Q is what the
edge of the file's valve passes and k differs by joint and direction; derivatives by local cubics. Noise in
the regressors biases it by some per cent, which the third stage mends.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from plant_emulator.core import columns as col
from plant_emulator.core.layout import JOINTS
from plant_emulator.core.model import Model
from testbed.identification.operating import (
    RETURN_EDGE,
    SUPPLY_EDGE,
    Operating,
    air_softness,
    edge_flow,
    share_open,
)
from testbed.identification.recording import Array

Deadbands = Mapping[tuple[int, int], float]
"""(joint, way) → where the meter-in edge opens, of full spool."""


class JointFlow(NamedTuple):
    """Of one joint: rated flow over the file's, extending and retracting, and leakage (m³/s/Pa), with σ's."""

    joint: int
    extend: float
    retract: float
    leakage: float
    extend_std: float
    retract_std: float
    leakage_std: float

    @property
    def name(self) -> str:
        """The joint's."""
        return JOINTS[self.joint]


class PressureFit(NamedTuple):
    """The bulk modulus (Pa) of all chambers with its σ, and what is each joint's own."""

    modulus: float
    modulus_std: float
    flows: list[JointFlow]


def pressure_fit(all_series: Sequence[Operating], model: Model, deadbands: Deadbands) -> PressureFit:
    """The equation error of all joints together; ``deadbands`` by the first stage."""
    blocks, targets = [], []
    count = 1 + 3 * len(all_series)
    for place, series in enumerate(all_series):
        block, target = _rows(series, model, deadbands)
        wide = np.zeros((len(target), count))
        wide[:, 0] = block[:, 0]
        wide[:, 1 + 3 * place : 4 + 3 * place] = block[:, 1:]
        scale = float(model.actuators[series.joint, col.A_GAIN])  # all joints count by their size
        blocks.append(wide / scale)
        targets.append(target / scale)
    rows, target = np.concatenate(blocks), np.concatenate(targets)
    sizes = np.maximum(np.linalg.norm(rows, axis=0), 1e-300)
    found, *_ = np.linalg.lstsq(rows / sizes, target, rcond=None)
    left = target - rows / sizes @ found
    cov = np.linalg.pinv((rows / sizes).T @ (rows / sizes)) * float(np.var(left))
    found, spread = found / sizes, np.sqrt(np.diag(cov)) / sizes
    softness = max(float(found[0]), 1e-12)
    flows = [
        JointFlow(series.joint, *found[1 + 3 * k : 4 + 3 * k], *spread[1 + 3 * k : 4 + 3 * k])
        for k, series in enumerate(all_series)
    ]
    return PressureFit(1.0 / softness, float(spread[0]) / softness**2, flows)


def _rows(series: Operating, model: Model, deadbands: Deadbands) -> tuple[Array, Array]:
    """Rows (m, 4) for 1/β, k of either direction and C, and what they explain (m,), while the joint moves."""
    row = model.actuators[series.joint]
    leak = series.pressures[:, 0] - series.pressures[:, 1]
    blocks, targets = [], []
    for way in (1, -1):
        used = series.moving & series.steady & (np.sign(series.spool) == way)
        for chamber, sign in ((0, 1.0), (1, -1.0)):
            into = (chamber == 0) == (way > 0)
            if not into and chamber == 0 and row[col.A_COUNTERBALANCE] > 0.0:
                continue  # a load-holding valve throttles it as well
            edge = (SUPPLY_EDGE if into else RETURN_EDGE)[way]
            nominal = float(row[col.A_DEADBAND + SUPPLY_EDGE[way]])
            wider = deadbands.get((series.joint, way), nominal) / nominal if nominal > 0.0 else 1.0
            overlap, curve = wider * float(row[col.A_DEADBAND + edge]), float(row[col.A_SLOPE + (way < 0)])
            flow = float(row[col.A_GAIN + edge]) * share_open(np.abs(series.spool), overlap, curve)
            flow *= edge_flow(series.drops[:, chamber], into, model)
            stored = series.volumes[:, chamber] * series.pressure_rates[:, chamber]
            air = stored * air_softness(series.pressures[:, chamber], model)
            speed = sign * float(row[(col.A_AREA_A, col.A_AREA_B)[chamber]]) * series.speed
            none = np.zeros(len(flow))
            both = (flow, none) if way > 0 else (none, flow)
            blocks.append(np.column_stack([-stored, *both, -sign * leak])[used])
            targets.append((speed + air)[used])
    return np.concatenate(blocks), np.concatenate(targets)
