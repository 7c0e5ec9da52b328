"""Which excitation tells most: pieces chosen one by one for the gain in information, all of it by the model.

The information of a piece is JᵀJ over the noise of its signals, at the plant file's parameters. A piece
counts when it stays inside the joints' ranges and speeds. Chosen is, again and again, the piece that gains
most in the logarithm of the determinant of information and prior (D-optimal), per second.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from typing import Any, NamedTuple

import numpy as np

from nominal_arm.description import NominalArm
from plant_emulator.config.plant import PlantConfig
from testbed.identification.checks import Machine
from testbed.identification.excitation import Piece, record
from testbed.identification.fit import problem_of
from testbed.identification.parameters import Parameter, parameters_of
from testbed.identification.problem import FitProblem, jacobian, signals
from testbed.identification.recording import Array, MotionRecording

_REST = Piece("rest", (), 0.0, 0.3)
_STEP = 1e-3  # of a prior's spread
JOINTS = (0, 1, 2)


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


def candidates(overlap: float, joints: Sequence[int] = JOINTS) -> list[Piece]:
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
    told = record(config, machine, [_REST, piece], [], seed=1)
    if refused := beyond_limits(told, arm):
        return Informed(piece, None, refused)
    problem = problem_of(config, told, JOINTS)
    return Informed(piece, information_of(problem, len(parameters_of(config, JOINTS)), pool))


def beyond_limits(told: MotionRecording, arm: NominalArm) -> str:
    """Which joint leaves its range or exceeds its speed in ``told``, and by what; empty where none does."""
    rates = np.abs(np.diff(told.angles, axis=0)).max(axis=0) / told.period_s
    for j, joint in enumerate(arm.joints):
        low, high = np.degrees(told.angles[:, j].min()), np.degrees(told.angles[:, j].max())
        if low < joint.lower_deg or high > joint.upper_deg:
            return f"{joint.name} goes to {low if low < joint.lower_deg else high:.1f}°"
        if (speed := float(np.degrees(rates[j]))) > joint.speed_deg_s:
            return f"{joint.name} at {speed:.1f} °/s, limit {joint.speed_deg_s:g}"
    return ""


def chosen(told: Sequence[Informed], seconds: float, before: Array | None = None) -> list[PlanStep]:
    """The pieces to use, in the order of their gain, within ``seconds``; ``before``: known already (p, p)."""
    able = [(one.piece, one.information) for one in told if one.information is not None]
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
