"""What a recording tells of each joint at each sample in the actuator's terms: position, speed, force, flow.

All by the plant file's own geometry and spool dynamics, before anything is fitted.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lsim

from foundation.compiled import allocation_free
from plant_emulator.config.plant import PlantConfig
from plant_emulator.core import layout as col
from plant_emulator.core.hydraulics.oil_rates import ATMOSPHERE
from plant_emulator.core.hydraulics.valve_commands import slew_limited
from plant_emulator.core.layout import EDGES, JOINTS
from plant_emulator.core.mechanics.geometry import actuator_reach
from plant_emulator.core.model import Model, build_model, put_payload
from testbed.identification.compiled_run import spool_words
from testbed.identification.free_run import Smoothed, smoothed
from testbed.identification.recording import Array, MotionRecording

_FAST = 5.0  # times its noise: a speed that counts as motion
_FINE_S = 1e-3
_SETTLED = 0.004  # of full stroke, between the valve word and where the spool is by the file's dynamics

SUPPLY_EDGE = {1: EDGES.index("supply_a"), -1: EDGES.index("supply_b")}
RETURN_EDGE = {1: EDGES.index("return_b"), -1: EDGES.index("return_a")}


class Operating(NamedTuple):
    """Series (n,) of one joint; areas, volumes and forces of a rotary actuator are per radian."""

    joint: int
    spool: Array  # by the file's dynamics, −1 to 1
    opening_rate: Array  # d|spool|/dt, 1/s
    position: Array  # m from the retracted end
    speed: Array  # m/s
    lever: Array  # m/rad
    pressures: Array  # (n, 2) Pa
    pressure_rates: Array  # (n, 2) Pa/s
    volumes: Array  # (n, 2) m³
    drops: Array  # (n, 2) Pa over the edges that the spool's sign opens: into chamber a, into chamber b
    push: Array  # N, of both chambers
    moving: NDArray[np.bool_]  # (n,): fast enough to tell
    steady: NDArray[np.bool_]  # (n,): the spool is where its word sends it


def file_model(base: dict[str, Any]) -> Model:
    """The tables of the plant that ``base`` describes, its payload hung on."""
    config = PlantConfig.model_validate(base)
    model, chain, tool = build_model(config)
    put_payload(model, tool, config.payload.mass_kg, config, chain)
    return model


def operating(base: dict[str, Any], model: Model, recording: MotionRecording, joint: int) -> Operating:
    """The series of ``joint`` by the plant of ``base``, whose tables are ``model``."""
    smooth, row = smoothed(recording), model.actuators[joint]
    offset = 1e-3 * float(base["errors"]["encoder_offsets"]["mrad"][joint])
    linkage = row[col.A_KIND : col.A_LENGTH0 + 1]
    reach = np.array([actuator_reach(float(angle) - offset, *linkage) for angle in smooth.angles[:, joint]])
    position, lever = reach[:, 0], reach[:, 1]
    speed = lever * smooth.rates[:, joint]
    spool, drive, sent = _spool(base["valves"]["joints"][JOINTS[joint]], recording, joint)
    pressures = smooth.pressures[:, joint]
    areas = row[[col.A_AREA_A, col.A_AREA_B]]
    volumes = np.column_stack(
        [
            row[col.A_DEAD_A] + areas[0] * position,
            row[col.A_DEAD_B] + areas[1] * (row[col.A_STROKE] - position),
        ]
    )
    back = float(model.circuit[col.C_RETURN])
    from_pump = np.where((spool >= 0.0)[:, None] == np.array([True, False]), smooth.supply[:, None], back)
    return Operating(
        joint,
        spool,
        np.sign(spool) * np.gradient(drive, recording.period_s),
        position,
        speed,
        lever,
        pressures,
        smooth.pressure_rates[:, joint],
        volumes,
        from_pump - pressures,
        pressures[:, 0] * areas[0] - pressures[:, 1] * areas[1],
        np.abs(speed) > _FAST * _speed_noise(smooth, recording, joint, lever),
        np.abs(spool - sent) < _SETTLED,
    )


def _spool(valves: dict[str, Any], recording: MotionRecording, joint: int) -> tuple[Array, Array, Array]:
    """Where the spool is (n,), its delayed and slewing word (n,), and where the word sends it (n,).

    By the file's hysteresis, delay, stroke rates and second order.
    """
    t, sent = recording.time_s - recording.time_s[0], np.empty((len(recording.time_s), 1))
    word = np.ascontiguousarray(recording.valves[:, joint : joint + 1])
    spool_words(word, np.array([0.5 * valves["hysteresis"]]), sent)
    fine = np.arange(0.0, t[-1] + 5e-4, _FINE_S)
    late = np.searchsorted(t, fine - 1e-3 * valves["delay_ms"] + 1e-9, side="right") - 1
    command = np.where(late >= 0, sent[np.maximum(late, 0), 0], 0.0)
    limit = valves["slew_limit_per_s"]
    _slew(command, limit["out"], limit["back"], _FINE_S)
    omega, zeta = 2.0 * math.pi * valves["bandwidth_hz"], valves["damping_ratio"]
    second = ([omega**2], [1.0, 2.0 * zeta * omega, omega**2])
    _, moved, _ = lsim(second, command, fine, interp=False)
    return np.interp(t, fine, moved), np.interp(t, fine, command), sent[:, 0]


@allocation_free
def _slew(command: Array, out: float, back: float, step_s: float) -> None:
    """Put into ``command`` (n,) how far a valve gets on its way there, ``step_s`` a sample."""
    now = 0.0
    for k in range(command.shape[0]):
        now, _ = slew_limited(now, command[k], out, back, step_s)
        command[k] = now


def _speed_noise(smooth: Smoothed, recording: MotionRecording, joint: int, lever: Array) -> float:
    """The spread of the smoothed speed while the arm stands still at the beginning."""
    rest = recording.time_s < recording.time_s[0] + recording.about.rest_s
    rates = smooth.rates[rest, joint]
    return float(np.abs(lever).max() * max(np.std(rates), 1e-5))


def air_softness(pressures: Array, model: Model) -> Array:
    """What entrained air adds to 1/β (1/Pa) at ``pressures``, by the file's share of air."""
    air, exponent = float(model.circuit[col.C_AIR]), float(model.circuit[col.C_EXPONENT])
    p = np.maximum(pressures, 1e5)
    return np.asarray(air * (ATMOSPHERE / p) ** (1.0 / exponent) / (exponent * p))


def edge_flow(drops: Array, from_pump: bool, model: Model) -> Array:
    """Q/K (√Pa) of an edge at ``drops`` (Pa): a regularised orifice, behind its compensator if any."""
    soft, kept = float(model.circuit[col.C_REGULARISATION]), float(model.circuit[col.C_COMPENSATOR])
    if from_pump and kept > 0.0:
        held = np.maximum(drops, 0.0)
        drops = held / (1.0 + (held / kept) ** 4) ** 0.25
    return np.asarray(drops / (drops**2 + soft**2) ** 0.25)


def share_open(travel: Array, overlap: float, slope: float) -> Array:
    """The effective opening 0…1 of an edge at spool ``travel`` (n,), by the plant's flow curve."""
    share = np.maximum(travel - overlap, 0.0) / (1.0 - overlap)
    return np.asarray(share * (slope + (1.0 - slope) * share))


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
