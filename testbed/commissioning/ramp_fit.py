"""The rims of one valve edge, its flow and its oil's compliance from triangles, its delay from steps; pure.

Integrated once, dq/dt = g e f(u − c) − κ dp/dt is linear in all but the rims c: they alone are sought.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from protocol.errors import MeasurementFailed
from testbed.commissioning.recording import Array, StrokeRecord
from testbed.commissioning.uncertain import Uncertain

SLOW, _FAST = 0.15, 0.92  # of the ramp's top speed, between which its halves are used
_SMOOTH_S = 0.2  # of the speed that sorts samples; the fit itself uses angles
FED_BAR = 1.0  # above the tank: less, and a chamber is filled from there, and its edge meters nothing
_SWINGS_RAD = 5.0e-5  # left by rows in motion, from which on rows with flow are tried: a load swings
_OPENING = 0.3  # of the rising ramp, in which the valve may still be closed
_LEAST_S = 0.2  # in motion, on one half of a triangle or on a step
_GAP_SAMPLES = 20
CLEARLY = 1.3  # times less is left: more than chance
_SETTLES_S = 0.15  # a step's flow, after its delay
_DELAYS_S = np.arange(0.0, 0.3, 0.001)
_GAIN_FLOOR = 0.01
_CURVATURE_STD = 1.0  # prior of the flow's curvature: progressive notches have 0.7
NOISE_RAD = 2.0e-5  # of an encoder reading


class _Part(NamedTuple):
    """Rows of a stroke in motion, and the weights of the rims whose sum holds there."""

    stroke: StrokeRecord
    rows: NDArray[np.intp]
    weights: Array


class RampFits(NamedTuple):
    """All triangles of one sense. ``gain``: flow over nominal where the valve opens; ``curvature`` k of the
    flow, f(x) = x + k x²; ``compliance``: κ (rad/bar); arrays (n,), one number a triangle: spools where flow
    begins and ends, the command's rate (1/s), residual (rad)."""

    gain: Uncertain
    curvature: float
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


def fit_flowing(triangles: Sequence[StrokeRecord], steps: Sequence[tuple[StrokeRecord, float]]) -> RampFits:
    """The fit by rows in motion; where a load swings, by rows with flow, if that leaves clearly less.

    A load that swings on its oil is quick and slow while the flow hardly changes, and rows that are sorted by
    its speed hold such in which the spool still stands in its hysteresis.
    """
    try:
        by_speed = fit_ramps(triangles, steps)
    except MeasurementFailed as error:
        return _fit_by_flow(triangles, steps, error)
    left = float(np.sqrt(np.mean(by_speed.residual**2)))
    if left < _SWINGS_RAD:
        return by_speed
    try:
        by_flow = _fit_by_flow(triangles, steps, None)
    except MeasurementFailed:
        return by_speed
    return by_flow if CLEARLY * float(np.sqrt(np.mean(by_flow.residual**2))) < left else by_speed


def _fit_by_flow(
    triangles: Sequence[StrokeRecord],
    steps: Sequence[tuple[StrokeRecord, float]],
    error: MeasurementFailed | None,
) -> RampFits:
    """By the triangles whose both halves show flow. Raises ``error``, if any, where two are too few."""
    compliance = _compliance(triangles)
    told, why = [], error
    for stroke in triangles:
        try:
            _halves(stroke, compliance)
            told.append(stroke)
        except MeasurementFailed as short:
            why = why or short
    if why is not None and len(told) < 2:
        raise why
    return fit_ramps(told, steps, compliance)


def _compliance(triangles: Sequence[StrokeRecord]) -> float:
    """The oil's compliance (rad/bar) without a valve's model: while a ramp rises, its flow has no swings."""
    found = []
    for stroke in triangles:
        rows = np.arange(round(_OPENING * stroke.top), stroke.top)
        x = np.linspace(-1.0, 1.0, len(rows))
        matrix = np.column_stack([x**k for k in range(4)] + [stroke.inlet[rows[0]] - stroke.inlet[rows]])
        units = np.maximum(np.abs(matrix).max(axis=0), 1e-12)
        solved, *_ = np.linalg.lstsq(matrix / units, stroke.turned[rows], rcond=None)
        found.append(float(solved[-1] / units[-1]))
    return max(float(np.median(found)), 0.0)


def fit_ramps(
    triangles: Sequence[StrokeRecord],
    steps: Sequence[tuple[StrokeRecord, float]] = (),
    compliance: float = 0.0,
) -> RampFits:
    """The RampFits of one sense's triangles: one gain, curvature and compliance, two rims each.

    ``steps``, each with its delay (s), reach further open than triangles: they tell the curvature.
    ``compliance`` (rad/bar) sorts rows by the flow that it makes of speed and pressure; 0: by the speed.

    Given the rims, all else is linear: they alone are sought, by Gauss-Newton. Raises MeasurementFailed when
    too little of a triangle moved, or when flow over nominal is not positive.
    """
    rates = np.array([_rate(stroke) for stroke in triangles])
    one_each = iter(np.eye(2 * len(triangles)))
    halves = [
        _Part(stroke, rows, next(one_each)) for stroke in triangles for rows in _halves(stroke, compliance)
    ]
    outward = np.zeros(2 * len(triangles))
    outward[0::2] = _at_rest(rates)
    parts = halves + [_Part(s, rows, outward) for s, delay in steps for rows in _plateau(s, delay)]
    start = np.array([stroke.u[rows].min() for stroke, rows, _ in halves])

    def left_at(rims: Array) -> Array:
        return _misfit(parts, rims)[0]

    fit = least_squares(left_at, start, x_scale=1e-3, method="lm")
    left, found = _misfit(parts, fit.x)
    if not found[0] > 0.0:
        raise MeasurementFailed(
            "measurement.ramp_unlike_model", f"flow over nominal is {found[0]:.3g}, wanted > 0"
        )
    ends = np.cumsum([0, *(len(rows) for _, rows, _ in halves)])
    residual = [float(np.sqrt(np.mean(left[ends[k] : ends[k + 2]] ** 2))) for k in range(0, len(halves), 2)]
    return RampFits(
        gain=Uncertain(float(found[0]), _GAIN_FLOOR * float(found[0])),
        curvature=float(found[1] / found[0]),
        compliance=float(found[2]),
        rising=fit.x[0::2],
        falling=fit.x[1::2],
        rate=rates,
        residual=np.array(residual),
    )


def _misfit(parts: Sequence[_Part], rims: Array) -> tuple[Array, Array]:
    """What the best linear fit at these rims leaves (rad), and its gain, gain · curvature, κ, and offsets."""
    blocks, targets = [], []
    for k, (stroke, rows, weights) in enumerate(parts):
        beyond = np.maximum(stroke.u[rows] - weights @ rims, 0.0)
        block = np.zeros((len(rows), 3 + len(parts)))
        block[:, 0] = _integral(stroke.t[rows], stroke.e[rows] * beyond)
        block[:, 1] = _integral(stroke.t[rows], stroke.e[rows] * beyond**2)
        block[:, 2] = -(stroke.inlet[rows] - stroke.inlet[rows[0]])
        block[:, 3 + k] = 1.0
        blocks.append(block)
        targets.append(stroke.turned[rows])
    prior = np.zeros((1, 3 + len(parts)))
    scale = max(float(np.abs(blocks[0][:, 0]).max()), 1e-9) / max(float(np.abs(targets[0]).max()), 1e-9)
    prior[0, 1] = NOISE_RAD * scale / _CURVATURE_STD
    matrix, wanted = np.vstack([*blocks, prior]), np.concatenate([*targets, np.zeros(1)])
    units = np.maximum(np.abs(matrix).max(axis=0), 1e-12)
    solved, *_ = np.linalg.lstsq(matrix / units, wanted, rcond=None)
    return wanted - (matrix / units) @ solved, solved / units


def _rate(stroke: StrokeRecord) -> float:
    return float(np.median(np.abs(np.diff(stroke.u)) / np.diff(stroke.t)))


def _halves(stroke: StrokeRecord, compliance: float) -> list[NDArray[np.intp]]:
    """The rows in motion, or with flow, on either half of a triangle, rising first, while its edge meters."""
    speed = smoothed_speed(stroke, compliance)
    top = float(speed.max())
    index = np.arange(len(speed))
    slow = np.abs(np.gradient(stroke.u, stroke.t)) < 1.5 * _rate(stroke)  # not the quick turn at the top
    usable = (speed > SLOW * top) & (speed < _FAST * top) & slow & (stroke.fed_bar > FED_BAR)
    found = []
    for name, half in (("rising", usable & (index < stroke.top)), ("falling", usable & (index > stroke.top))):
        rows = _longest_run(half)
        seconds = float(stroke.t[rows[-1]] - stroke.t[rows[0]]) if len(rows) else 0.0
        if seconds < _LEAST_S:
            raise MeasurementFailed(
                "measurement.ramp_too_short",
                f"{seconds:.2f} s in motion on the {name} ramp, at least {_LEAST_S:g} s wanted",
            )
        found.append(rows)
    return found


def _plateau(stroke: StrokeRecord, delay: float) -> list[NDArray[np.intp]]:
    """The rows of a step once its flow is steady and metered by the edge that is told."""
    rows = _longest_run((stroke.t > delay + _SETTLES_S) & (stroke.fed_bar > FED_BAR))
    return [rows] if len(rows) and stroke.t[rows[-1]] - stroke.t[rows[0]] >= _LEAST_S else []


def _at_rest(rates: Array) -> Array:
    """Weights with which the rims of rising ramps at these rates make that of a spool that has come out and
    stands: the lag's part grows with the rate, and is left out by a line through them."""
    if np.ptp(rates) < 0.2 * rates.mean():
        return np.full(len(rates), 1.0 / len(rates))
    matrix = np.column_stack([np.ones_like(rates), rates])
    return np.asarray(np.linalg.pinv(matrix)[0])


def _longest_run(flags: NDArray[np.bool_]) -> NDArray[np.intp]:
    """The longest run of samples for which ``flags`` hold; a swing may interrupt it shortly."""
    rows = np.flatnonzero(flags)
    if len(rows) == 0:
        return rows
    runs = np.split(rows, np.flatnonzero(np.diff(rows) > _GAP_SAMPLES) + 1)
    longest = max(runs, key=len)
    return np.arange(longest[0], longest[-1] + 1)


def fit_step(stroke: StrokeRecord) -> StepFit:
    """The StepFit of a step: the delay is the one with which constant flow from then on fits best."""
    passed = _integral(stroke.t, stroke.e)
    best: tuple[float, float, float] | None = None
    for delay in _DELAYS_S:
        if delay > 0.6 * stroke.t[-1]:
            break
        since = np.maximum(passed - np.interp(delay, stroke.t, passed), 0.0)
        matrix = np.column_stack([np.ones_like(since), since, -1e-4 * (stroke.inlet - stroke.inlet[0])])
        found, *_ = np.linalg.lstsq(matrix, stroke.turned, rcond=None)
        residual = float(np.sqrt(np.mean((stroke.turned - matrix @ found) ** 2)))
        if best is None or residual < best[0]:
            best = residual, float(delay), float(found[1])
    if best is None:
        raise MeasurementFailed("measurement.step_too_short", f"a step of {stroke.t[-1]:.3f} s")
    residual, delay, speed = best
    return StepFit(float(stroke.u[stroke.top]), delay, speed, residual)


def smoothed_speed(stroke: StrokeRecord, compliance: float = 0.0) -> Array:
    """The mean speed (n,) rad/s along the stroke's sense over a window about each sample; with
    ``compliance`` (rad/bar) that of the oil that flows in."""
    passed = stroke.turned + compliance * stroke.inlet
    half = max(1, round(0.5 * _SMOOTH_S / float(np.median(np.diff(stroke.t)))))
    index = np.arange(len(stroke.t))
    before, after = np.maximum(index - half, 0), np.minimum(index + half, len(index) - 1)
    return np.asarray((passed[after] - passed[before]) / (stroke.t[after] - stroke.t[before]))


def _integral(t: Array, values: Array) -> Array:
    """The integral (n,) from the first sample on, by trapezoids."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(t))])
