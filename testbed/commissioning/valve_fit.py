"""Deadband, hysteresis, delay and flow of one valve edge from ramps and steps; pure functions.

Above the deadband's rim c the joint moves with dq/dt = g e (u − c) − κ dp/dt: g is the true flow over the
nominal one, e the nominal speed at full opening at the measured pressures, u the spool, p the load pressure
and κ the oil's compliance. Integrated once, every unknown is a factor of a measured signal: encoders are not
differentiated, and the oil that fills the chambers instead of moving the load is not taken for deadband.

On its way up the spool lags behind its command by half the hysteresis h and by the delay τ, on its way down
it leads by the first: c_rising = d + h/2 + ρ τ, c_falling = d − h/2 − ρ τ at the ramp's rate ρ. So the mean
is the deadband d, whatever h and τ are.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controller.core.excitation.plan import StrokeKind
from protocol.errors import MeasurementFailed
from testbed.commissioning.recording import Array, StrokeRecord
from testbed.commissioning.uncertain import Uncertain, repeated

_SLOW, _FAST = 0.15, 0.92  # of the ramp's top speed, between which its halves are used
_SMOOTH_S = 0.2  # of the speed that sorts samples; the fit itself uses angles
_LEAST_SAMPLES = 40
_DELAYS_S = np.arange(0.0, 0.3, 0.001)
# Standard deviation of what repeating does not average out: leakage past the spool and the orifice's laminar
# part shift the rim by up to about 2e-4 of the spool, the other errors grow with the deadband.
_RIM_FLOOR, _RIM_SHARE = 1.0e-4, 0.006
_GAIN_FLOOR = 0.01
_DELAY_FLOOR_S = 0.003
_WIDTH_FLOOR = 1.0e-4  # of spool


class RampFits(NamedTuple):
    """All triangles of one sense. ``gain``: flow over nominal; ``compliance``: κ (rad/bar); arrays (n,), one
    number a triangle: spools where flow begins and ends, the command's rate (1/s), residual (rad)."""

    gain: Uncertain
    compliance: float
    rising: Array
    falling: Array
    rate: Array
    residual: Array


class StepFit(NamedTuple):
    """One step: spool, time (s) from command to flow, speed over the nominal one at full opening."""

    spool: float
    delay: float
    relative_speed: float
    residual: float


class EdgeFindings(NamedTuple):
    """One sense of one valve.

    ``deadband``, ``hysteresis``: of the spool. ``lag`` (s): from a slowly changing command to the flow;
    ``response`` (s): from a step to its flow. ``gain``: true flow over nominal; ``compliance`` (rad/bar): of
    the oil; ``flow``: (spool, speed over nominal at full spool) of every step. ``residual`` (rad): rms of
    the worst ramp.
    """

    deadband: Uncertain
    hysteresis: Uncertain
    lag: Uncertain
    response: Uncertain
    gain: Uncertain
    compliance: float
    flow: tuple[tuple[float, float], ...]
    residual: float


def edge_findings(strokes: Sequence[StrokeRecord], sense: float) -> EdgeFindings:
    """What the strokes of one sense say. Raises MeasurementFailed where they say too little."""
    mine = [stroke for stroke in strokes if stroke.sense == sense]
    triangles = [stroke for stroke in mine if stroke.kind is StrokeKind.RAMP][1:]  # the first found the way
    steps = [fit_step(stroke) for stroke in mine if stroke.kind is StrokeKind.STEP]
    if len(triangles) < 2 or len(steps) < 2:
        why = f"{len(triangles)} full ramps and {len(steps)} steps: two of each are wanted"
        raise MeasurementFailed("measurement.too_few_strokes", why)
    ramps = fit_ramps(triangles)
    middle = 0.5 * (ramps.rising + ramps.falling)
    hysteresis, lag = _loop(ramps)
    return EdgeFindings(
        deadband=repeated(middle.tolist(), math.hypot(_RIM_FLOOR, _RIM_SHARE * float(middle.mean()))),
        hysteresis=hysteresis,
        lag=lag,
        response=repeated([step.delay for step in steps], _DELAY_FLOOR_S),
        gain=ramps.gain,
        compliance=ramps.compliance,
        flow=tuple((step.spool, step.relative_speed) for step in steps),
        residual=float(ramps.residual.max()),
    )


def _loop(ramps: RampFits) -> tuple[Uncertain, Uncertain]:
    """Hysteresis (of spool) and lag (s): the loop's width is h + 2 ρ τ, at two rates ρ or more."""
    width = ramps.rising - ramps.falling
    matrix = np.column_stack([np.ones_like(width), 2.0 * ramps.rate])
    if np.ptp(ramps.rate) < 0.2 * ramps.rate.mean():
        raise MeasurementFailed(
            "measurement.one_pace", "all ramps have one pace: hysteresis and lag look alike"
        )
    found, *_ = np.linalg.lstsq(matrix, width, rcond=None)
    error = math.hypot(_WIDTH_FLOOR, float(np.std(width - matrix @ found)) * 2.0)
    covariance = error**2 * np.linalg.inv(matrix.T @ matrix)
    stds = np.sqrt(np.diag(covariance))
    return Uncertain(float(found[0]), float(stds[0])), Uncertain(float(found[1]), float(stds[1]))


def fit_ramps(triangles: Sequence[StrokeRecord]) -> RampFits:
    """The RampFits of one sense's triangles: one gain and one compliance, two rims each.

    Raises MeasurementFailed when too little of one moved, or when flow over nominal is not positive.
    """
    halves = [half for triangle in triangles for half in _halves(triangle)]
    count = 2 + 2 * len(halves)
    blocks, targets = [], []
    for k, (stroke, rows) in enumerate(halves):
        block = np.zeros((len(rows), count))
        block[:, 0] = _integral(stroke.t[rows], stroke.e[rows] * stroke.u[rows])
        block[:, 1] = -(stroke.load[rows] - stroke.load[rows[0]])
        block[:, 2 + 2 * k] = 1.0
        block[:, 3 + 2 * k] = -_integral(stroke.t[rows], stroke.e[rows])
        blocks.append(block)
        targets.append(stroke.turned[rows])
    matrix, wanted = np.vstack(blocks), np.concatenate(targets)
    scale = np.maximum(np.abs(matrix).max(axis=0), 1e-12)
    solved, *_ = np.linalg.lstsq(matrix / scale, wanted, rcond=None)
    found = solved / scale
    if not found[0] > 0.0:
        raise MeasurementFailed(
            "measurement.ramp_unlike_model", f"flow over nominal is {found[0]:.3g}, wanted > 0"
        )
    rims = found[3::2] / found[0]
    square = (wanted - matrix @ found) ** 2
    ends = np.cumsum([0, *map(len, targets)])
    residual = np.sqrt([square[ends[k] : ends[k + 2]].mean() for k in range(0, len(halves), 2)])
    return RampFits(
        gain=Uncertain(float(found[0]), _GAIN_FLOOR * float(found[0])),
        compliance=float(found[1]),
        rising=rims[0::2],
        falling=rims[1::2],
        rate=np.array([_rate(stroke) for stroke in triangles]),
        residual=residual,
    )


def _rate(stroke: StrokeRecord) -> float:
    return float(np.median(np.abs(np.diff(stroke.u)) / np.diff(stroke.t)))


def _halves(stroke: StrokeRecord) -> list[tuple[StrokeRecord, NDArray[np.intp]]]:
    """The rows in motion on the rising and the falling half of a triangle."""
    speed = smoothed_speed(stroke)
    top = float(speed.max())
    index = np.arange(len(speed))
    slow = np.abs(np.gradient(stroke.u, stroke.t)) < 1.5 * _rate(stroke)  # not the quick turn at the top
    usable = (speed > _SLOW * top) & (speed < _FAST * top) & slow
    found = []
    for name, half in (("rising", usable & (index < stroke.top)), ("falling", usable & (index > stroke.top))):
        rows = np.flatnonzero(half)
        if len(rows) < _LEAST_SAMPLES:
            raise MeasurementFailed(
                "measurement.ramp_too_short",
                f"{len(rows)} samples in motion on the {name} ramp, at least {_LEAST_SAMPLES} wanted",
            )
        found.append((stroke, np.arange(rows[0], rows[-1] + 1)))
    return found


def fit_step(stroke: StrokeRecord) -> StepFit:
    """The StepFit of a step: the delay is the one with which constant flow from then on fits best."""
    passed = _integral(stroke.t, stroke.e)
    best: tuple[float, float, float] | None = None
    for delay in _DELAYS_S:
        if delay > 0.6 * stroke.t[-1]:
            break
        since = np.maximum(passed - np.interp(delay, stroke.t, passed), 0.0)
        matrix = np.column_stack([np.ones_like(since), since, -1e-4 * (stroke.load - stroke.load[0])])
        found, *_ = np.linalg.lstsq(matrix, stroke.turned, rcond=None)
        residual = float(np.sqrt(np.mean((stroke.turned - matrix @ found) ** 2)))
        if best is None or residual < best[0]:
            best = residual, float(delay), float(found[1])
    if best is None:
        raise MeasurementFailed("measurement.step_too_short", f"a step of {stroke.t[-1]:.3f} s")
    residual, delay, speed = best
    return StepFit(float(stroke.u[stroke.top]), delay, speed, residual)


def smoothed_speed(stroke: StrokeRecord) -> Array:
    """The speed (n,) rad/s along the stroke's sense, a moving mean."""
    width = max(3, round(_SMOOTH_S / float(np.median(np.diff(stroke.t)))))
    speed = np.gradient(stroke.turned, stroke.t)
    padded = np.pad(speed, width // 2, mode="edge")
    return np.convolve(padded, np.ones(width) / width, mode="same")[width // 2 : width // 2 + len(speed)]


def _integral(t: Array, values: Array) -> Array:
    """The integral (n,) from the first sample on, by trapezoids."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(t))])
