"""Third stage: the plant's parameters by multiple shooting: the maximum of the posterior, its covariance.

The recording is cut into windows; each begins at the state that the sensors tell, and what no sensor tells is
carried over (free_run). Short windows keep a wrong parameter from running away, so that Gauss and Newton's
steps go on where a single shot stalls; but their restarts bring noise in, so that the last steps take the
whole recording as one window, which is the likelihood itself.
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
from testbed.identification.parameters import Parameter, changed, entry, moved_start
from testbed.identification.recording import Array, MotionRecording


class FitProblem(NamedTuple):
    """What is fitted to what: ``base`` with ``parameters``, to the signals of ``recording`` from ``start``.

    ``used`` (k,) are the signals' indices, ``std`` (k,) their noise.
    """

    base: dict[str, Any]
    parameters: tuple[Parameter, ...]
    recording: MotionRecording
    start: Start
    smoothed: Smoothed
    used: tuple[int, ...]
    std: Array

    @property
    def spreads(self) -> Array:
        """The priors' standard deviations."""
        return np.array([p.spread for p in self.parameters])

    @property
    def limits(self) -> tuple[Array, Array]:
        """Between which (p,) each parameter may be."""
        file = [entry(self.base, p.keys[0]) if p.keys else 0.0 for p in self.parameters]
        lowest = [p.least - at for p, at in zip(self.parameters, file, strict=True)]
        highest = [p.most - at for p, at in zip(self.parameters, file, strict=True)]
        return np.array(lowest), np.array(highest)


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
        smoothed = problem.smoothed if window_s > 0.0 else None
        found = predicted(config, problem.recording, start, smoothed, window_s)
    except (ConfigurationError, ValueError):
        return None
    well_known = found[:, list(problem.used)] / problem.std
    return well_known if bool(np.isfinite(well_known).all()) else None


def residuals(problem: FitProblem, found: Array) -> Array:
    """What ``found`` (n, k), by ``signals``, leaves of the recording, over the noise."""
    return np.asarray(measured(problem.recording)[:, list(problem.used)] / problem.std - found)


def cost(problem: FitProblem, theta: Array, found: Array | None) -> float:
    """χ² of data and prior at ``theta``, where the plant tells ``found``; ∞ where there is none."""
    if found is None:
        return float("inf")
    prior = float(np.sum((theta / problem.spreads) ** 2))
    return float(np.sum(residuals(problem, found) ** 2)) + prior


def misfit(problem: FitProblem, theta: Array) -> float:
    """Mean square over the noise of what one run of the plant at ``theta`` leaves; ∞ where there is none."""
    found = signals(problem, 0.0, theta)
    return float("inf") if found is None else float(np.mean(residuals(problem, found) ** 2))


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
    columns, steps = np.zeros((found.size, len(theta))), steps.copy()
    beyond = theta + steps > problem.limits[1]
    steps[beyond] *= -1.0
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


def signals_of(joints: Sequence[int]) -> tuple[int, ...]:
    """The indices of the signals of ``joints``: angles, both chambers, and the supply."""
    chambers = [N_ACTUATORS + 2 * j + side for j in joints for side in (0, 1)]
    return (*joints, *chambers, 3 * N_ACTUATORS)


_STEP = 0.01  # of a prior's spread: over which a first difference is taken, and at most
_PART = 0.3  # of σ: over which differences are taken once it is known
_GAINED = 0.2  # of the cost: a step that gains less is the last one
_GOOD_PART = 0.5  # of the gain that a linear model promises: such a step is taken
DAMPINGS = (0.0, 1e-3, 1e-2, 1e-1, 1.0, 10.0)
"""Times the diagonal of the information (Marquardt 1963): trial steps of one Jacobian, in turn."""


class Fit(NamedTuple):
    """Where the fit ended: ``theta`` (p,) and ``covariance`` (p, p), in the parameters' own kinds.

    ``cost`` is χ² of data and prior, ``data`` that of the data alone, ``samples`` the numbers compared.
    ``runs`` of the plant it took. ``residuals`` (n, k) over their noise. ``fixed`` parameters, which the
    recording does not tell, are at the file's number (``keeping``). ``promised`` is by how much χ² would
    still fall, as the last slopes tell: the square of the way to its minimum, in σ. Near 0 where a fit has
    come to rest; where it has not, the covariance is not that of ``theta``.
    """

    theta: Array
    covariance: Array
    cost: float
    data: float
    samples: int
    runs: int
    residuals: Array
    jacobian: Array
    fixed: tuple[int, ...] = ()
    promised: float = float("nan")


class _Trial(NamedTuple):
    theta: Array
    found: Array | None
    cost: float


class Plan(NamedTuple):
    """How a fit goes: windows of ``window_s`` (0: one run), at most ``most_steps`` steps, damped as told.

    A Jacobian serves until a step gains less than half of what it promised; at most ``jacobians`` are taken.
    It ends with a step that gains less than ``least_gain`` of the cost. ``held`` parameters stay put.
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
    near: Fit | None = None,
) -> Fit:
    """Gauss and Newton's damped steps from ``theta`` until one gains little.

    ``near``: a fit whose σ say over how little the first differences are taken. Without it they are coarse,
    and what curves seems to tell apart what no recording does: such a covariance is too small.
    Raises ConfigurationError when there is no plant at ``theta``.
    """
    mapped: Callable[..., Any] = map if pool is None else pool.map
    now = _trial(problem, plan.window_s, theta)
    if now.found is None:
        plant_of(problem, theta)
        raise ConfigurationError(
            "identification.no_start", "the plant cannot be run from where the fit begins"
        )
    free = np.array([j for j in range(len(theta)) if j not in plan.held], dtype=np.int64)
    steps, runs, part, left = np.zeros(len(theta)), 1, 0.0, plan.jacobians
    steps[free] = _STEP * problem.spreads[free] if near is None else _fine(problem, near.covariance, free)
    for number in range(plan.most_steps):
        fresh = part < _GOOD_PART and left > 0
        if fresh:
            columns, left = jacobian(problem, plan.window_s, now.theta, now.found, steps, mapped), left - 1
            runs += len(free)
            steps[free] = _fine(problem, _inverse(problem, columns, free), free)
        best, promised, tried = _step(problem, plan, now, columns, free)
        gained, now, runs = now.cost - best.cost, best, runs + tried
        part = gained / promised if promised > 0.0 else 1.0
        what = f"windows of {plan.window_s:g} s" if plan.window_s > 0.0 else "one run"
        tell(f"{what}, step {number + 1}: χ² {now.cost:.5g}")
        done = fresh or left == 0 or part >= _GOOD_PART or promised < _GAINED
        if done and gained < _GAINED + plan.least_gain * now.cost:
            break
    fit = _fit(problem, now, columns, _inverse(problem, columns, free), runs)
    return fit._replace(promised=_move(problem, now, columns, free)[1])


def _fine(problem: FitProblem, covariance: Array, free: NDArray[np.int64]) -> Array:
    """Over what (f,) differences of the ``free`` parameters are taken, whose errors have ``covariance``."""
    spreads = problem.spreads[free]
    return np.clip(_PART * np.sqrt(np.diag(covariance)[free]), 1e-4 * spreads, _STEP * spreads)


def refined(problem: FitProblem, fit: Fit, theta: Array, plan: Plan) -> Fit:
    """``fit`` moved to ``theta`` and one step of ``plan`` on from there, by its own Jacobian."""
    now = _trial(problem, plan.window_s, theta)
    if now.found is None:
        return fit
    free = np.array([j for j in range(len(theta)) if j not in plan.held], dtype=np.int64)
    best, _, tried = _step(problem, plan, now, fit.jacobian, free)
    return _fit(problem, best, fit.jacobian, fit.covariance, fit.runs + 1 + tried)


def _fit(problem: FitProblem, there: _Trial, columns: Array, covariance: Array, runs: int) -> Fit:
    assert there.found is not None  # it has a cost
    left = residuals(problem, there.found)
    data = float(np.sum(left**2))
    return Fit(there.theta, covariance, there.cost, data, left.size, runs, left, columns)


def _step(
    problem: FitProblem, plan: Plan, now: _Trial, columns: Array, free: NDArray[np.int64]
) -> tuple[_Trial, float, int]:
    """The best trial of one step from ``now``, what the whole step promised, and how many trials there were.

    They are damped more and more. The first that gains a good part of what its linear model promises is good
    enough; one that promises nothing is the last. From where a trial leads by the slopes of ``now``, the same
    slopes lead back to the floor of a curved valley (Transtrum and Sethna 2012): that is tried as well.
    """
    best, tried, whole = now, 0, 0.0
    for damping in plan.dampings:
        move, promised = _move(problem, now, columns, free, damping)
        whole = whole if tried else promised
        trial, tried = _trial(problem, plan.window_s, now.theta + move), tried + 1
        best = min(best, trial, key=lambda one: one.cost)
        if _is_good(now, best, promised) or promised < _GAINED:
            break
        if trial.found is None:
            continue
        back, _ = _move(problem, trial, columns, free, damping)
        best = min(best, _trial(problem, plan.window_s, trial.theta + back), key=lambda one: one.cost)
        tried += 1
        if _is_good(now, best, promised):
            break
    return best, whole, tried


def _is_good(now: _Trial, best: _Trial, promised: float) -> bool:
    return now.cost - best.cost >= _GOOD_PART * promised


def _move(
    problem: FitProblem, now: _Trial, columns: Array, free: NDArray[np.int64], damping: float = 0.0
) -> tuple[Array, float]:
    """Where ``columns`` lead (p,) from ``now`` within the limits, and by how much χ² is to fall."""
    assert now.found is not None  # it has a cost
    s, left = problem.spreads[free], residuals(problem, now.found).ravel()
    sensitivity = columns[:, free]
    downhill = (sensitivity.T @ left) * s - now.theta[free] / s
    low, high = ((limit[free] - now.theta[free]) / s for limit in problem.limits)
    move = np.zeros(len(now.theta))
    move[free] = s * bounded_move(information_of_step(sensitivity, s, damping), downhill, low, high)
    there = float(np.sum((left - columns @ move) ** 2) + np.sum(((now.theta + move) / problem.spreads) ** 2))
    return move, now.cost - there


def _inverse(problem: FitProblem, columns: Array, free: NDArray[np.int64]) -> Array:
    """(JᵀJ + prior)⁻¹ (p, p) of the free parameters; zero for the others."""
    s = problem.spreads[free]
    whole = np.zeros((columns.shape[1], columns.shape[1]))
    whole[np.ix_(free, free)] = np.linalg.inv(information_of_step(columns[:, free], s)) * np.outer(s, s)
    return whole


def _trial(problem: FitProblem, window_s: float, theta: Array) -> _Trial:
    found = signals(problem, window_s, theta)
    return _Trial(theta, found, cost(problem, theta, found))


def information_of_step(columns: Array, spreads: Array, damping: float = 0.0) -> Array:
    """JᵀJ + damping · diag JᵀJ + prior (f, f) for ``columns`` (m, f), in units of the priors' ``spreads``.

    Scaled so, it is well conditioned; Marquardt (1963) damps along its diagonal.
    """
    scaled = columns * spreads
    found = scaled.T @ scaled
    return np.asarray(found + np.diag(damping * np.diag(found) + 1.0))


def bounded_move(information: Array, downhill: Array, low: Array, high: Array) -> Array:
    """The move (f,) inside ``low`` to ``high`` that gains most of 2 xᵀ downhill − xᵀ information x.

    What would leave its bounds is put there, and the others are solved for again: they make up for it. A step
    that is merely cut off there goes on as if the one at its bound had moved, and may well lead uphill.
    """
    move, fixed = np.zeros(len(downhill)), np.zeros(len(downhill), dtype=bool)
    while not fixed.all():
        free = ~fixed
        asked = downhill[free] - information[np.ix_(free, fixed)] @ move[fixed]
        move[free] = np.linalg.solve(information[np.ix_(free, free)], asked)
        beyond = free & ((move < low) | (move > high))
        if not beyond.any():
            break
        move[beyond] = np.clip(move[beyond], low[beyond], high[beyond])
        fixed |= beyond
    return move
