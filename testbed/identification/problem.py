"""What a fit compares: the plant with its parameters along a recording, in units of the sensors' noise.

Its derivatives are forward differences, a column a run of the plant.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

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
    told: Smoothed
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
        told = problem.told if window_s > 0.0 else None
        found = predicted(config, problem.recording, start, told, window_s)
    except (ConfigurationError, ValueError):
        return None
    told_well = found[:, list(problem.used)] / problem.std
    return told_well if bool(np.isfinite(told_well).all()) else None


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
