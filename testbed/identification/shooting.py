"""Third stage: the plant's parameters by multiple shooting: the maximum of the posterior, its covariance.

The recording is cut into windows; each begins at the state that the sensors tell, and what no sensor tells is
carried over (free_run). Short windows keep a wrong parameter from running away, so that Gauss and Newton's
steps go on where a single shot stalls; but their restarts bring noise in, so that the last steps take the
whole recording as one window, which is the likelihood itself. Sensitivities are forward differences, a column
a run.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from plant_emulator.config.plant import PlantConfig
from plant_emulator.core.layout import N_ACTUATORS
from protocol.errors import ConfigurationError
from testbed.identification.free_run import Smoothed, Start, measured, predicted
from testbed.identification.parameters import Parameter, changed, moved_start
from testbed.identification.recording import Array, MotionRecording

_STEP = 0.01  # of a prior's spread, or of what is left of it: over which a difference is taken
_GAINED = 0.2  # of the cost: a step that gains less is the last one
DAMPINGS = (0.0, 1e1, 1e2, 1e3, 1e4, 1e5)
"""Times the prior's information: trial steps of one Jacobian."""


class FitProblem(NamedTuple):
    """What is fitted to what: ``base`` with ``parameters``, to the signals of ``recording`` from ``start``.

    ``used`` (k,) are the signals' indices, ``std`` (k,) their noise.
    """

    base: dict[str, Any]
    parameters: tuple[Parameter, ...]
    recording: MotionRecording
    start: Start
    told: Smoothed
    used: tuple[int, ...]
    std: Array

    @property
    def spreads(self) -> Array:
        """The priors' standard deviations."""
        return np.array([p.spread for p in self.parameters])


class Fit(NamedTuple):
    """Where the fit ended: ``theta`` (p,) and ``covariance`` (p, p), in the parameters' own kinds.

    ``cost`` is χ² of data and prior, ``data`` that of the data alone, ``samples`` the numbers compared.
    ``runs`` of the plant it took. ``residuals`` (n, k) over their noise.
    """

    theta: Array
    covariance: Array
    cost: float
    data: float
    samples: int
    runs: int
    residuals: Array
    jacobian: Array


def plant_of(problem: FitProblem, theta: Array) -> PlantConfig:
    """The plant at ``theta``. Raises ConfigurationError where there is no such plant."""
    return PlantConfig.model_validate(changed(problem.base, problem.parameters, theta))


def signals(problem: FitProblem, window_s: float, theta: Array) -> Array | None:
    """What the plant at ``theta`` predicts (n, k), over the noise; None where there is no such plant.

    ``window_s``: of the windows; 0 for one run.
    """
    try:
        config = plant_of(problem, theta)
        start = moved_start(problem.start, problem.parameters, theta)
        told = problem.told if window_s > 0.0 else None
        found = predicted(config, problem.recording, start, told, window_s)
    except (ConfigurationError, ValueError):
        return None
    told_well = found[:, list(problem.used)] / problem.std
    return told_well if bool(np.isfinite(told_well).all()) else None


def _residuals(problem: FitProblem, found: Array) -> Array:
    return np.asarray(measured(problem.recording)[:, list(problem.used)] / problem.std - found)


def _cost(problem: FitProblem, theta: Array, found: Array | None) -> float:
    if found is None:
        return float("inf")
    prior = float(np.sum((theta / problem.spreads) ** 2))
    return float(np.sum(_residuals(problem, found) ** 2)) + prior


def jacobian(
    problem: FitProblem,
    window_s: float,
    theta: Array,
    found: Array,
    steps: Array,
    mapped: Callable[..., Any] = map,
) -> Array:
    """The derivative (n k, p) of the signals over the noise, by one run for each step (p,) that is not 0.

    A step that leaves the range of possible plants is taken the other way. ``mapped`` is ``map`` or a pool's.
    """
    columns = np.zeros((found.size, len(theta)))
    moved = [j for j in range(len(theta)) if steps[j] != 0.0]
    points = [theta + steps[j] * np.eye(len(theta))[j] for j in moved]
    for j, point, there in zip(
        moved, points, mapped(partial(signals, problem, window_s), points), strict=True
    ):
        step = steps[j]
        if there is None:
            there, step = signals(problem, window_s, 2.0 * theta - point), -step
        if there is not None:
            columns[:, j] = (there - found).ravel() / step
    return columns


class Plan(NamedTuple):
    """How a fit goes: windows of ``window_s`` (0: one run), at most ``most_steps`` steps, damped as told.

    The Jacobian is taken anew before each of the first ``jacobians`` steps, and serves the later ones as it
    is. It ends with a step that gains less than ``least_gain`` of the cost. ``held`` parameters stay put.
    """

    window_s: float
    most_steps: int
    jacobians: int
    dampings: tuple[float, ...]
    least_gain: float
    held: frozenset[int]


def shoot(
    problem: FitProblem,
    theta: Array,
    plan: Plan,
    pool: Executor | None = None,
    tell: Callable[[str], None] = lambda note: None,
) -> Fit:
    """Gauss and Newton's damped steps from ``theta`` until one gains little.

    Raises ConfigurationError when there is no plant at ``theta``.
    """
    mapped: Callable[..., Any] = map if pool is None else pool.map
    now = _best_of(problem, plan.window_s, [theta], map)
    if now.found is None:
        plant_of(problem, theta)
        raise ConfigurationError(
            "identification.no_start", "the plant cannot be run from where the fit begins"
        )
    free = np.array([j for j in range(len(theta)) if j not in plan.held], dtype=np.int64)
    steps, runs = np.zeros(len(theta)), 1
    steps[free] = _STEP * problem.spreads[free]
    for number in range(plan.most_steps):
        if number < plan.jacobians:
            columns = jacobian(problem, plan.window_s, now.theta, now.found, steps, mapped)
            runs += len(free)
            stds = np.sqrt(np.diag(_inverse(problem, columns, free))[free])
            steps[free] = np.clip(0.3 * stds, 1e-4 * problem.spreads[free], _STEP * problem.spreads[free])
        downhill = columns.T @ _residuals(problem, now.found).ravel() - now.theta / problem.spreads**2
        moves = [_inverse(problem, columns, free, damping) @ downhill for damping in plan.dampings]
        best = _best_of(problem, plan.window_s, [now.theta + move for move in moves], mapped)
        runs += len(moves)
        gained = now.cost - best.cost
        now = best if gained > 0.0 else now
        what = f"windows of {plan.window_s:g} s" if plan.window_s > 0.0 else "one run"
        tell(f"{what}, step {number + 1}: χ² {now.cost:.5g}")
        if gained < _GAINED + plan.least_gain * now.cost:
            break
    theta, found, cost = now
    assert found is not None  # it has a cost
    left = _residuals(problem, found)
    covariance = _inverse(problem, columns, free)
    return Fit(theta, covariance, cost, float(np.sum(left**2)), left.size, runs, left, columns)


def _inverse(problem: FitProblem, columns: Array, free: NDArray[np.int64], damping: float = 0.0) -> Array:
    """(JᵀJ + (1 + damping) prior)⁻¹ of the free parameters, scaled for its condition; zero for held ones."""
    s = problem.spreads[free]
    scaled = columns[:, free] * s
    whole = np.zeros((columns.shape[1], columns.shape[1]))
    whole[np.ix_(free, free)] = np.linalg.inv(
        scaled.T @ scaled + (1.0 + damping) * np.eye(len(free))
    ) * np.outer(s, s)
    return whole


class _Trial(NamedTuple):
    theta: Array
    found: Array | None
    cost: float


def _best_of(problem: FitProblem, window_s: float, points: list[Array], mapped: Callable[..., Any]) -> _Trial:
    """The point with the least cost."""
    there = mapped(partial(signals, problem, window_s), points)
    trials = [_Trial(p, found, _cost(problem, p, found)) for p, found in zip(points, there, strict=True)]
    return min(trials, key=lambda trial: trial.cost)


def signals_of(joints: Sequence[int]) -> tuple[int, ...]:
    """The indices of the signals of ``joints``: angles, both chambers, and the supply."""
    chambers = [N_ACTUATORS + 2 * j + side for j in joints for side in (0, 1)]
    return (*joints, *chambers, 3 * N_ACTUATORS)
