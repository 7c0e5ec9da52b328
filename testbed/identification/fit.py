"""The stages in turn: from a checked recording and a plant file to parameters with their covariance."""

import math
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from typing import NamedTuple

import numpy as np

from plant_emulator.config.plant import PlantConfig
from plant_emulator.core import layout as col
from plant_emulator.core.layout import JOINTS, N_ACTUATORS
from plant_emulator.core.truth import COUNTS_PER_RADIAN
from testbed.identification.free_run import smoothed, start_of
from testbed.identification.operating import (
    SUPPLY_EDGE,
    Operating,
    PressureFit,
    file_model,
    operating,
    pressure_fit,
)
from testbed.identification.parameters import Parameter, base_of, parameters_of, start_parameters
from testbed.identification.recording import Array, MotionRecording
from testbed.identification.shooting import (
    DAMPINGS,
    Fit,
    FitProblem,
    Plan,
    misfit,
    refined,
    shoot,
    signals_of,
)
from testbed.identification.static_fit import DeadZone, ForceBalance, balance, dead_zone

WINDOW_S = 0.5
LONG_S = 2.0
_FAR = 300.0  # of the noise, in one run: a plant that leaves more goes through longer windows first
NEAR = Plan(0.0, 24, 8, DAMPINGS, 1e-2, frozenset())
WHOLE = Plan(0.0, 24, 8, DAMPINGS, 1e-6, frozenset())
"""Of one run: until noise and slopes are told well, then to the end. What they do not reach is refused."""
_ROUNDING = 1.0 / math.sqrt(12.0) / COUNTS_PER_RADIAN  # rad rms of a count


class Simple(NamedTuple):
    """What the first two stages found; None where the recording tells too little."""

    dead_zones: list[DeadZone]
    balance: ForceBalance | None
    pressures: PressureFit


class Identified(NamedTuple):
    """A fitted plant: the problem, what the simple stages found, the fit as one run."""

    problem: FitProblem
    joints: list[int]
    simple: Simple
    whole: Fit


def problem_of(config: PlantConfig, recording: MotionRecording, joints: Sequence[int]) -> FitProblem:
    """What is to be fitted to ``recording``, whose ``joints`` move, beginning with the plant ``config``."""
    fitted = recording.part(0.0, recording.about.held_out_from_s)
    start = start_of(fitted)
    rest = fitted.part(0.0, fitted.time_s[0] + fitted.about.rest_s)
    angle_std, pressure_std = _noise(config, rest, joints)
    play = config.errors.backlash
    half_play = 1e-3 * np.array(play.half_width_mrad if play.enabled else [0.0] * N_ACTUATORS)
    of_start = start_parameters(
        joints, start.of_noise * angle_std, start.of_noise * pressure_std, half_play.tolist()
    )
    used = signals_of(joints)
    std = np.array([angle_std if k < N_ACTUATORS else pressure_std for k in used])
    known = (*parameters_of(config, joints), *of_start)
    return FitProblem(base_of(config, fitted.period_s), known, fitted, start, smoothed(fitted), used, std)


def _noise(config: PlantConfig, rest: MotionRecording, joints: Sequence[int]) -> tuple[float, float]:
    """The noise of an angle (rad) and of a pressure (Pa), from one sample to the next at rest.

    Differences of neighbours, so that creep and slow waves do not count. An encoder's is at least its
    rounding.
    """
    angles = np.diff(rest.angles[:, list(joints)], axis=0) / math.sqrt(2.0)
    chambers = np.diff(rest.pressures.reshape(len(rest.time_s), -1), axis=0) / math.sqrt(2.0)
    noise = config.errors.encoder_noise
    file = (noise.rms_lsb if noise.enabled else 0.0) / COUNTS_PER_RADIAN
    least = math.hypot(file, _ROUNDING)
    return max(float(np.sqrt(np.mean(angles**2))), least), max(float(np.sqrt(np.mean(chambers**2))), 100.0)


def simple_stages(problem: FitProblem, joints: Sequence[int]) -> Simple:
    """Dead zones, friction and load, oil and orifices: by linear least squares."""
    config = PlantConfig.model_validate(problem.base)
    model = file_model(problem.base)
    series: list[Operating] = [operating(problem.base, model, problem.recording, j) for j in joints]
    zones = [dead_zone(one, model, way) for one in series for way in (1, -1)]
    found = [zone for zone in zones if zone is not None]
    poses = problem.smoothed.angles - 1e-3 * np.array(config.errors.encoder_offsets.mrad)
    forces = balance(series, model, config, poses)
    deadbands = {(zone.joint, zone.way): zone.deadband for zone in found}
    return Simple(found, forces, pressure_fit(series, model, deadbands))


def first_guess(problem: FitProblem, simple: Simple) -> Array:
    """Where the third stage begins (p,): what the simple stages found, at most two spreads off the file."""
    model = file_model(problem.base)
    nominal = model.actuators
    guess: dict[str, float] = {
        "bulk modulus": _log(simple.pressures.modulus, float(model.circuit[col.C_MODULUS]))
    }
    for flow in simple.pressures.flows:
        guess[f"{flow.name} rated flow +"] = _log(flow.extend, 1.0)
        guess[f"{flow.name} rated flow −"] = _log(flow.retract, 1.0)
    loops: dict[str, list[float]] = {}
    for zone in simple.dead_zones:
        sign, name = zone.name[-1], JOINTS[zone.joint]
        band = float(nominal[zone.joint, col.A_DEADBAND + SUPPLY_EDGE[zone.way]])
        guess[f"{name} deadband {sign}"] = _log(zone.deadband, band)
        file = float(problem.base["valves"]["joints"][name]["hysteresis"])
        loops.setdefault(name, []).append(file + 2.0 * zone.hysteresis)
    for name, widths in loops.items():
        file = float(problem.base["valves"]["joints"][name]["hysteresis"])
        guess[f"{name} hysteresis"] = _log(float(np.mean(widths)), file)
    if simple.balance is not None:
        guess["payload"] = simple.balance.more_kg
        for friction in simple.balance.frictions:
            row, name = nominal[friction.joint], JOINTS[friction.joint]
            guess[f"{name} Coulomb"] = _log(friction.coulomb, float(row[col.A_COULOMB]))
            guess[f"{name} viscous"] = _log(friction.viscous, float(row[col.A_VISCOUS]))
    return np.array([_within(p, guess.get(p.name, 0.0)) for p in problem.parameters])


def _log(found: float, nominal: float) -> float:
    return math.log(found / nominal) if found > 0.0 and nominal > 0.0 else 0.0


def _within(parameter: Parameter, guess: float) -> float:
    return float(np.clip(guess, -2.0 * parameter.spread, 2.0 * parameter.spread))


def identify(
    config: PlantConfig,
    recording: MotionRecording,
    joints: Sequence[int],
    pool: Executor | None = None,
    tell: Callable[[str], None] = lambda note: None,
) -> Identified:
    """The plant that ``recording`` is of, beginning with ``config``; ``joints`` move in it.

    Raises ConfigurationError where no plant can be run from the recording's start.
    """
    problem = problem_of(config, recording, joints)
    tell("dead zones, friction, oil")
    simple = simple_stages(problem, joints)
    theta = first_guess(problem, simple)
    small = frozenset(k for k, p in enumerate(problem.parameters) if p.of_start or p.is_small)
    windows = shoot(problem, theta, Plan(WINDOW_S, 8, 3, DAMPINGS, 0.05, small), pool, tell)
    all_free, runs = frozenset[int](), windows.runs + 1
    if misfit(problem, windows.theta) > _FAR:
        windows = shoot(problem, windows.theta, Plan(LONG_S, 6, 2, DAMPINGS, 0.05, all_free), pool, tell)
        runs += windows.runs
    near = shoot(problem, windows.theta, NEAR, pool, tell)
    problem = problem._replace(std=problem.std * _left_over(near, len(joints)))
    whole = shoot(problem, near.theta, WHOLE, pool, tell, near)
    whole = whole._replace(runs=whole.runs + near.runs + runs)
    return Identified(problem, list(joints), simple, reported(problem, whole))


def _left_over(near: Fit, joints: int) -> Array:
    """By what (k,) the noise told at rest is to be corrected: rms of what a close plant leaves.

    One number for the angles of all ``joints`` and one for all pressures, within a factor of three.
    """
    angles, pressures = near.residuals[:, :joints], near.residuals[:, joints:]
    both = [float(np.clip(np.sqrt(np.median(part**2) / 0.4549), 1 / 3, 3.0)) for part in (angles, pressures)]
    return np.array([both[0]] * joints + [both[1]] * pressures.shape[1])


IDENTIFIED_BELOW = 0.5
"""σ over the prior's spread below which the recording, and not the prior, says what a parameter is."""


class FixedParameters(NamedTuple):
    """``fixed`` parameters at the file's number, ``theta`` (p,) of all, ``covariance`` (p, p) of its error.

    In units of the priors' spreads.
    """

    fixed: tuple[int, ...]
    theta: Array
    covariance: Array


def fix_unidentified(theta: Array, posterior: Array, machine: list[int]) -> FixedParameters:
    """Put those of ``machine`` that are not told back to 0, one by one, the others conditioned on it.

    ``theta`` (p,) and the covariance ``posterior`` (p, p) of the fit, in units of the priors' spreads.
    """
    found, left, fixed = theta.copy(), posterior.copy(), list[int]()
    while True:
        spread = np.sqrt(np.maximum(np.diag(left), 0.0))
        open_ = [k for k in machine if k not in fixed]
        worst = max(open_, key=lambda k: spread[k], default=-1)
        if worst < 0 or spread[worst] < IDENTIFIED_BELOW:
            break
        along = left[:, worst] / left[worst, worst]
        found -= along * found[worst]
        left -= np.outer(along, left[worst])
        fixed.append(worst)
        found[fixed] = 0.0
    if not fixed:
        return FixedParameters((), found, left)
    slopes = np.linalg.solve(posterior[np.ix_(fixed, fixed)], posterior[fixed]).T  # (p, kept) of the means
    left[fixed] = 0.0
    left[:, fixed] = 0.0
    return FixedParameters(tuple(fixed), found, left + slopes @ slopes.T)


def _inverse(information: Array) -> Array:
    """The covariance of data of this ``information`` and the priors together, in units of the priors'."""
    return np.asarray(np.linalg.inv(information + np.eye(len(information))), dtype=np.float64)


def reported(problem: FitProblem, fit: Fit) -> Fit:
    """``fit`` with what the recording does not tell at the file's number, and the honest covariance.

    What is left beyond the noise told at rest widens what the data say, not what the priors do.
    """
    s, columns = problem.spreads, fit.jacobian * problem.spreads
    excess = max(fit.data / (fit.samples - len(s)), 1.0)
    posterior = _inverse(columns.T @ columns / excess)
    machine = [k for k, p in enumerate(problem.parameters) if not p.of_start]
    identified = fix_unidentified(fit.theta / s, posterior, machine)
    covariance = identified.covariance * np.outer(s, s)
    if not identified.fixed:
        return fit._replace(covariance=covariance)
    plan = Plan(0.0, 1, 0, (0.0, 0.1), 1e-6, frozenset(identified.fixed))
    moved = refined(problem, fit, identified.theta * s, plan)
    return moved._replace(covariance=covariance, fixed=identified.fixed, promised=fit.promised)
