"""Valve words over time that move an arm for identification: ramps, steps and small mixtures in turn.

A ramp crosses the dead zone slowly, both ways; steps show oil spring and flow; a mixture of small steps on
several joints shows friction, coupling and bending. All go as far one way as the other.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from typing import Any, Literal, NamedTuple

import numpy as np

from foundation.configuration import configuration_hash
from nominal_arm.description import NominalArm
from plant_emulator.config.actuators import BAR
from plant_emulator.config.plant import PlantConfig
from plant_emulator.config.valves import JOINT_NAMES
from plant_emulator.core.layout import JOINTS, N_ACTUATORS
from plant_emulator.core.plant import Plant
from plant_emulator.core.truth import COUNTS_PER_RADIAN
from protocol.process_image import CONTROL_ENABLE, ValveImage
from testbed.identification.fit import problem_of
from testbed.identification.parameters import Parameter, parameters_of
from testbed.identification.recording import About, Array, Machine, MotionRecording, hex_hash
from testbed.identification.shooting import FitProblem, jacobian, signals

Kind = Literal["rest", "ramp", "step", "mixture"]


class Piece(NamedTuple):
    """A few seconds of excitation: ``amplitude`` of the valve word on ``joints`` (none: at rest)."""

    kind: Kind
    joints: tuple[int, ...]
    amplitude: float
    seconds: float
    seed: int = 0

    @property
    def name(self) -> str:
        """Such as ``ramp of lift, 4 %, 2 s``."""
        who = " and ".join(JOINTS[j] for j in self.joints) or "all"
        return f"{self.kind} of {who}, {100.0 * self.amplitude:.3g} %, {self.seconds:.3g} s"


def words(pieces: list[Piece], period_s: float) -> Array:
    """The valve words (n, 6) of ``pieces`` in turn, one every ``period_s``."""
    return np.concatenate([_words(piece, period_s) for piece in pieces])


def seconds(pieces: list[Piece]) -> float:
    """How long ``pieces`` last together."""
    return sum(piece.seconds for piece in pieces)


def _words(piece: Piece, period_s: float) -> Array:
    n = round(piece.seconds / period_s)
    table, phase = np.zeros((n, N_ACTUATORS)), np.arange(n) / n
    for place, joint in enumerate(piece.joints):
        if piece.kind == "ramp":
            shape = 1.0 - np.abs(4.0 * ((phase + 0.25) % 1.0) - 2.0)
        elif piece.kind == "step":
            shape = np.select([phase < 0.3, phase < 0.5, phase < 0.8], [1.0, 0.0, -1.0], 0.0)
        elif piece.kind == "mixture":
            shape = _mixture(n, period_s, np.random.default_rng([piece.seed, joint, place]))
        else:
            shape = np.zeros(n)
        table[:, joint] = piece.amplitude * shape
    return table


def _mixture(n: int, period_s: float, rng: np.random.Generator) -> Array:
    """Levels of random height, each held 0.08 to 0.4 s, with a sum of zero: the joint ends where it began."""
    shape, k = np.zeros(n), 0
    while k < n:
        held = round(float(rng.uniform(0.08, 0.4)) / period_s)
        level = float(rng.uniform(0.3, 1.0)) * (1.0 if rng.random() < 0.5 else -1.0)
        shape[k : k + held] = 0.0 if rng.random() < 0.2 else level
        k += held
    moving = shape != 0.0
    total, size = float(shape.sum()), float(np.abs(shape).sum())
    if 0.0 < abs(total) < size:  # the stronger side is weakened until both balance
        strong = moving & (np.sign(shape) == np.sign(total))
        shape[strong] *= (size - abs(total)) / (size + abs(total))
    return shape


def standard(deadband: float, joints: tuple[int, ...] = (0, 1, 2), seed: int = 1) -> list[Piece]:
    """The usual excitation of valves with about this ``deadband``: about 13 s of ramps, steps, mixtures."""
    ramp, step, small = 2.0 * deadband + 0.03, deadband + 0.06, deadband + 0.02
    pieces = [Piece("rest", (), 0.0, 0.5)]
    pieces += [Piece("ramp", (j,), ramp, 2.0) for j in joints]
    pieces += [Piece("step", (j,), step, 1.2) for j in joints]
    pieces += [Piece("mixture", joints, small, 2.5, seed), Piece("rest", (), 0.0, 0.5)]
    return pieces


def held_out(deadband: float, joints: tuple[int, ...] = (0, 1, 2), seed: int = 2) -> list[Piece]:
    """Ten seconds that look otherwise than the usual excitation, to judge a fitted plant by."""
    return [
        Piece("mixture", joints, deadband + 0.06, 5.0, seed),
        Piece("mixture", joints, deadband + 0.04, 5.0, seed + 1),
    ]


def widest_overlap(config: PlantConfig) -> float:
    """The widest dead zone of the valves of slew, lift and tilt, half of the hysteresis included."""
    valves = [config.valves.of(name, 1.0) for name in JOINT_NAMES[:3]]
    return max(max(valve.deadband) + 0.5 * valve.hysteresis for valve in valves)


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
    readings: Array = np.array(rows, dtype=np.float64)
    readings[:, 6:19] += PRESSURE_NOISE_BAR * noise.standard_normal((len(readings), 13))
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
        np.arange(len(readings), dtype=np.float64) * PERIOD_S,
        valves,
        readings[:, :6] / COUNTS_PER_RADIAN,
        readings[:, 6:18].reshape(-1, N_ACTUATORS, 2) * BAR,
        readings[:, 18] * BAR,
        readings[:, 19],
    )


_REST = Piece("rest", (), 0.0, 0.3)
_STEP = 1e-3  # of a prior's spread
PLANNED_JOINTS = (0, 1, 2)


class Informed(NamedTuple):
    """A piece and its information (p, p) in units of the priors; None where limits forbid it."""

    piece: Piece
    information: Array | None
    refused: str = ""


class PlanStep(NamedTuple):
    """A chosen piece: bits gained by it, and how many parameters are identified then."""

    piece: Piece
    bits: float
    identified: int


def candidates(overlap: float, joints: Sequence[int] = PLANNED_JOINTS) -> list[Piece]:
    """Ramps, steps and mixtures of each joint, small and large, and mixtures of all."""
    found = []
    for j in joints:
        found += [Piece("ramp", (j,), 2.0 * overlap + 0.03, 2.0), Piece("step", (j,), overlap + 0.03, 1.2)]
        found += [Piece("step", (j,), overlap + 0.06, 1.2), Piece("mixture", (j,), overlap + 0.02, 1.5, 1)]
    several = tuple(joints)
    return [*found, *(Piece("mixture", several, overlap + more, 2.0, 1) for more in (0.02, 0.06))]


def information_of(problem: FitProblem, known: int, pool: Executor | None = None) -> Array:
    """JᵀJ (known, known) of the first ``known`` parameters, in units of the priors, at the file's own."""
    mapped: Callable[..., Any] = map if pool is None else pool.map
    at = np.zeros(len(problem.parameters))
    found = signals(problem, 0.0, at)
    if found is None:
        return np.zeros((known, known))
    steps = _STEP * problem.spreads
    steps[known:] = 0.0
    columns = jacobian(problem, 0.0, at, found, steps, mapped)[:, :known] * problem.spreads[:known]
    return np.asarray(columns.T @ columns)


def informed(
    config: PlantConfig, arm: NominalArm, machine: Machine, piece: Piece, pool: Executor | None = None
) -> Informed:
    """What ``piece`` would tell, from the start pose of ``config``."""
    motion = record(config, machine, [_REST, piece], [], seed=1)
    if refused := beyond_limits(motion, arm):
        return Informed(piece, None, refused)
    problem = problem_of(config, motion, PLANNED_JOINTS)
    return Informed(piece, information_of(problem, len(parameters_of(config, PLANNED_JOINTS)), pool))


def beyond_limits(motion: MotionRecording, arm: NominalArm) -> str:
    """Which joint leaves its range or exceeds its speed in ``told``, and by what; empty where none does."""
    rates = np.abs(np.diff(motion.angles, axis=0)).max(axis=0) / motion.period_s
    for j, joint in enumerate(arm.joints):
        low, high = np.degrees(motion.angles[:, j].min()), np.degrees(motion.angles[:, j].max())
        if low < joint.lower_deg or high > joint.upper_deg:
            return f"{joint.name} goes to {low if low < joint.lower_deg else high:.1f}°"
        if (speed := float(np.degrees(rates[j]))) > joint.speed_deg_s:
            return f"{joint.name} at {speed:.1f} °/s, limit {joint.speed_deg_s:g}"
    return ""


def chosen(candidates: Sequence[Informed], seconds: float, before: Array | None = None) -> list[PlanStep]:
    """The pieces to use, in the order of their gain, within ``seconds``; ``before``: known already (p, p)."""
    able = [(one.piece, one.information) for one in candidates if one.information is not None]
    if not able:
        return []
    total: Array = np.eye(len(able[0][1])) + (0.0 if before is None else before)
    steps: list[PlanStep] = []
    while True:
        left = seconds - sum(step.piece.seconds for step in steps)
        fitting = [(piece, information) for piece, information in able if piece.seconds <= left + 1e-9]
        if not fitting:
            return steps
        gains = [_bits(total + information) - _bits(total) for _, information in fitting]
        a_second = [gain / piece.seconds for gain, (piece, _) in zip(gains, fitting, strict=True)]
        best = int(np.argmax(a_second))
        total = total + fitting[best][1]
        steps.append(PlanStep(fitting[best][0], gains[best], len(told_by(total))))


def _bits(information: Array) -> float:
    return float(0.5 * np.linalg.slogdet(information)[1] / np.log(2.0))


def told_by(total: Array, below: float = 0.5) -> list[int]:
    """The parameters whose σ is below ``below`` of the prior's, by information and prior (p, p) together."""
    return np.flatnonzero(np.sqrt(np.diag(np.linalg.inv(total))) < below).tolist()


def not_told(information: Array, parameters: Sequence[Parameter]) -> list[str]:
    """The names of the parameters that a log of this information (p, p) cannot give."""
    known = set(told_by(np.eye(len(information)) + information))
    return [p.name for k, p in enumerate(parameters[: len(information)]) if k not in known]
