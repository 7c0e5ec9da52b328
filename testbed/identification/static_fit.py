"""First stage: dead zones from where the flow begins, friction and loads from pressures in motion.

Both are least squares on single samples, so that they need no good start. Their answers are good to some per
cent, and where the later stages begin.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.optimize import least_squares
from scipy.signal import savgol_filter

from plant_emulator.config.plant import PlantConfig
from plant_emulator.core import layout as col
from plant_emulator.core.layout import JOINTS
from plant_emulator.core.model import Model
from testbed.identification.free_run import standing_push
from testbed.identification.operating import SUPPLY_EDGE, Operating, air_softness, edge_flow, share_open
from testbed.identification.recording import Array

LEAST_SAMPLES = 8
_EVERY = 8  # samples of which gravity is computed
_SMALL = 0.25  # of the widest opening: near the dead zone, where a curved edge counts as straight
_AVERAGED = 21
_FRICTION_SPREAD = 0.5  # of the file's friction
_VIBRATION = 0.5  # of the file's Coulomb level: what bending and other joints leave of the balance


class DeadZone(NamedTuple):
    """Of one joint, one way: where the flow begins, half of the hysteresis beyond the file's, rated flow
    over the file's.

    All from the meter-in edge; the first two in spool words, 0 to 1.
    """

    joint: int
    way: int  # +1 opens to raise the angle
    deadband: float
    hysteresis: float
    flow: float
    deadband_std: float
    samples: int

    @property
    def name(self) -> str:
        """Such as ``lift +``."""
        return f"{JOINTS[self.joint]} {'+' if self.way > 0 else '−'}"


class Friction(NamedTuple):
    """Of one joint at steady speed: Coulomb (N) and viscous (N s/m) with σ; N m for a rotary actuator."""

    joint: int
    coulomb: float
    viscous: float
    coulomb_std: float
    viscous_std: float
    samples: int


def dead_zone(series: Operating, model: Model, way: int) -> DeadZone | None:
    """The dead zone of ``series`` for openings of sign ``way``; None with too few samples that flow.

    Meter-in flow over √Δp is K times the flow curve from |x| − d ∓ h on, the sign by whether the spool opens
    or closes, or did so last: the loop that hysteresis and lag make beyond the file's.
    Samples inside the dead zone belong to it as well: to leave them out by their speed would pull d to zero.
    """
    chamber = 0 if way > 0 else 1
    spool, drop = np.abs(series.spool), series.drops[:, chamber]
    band = float(model.actuators[series.joint, col.A_DEADBAND + SUPPLY_EDGE[way]])
    small = spool < 2.0 * band + _SMALL * max(spool.max() - band, 0.0)
    used = series.steady & small & (np.sign(series.spool) == way) & (spool > 1e-6) & (drop > 5e5)
    through = _through(series, model, chamber)[used]
    x, opens = spool[used], _latest_sign(series.opening_rate)[used]
    top = float(x.max(initial=0.0))
    if used.sum() < 2 * LEAST_SAMPLES or (x > 0.5 * top).sum() < LEAST_SAMPLES:
        return None
    row = model.actuators[series.joint]
    curve, nominal = float(row[col.A_SLOPE + chamber]), float(row[col.A_GAIN + SUPPLY_EDGE[way]])
    size = nominal * float(share_open(np.array([top]), 0.3 * top, curve)[0])

    def left(guess: Array) -> Array:
        flow = guess[0] * nominal * share_open(x - guess[2] * opens, guess[1], curve)
        return np.asarray((flow - through) / size)

    found = least_squares(
        left, np.array([1.0, 0.3 * top, 0.0]), loss="soft_l1", f_scale=0.05, x_scale=[1.0, top, top],
        bounds=([0.01, 0.0, -0.5 * top], [100.0, 0.9 * top, 0.5 * top]),
    )  # fmt: skip
    flow, d, h = (float(number) for number in found.x)
    spread = 1.4826 * float(np.median(np.abs(left(found.x))))
    slopes = np.asarray(found.jac)
    stds = spread * np.sqrt(np.abs(np.diag(np.linalg.pinv(slopes.T @ slopes))))
    return DeadZone(series.joint, way, d, h, flow, float(stds[1]), int(used.sum()))


def _latest_sign(values: Array) -> Array:
    """The sign (n,) of ``values`` (n,), or where they are 0 the last one before; 0 before any."""
    last = np.maximum.accumulate(np.where(values != 0.0, np.arange(len(values)), 0))
    return np.asarray(np.sign(values[last]))


def _through(series: Operating, model: Model, chamber: int) -> Array:
    """The meter-in flow of ``chamber`` over the root of its edge's drop (n,): K times the opening."""
    area = float(model.actuators[series.joint, (col.A_AREA_A, col.A_AREA_B)[chamber]])
    softness = 1.0 / float(model.circuit[col.C_MODULUS]) + air_softness(series.pressures[:, chamber], model)
    stored = series.volumes[:, chamber] * series.pressure_rates[:, chamber] * softness
    moved = area * series.speed * (1.0 if chamber == 0 else -1.0)
    return np.asarray((moved + stored) / edge_flow(np.maximum(series.drops[:, chamber], 1e5), True, model))


class Loads(NamedTuple):
    """What the arm at rest asks of its actuators (m, 6), N or N m, and the change of it per kg of payload."""

    own: Array
    per_kg: Array


def loads(config: PlantConfig, poses: Array) -> Loads:
    """What ``config``'s arm asks of its actuators at ``poses`` (m, 6) rad of the joints."""
    heavier = config.payload.model_copy(update={"mass_kg": config.payload.mass_kg + 1.0})
    own = standing_push(config, poses)
    return Loads(own, standing_push(config.model_copy(update={"payload": heavier}), poses) - own)


class ForceBalance(NamedTuple):
    """Friction of each joint, and the payload (kg) beyond the file's that the pressures carry, with σ."""

    frictions: list[Friction]
    more_kg: float
    more_kg_std: float


def balance(
    all_series: Sequence[Operating], model: Model, config: PlantConfig, poses: Array
) -> ForceBalance | None:
    """The balance of forces in motion: push − own weight = payload + friction + inertia, joints together.

    ``poses`` (n, 6) of the joints. The payload is one number for all joints; friction is two and inertia one
    a joint. All is averaged over ``_AVERAGED`` samples, over which vibration all but cancels; friction is
    drawn to the file's by its prior. None with too few samples.
    """
    count = 3 * len(all_series) + 1
    blocks, targets = [], []
    for place, series in enumerate(all_series):
        rows, target = _force_rows(series, model, config, poses)
        wide = np.zeros((len(target) + 2, count))
        wide[:-2, 3 * place : 3 * place + 3], wide[:-2, -1] = rows[:, :3], rows[:, 3]
        file = model.actuators[series.joint, [col.A_COULOMB, col.A_VISCOUS]]
        scale = _VIBRATION * max(float(file[0]), 1.0)  # a torque of the slew counts as much as a force
        wide[:-2] /= scale
        prior = 1.0 / (_FRICTION_SPREAD * np.maximum(file, 1e-3))
        wide[-2, 3 * place], wide[-1, 3 * place + 1] = prior
        blocks.append(wide)
        targets.append(np.concatenate([target / scale, prior * file]))
    if min(len(target) for target in targets) < LEAST_SAMPLES:
        return None
    rows, target = np.concatenate(blocks), np.concatenate(targets)
    found, *_ = np.linalg.lstsq(rows, target, rcond=None)
    spread = np.sqrt(np.diag(np.linalg.pinv(rows.T @ rows)))
    frictions = [
        Friction(
            series.joint,
            found[3 * k],
            found[3 * k + 1],
            spread[3 * k],
            spread[3 * k + 1],
            len(targets[k]) - 2,
        )
        for k, series in enumerate(all_series)
    ]
    return ForceBalance(frictions, float(found[-1]), float(spread[-1]))


def _force_rows(series: Operating, model: Model, config: PlantConfig, poses: Array) -> tuple[Array, Array]:
    """Rows (m, 4) for Coulomb, viscous, inertia and payload, and the force (m,) that they explain."""

    def averaged(values: Array, derivative: int = 0) -> Array:
        return np.asarray(savgol_filter(values, _AVERAGED, 2, deriv=derivative, axis=0))

    alike = np.abs(uniform_filter1d(np.sign(series.speed) * series.moving, _AVERAGED)) > 1.0 - 1e-9
    used = np.flatnonzero(alike)[::_EVERY]
    row = model.actuators[series.joint]
    weigh = loads(config, poses[used])
    v = averaged(series.speed)[used]
    more = float(row[col.A_STATIC] / row[col.A_COULOMB]) - 1.0 if row[col.A_COULOMB] > 0.0 else 0.0
    shape = np.sign(v) * (1.0 + more * np.exp(-((v / row[col.A_STRIBECK]) ** 2)))
    rows = np.column_stack([shape, v, averaged(series.speed, 1)[used], weigh.per_kg[:, series.joint]])
    return rows, averaged(series.push)[used] - weigh.own[:, series.joint]
