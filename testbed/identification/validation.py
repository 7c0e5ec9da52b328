"""Fourth stage: whether the fitted plant predicts motion that it was not fitted to, and what is left over."""

from typing import NamedTuple

import numpy as np

from plant_emulator.core.layout import JOINTS, N_ACTUATORS
from protocol.errors import ConfigurationError
from testbed.identification.fit import Identified
from testbed.identification.free_run import measured, predicted
from testbed.identification.parameters import Parameter, moved_start
from testbed.identification.recording import Array, MotionRecording
from testbed.identification.shooting import FitProblem, plant_of

LEAST_FIT = 0.9
"""Of a joint's angle on held-out motion: 1 − |error| / |motion|; below it, a plant is not believed."""
MOST_SPREADS = 4.0
MOST_PUSHED = 4.0
"""σ: a machine without load may well be fitted with a little less than none, and is none."""
MOST_PROMISED = 1.0
"""By how much χ² could still fall, as the last slopes tell: one σ off its minimum, all numbers together."""
LEAST_WHITE = 0.6
"""Of a signal's first autocorrelations, those in the band of noise. On development plants 0.8 or more in
every signal of a plant of the model; 0.3 down to none in some signal where it has what the model does not.
"""
_LAGS = 20


class SignalFit(NamedTuple):
    """How well a signal is predicted. ``fit`` is 1 − NRMSE on held-out motion, ``before`` with the file's.

    ``rms_over_noise`` on the fitted part; ``white``: the share of its first autocorrelations inside the 95 %
    band of white noise.
    """

    signal: str
    fit: float
    before: float
    rms_over_noise: float
    white: float


def signal_name(index: int) -> str:
    """Such as ``lift angle`` or ``lift pressure a``."""
    if index < N_ACTUATORS:
        return f"{JOINTS[index]} angle"
    if index == 3 * N_ACTUATORS:
        return "supply pressure"
    joint, side = divmod(index - N_ACTUATORS, 2)
    return f"{JOINTS[joint]} pressure {'ab'[side]}"


def validate(found: Identified, whole: MotionRecording) -> list[SignalFit]:
    """Each fitted signal of ``whole``, the recording with its held-out part, predicted in one run."""
    problem = found.problem
    late = whole.time_s >= whole.about.held_out_from_s
    held_out = measured(whole)[late]
    with_fit = _run(problem, found.whole.theta, whole)[late]
    with_file = _run(problem, np.zeros(len(found.whole.theta)), whole)[late]
    return [
        SignalFit(
            signal_name(index),
            _fit(held_out[:, index], with_fit[:, index]),
            _fit(held_out[:, index], with_file[:, index]),
            float(np.sqrt(np.mean(found.whole.residuals[:, k] ** 2))),
            whiteness(found.whole.residuals[:, k]),
        )
        for k, index in enumerate(problem.used)
    ]


def _run(problem: FitProblem, theta: Array, whole: MotionRecording) -> Array:
    start = moved_start(problem.start, problem.parameters, theta)
    return predicted(plant_of(problem, theta), whole, start)


def _fit(held_out: Array, found: Array) -> float:
    size = float(np.linalg.norm(held_out - held_out.mean()))
    return 1.0 - float(np.linalg.norm(held_out - found)) / size if size > 0.0 else float("nan")


def whiteness(residual: Array) -> float:
    """The share of the first 20 autocorrelations of ``residual`` (n,) that white noise has at 95 %."""
    centred = residual - residual.mean()
    power = float(centred @ centred)
    if power == 0.0:
        return 1.0
    values = [float(centred[lag:] @ centred[:-lag]) / power for lag in range(1, _LAGS + 1)]
    return float(np.mean(np.abs(values) < 1.96 / np.sqrt(len(residual))))


def check_believable(found: Identified, signals: list[SignalFit]) -> None:
    """Raise ConfigurationError for a fit that is not at its minimum, for a parameter at its bound, or a joint
    that is not predicted."""
    if not found.whole.promised <= MOST_PROMISED:
        raise ConfigurationError(
            "identification.not_converged",
            f"the fit: χ² of {found.whole.cost:.0f} would still fall by {found.whole.promised:.3g},"
            f" wanted at most {MOST_PROMISED:g}: its numbers are not where the recording has them",
        )
    for index, (parameter, theta) in enumerate(zip(found.problem.parameters, found.whole.theta, strict=True)):
        if not parameter.of_start:
            _check_parameter(found, index, parameter, float(theta))
    for joint in found.joints:
        one = next(s for s in signals if s.signal == f"{JOINTS[joint]} angle")
        if not one.fit >= LEAST_FIT:
            raise ConfigurationError(
                "identification.not_predicted",
                f"{one.signal}: {100.0 * one.fit:.1f} % of the held-out motion is predicted, wanted"
                f" {100.0 * LEAST_FIT:g}: the arm behaves otherwise than the model",
            )


def leaves_noise(signals: list[SignalFit]) -> bool:
    """Whether what the fit leaves of every signal is noise, so that σ hold."""
    return all(signal.white >= LEAST_WHITE for signal in signals)


def check_noise(signals: list[SignalFit]) -> None:
    """Raise ConfigurationError where what the fit leaves of a signal is not noise: the model lacks something.

    Numbers then make up for what is missing, by more than their σ, however well all motion is predicted.
    """
    if not leaves_noise(signals):
        worst = min(signals, key=lambda signal: signal.white)
        raise ConfigurationError(
            "identification.not_noise",
            f"{worst.signal}: {100.0 * worst.white:.0f} % of the autocorrelations of what is left are as of"
            f" noise, wanted {100.0 * LEAST_WHITE:g}: the model lacks what the machine or a sensor has, and"
            " σ do not hold; --unsure writes the plant without them",
        )


def _check_parameter(found: Identified, index: int, parameter: Parameter, theta: float) -> None:
    low, high = (float(limit[index]) for limit in found.problem.limits)
    beyond = _push_from_bound(found, index) if theta <= low or theta >= high else 0.0
    if abs(theta) > MOST_SPREADS * parameter.spread or beyond > MOST_PUSHED:
        where = (
            f"{abs(theta) / parameter.spread:.1f} spreads of its prior off the file, at most {MOST_SPREADS:g}"
        )
        if beyond > MOST_PUSHED:
            where = (
                f"at {parameter.least if theta <= low else parameter.most:g} {parameter.unit}, and the"
                f" recording asks for {beyond:.0f} σ beyond, at most {MOST_PUSHED:g}"
            )
        raise ConfigurationError(
            "identification.at_bound", f"{parameter.name}: {where}: the arm behaves otherwise than the model"
        )


def _push_from_bound(found: Identified, index: int) -> float:
    """By how many of its σ the recording would move a parameter on from the bound that it stands at."""
    fit = found.whole
    downhill = fit.jacobian[:, index] @ fit.residuals.ravel()
    downhill -= fit.theta[index] / found.problem.spreads[index] ** 2
    return float(abs(downhill) * np.sqrt(fit.covariance[index, index]))
